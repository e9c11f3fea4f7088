"""Level of detail: near the camera feelers meet triangles, further off the boxes about pieces, beyond that nothing."""

from __future__ import annotations

import json
from pathlib import Path

import meshes
import numpy as np
import pytest
from meaning import FAST, OPTION_SETS, crowd, play
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.runtime import Options, bind, checkpoints, state_hash, step
from antdsl.runtime.level_of_detail import DetailLevels, MeshPieces, is_in_boxes
from antdsl.scene.setting import DetailLevelData, MeshData
from antdsl.scene.staging.motion import GeometryMotion, MeshMotion

WORLD = "ant 1\nworld { obstacle stones }\n"
FEELS = """species a { x = 0 mm
response 1 step
on spawn { heading = vector(1, 0, 0); velocity = vector(0 mm/s, 0 mm/s, 0 mm/s) }
let feeler = nearest(feelers(stones, count: 1, spread: 0 deg, reach: 30 mm))
start s
state s { x = min(feeler.distance, 99 mm); when false -> s } }"""
ORIGIN = np.zeros((1, 3))
BALL = {"stones": MeshData(*meshes.ball(10.0, (20, 0, 0), 24))}
POINTS = [(0, 0), (0, 7), (0, 9.9), (11, 8), (0, 12)]


def feeler_distances(near: float, far: float = float("inf")) -> list[float]:
    data = DetailLevelData(np.array([[0.0, 100.0, 0.0]]), near, far)
    return play(FEELS, crowd(at=POINTS), world=WORLD, obstacles=BALL, level_of_detail=data)["x"]


@pytest.mark.slow
def test_feelers_meet_triangles_then_boxes_then_nothing() -> None:
    inf = 99.0  # nothing
    ball = [20 - np.sqrt(100 - z * z) - x for x, z in POINTS[:4]]
    assert feeler_distances(200) == pytest.approx([*ball, inf], abs=0.3)
    # who stands beside the ball and inside its box still feels the ball
    assert feeler_distances(50) == pytest.approx([10, 10, 10, ball[3], inf], abs=0.05)
    assert feeler_distances(50, 90) == [inf] * 5
    assert feeler_distances(50, 100.1) == pytest.approx([10, inf, inf, inf, inf], abs=0.05)  # by each one's own distance


def test_pieces_hang_together_by_the_places_of_their_corners() -> None:
    parts = [meshes.ball(5.0, (0, 0, 0), 6), meshes.box((10, 1, 2), (12, 3, 5)), meshes.box((12, 3, 5), (13, 4, 6))]
    corners = np.concatenate([v[f].reshape(-1, 3) for v, f in parts])  # no two faces share a corner's number
    lone = np.array([[99.0, 0, 0]])
    mesh = MeshData(np.concatenate([corners, lone]), np.arange(len(corners), dtype=np.int32).reshape(-1, 3))
    low, high = MeshPieces(mesh).compute_bounding_boxes(mesh.vertices)
    boxes = sorted(zip(low.round(3).tolist(), high.round(3).tolist(), strict=True))
    assert boxes[1] == ([10, 1, 2], [13, 4, 6]) and len(boxes) == 2  # boxes that touch in a corner are one piece
    assert boxes[0][1][1] == 5.0


@pytest.mark.slow
def test_boxes_go_with_their_obstacle() -> None:
    poses = np.repeat(np.eye(3, 4)[None], 4, axis=0)
    poses[:, 2, 3] = (0, 3, 6, 9)
    moves = GeometryMotion(meshes={"stones": MeshMotion.from_transforms(poses, len(BALL["stones"].vertices))})
    at = crowd(at=[(0, -9), (0, 9), (0, 18)])
    data = DetailLevelData(np.array([[0.0, 100.0, 0.0]]), 50.0)
    history = play(FEELS, at, steps=4, world=WORLD, obstacles=BALL, level_of_detail=data, motion=moves)
    assert history["x"] == pytest.approx([99, 10, 10], abs=0.05)  # at frame 3 the box is 9 mm further
    assert history.at("x", 1) == pytest.approx([10, 10, 99], abs=0.05)


def test_inside_is_inside_of_any_box() -> None:
    draw = np.random.default_rng(4)
    place = draw.uniform(0, 10, (500, 3)).astype(np.float32)
    low = draw.uniform(0, 9, (40, 3)).astype(np.float32)
    high = low + draw.uniform(0, 2, (40, 3)).astype(np.float32)
    expected = ((place[:, None] >= low) & (place[:, None] <= high)).all(axis=2).any(axis=1)
    assert 0 < expected.sum() < 500 and np.array_equal(is_in_boxes(place, low, high), expected)


AVOID = """behaviour round() -> push {
  limit(sum(hit in feelers(stones, count: 3, spread: 35 deg, reach: 12 mm): hit.normal * (1 - hit.distance / (12 mm))), 1)
}
species a { size 4 mm
response 0.1 s
max_speed 40 mm/s
start s
state s { steer heading * 0.8; when false -> s }
layers { round(); state } }"""
STONES = {"stones": MeshData(*meshes.ball(9.0, (25, 0, 10), 8))}


