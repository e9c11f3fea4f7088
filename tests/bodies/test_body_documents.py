"""The documented forms of rig, layer, transform group and metadata: read, written, read again; and messages about mistakes."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from body_parts import READERS, Reader, read_part

from antdsl import limits
from antdsl.bodies.agents.definition import Binding, Channel, Rig, TransformGroup
from antdsl.bodies.files.documents import TypedValue, write_group, write_layer, write_metadata, write_rig

RIG = """{
    "rig_version": 1,
    "transforms": {
        "palm": ["thumb", "finger"],
        "thumb": [],
        "fingertip": [],
        "finger": ["fingertip"],
    },
    "channels": {
        "frown": {"default_value": 0, "transform": ""},
        "finger.swell": {"default_value": 0.5, "transform": "finger"}
    }
}
"""
LAYER = """{
    "version": 2,
    "name": "gloved",
    "static": [{"transform": "finger", "shape": "ring", "bounds_scale": [1,1,1], "deformer": ""}],
    "deforming": [{"transform": "", "shape": "glove", "bounds_scale": [1,1.5,1], "deformer": "linearskinning"}]
}
"""
GROUP = """{
    "version": 2,
    "name": "fingers",
    "members": [{"name": "thumb", "weight": 0.25}, {"name": "finger", "weight": 1}],
    "channels": [{"name": "frown"}]
}
"""
METADATA = """{
    "height": 2.3,
    "made_by": "somebody",
    "parts": [1, 2.5, "three"],
    "version": {"type": "int", "value": 2},
    "inner": {"type": "a key as any other", "value": 1, "more": {"type": "vector3", "value": [1, 2, 3]}}
}
"""


def rig_of(text: str) -> Rig:
    parsed_rig, report = read_part(text.encode(), READERS["rig"])
    assert parsed_rig is not None and not report.diagnostics, report.diagnostics
    return parsed_rig


def test_a_rig_is_a_tree_in_any_order_with_channels() -> None:
    rig = rig_of(RIG)
    assert rig.names == ("palm", "thumb", "finger", "fingertip") and rig.parents.tolist() == [-1, 0, 0, 2]
    assert rig.channels == (Channel("frown"), Channel("finger.swell", 0.5, "finger"))
    assert (rig.rest_matrices == np.eye(4)).all() and rig.rest_matrices.shape == (4, 4, 4)


def test_what_is_written_is_read_as_it_was() -> None:
    rig = rig_of(RIG)
    rig.rest_matrices[2, :3] = [[0.1, 2, 3, 4], [5, 1 / 3, 7, 8], [9, 10, 11, 1e-7]]
    text = write_rig(rig)
    again = rig_of(text)
    assert (again.names, again.channels) == (rig.names, rig.channels)
    assert (again.parents == rig.parents).all() and (again.rest_matrices == rig.rest_matrices).all() and write_rig(again) == text
    writers: tuple[tuple[str, str, Callable[[Any], str]], ...] = (
        (LAYER, "layer", write_layer), (GROUP, "group", write_group), (METADATA, "metadata", write_metadata),
    )  # fmt: skip
    for json_text, kind, write in writers:
        part, report = read_part(json_text.encode(), READERS[kind])
        assert part is not None and not report.diagnostics, report.diagnostics
        assert read_part(write(part).encode(), READERS[kind])[0] == part


def test_layers_groups_and_metadata_say_what_the_text_says() -> None:
    layer, _ = read_part(LAYER.encode(), READERS["layer"])
    group, _ = read_part(GROUP.encode(), READERS["group"])
    metadata, _ = read_part(METADATA.encode(), READERS["metadata"])
    assert layer is not None and layer.static == (Binding("finger", "ring"),)
    assert layer.deforming == (Binding("", "glove", (1.0, 1.5, 1.0), "linearskinning"),)
    assert group == TransformGroup("fingers", (("thumb", 0.25), ("finger", 1.0)), ("frown",))
    assert metadata is not None and metadata["version"] == TypedValue("int", 2) and metadata["parts"] == [1, 2.5, "three"]
    assert type(metadata["parts"][0]) is int
    assert metadata["inner"] == {"type": "a key as any other", "value": 1, "more": TypedValue("vector3", [1, 2, 3])}


def test_several_roots_are_fine() -> None:
    assert rig_of('{"rig_version": 1, "transforms": {"a": [], "b": ["c"], "c": []}}').parents.tolist() == [-1, -1, 1]


def rig(transforms: str, extra_text: str = "") -> str:
    return f'{{"rig_version": 1, "transforms": {transforms}{extra_text}}}'


RESTS = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]]"
STILL = "[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
RIGS = [
    (rig('{"a": ["b"], "c": ["b"], "b": []}'), "bad-rig", '"b"', "delete `b` below one of them"),
    (rig('{"a": ["b"], "b": ["a"]}'), "bad-rig", '"b"', "delete `b` here, so that one of them is a root"),
    (rig('{"a": ["a"]}'), "bad-rig", '"a"', "delete `a` here, so that one of them is a root"),
    (rig('{"root": ["LUperArm"], "LUpperArm": []}'), "bad-rig", '"LUperArm"', 'write `"LUpperArm"`'),
    (rig('{"root": ["tail"]}'), "bad-rig", '"tail"', 'add `"tail": []` to the transforms'),
    (rig("{}"), "bad-rig", "{", 'write `{"root": []}`'),
    (rig('{"a": ["b", "b"], "b": []}'), "duplicate-name", '"b"', "keep one of them"),
    (rig('{"a": [], "a": []}'), "duplicate-key", '"a"', "keep one of them"),
    (rig('{"a": "b"}'), "wrong-value", '"b"', "write `[ … ]`"),
    (rig('{"a": [1]}'), "wrong-value", "[", None),
    (rig('{"": []}'), "wrong-value", '""', None),
    ('{"rig_version": 2, "transforms": {"a": []}}', "wrong-value", "2", "write `1` if the file has this format"),
    ('{"rig_version": true, "transforms": {"a": []}}', "wrong-value", "true", "write `1` if the file has this format"),
    ('{"rig_version": 1}', "missing-key", "{", 'add `"transforms": {}`'),
    ('{"rig_version": 1, "transform": {"a": []}}', "unknown-key", '"transform"', 'write `"transforms"`'),
    ("[]", "wrong-value", "[", "write `{ … }`"),
    (rig('{"a": []}', ', "channels": {"c": {"transform": "A"}}'), "unknown-name", '"A"', 'write `"a"`'),
    (rig('{"a": []}', ', "channels": {"c": {"default_value": "1"}}'), "wrong-value", '"1"', None),
    (rig('{"a": []}', ', "channels": {"c": {"default_value": 1e39}}'), "out-of-range", "1e39", None),
    (rig('{"a": []}', f', "antdsl_rest": {{"a": {RESTS}}}'), "wrong-value", "[", "write the translation into the last column"),
    (rig('{"a": []}', ', "antdsl_rest": {"a": [[1, 0, 0, 0], [0, 1, 0, 0]]}'), "wrong-value", "[", None),
    (rig('{"arm": []}', f', "antdsl_rest": {{"arms": {STILL}}}'), "unknown-key", '"arms"', 'write `"arm"`'),
]  # fmt: skip
LAYERS = [
    ('{"version": 1, "name": "x"}', "wrong-value", "1", "write `2` if the file has this format"),
    ('{"version": 2, "name": 3}', "wrong-value", "3", 'write `"…"`'),
    ('{"version": 2, "name": "x", "static": [{"transform": "a"}]}', "missing-key", "{", 'add `"shape": "…"`'),
    ('{"version": 2, "name": "x", "static": [{"transform": "", "shape": "s"}]}', "wrong-value", '""', None),
    ('{"version": 2, "name": "x", "static": [{"transform": "a", "shape": "s", "deformer": "linearskinning"}]}',
     "wrong-value", '"linearskinning"', 'move the shape to `deforming`, or write `""` as its deformer'),
    ('{"version": 2, "name": "x", "deforming": [{"shape": "s", "deformer": ""}]}', "wrong-value", '""', None),
    ('{"version": 2, "name": "x", "static": [{"transform": "a", "shape": "s", "bounds_scale": [1, 1]}]}',
     "wrong-value", "[1, 1]", None),
    ('{"version": 2, "name": "x", "static": [{"transform": "a", "shape": "s", "bounds_scale": [1, -1, 1]}]}',
     "out-of-range", "-1", "write `0`"),
    ('{"version": 2, "name": "x", "static": [{"transform": "a", "shape": "s", "bounds_scale": [1, true, 1]}]}',
     "wrong-value", "true", None),
    ('{"version": 2, "name": null}', "wrong-value", "null", "delete the key"),
    ('{"version": 2, "name": "x", "static": [null]}', "wrong-value", "null", "delete it"),
    ('{"version": 2, "name": "x", "static": [1, 2]}', "wrong-value", "[", None),
]  # fmt: skip
GROUPS = [
    ('{"version": 2, "name": "x", "members": [{"name": "a", "weight": 1.5}]}', "out-of-range", "1.5", "write `1`"),
    ('{"version": 2, "name": "x", "members": [{"name": "a", "weight": -0.1}]}', "out-of-range", "-0.1", "write `0`"),
    ('{"version": 2, "name": "x", "members": [{"name": "a"}, {"name": "a"}]}', "duplicate-name", '"a"', "keep one of them"),
    ('{"version": 2, "name": "x", "channels": ["a"]}', "wrong-value", '"a"', "write `{ … }`"),
    ('{"version": 2, "name": "x", "members": {}}', "wrong-value", "{", "write `[ … ]`"),
]
METADATAS = [
    ('{"a": {"type": "int", "value": 2.5}}', "wrong-value", "2.5", "write the whole number `2`, or change the type to `float`"),
    ('{"a": {"type": "vector3", "value": [1, 2]}}', "wrong-value", "[", None),
    ('{"a": {"type": "string", "value": 1}}', "wrong-value", "1", None),
    ('{"a": {"type": 1, "value": 1}}', "wrong-value", "1", 'write it in quotes, such as `"float"`'),
    ('{"a": true}', "wrong-value", "true", "write `1`"),
    ('{"a": null}', "wrong-value", "null", "delete the key"),
    ("[1]", "wrong-value", "[", 'write `{"name": 1}`'),
]
CASES = [
    (text, READERS[kind], *rest)
    for kind, cases in (("rig", RIGS), ("layer", LAYERS), ("group", GROUPS), ("metadata", METADATAS))
    for text, *rest in cases
]


@pytest.mark.parametrize(("text", "read", "code", "marked", "help"), CASES, ids=[case[0][:70] for case in CASES])
def test_a_mistake_is_reported_at_its_place_with_what_to_write(
    text: str, read: Reader, code: str, marked: str, help: str | None
) -> None:
    part, report = read_part(text.encode(), read)
    assert part is None
    (error,) = report.errors
    assert error.span is not None and (error.code, error.span.text, error.help) == (code, marked, help), error


def test_additions_of_others_to_a_documented_form_are_reported_and_read() -> None:
    text = '{"version": 2, "name": "x", "colour": 1, "members": [{"name": "a", "side": "left"}]}'
    part, report = read_part(text.encode(), READERS["group"])
    assert part == TransformGroup("x", (("a", 1.0),))
    assert [(each.severity, each.code) for each in report.diagnostics] == [("warning", "unknown-key")] * 2


def test_bytes_that_are_no_text_and_too_many_joints_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert read_part(b"\xff\xfe{}", READERS["rig"])[1].errors[0].code == "not-utf8"
    monkeypatch.setattr(limits, "MAX_RIG_JOINTS", 2)
    assert read_part(RIG.encode(), READERS["rig"])[1].errors[0].code == "too-large"


def test_a_deep_rig_is_read_without_recursion() -> None:
    names = [f"j{number}" for number in range(limits.MAX_RIG_JOINTS)]
    children = [f'"{a}": ["{b}"]' for a, b in pairwise(names)]
    deep_rig = rig_of(rig("{" + ", ".join([*children, f'"{names[-1]}": []']) + "}"))
    assert deep_rig.parents.tolist() == list(range(-1, limits.MAX_RIG_JOINTS - 1))
