"""Definitions written as files of our own and as glTF, and read back: the same parts, the same poses."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from antdsl.bodies.agents.definition import DEFAULT_FRONT, DEFAULT_UP, Definition
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.agents.other_axes import convert_definition_axes
from antdsl.bodies.agents.poses import build_clip_table
from antdsl.bodies.files.documents import TypedValue
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.files.writing import build_definition_files, write_gltf
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import PosedBody, find_base_layer
from tests.commands import run
from tests.gltf_bodies import arm, binary
from tests.gltf_scene import Scene

EXAMPLE = Path(__file__).parents[2] / "examples" / "walker"
AROUND = {
    "antdsl_body": 1, "from": "arm.glb", "front": "+y", "up": "-x", "units": "cm", "length": 4,
    "rig": {
        "rig_version": 1, "transforms": {"root": ["elbow"], "elbow": ["tip"], "tip": []},
        "channels": {"arm.smile": {"default_value": 0.25, "transform": ""}, "load": {"default_value": 2, "transform": "root"}},
        "antdsl_rest": {"root": [[1, 0, 0, 0], [0, 1, 0, 1], [0, 0, 1, 0], [0, 0, 0, 1]],
                        "elbow": [[1, 0.5, 0, 0], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]],
                        "tip": [[1, 0, 0, 0], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]]},
    },
    "shapes": [
        {"file": "block.obj", "name": "block", "material": "wood"}, {"file": "arm.glb", "shape": "arm.smile", "name": "half"},
        {"shape": "arm.smile", "blendshape_shapenames": ["half"], "blendshape_inbetweenweights": [0.5]},
    ],
    "materials": {"wood": [0.4, 0.3, 0.1]},
    "layers": [
        {"version": 2, "name": "shown", "static": [{"transform": "elbow", "shape": "block", "bounds_scale": [1, 2, 3]}],
         "deforming": [{"shape": "arm", "deformer": "blendshape+dualquatskinning"}]},
        {"version": 2, "name": "collision", "static": [{"transform": "root", "shape": "block"}]},
    ],
    "clips": [
        {"clip": "bend", "stride": 3, "loop": False, "feet": False, "marks": {"down": 0.25}},
        {"antdsl_clip": 1, "name": "sheared", "rate": 8, "channels": {"elbow:shear1": [0, 1, 0.5], "load": [0, 1, 2]}},
    ],
    "groups": [{"version": 2, "name": "arms", "members": [{"name": "elbow", "weight": 0.5}], "channels": [{"name": "load"}]}],
    "legs": [{"name": "only", "upper": "root", "lower": "elbow", "foot": "tip"}],
    "gaits": [{"name": "hop", "speed": 3, "stride": 1.5, "duty": 0.6, "lift": 0.25, "phases": [0.5]}], "idle": "bend",
    "variation": {"scale": {"arms": [0.5, 2]}, "materials": {"wood": [[0.4, 0.3, 0.1], [0.1, 0.1, 0.1]]}},
    "metadata": {"who": "us", "size": {"type": "float", "value": 2}, "deep": {"list": [1, 2]}},
}  # fmt: skip


@pytest.fixture
def body(tmp_path: Path) -> Definition:
    (tmp_path / "arm.glb").write_bytes(binary(*arm()))
    (tmp_path / "block.obj").write_text("v 0 0 0\nv 2 0 0\nv 0 1 0\nv 0 0 3\nf 1 2 3\nf 1 3 4\n")
    (tmp_path / "around.json").write_text(json.dumps(AROUND))
    definition, report = read_definition(tmp_path / "around.json")
    assert definition is not None, str(report.sort_by_place())
    return definition


def read_back(path: Path, files: dict[str, bytes], name: str, rate: float = 0.0) -> Definition:
    for each, data in files.items():
        (path / each).parent.mkdir(parents=True, exist_ok=True)
        (path / each).write_bytes(data)
    definition, report = read_definition(path / name, rate=rate)
    assert definition is not None and not report.diagnostics, [each.message for each in report.sort_by_place()]
    return definition


def same(a: object, b: object, within: float = 1e-6) -> None:
    """All fields alike, arrays to some digits."""
    if isinstance(a, np.ndarray):
        assert (
            isinstance(b, np.ndarray) and a.shape == b.shape and a.dtype == b.dtype and np.allclose(a, b, atol=within, rtol=1e-6)
        )
    elif isinstance(a, dict):
        assert isinstance(b, dict) and list(a) == list(b)
        for key in a:
            same(a[key], b[key], within)
    elif isinstance(a, list | tuple):
        assert isinstance(b, list | tuple) and len(a) == len(b)
        for mine, other in zip(a, b, strict=True):
            same(mine, other, within)
    elif hasattr(type(a), "__dataclass_fields__"):
        for name in type(a).__dataclass_fields__:
            same(getattr(a, name), getattr(b, name), within)
    elif isinstance(a, float):
        assert a == pytest.approx(b, abs=within)
    else:
        assert type(a) is type(b) and a == b, (a, b)


def test_our_own_files_are_read_back_as_they_were(body: Definition, tmp_path: Path) -> None:
    files = build_definition_files(body, "copy")
    assert {"copy.json", "copy/rig.json", "copy/shapes.glb", "copy/clips/bend.json", "copy/layers/collision.json"} <= set(files)
    definition = read_back(tmp_path / "there", files, "copy.json")
    same(body, definition)
    assert definition.metadata["size"] == TypedValue("float", 2) and definition.clips["sheared"].shear is not None
    again = build_definition_files(definition, "copy")
    assert {name for name in files if again[name] != files[name]} <= {"copy/clips/bend.json"}, "angles, to the last digits"


def posed(body: Definition, clip: str, turns: list[float]) -> dict[str, np.ndarray]:
    """The points of each shape by the joint that it is bound to, in metres, +x ahead, +y up."""
    worn = PosedBody(body, ((clip, ""),))
    one, n = np.ones(len(turns), np.float32), len(turns)
    previous_clip = np.full(n, -1, np.int16)
    machine = MachineClips(np.zeros(n, np.int16), np.array(turns, np.float32), one, previous_clip, one * 0, one * 0, one * 0)
    poses = worn.compute_poses((machine,), n)
    turn = body.compute_base_matrix()[:3, :3] * body.length * body.unit / 1000
    return {each.transform: deform_binding(body, each, poses).points @ turn.T for each in worn.bindings}


def test_walker_is_written_both_ways_and_poses_are_the_same(tmp_path: Path) -> None:
    for name in ("walker.json", "parts.glb"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    body, _ = read_definition(tmp_path / "walker.json")
    assert body is not None
    same(body, read_back(tmp_path / "own", build_definition_files(body, "w"), "w.json"), 2e-6)
    data, notes = write_gltf(body, find_base_layer(body), text=False)
    assert notes == ["transform groups are left out: glTF cannot store groups"]
    scene = Scene(data)
    scene.check()
    definition = read_back(tmp_path / "gltf", {"w.glb": data}, "w.glb", rate=30.0)
    assert (
        definition.rig.names == body.rig.names
        and {name: definition.materials[name] for name in body.materials} == body.materials
        and set(definition.clips) == set(body.clips)
    )
    assert definition.unit == 1000 and definition.clips["walk"].duration == pytest.approx(body.clips["walk"].duration)
    turns = [0.0, 0.25, 0.5, 0.75, 0.99]
    mine, other = posed(body, "walk", turns), posed(definition, "walk", turns)
    assert set(mine) == set(other) == set(body.rig.names)
    for joint, points in mine.items():
        assert points.shape == other[joint].shape and np.abs(points - other[joint]).max() < 1e-5, "metres"


def test_length_legs_gaits_idle_and_capsule_are_in_the_extras(tmp_path: Path) -> None:
    body = replace(load_library_body("hunter"), capsule=(0.5, 0.2, 0.3, 0.05))
    data, notes = write_gltf(body, find_base_layer(body), text=True)
    assert not any("legs" in note for note in notes)
    definition = read_back(tmp_path, {"w.gltf": data}, "w.gltf", rate=30.0)
    scale = body.unit / 1000
    assert definition.length == pytest.approx(body.length * scale) and definition.idle == body.idle
    assert definition.legs == body.legs and len(definition.gaits) == len(body.gaits)
    for mine, other in zip(body.gaits, definition.gaits, strict=True):
        assert (other.speed, other.stride, other.lift) == pytest.approx(
            (mine.speed * scale, mine.stride * scale, mine.lift * scale)
        )
        assert (other.name, other.duty, other.phases) == (mine.name, mine.duty, mine.phases)
    assert definition.capsule == pytest.approx([each * scale for each in (0.5, 0.2, 0.3, 0.05)])
    damaged = data.replace(b'"duty":', b'"dty":')
    (tmp_path / "w.gltf").write_bytes(damaged)
    unread, report = read_definition(tmp_path / "w.gltf")
    assert unread is None and "extras" in report.errors[0].message


def test_what_gltf_lacks_is_reported_and_the_rest_is_the_same(body: Definition, tmp_path: Path) -> None:
    data, notes = write_gltf(body, body.layers["shown"], text=True)
    note_text = "; ".join(notes)
    for words in ("layer `collision`", "metadata", "groups", "dual quaternion", "shear", "in-betweens", "drive no morph"):
        assert words in note_text, note_text
    scene = Scene(data)
    scene.check()
    names = [node.get("name") for node in scene.tree["nodes"]]
    assert scene.tree["meshes"][scene.tree["nodes"][names.index("elbow")]["mesh"]]["name"] == "block"
    table = build_clip_table(body)
    number = [each["name"] for each in scene.tree["animations"]].index("bend")
    world, _ = scene.at(0.75, number)
    from antdsl.bodies.agents.poses import compute_transforms, sample_poses

    at = compute_transforms(table, sample_poses(table, np.array([table.find_clip("bend")]), np.array([0.75])))[1][:, 3, :, 0]
    # +y is ahead, -x is up: what is ahead is +z there, what is up is +y, and centimetres are metres
    ahead, up = at[1], -at[0]
    order = [names.index(body.rig.names[k]) for k in table.joint_order]
    for joint, node in enumerate(order):
        assert world[node][2, 3] == pytest.approx(ahead[joint] / 100, abs=1e-6)
        assert world[node][1, 3] == pytest.approx(up[joint] / 100, abs=1e-6)


@pytest.mark.parametrize("word", ["ant", "ant_queen"])
def test_bodies_of_the_library_are_written(word: str, tmp_path: Path) -> None:
    body = convert_definition_axes(load_library_body(word), DEFAULT_FRONT, DEFAULT_UP, 1.0)  # units that files can name
    own = read_back(tmp_path, build_definition_files(body, word), f"{word}.json")
    for name in ("layers", "groups", "legs", "gaits", "idle", "front", "up", "length", "unit"):
        same(getattr(body, name), getattr(own, name))
    assert {name: own.materials[name] for name in body.materials} == body.materials
    assert sorted(own.rig.names) == sorted(body.rig.names), "joints may stand in another order"
    same([(c.name, c.duration, c.stride, c.loop, c.feet, dict(c.marks)) for c in body.clips.values()],
         [(c.name, c.duration, c.stride, c.loop, c.feet, dict(c.marks)) for c in own.clips.values()])  # fmt: skip
    for name, shape in body.shapes.items():
        other = own.shapes[name]
        same((shape.points, shape.uvs), (other.points, other.uvs))
        for each in set(shape.materials):
            mine, theirs = (
                s.faces[s.material == s.materials.index(each)] if s.material is not None else s.faces for s in (shape, other)
            )
            assert np.array_equal(mine, theirs), "by material"
    result = run("body", word, "--to", f"{word}.glb", "--layer", "body", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    scene = Scene((tmp_path / f"{word}.glb").read_bytes())
    scene.check()
    definition, _ = read_definition(tmp_path / f"{word}.glb", rate=body.clips["walk"].rate)
    assert (
        definition is not None and set(definition.clips) == set(body.clips) and len(definition.rig.names) >= len(body.rig.names)
    )
    turns = [0.0, 0.3, 0.8]
    mine, other = posed(body, "walk", turns), posed(definition, "walk", turns)
    again = posed(own, "walk", turns)
    for joint in mine:
        assert np.abs(mine[joint] - again[joint]).max() < 1e-6 * body.length
        assert np.abs(mine[joint] - other[joint]).max() < 1e-6 * body.length


def test_the_command_writes_and_refuses(tmp_path: Path) -> None:
    for name in ("walker.json", "parts.glb"):
        shutil.copy(EXAMPLE / name, tmp_path / name)
    result = run("body", "walker.json", "--to", "copy.json", "-q", cwd=tmp_path)
    assert result.returncode == 0 and result.stdout == "" and (tmp_path / "copy/clips/walk.json").is_file()
    assert run("body", "copy.json", cwd=tmp_path).stdout == run("body", "walker.json", cwd=tmp_path).stdout
    result = run("body", "walker.json", "--to", "walker.glb", cwd=tmp_path)
    assert "note: transform groups are left out" in result.stdout and "walker.glb" in result.stdout
    original_bytes = (tmp_path / "walker.json").read_bytes()
    for words, message in (
        (("walker.json",), "is an input and would be lost"),
        (("a.fbx",), ".gltf"),
        (("a.glb", "--layer", "hat"), "no layer `hat`"),
    ):
        result = run("body", "walker.json", "--to", *words, cwd=tmp_path)
        assert result.returncode == 2 and message in result.stderr.replace("\n", " "), result.stderr
    assert (tmp_path / "walker.json").read_bytes() == original_bytes