def test_same_bits_for_all_options_and_no_agent_walks_through() -> None:
    data = DetailLevelData(np.array([[0.0, 30.0, 0.0]]), 40.0, 60.0)
    deepest = []

    def watch(world):
        away = np.linalg.norm(world.populations["a"].position - (25, 0, 10), axis=1)
        deepest.append(float(away.min()))

    history = play(
        AVOID, crowd(150, radius=50), steps=12, world=WORLD, obstacles=STONES, level_of_detail=data, option_sets=FAST, each=watch
    )
    assert min(deepest) > 8.0
    counts = history.world.detail_levels.counts
    assert counts[0] == 12 and counts[1:].sum() == 12 * 150 and counts[1:].min() > 0
    play(AVOID, crowd(14, radius=50), steps=6, world=WORLD, obstacles=STONES, level_of_detail=data, option_sets=OPTION_SETS)


def test_near_enough_is_as_if_there_were_no_levels_and_a_checkpoint_goes_on() -> None:
    at = crowd(60, radius=50)
    plain = play(AVOID, at, steps=10, world=WORLD, obstacles=STONES, option_sets=FAST[:1]).world
    near = play(
        AVOID, at, steps=10, world=WORLD, obstacles=STONES, option_sets=FAST[:1], level_of_detail=DetailLevelData(ORIGIN, 1e6)
    ).world
    assert state_hash(plain) == state_hash(near)
    far = play(
        AVOID, at, steps=10, world=WORLD, obstacles=STONES, option_sets=FAST[:1], level_of_detail=DetailLevelData(ORIGIN, 20.0)
    ).world
    assert state_hash(far) != state_hash(plain)
    again = bind(far.plan, far.setting, Options())
    checkpoints.restore_checkpoint(again, checkpoints.take_checkpoint(far))
    step(again)
    step(far)
    assert state_hash(again) == state_hash(far) and np.array_equal(again.detail_levels.counts, far.detail_levels.counts)


PROGRAM = """ant 1
use steering
world { surface ground; obstacle stones }
species ant {
  size 4 mm
  start go
  state go { steer wander() }
  layers { avoid(stones); state }
}
"""
SCENE = """antdsl: 1
frames: 1..8
world: {ground: {mesh: ground.ply}, stones: {mesh: stones.ply}}
crowd: [{species: ant, from: ant.ant, count: 40, place: {on: ground}}]
camera: {at: [0, 50, 0], look_at: [0, 0, 1]}
lod: {near: 60 mm, far: 80 mm}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    import trimesh

    for name, mesh in (("ground", meshes.grid(200, 10)), ("stones", meshes.box((20, -5, 20), (40, 9, 40)))):
        (tmp_path / f"{name}.ply").write_bytes(trimesh.Trimesh(*mesh, process=False).export(file_type="ply"))
    (tmp_path / "ant.ant").write_text(PROGRAM)
    (tmp_path / "scene.yaml").write_text(SCENE)
    return tmp_path


def test_a_run_says_how_many_were_at_which_level(folder: Path) -> None:
    words = ["run", str(folder / "scene.yaml"), "--out", str(folder / "out"), "--summary", str(folder / "s.json")]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 0, result.output
    assert "level of detail, agents on the average: triangles " in result.output
    lod = json.loads((folder / "s.json").read_text())["lod"]
    assert set(lod["end"]) == {"triangles", "boxes", "nothing"} and sum(lod["end"].values()) == 40
    assert sum(lod["mean"].values()) == pytest.approx(40, abs=0.01) and min(lod["mean"].values()) > 0


@pytest.mark.parametrize(
    ("old", "new", "place", "words"),
    [
        ("camera: {at: [0, 50, 0], look_at: [0, 0, 1]}\n", "", "lod", "no camera during the run"),
        ("far: 80 mm", "far: 50 mm", "50 mm", "`far` is less than `near`"),
        ("near: 60 mm", "near: 0 mm", "0 mm", ""),
        ("near: 60 mm, ", "", "lod", "`lod` has no `near`"),
    ],
)
def test_what_does_not_fit_is_reported_in_the_scene(folder: Path, old: str, new: str, place: str, words: str) -> None:
    (folder / "scene.yaml").write_text(SCENE.replace(old, new))
    result = CliRunner().invoke(app, ["check", str(folder / "scene.yaml"), "--format", "concise"])
    assert result.exit_code == 1 and words in result.output, result.output
    assert result.output.count("error[") + result.output.count("warning[") == 1, result.output


def test_the_camera_is_part_of_the_result_only_where_it_counts(folder: Path) -> None:
    from antdsl.pipeline import open_scene

    def inputs(text: str) -> str:
        (folder / "scene.yaml").write_text(text)
        shot, report = open_scene(folder / "scene.yaml")
        assert shot is not None, report.sort_by_place()
        return shot.inputs["scene"]

    plain = SCENE.replace("lod: {near: 60 mm, far: 80 mm}\n", "")
    assert inputs(SCENE) != inputs(SCENE.replace("[0, 50, 0]", "[0, 51, 0]"))
    assert inputs(plain) == inputs(plain.replace("[0, 50, 0]", "[0, 51, 0]"))


def test_levels_go_by_the_scene_moved_to_its_middle() -> None:
    """Far from zero a scene is bound about its own middle; the camera with it."""
    middle = np.array([1e6, 0, 0])
    detail = DetailLevels(DetailLevelData(np.add(middle, [[0, 0, 0], [0, 0, 9], [0, 0, 20]]), 10.0, first=5), middle, {})
    positions = np.array([[0, 0, 5], [0, 0, 15]], np.float32)
    levels = [detail._find_levels_at(positions, frame).tolist() for frame in (0, 5, 6, 7, 99)]
    assert levels == [[0, 1], [0, 1], [0, 0], [1, 0], [1, 0]]  # a camera that moves; before and after it stands
