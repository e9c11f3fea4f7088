"""Definition files: parts inside or in separate files, shapes, libraries, clips of other files; messages about mistakes."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import gltf_bodies
import pytest

from antdsl import limits
from antdsl.bodies.agents.definition import BlendTargets, Definition, InBetweens
from antdsl.bodies.files.clip_document import write_clip
from antdsl.bodies.files.documents import TypedValue
from antdsl.bodies.files.named_files import BodyFiles
from antdsl.bodies.files.reading import read_definition
from antdsl.diagnostics import Diagnostic
from antdsl.scene.paths import Roots

RIG = {
    "rig_version": 1,
    "transforms": {"root": ["hand"], "hand": []},
    "channels": {"fist": {"default_value": 0, "transform": ""}},
}
OBJ = "v 0 0 0\nv 10 0 0\nv 0 4 0\nf 1 2 3\n"
LAYER = {"version": 2, "name": "armed", "static": [{"transform": "hand", "shape": "sword"}]}
GROUP = {"version": 2, "name": "arm", "members": [{"name": "hand", "weight": 0.5}], "channels": [{"name": "fist"}]}
CLIP = {"antdsl_clip": 1, "name": "wave", "rate": 10, "channels": {"hand:tx": [0, 1, 0]}}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "sword.obj").write_text(OBJ)
    tree, data = gltf_bodies.arm()
    (tmp_path / "arm.glb").write_bytes(gltf_bodies.binary(tree, data))
    return tmp_path


def read(folder: Path, **parts: Any) -> tuple[Definition | None, list[Diagnostic]]:
    (folder / "body.json").write_text(json.dumps({"antdsl_body": 1, **parts}))
    definition, report = read_definition(folder / "body.json")
    return definition, report.diagnostics


def fine(folder: Path, **parts: Any) -> Definition:
    definition, diagnostics = read(folder, **parts)
    assert definition is not None and not diagnostics, diagnostics
    return definition


def error_of(folder: Path, **parts: Any) -> tuple[str, str, str | None]:
    """Code, marked text and help of the one error."""
    definition, diagnostics = read(folder, **parts)
    assert definition is None
    (error,) = [each for each in diagnostics if each.severity == "error"]
    return error.code, error.span.text if error.span else "", error.help


COMPLETE_BODY: dict[str, Any] = {
    "name": "soldier", "front": "+x", "up": "+z", "units": "cm",
    "shapes": [{"file": "sword.obj", "name": "sword", "units": "mm", "material": "steel"}],
    "materials": {"steel": [0.5, 0.5, 0.6]},
}  # fmt: skip


def test_parts_are_inside_or_in_files_of_their_own(folder: Path) -> None:
    inside = fine(
        folder,
        **COMPLETE_BODY,
        rig=RIG,
        layers=[LAYER],
        groups=[GROUP],
        clips=[CLIP],
        metadata={"a": {"type": "int", "value": 2}},
    )
    (folder / "parts").mkdir()
    named = {}
    metadata = {"a": {"type": "int", "value": 2}}
    for name, part in (("rig", RIG), ("layer", LAYER), ("group", GROUP), ("clip", CLIP), ("metadata", metadata)):
        (folder / "parts" / f"{name}.json").write_text(json.dumps(part))
        named[name] = {"file": f"parts/{name}.json"}
    beside = fine(
        folder, **COMPLETE_BODY, rig=named["rig"], layers=[named["layer"]], groups=[named["group"]], clips=[named["clip"]],
        metadata=named["metadata"],
    )  # fmt: skip
    for each in (inside, beside):
        assert (each.name, each.rig.names, each.front, each.up) == ("soldier", ("root", "hand"), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
        assert each.unit == 10.0 and each.length == 1.0  # 10 mm along x
        assert list(each.layers) == ["armed"] and each.groups["arm"].members == (("hand", 0.5),)
        assert each.clips["wave"].sample_count == 3 and each.metadata == {"a": TypedValue("int", 2)}
        assert each.shapes["sword"].materials == ("steel",) and each.materials == {"steel": (0.5, 0.5, 0.6)}


def test_all_of_a_gltf_file_and_what_is_said_beside(folder: Path) -> None:
    clips = [{"clip": "bend", "name": "salute", "loop": False, "stride": 3, "marks": {"top": 0.5}}]
    layer = {"version": 2, "name": "armed", "static": [{"transform": "elbow", "shape": "sword"}]}
    body = fine(
        folder, **{"from": "arm.glb"}, shapes=[{"file": "sword.obj", "name": "sword"}], layers=[layer], clips=clips, length=4
    )
    assert list(body.shapes) == ["arm", "arm.smile", "sword"] and list(body.layers) == ["body", "armed"]
    assert list(body.clips) == ["hop", "smile", "salute"] and body.length == 4.0 and body.unit == 1000.0
    salute = body.clips["salute"]
    assert (salute.name, salute.loop, salute.stride, salute.marks) == ("salute", False, 3.0, {"top": 0.5})


def test_clips_of_another_file_lose_what_the_rig_does_not_have(folder: Path) -> None:
    rig = {"rig_version": 1, "transforms": {"elbow": []}}
    body, diagnostics = read(folder, rig=rig, length=1, clips=[{"file": "arm.glb", "clip": "hop", "rate": 10}])
    assert body is not None and body.clips["hop"].joints == ("elbow",) and body.clips["hop"].sample_count == 11
    assert [each.code for each in diagnostics] == ["body-left-out"] and "`root`" in diagnostics[0].message


def test_what_a_clip_of_a_file_does_not_key_rests_as_in_the_rig(folder: Path) -> None:
    rest = [[1, 0, 0, 3], [0, 1, 0, 5], [0, 0, 1, 7], [0, 0, 0, 1]]
    rig = {"rig_version": 1, "transforms": {"root": ["elbow"], "elbow": []}, "antdsl_rest": {"elbow": rest}}
    shapes = [{"file": "arm.glb", "shape": "arm.smile", "name": "mask"}]
    for parts in ({}, {"shapes": shapes}):  # whether the file was read before for its shapes or not
        body, _ = read(folder, rig=rig, length=1, clips=[{"file": "arm.glb", "clip": "bend"}], **parts)
        assert body is not None and (body.clips["bend"].translation[:, 0] == (3, 5, 7)).all()


def test_a_usd_file_is_read_once_for_shapes_and_clips(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    arm, _ = read_definition(folder / "arm.glb")
    assert arm is not None
    calls: list[str] = []
    monkeypatch.setattr(BodyFiles, "_read_usd", lambda self, full, *_: calls.append(full) or (arm, []))
    rest = [[1, 0, 0, 3], [0, 1, 0, 5], [0, 0, 1, 7], [0, 0, 0, 1]]
    rig = {"rig_version": 1, "transforms": {"root": ["elbow"], "elbow": []}, "antdsl_rest": {"elbow": rest}}
    shapes = [{"file": "arm.usda", "shape": "arm.smile", "name": "mask"}]
    body, _ = read(folder, rig=rig, length=1, shapes=shapes, clips=[{"file": "arm.usda", "clip": "bend"}])
    assert body is not None and calls == ["arm.usda"]


def test_joints_stay_in_the_order_of_the_text_where_parents_come_first(folder: Path) -> None:
    tree = {"root": ["a", "b"], "a": ["c"], "b": [], "c": []}
    assert fine(folder, rig={"rig_version": 1, "transforms": tree}, length=1).rig.names == ("root", "a", "b", "c")
    tree = {"c": [], "root": ["a", "b"], "a": ["c"], "b": []}
    assert fine(folder, rig={"rig_version": 1, "transforms": tree}, length=1).rig.names == ("root", "a", "c", "b")


def test_a_unit_may_be_a_number_of_millimetres(folder: Path) -> None:
    for text, unit in (("6 mm", 6.0), ("0.5 m", 500.0), ("cm", 10.0)):
        assert fine(folder, rig=RIG, length=1, units=text).unit == unit
    for text in ("0 mm", "-1 mm", "6mm", "1e3 mm", " mm", "6  mm"):
        assert error_of(folder, rig=RIG, units=text)[0] == "wrong-value"


def test_a_shape_has_units_as_a_definition_has_them(folder: Path) -> None:
    shapes = [{"file": "sword.obj", "name": name, "units": units} for name, units in (("a", "cm"), ("b", "5 mm"))]
    body = fine(folder, rig=RIG, length=1, units="0.5 cm", shapes=shapes)
    assert [body.shapes[name].points.max() for name in "ab"] == [20, 10]


def test_one_finding_of_a_kind_is_reported_at_each_place(folder: Path) -> None:
    layer = {"version": 2, "name": "a", "static": [{"bounds_scale": [1]}]}
    rig = {**RIG, "antdsl_rest": {"hand": [[1, 0, 0, 0]]}}
    _, diagnostics = read(folder, rig=rig, layers=[layer])
    assert sorted(each.message for each in diagnostics) == [
        "`bounds_scale` has 1 value, which is too few", "`hand` has 1 value, which is too few", "a binding has no `transform`",
    ]  # fmt: skip


def test_one_shape_of_a_file_and_two_of_a_name(folder: Path) -> None:
    shapes = [{"file": "arm.glb", "shape": "arm.smile", "name": "mask"}]
    assert list(fine(folder, rig=RIG, length=1, shapes=shapes).shapes) == ["mask"]
    twice = [{"file": "sword.obj", "name": "a"}, {"file": "sword.obj", "name": "a"}]
    assert error_of(folder, rig=RIG, shapes=twice) == ("duplicate-name", '"a"', "keep one of them")
    assert error_of(folder, rig=RIG, shapes=[{"file": "arm.glb", "name": "a"}])[2] == 'add `"shape": "arm"`'
    assert error_of(folder, rig=RIG, shapes=[{"file": "arm.glb", "shape": "arn"}]) == ("unknown-name", '"arn"', 'write `"arm"`')


def test_blend_shapes_by_their_documented_attributes(folder: Path) -> None:
    shapes: list[dict[str, Any]] = [
        {"file": "sword.obj", "name": "head", "blendshape_shapenames": ["smile"], "blendshape_channels": ["fist"],
         "blendshape_attribs": "P", "blendshape_ptidattr": "number", "deformDualQuaternionBlendAttrib": "soft"},
        {"file": "sword.obj", "name": "smile", "blendshape_shapenames": ["half"], "blendshape_inbetweenweights": [0.5]},
        {"file": "sword.obj", "name": "half"},
    ]  # fmt: skip
    layer = {"version": 2, "name": "a", "deforming": [{"transform": "hand", "shape": "head", "deformer": "blendshape"}]}
    body = fine(folder, rig=RIG, shapes=shapes, layers=[layer])
    assert body.shapes["head"].blend == BlendTargets(("smile",), ("fist",), ("P",), "number", "id")
    assert body.shapes["head"].dual_quaternion_blend == "soft"
    assert body.shapes["smile"].in_betweens == InBetweens(("half",), (0.5,))
    shapes[1]["blendshape_inbetweenweights"] = [1]
    assert error_of(folder, rig=RIG, shapes=shapes) == ("out-of-range", "[1]", "write `0.5`")
    shapes[1]["blendshape_inbetweenweights"] = [0.5]
    shapes[0]["blendshape_channels"] = ["fest"]
    assert error_of(folder, rig=RIG, shapes=shapes)[::2] == ("unknown-name", "did you mean `fist`?")


def test_a_library_is_found_by_its_condensed_path_or_where_a_root_grants_the_absolute_one(folder: Path, tmp_path: Path) -> None:
    includes = [["$HIP/sword.obj", "/elsewhere/sword.obj"]]
    assert list(fine(folder, rig=RIG, shapelib_includes=includes, length=1).shapes) == ["sword"]
    job = tmp_path / "job"
    (job / "geo").mkdir(parents=True)
    (job / "geo" / "axe.obj").write_text(OBJ)
    inner = tmp_path / "inner"
    inner.mkdir()
    for condensed, absolute in (("$JOB/geo/axe.obj", "/nowhere/axe.obj"), ("$HIP/gone.obj", str(job / "geo" / "axe.obj"))):
        (inner / "body.json").write_text(
            json.dumps({"antdsl_body": 1, "rig": RIG, "length": 1, "shapelib_includes": [[condensed, absolute]]})
        )
        definition, report = read_definition(inner / "body.json")
        assert definition is None and report.errors[0].code in ("root-not-granted", "no-such-file")
        definition, report = read_definition(inner / "body.json", Roots(inner, {"JOB": job}))
        assert definition is not None and list(definition.shapes) == ["axe"], report.diagnostics


@pytest.mark.parametrize(
    ("parts", "code", "marked", "help"),
    [
        ({"rig": {"file": "../rig.json"}}, "bad-path", '"../rig.json"', None),
        ({"rig": {"file": "/etc/passwd"}}, "bad-path", '"/etc/passwd"', None),
        ({"rig": {"file": "rog.json"}}, "no-such-file", '"rog.json"', None),
        ({"rig": RIG, "clips": [{"file": "walk.bclip"}]}, "wrong-kind", '"walk.bclip"', "the format is not pub"),
        ({"rig": RIG, "shapes": [{"file": "skin.bgeo.sc"}]}, "wrong-kind", '"skin.bgeo.sc"', "the file is compressed"),
        ({"rig": RIG, "shapelib_includes": [["$HIP/lib.bgeo.sc", ""]]}, "wrong-kind", None, "the file is compressed"),
        ({"from": "body.fbx"}, "wrong-kind", '"body.fbx"', "the format is not published: export the body as glTF or USD"),
        ({"from": "sword.obj"}, "wrong-kind", '"sword.obj"', "use a file of one of these types: .glb"),
        ({}, "missing-key", "{", 'add `"rig": {"file": "rig.json"}`'),
        ({"rig": RIG, "clip": []}, "unknown-key", '"clip"', 'write `"clips"`'),
        ({"rig": RIG, "front": "z"}, "wrong-value", '"z"', 'write `"+z"`'),
        ({"rig": RIG, "front": "+y"}, "wrong-value", '"+y"', 'write `"up": "+y"`'),
        ({"rig": RIG, "units": "inch"}, "wrong-value", '"inch"', 'write `"mm"`'),
        ({"rig": RIG, "length": 0}, "out-of-range", "0", None),
        ({"rig": RIG, "materials": {"a": [1, 2, 0]}}, "out-of-range", "2", "write `1`"),
        ({"rig": RIG, "layers": [{**LAYER, "static": [{"transform": "hand", "shape": "swrd"}]}],
          "shapes": [{"file": "sword.obj", "name": "sword"}]}, "unknown-name", '"swrd"', 'write `"sword"`'),
        ({"rig": RIG, "groups": [{**GROUP, "members": [{"name": "hond"}]}]}, "unknown-name", '"hond"', 'write `"hand"`'),
        ({"rig": RIG, "groups": [GROUP, GROUP]}, "duplicate-name", None, "keep one of them"),
        ({"rig": RIG, "clips": [CLIP, CLIP]}, "duplicate-name", None, "keep one of them"),
        ({"rig": RIG, "clips": [{"clip": "wave"}]}, "unknown-name", '"wave"', None),
        ({"rig": RIG, "shapelib_includes": [["a.glb"]]}, "wrong-value", '["a.glb"]', 'write `["$HIP/lib.glb", "/…/lib.glb"]`'),
        ({"rig": RIG, "shapes": [{"file": "sword.obj", "units": "6 in"}]}, "wrong-value", '"6 in"', 'write `"mm"`, or `"6 mm"`'),
        ({"rig": RIG, "shapes": [{"name": "a"}]}, "missing-key", "{", 'add `"file": "sword.obj"`'),
        ({"rig": RIG, "shapes": [{"file": "sword.obj", "name": "s"}], "layers": [{"version": 2, "name": "x",
          "deforming": [{"transform": "", "shape": "s", "deformer": "linearskinning"}]}]},
         "bad-body", '"linearskinning"', "take the shape from"),
        ({"rig": RIG, "shapes": [{"file": "arm.glb"}]}, "unknown-name", "{", "add the missing joint to the rig"),
    ],
)  # fmt: skip
def test_a_mistake_is_reported_at_its_place(
    folder: Path, parts: dict[str, Any], code: str, marked: str | None, help: str | None
) -> None:
    error = error_of(folder, **parts)
    assert error[0] == code and marked in (None, error[1]), error
    assert help is None or (error[2] or "").startswith(help), error


@pytest.mark.parametrize(("part", "what"), [(RIG, "a rig"), (LAYER, "a layer"), (GROUP, "a transform group"), (CLIP, "a clip")])
def test_a_part_alone_is_no_definition(folder: Path, part: dict[str, Any], what: str) -> None:
    (folder / "part.json").write_text(json.dumps(part))
    definition, report = read_definition(folder / "part.json")
    (error,) = report.errors
    assert (
        definition is None
        and error.code == "wrong-kind"
        and error.message.startswith(f"this file contains {what}, which is only a part")
    )
    assert (error.help or "").startswith('write a body definition that names this file: `{"antdsl_body": 1, "')


def test_unknown_deformers_and_channels_of_other_rigs_are_only_reported(folder: Path) -> None:
    layer = {"version": 2, "name": "a", "deforming": [{"transform": "hand", "shape": "s", "deformer": "lineerskinning"}]}
    group = {**GROUP, "channels": [{"name": "fost"}]}
    body, diagnostics = read(folder, rig=RIG, shapes=[{"file": "sword.obj", "name": "s"}], layers=[layer], groups=[group])
    assert body is not None and sorted((each.code, each.help) for each in diagnostics) == [
        ("unknown-name", 'write `"fist"`'), ("unknown-name", 'write `"linearskinning"`'),
    ]  # fmt: skip


def test_a_mistake_in_a_separate_file_is_reported_there(folder: Path) -> None:
    (folder / "wave.json").write_text(json.dumps({**CLIP, "channels": {"hand:tx": [0, "x"]}}))
    body, diagnostics = read(folder, rig=RIG, clips=[{"file": "wave.json"}])
    assert body is None and [(each.span.source.path, each.span.text) for each in diagnostics if each.span] == [
        (str(folder / "wave.json"), '"x"')
    ]


def test_a_text_names_a_body_below_granted_roots_and_its_parts_lie_beside_it(folder: Path) -> None:
    (folder / "deep").mkdir()
    (folder / "deep" / "sword.obj").write_text(OBJ)
    body = {"antdsl_body": 1, "rig": RIG, "shapes": [{"file": "sword.obj", "name": "sword"}], "layers": [LAYER]}
    (folder / "deep" / "body.json").write_text(json.dumps(body))
    for text, roots in (("deep/body.json", Roots(folder)), ("assets:deep/body.json", Roots(folder / "deep", {"assets": folder}))):
        definition, report = read_definition(text, roots)
        assert definition is not None and list(definition.shapes) == ["sword"], report.diagnostics
    definition, report = read_definition("other:body.json", Roots(folder))
    assert definition is None and report.errors[0].code == "root-not-granted"


def test_clips_written_by_the_package_are_read_in_a_definition(folder: Path) -> None:
    body = fine(folder, **{"from": "arm.glb"})
    (folder / "hop.json").write_text(write_clip(body.clips["hop"]))
    again = fine(folder, **{"from": {"file": "arm.glb", "rate": 24}}, clips=[{"file": "hop.json", "name": "jump"}])
    assert (again.clips["jump"].translation == body.clips["hop"].translation).all() and again.clips["hop"].rate == 24


ODD: tuple[Any, ...] = (
    None,
    -1,
    0,
    1,
    0.5,
    1e300,
    "x",
    "hand",
    "",
    [],
    {},
    [1, 2],
    {"file": "sword.obj"},
    {"a": 1},
    True,
    "arm.glb",
)


def spots(tree: Any) -> list[tuple[Any, Any]]:
    """Every place of a tree as (holder, key)."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ()
    return [each for key in keys for each in ((tree, key), *spots(tree[key]))]


