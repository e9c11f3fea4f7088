"""What agents sense of a camera: its view, its distance and its direction, compared with the projection of pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from meaning import OPTION_SETS, RunHistory, crowd, play
from meshes import grid

from antdsl.outputs.pictures.camera import make_view, to_tuple
from antdsl.outputs.pictures.model import Camera
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData
from antdsl.scene.setting import CameraData

WORLD = "ant 1\nworld { camera shot; camera wide }\n"
TEXT = """species a {
  shown = 0; near = 0; inner = 0; far = 0 mm; ahead = 0; twice = 0
  start see
  state see {
    shown = if in_view(shot) then 1 else 0
    near = if in_view(shot, margin: 12 mm) then 1 else 0
    inner = if in_view(shot, margin: -3 mm) then 1 else 0
    far = distance(wide)
    ahead = dot(direction(wide), up)
    twice = if in_view(wide) then 1 else 0
  }
}
"""
OPTIONS = (*OPTION_SETS, Options(), Options(chunk=5, threads=2, shuffle_rows=4))
GRID = [(float(x), float(z)) for x in range(-60, 61, 12) for z in range(-60, 61, 12)]


def make_data(*cameras: tuple[tuple[float, float, float], tuple[float, float, float]], focal: float = 50.0, first: int = 0):
    rows = np.array(cameras, np.float64)
    up = np.tile([0.0, 1.0, 0.0], (len(rows), 1))
    return CameraData(rows[:, 0], rows[:, 1], up, np.full(len(rows), focal), first)


SHOT = make_data(((0, 30, 60), (0, 0, 0)), ((0, 30, 60), (40, 0, 0)), ((20, 40, -50), (0, 0, 10)))
WIDE = make_data(((10, 80, 5), (10, 0, 5)), focal=0.0)


def run(steps: int = 3) -> RunHistory:
    return play(TEXT, crowd(at=GRID), world=WORLD, steps=steps, option_sets=OPTIONS, cameras={"shot": SHOT, "wide": WIDE})


def project(data: CameraData, row: int, place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far points are from the middle of a 16:9 picture, in halves of its sides, and their distances ahead."""
    at, look_at = (to_tuple(points[row]) for points in (data.at, data.look_at))
    view = make_view(Camera(at, look_at, focal=float(data.focal[row]) or 35.0), 1600, 900, (0.0, 1.0, 0.0))
    pixels, depth = view.project(place)
    return np.abs(pixels / [1600, 900] * 2 - 1).max(axis=1), depth


def test_agents_in_view_are_those_in_the_picture() -> None:
    history = run()
    for frame in range(1, 4):
        place = np.stack([history.at(f"position.{axis}", frame - 1) for axis in "xyz"], axis=1)
        off, depth = project(SHOT, frame - 1, place)  # the step to a frame begins in the frame before it
        assert np.abs(off - 1).min() > 1e-5, "no agent is on an edge"
        in_view = np.array(history.at("shown", frame))
        assert (in_view == ((depth > 0) & (off < 1))).all()
        assert 5 < in_view.sum() < len(GRID) - 5
        near, inner = np.array(history.at("near", frame)), np.array(history.at("inner", frame))
        assert (inner <= in_view).all() and (in_view <= near).all() and inner.sum() < in_view.sum() < near.sum()


def test_a_margin_is_a_distance_from_the_planes_of_the_view() -> None:
    place = np.array([(x, 0.0, z) for x, z in GRID])
    eye, aim = SHOT.at[0], SHOT.look_at[0]
    ahead = (aim - eye) / np.linalg.norm(aim - eye)
    right = np.cross(ahead, [0, 1, 0])
    right /= np.linalg.norm(right)
    top = np.cross(right, ahead)
    sides = [(axis * sign - ahead * tan) / np.hypot(1, tan) for axis, tan in ((right, 0.36), (top, 0.2025)) for sign in (1, -1)]
    outside = np.max([(place - eye) @ side for side in [*sides, -ahead]], axis=0)
    history = run(steps=1)
    assert (np.array(history["near"]) == (outside <= 12)).all() and (np.array(history["inner"]) == (outside <= -3)).all()


def test_cameras_have_positions() -> None:
    history = run(steps=1)
    offset = WIDE.at[0] - np.array([(x, 0.0, z) for x, z in GRID])
    far = np.linalg.norm(offset, axis=1)
    assert np.allclose(history["far"], far, rtol=1e-6) and np.allclose(history["ahead"], offset[:, 1] / far, atol=1e-6)
    off, depth = project(WIDE, 0, np.array([(x, 0.0, z) for x, z in GRID]))
    assert (np.array(history["twice"]) == ((depth > 0) & (off < 1))).all(), "straight down, with the default focal length"


@pytest.mark.parametrize(("first", "row"), [(0, 0), (-1, 1), (-9, 2), (9, 0)])
def test_camera_keys_hold_outside_their_frames(first: int, row: int) -> None:
    cameras = {"shot": replace(SHOT, first=first), "wide": WIDE}
    history = play(TEXT, crowd(at=GRID), world=WORLD, steps=1, cameras=cameras)
    off, depth = project(SHOT, row, np.array([(x, 0.0, z) for x, z in GRID]))
    assert (np.array(history["shown"]) == ((depth > 0) & (off < 1))).all()


def test_cameras_are_where_they_are_in_a_world_far_from_its_zero_point() -> None:
    """Positions are relative to an origin near the ground; cameras are too."""
    shift = np.array([4e6, 0.0, -3e6])
    vertices, faces = grid(200.0, 4)
    points = np.array([(x, 0.0, z) for x, z in GRID]) + shift
    cameras = {"shot": replace(SHOT, at=SHOT.at + shift, look_at=SHOT.look_at + shift), "wide": replace(WIDE, at=WIDE.at + shift)}
    surfaces = {"ground": MeshData(vertices + shift, faces)}
    far_text = WORLD.replace("{", "{ surface ground;")
    crowds = CrowdData("a", len(points), PlacementData(points=points))
    history = play(TEXT, crowds, world=far_text, steps=1, cameras=cameras, surfaces=surfaces)
    assert history["shown"] == run(steps=1)["shown"] and np.allclose(history["far"], run(steps=1)["far"], rtol=1e-5)
