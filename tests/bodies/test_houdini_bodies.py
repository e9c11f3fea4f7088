"""Shapes and clips of Houdini in a definition."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from houdini_files import CLIP, attribute, cube, library, to_binary, to_text

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.transforms import angles_to_quaternion
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.files.writing import build_definition_files
from antdsl.bodies.library import load_library_body
from antdsl.diagnostics import Report

RIG = {"rig_version": 1, "transforms": {"root": ["hand"], "hand": []}}


def read_body(folder: Path, **parts: Any) -> tuple[Definition | None, Report]:
    (folder / "body.json").write_text(json.dumps({"antdsl_body": 1, "length": 1, "rig": RIG, **parts}))
    return read_definition(folder / "body.json")


def test_packed_primitives_are_shapes_by_name(tmp_path: Path) -> None:
    for name, data in (("lib.bgeo", to_binary(library())), ("lib.geo", to_text(library()))):
        (tmp_path / name).write_bytes(data)
        for parts in ({"shapes": [{"file": name}]}, {"shapelib_includes": [[f"$HIP/{name}", ""]]}):
            definition, report = read_body(tmp_path, **parts)
            assert definition is not None and list(definition.shapes) == ["head", "box"]
            assert np.allclose(definition.shapes["box"].points.max(axis=0), (11, 1, 1))
            (warning,) = report.diagnostics
            assert warning.code == "body-left-out" and "`Sphere` from byte" in warning.message
        definition, _ = read_body(tmp_path, shapes=[{"file": name, "shape": "head", "name": "skull"}])
        assert definition is not None and list(definition.shapes) == ["skull"]


def test_a_file_without_names_is_one_shape_and_its_skin_weights_are_reported(tmp_path: Path) -> None:
    points = [attribute("P", [[0, 0, 0]] * 8, 3), attribute("boneCapture", [[0]] * 8, 1)]
    points[0][1][-1][-1] = cube()[13][1][0][1][-1][-1]
    (tmp_path / "skin.bgeo").write_bytes(to_binary(cube(point_attributes=points)))
    definition, report = read_body(tmp_path, shapes=[{"file": "skin.bgeo", "name": "skin"}])
    assert definition is not None and len(definition.shapes["skin"].faces) == 12
    assert ["skin weights `boneCapture` from byte" in each.message for each in report.diagnostics] == [True]


def test_a_text_clip_moves_the_joints_that_it_names(tmp_path: Path) -> None:
    (tmp_path / "wave.clip").write_text(CLIP)
    definition, report = read_body(tmp_path, clips=[{"file": "wave.clip", "loop": False}])
    assert definition is not None and not report.diagnostics, report.diagnostics
    clip = definition.clips["wave"]
    assert (clip.rate, clip.joints, clip.loop) == (30.0, ("hand",), False)
    assert clip.translation[:, 0, 0].tolist() == [0, 1, 2]
    expected = angles_to_quaternion(np.radians([[0.0, 0, 0], [0, 0, 0], [0, 90, 0]]), "xyz")
    assert np.abs(np.abs((clip.rotation[:, 0] * expected).sum(axis=1)) - 1).max() < 1e-6


def test_the_order_of_rotations_is_that_of_the_clip(tmp_path: Path) -> None:
    turned = CLIP.replace("data = 0 1 2", "data = 30 30 30").replace("hand:tx", "hand:rz")
    (tmp_path / "wave.clip").write_text(turned.replace("@3 0", "@3 5"))
    definition, _ = read_body(tmp_path, clips=[{"file": "wave.clip"}])
    assert definition is not None
    expected = angles_to_quaternion(np.radians([0.0, 90, 30]), "zyx")
    assert abs(abs(definition.clips["wave"].rotation[2, 0] @ expected) - 1) < 1e-6


def test_a_library_body_with_clips_of_houdini_is_read_as_it_was(tmp_path: Path) -> None:
    body = load_library_body("ant")
    for path, data in build_definition_files(body, "ant", has_houdini_clips=True).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(data)
    assert len(list(tmp_path.rglob("*.clip"))) == len(body.clips) and not list(tmp_path.rglob("clips/*.json"))
    again, report = read_definition(tmp_path / "ant.json")
    assert again is not None and report.ok and list(again.clips) == list(body.clips)
    for name, clip in body.clips.items():
        read = again.clips[name]
        assert (read.rate, read.joints, read.channels, read.loop, dict(read.marks)) == (
            clip.rate, clip.joints, clip.channels, clip.loop, dict(clip.marks)
        )  # fmt: skip
        assert read.stride == pytest.approx(clip.stride) and read.feet == clip.feet
        assert np.allclose(read.translation, clip.translation, atol=1e-6) and np.allclose(read.values, clip.values)
        assert np.allclose(np.abs((read.rotation * clip.rotation).sum(axis=-1)), 1, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("data = 0 1 2", "data = 0 1", "has 2 samples, not 3"),
        ("@2 0 90", "@9 0 90", "more than 3 samples"),
        ("data = 0 1 2", "data = 0 one 2", "`one` is not a number (byte 124)"),
        ("tracklength = 3", "tracklength = 1e99", "`tracklength` is `1e+99`"),
        ("@3 0", "@2 0 4", "do not share one constant order of rotations"),
        ("rate = 30\n", "", "the clip needs one number for `rate`"),
        ("hand:ry", "hand:tx", "two tracks `hand:tx`"),
        ("name = hand:tx", "", "a track has no `name`"),
        ("data_rle = @3 0\n   }\n}", "data_rle = @3 0", "not the end"),
    ],
)
def test_mistakes_in_a_clip_are_reported_at_their_byte(tmp_path: Path, old: str, new: str, words: str) -> None:
    assert old in CLIP
    (tmp_path / "wave.clip").write_text(CLIP.replace(old, new))
    definition, report = read_body(tmp_path, clips=[{"file": "wave.clip"}])
    assert definition is None and words in report.errors[0].message and "(byte " in report.errors[0].message
    assert report.errors[0].span is not None and report.errors[0].span.source.path.endswith("wave.clip")