def test_any_change_of_a_definition_is_read_or_reported(folder: Path) -> None:
    shapes = [
        {"file": "sword.obj", "name": "sword", "units": "mm", "blendshape_shapenames": ["cut"], "blendshape_channels": ["fist"]},
        {"file": "sword.obj", "name": "cut", "blendshape_shapenames": ["sword"], "blendshape_inbetweenweights": [0.5]},
    ]
    rig = {**RIG, "antdsl_rest": {"hand": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}}
    clips = [{**CLIP, "marks": {"a": 0.1}}, {"file": "arm.glb", "clip": "hop", "rate": 10}]
    complete_body = {
        **COMPLETE_BODY, "antdsl_body": 1, "rig": rig, "shapes": shapes, "layers": [LAYER], "groups": [GROUP], "clips": clips,
        "length": 2,
        "metadata": {"a": {"type": "int", "value": 2}, "b": [1, {"c": "d"}]},
        "shapelib_includes": [["$HIP/block.obj", ""]],
    }  # fmt: skip
    (folder / "block.obj").write_text(OBJ)
    text, draw, read = json.dumps(complete_body), random.Random(7), 0
    for _ in range(150):
        tree = json.loads(text)
        for _ in range(draw.choice([0, 1, 1, 2])):
            holder, key = draw.choice(spots(tree))
            if draw.random() < 0.3 and isinstance(holder, dict):
                del holder[key]
            else:
                holder[key] = draw.choice(ODD)
        (folder / "body.json").write_text(json.dumps(tree))
        definition, report = read_definition(folder / "body.json")
        assert (definition is None) == bool(report.errors), (tree, report.diagnostics)
        assert all(each.span is not None for each in report.diagnostics)
        read += definition is not None
    assert 15 < read < 125


