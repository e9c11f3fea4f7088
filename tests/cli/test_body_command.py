"""`antdsl body FILE`: what is in a body, for people and for programs, and exit codes."""

from __future__ import annotations

import json
from pathlib import Path

import gltf_bodies
import pytest
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.cli.exits import CommandError, ExitCode


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    tree, data = gltf_bodies.arm()
    path = tmp_path / "arm.glb"
    path.write_bytes(gltf_bodies.binary(tree, data))
    return path


def printed(*words: str) -> str:
    result = CliRunner().invoke(app, ["body", *words])
    assert result.exception is None, result.exception
    return result.stdout


def left(*words: str) -> tuple[ExitCode, str]:
    result = CliRunner().invoke(app, ["body", *words])
    assert isinstance(result.exception, CommandError), result.stdout
    return result.exception.code, result.stdout


def test_body_prints_joints_shapes_layers_and_clips(arm: Path) -> None:
    assert printed(str(arm)).splitlines() == [
        "body         arm: 1 m long, front +z, up +y",
        "joints       2",
        "  root",
        "    elbow",
        "channel      arm.smile: 0.25 where no clip says otherwise",
        "shape        arm: 5 points, 3 triangles, follows 2 joints, blends with 1",
        "shape        arm.smile: 5 points, 3 triangles",
        "layer        body: arm by blendshape+linearskinning",
        "clip         bend: 1 s, 30 samples a second, 1 joints, loops, stays in place, does not close",
        "clip         hop: 1 s, 30 samples a second, 2 joints, loops, stays in place, does not close",
        "clip         smile: 1 s, 30 samples a second, 0 joints, 1 channels, loops, stays in place, does not close",
        "material     shell: 0.8 0.4 0.2",
        "written      channel arm.smile: arm_smile",
    ]
    assert "24 samples a second" in printed(str(arm), "--rate", "24")
    assert printed(str(arm), "--quiet") == ""


def test_body_accepts_names_of_the_library() -> None:
    lines = printed("spider").splitlines()
    assert lines[0] == "body         spider: 1 × 12 mm long, front +x, up +y"
    assert "layer        close: spider_close by linearskinning" in lines
    assert len([line for line in lines if line.startswith("leg ")]) == 8


def test_metadata_groups_and_marks_are_printed(arm: Path) -> None:
    body = arm.parent / "body.json"
    body.write_text(
        json.dumps(
            {
                "antdsl_body": 1, "from": "arm.glb", "metadata": {"by": {"type": "string", "value": "me"}},
                "groups": [{"version": 2, "name": "arms", "members": [{"name": "elbow", "weight": 0.5}, {"name": "root"}]}],
                "clips": [{"clip": "hop", "loop": False, "stride": 2, "marks": {"top": 0.5}}],
            }
        )
    )  # fmt: skip
    lines = printed(str(body)).splitlines()
    assert "group        arms: elbow 0.5, root" in lines
    assert "clip         hop: 1 s, 30 samples a second, 2 joints, plays once, stride 2 m, top at 0.5 s" in lines
    assert 'metadata     by: {"type": "string", "value": "me"}' in lines


def test_body_writes_json(arm: Path) -> None:
    document = json.loads(printed(str(arm), "--json"))
    assert document["valid"] and document["findings"] is None
    assert document["body"]["joints"] == {"root": None, "elbow": "root"}
    assert document["body"]["shapes"]["arm"]["blends_with"] == ["arm.smile"]
    assert document["body"]["clips"]["hop"]["seconds"] == 1.0
    arm.write_bytes(arm.read_bytes()[:100])
    code, text = left(str(arm), "--json")
    document = json.loads(text)
    assert code == ExitCode.FINDINGS and document["body"] is None and document["findings"]["diagnostics"][0]["code"] == "bad-body"


def test_exit_codes(arm: Path, tmp_path: Path) -> None:
    assert left(str(tmp_path / "gone.json"))[0] == ExitCode.INPUT_OUTPUT
    assert left(str(tmp_path))[0] == ExitCode.FINDINGS  # a folder is no kind of file that has a body
    code, text = left(str(tmp_path / "ant.fbx"))
    assert code == ExitCode.FINDINGS and "export the body as glTF or USD" in text
    (tmp_path / "body.json").write_text('{"antdsl_body": 1, "rig": {"file": "assets:rig.json"}, "length": 1}')
    assert "root-not-granted" in left(str(tmp_path / "body.json"))[1]
    (tmp_path / "assets").mkdir()
    (tmp_path / "assets" / "rig.json").write_text('{"rig_version": 1, "transforms": {"root": []}}')
    assert "joints       1" in printed(str(tmp_path / "body.json"), "--root", f"assets={tmp_path / 'assets'}")
