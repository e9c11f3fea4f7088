"""Bodies on solids: they tilt over an edge in some steps, turn no faster than they may, and find their way out of a pit."""

from __future__ import annotations

import digging_shots
import numpy as np
import pytest
from meshes import box

from antdsl.ground.solid import Volume, move_over_solid
from antdsl.runtime import Options, World, bind, step

PROGRAM = """ant 1
use steering
world { surface ground; solid hill; items goal }
species walker {
  size 4 mm
  max_speed 30 mm/s
  response 0.15 s
  max_turn 400 deg/s
  start go
  state go { steer seek(nearest(goal)) }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..40
seed: 3
world:
  ground: {mesh: ground.ply}
  hill: {mesh: hill.ply, voxel: 0.5 mm}
  goal: {there: {at: [19, 0, 0], on: ground, radius: 2 mm}}
crowd:
  - {species: walker, from: dig.ant, count: 12, place: {on: hill, around: [0, 0, 0], radius: 3 mm}}
"""


def degrees(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(2 * np.arcsin(np.minimum(np.linalg.norm(a - b, axis=1) / 2, 1)))


def test_a_body_tilts_before_an_edge_and_over_it_in_several_steps() -> None:
    cube = Volume.from_mesh(*box((-20, -20, -20), (20, 20, 20)), 0.5)
    assert isinstance(cube, Volume)
    tilts = {}
    for body in (0.5, 5.0):
        place, up, head = np.array([[14.0, 20.0, 0.3]]), np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
        place = cube.project_to_surface(place, up).points
        turns = []
        for _ in range(14):
            moved = move_over_solid(cube, place, head, head, up, body)
            turns.append(degrees(moved.up, up)[0])
            assert abs((moved.heading * moved.up).sum()) < 1e-9 and abs((moved.direction * moved.up).sum()) < 1e-9
            place, up, head = moved.position, moved.up, moved.heading
        assert place[0, 0] == pytest.approx(20.0, abs=0.01) and place[0, 1] < 14 and up[0, 0] > 0.99, "down the other face"
        assert head[0, 1] < -0.99, "and looks down it"
        tilts[body] = max(turns)
    assert tilts[0.5] > 40 and tilts[5.0] < 30


@pytest.fixture(scope="module")
def pit(tmp_path_factory: pytest.TempPathFactory) -> World:
    """A shaft from the top of the hill half way down, with walkers at its bottom."""
    shot = digging_shots.opened(digging_shots.folder(tmp_path_factory.mktemp("pit"), PROGRAM, SCENE))
    world = bind(shot.plan, shot.setting, Options())
    hill, walkers = world.solids["hill"], world.populations["walker"]
    y = np.linspace(8, 22, 60)
    hill.carve_balls(np.stack([0 * y, y, 0 * y], axis=1), np.full(60, 4.0), np.arange(60))
    below = np.tile([0.0, 5.0, 0.0], (12, 1)) + np.random.default_rng(2).normal(size=(12, 3)) * [1.0, 0.0, 1.0]
    walkers.footing, _ = world.ground.find_nearest(below)
    walkers.position = world.ground.position(walkers.footing)
    up = world.ground.compute_upright_normals(walkers.footing, world.up)
    heading = np.cross(up, np.random.default_rng(3).normal(size=(12, 3)))
    for name, value in (
        ("position", walkers.position),
        ("up", up),
        ("heading", heading / np.linalg.norm(heading, axis=1)[:, None]),
    ):
        for k, axis in enumerate("xyz"):
            walkers.start[f"{name}.{axis}"][:] = walkers.now[f"{name}.{axis}"][:] = value[:, k]
    return world


def test_who_seeks_something_outside_a_pit_climbs_out_of_it(pit: World) -> None:
    walkers = pit.populations["walker"]
    assert (walkers.position[:, 1] < 8).all()
    arrived = np.zeros(len(walkers), np.bool_)
    for _ in range(150):
        step(pit)
        arrived |= np.hypot(walkers.position[:, 0] - 19, walkers.position[:, 2]) < 4
    assert arrived.mean() > 0.9
    assert pit.motion.summarise()["turn_p99"] < 16.9, "tilt and turn together are at most 16.7 degrees a step"