def test_all_clips_together_have_a_limit(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_BODY_PARTS", 1)
    clips = [{**CLIP, "name": name} for name in "ab"]
    assert error_of(folder, rig=RIG, clips=clips)[0] == "too-large"


# ---- legs and gaits

LEGS: dict[str, Any] = {
    "rig": {
        "rig_version": 1,
        "transforms": {"hip": ["knee", "tail"], "knee": ["shank"], "shank": ["foot"], "foot": [], "tail": []},
    },
    "legs": [{"name": "left", "upper": "hip", "lower": "knee", "foot": "foot"}],
    "gaits": [
        {"name": "run", "speed": 9, "stride": 6, "duty": 0.4, "lift": 1, "phases": [0.25]},
        {"name": "walk", "speed": 2, "stride": 4, "duty": 0.7, "lift": 0.5, "phases": [0]},
    ],
    "length": 10,
}  # fmt: skip


def with_leg(**changed: Any) -> dict[str, Any]:
    return LEGS | {"legs": [LEGS["legs"][0] | changed]}


def with_gait(**changed: Any) -> dict[str, Any]:
    return LEGS | {"gaits": [LEGS["gaits"][0] | changed]}


def test_legs_and_gaits_from_slow_to_fast(folder: Path) -> None:
    body = fine(folder, **LEGS)
    assert [(leg.name, leg.upper, leg.lower, leg.foot) for leg in body.legs] == [("left", "hip", "knee", "foot")]
    assert [(gait.name, gait.speed, gait.stride, gait.duty, gait.lift, gait.phases) for gait in body.gaits] == [
        ("walk", 2.0, 4.0, 0.7, 0.5, (0.0,)), ("run", 9.0, 6.0, 0.4, 1.0, (0.25,)),
    ]  # fmt: skip


def test_mistakes_in_legs_and_gaits_are_reported(folder: Path) -> None:
    assert error_of(folder, **with_leg(foot="fot")) == ("unknown-name", '"fot"', 'write `"foot"`')
    assert error_of(folder, **with_leg(foot="tail"))[:2] == ("bad-rig", '"tail"')
    assert error_of(folder, **with_leg(upper="knee", lower="hip"))[0] == "bad-rig"
    assert error_of(folder, **with_leg(ankle="shin"))[:2] == ("unknown-name", '"shin"')
    assert error_of(folder, **with_leg(ankle="hip"))[:2] == ("bad-rig", '"hip"')
    assert error_of(folder, **with_leg(ankle="foot", foot="shank"))[:2] == ("bad-rig", '"shank"')
    assert [fine(folder, **with_leg(ankle=joint)).legs[0].ankle for joint in ("shank", "foot")] == ["shank", "foot"]
    assert error_of(folder, **with_leg(knee="knee"))[:2] == ("unknown-key", '"knee"')
    assert error_of(folder, **(LEGS | {"legs": LEGS["legs"] * 2, "gaits": []}))[:2] == ("duplicate-name", '"left"')
    assert error_of(folder, **with_gait(phases=[0, 0.5]))[0] == "wrong-value"
    assert error_of(folder, **with_gait(duty=1.5))[:2] == ("out-of-range", "1.5")
    assert error_of(folder, **with_gait(stride=0))[:2] == ("out-of-range", "0")
    assert error_of(folder, **with_gait(phases=[2]))[:2] == ("out-of-range", "2")
    assert error_of(folder, **(LEGS | {"gaits": [LEGS["gaits"][0], LEGS["gaits"][0] | {"name": "trot"}]}))[:2] == (
        "wrong-value",
        "9",
    )
    assert error_of(folder, **LEGS, idle="stand")[:2] == ("unknown-name", '"stand"')
    definition, said = read(folder, **(LEGS | {"gaits": []}))
    assert definition is not None and [each.code for each in said] == ["missing-key"]


def test_a_clip_says_whether_feet_stand(folder: Path) -> None:
    clips = [CLIP, CLIP | {"name": "groom", "feet": False}]
    body = fine(folder, **COMPLETE_BODY, rig=RIG, clips=clips, idle="wave", length=10)
    assert body.clips["wave"].feet and not body.clips["groom"].feet and body.idle == "wave"
    (folder / "wave.json").write_text(json.dumps(CLIP))
    other = fine(folder, **COMPLETE_BODY, rig=RIG, clips=[{"file": "wave.json", "feet": False}], length=10)
    assert not other.clips["wave"].feet
