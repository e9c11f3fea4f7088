"""Walking on solids: on the zero level for thousands of steps, round edges, through tunnels, never through what is solid."""

from __future__ import annotations

from collections.abc import Iterator

import meshes
import numpy as np
import pytest

from antdsl.ground.protocol import GroundMove
from antdsl.ground.solid import Volume, move

BODY = 5.0
STEPS = 2000


def make_solid(mesh: meshes.Mesh, voxel: float = 1.0) -> Volume:
    solid = Volume.from_mesh(*mesh, voxel)
    assert isinstance(solid, Volume)
    return solid


def cube() -> Volume:
    return make_solid(meshes.box((-20, -20, -20), (20, 20, 20)))


def tunnel() -> Volume:
    """A cube with a hole of radius 4 from side to side along x, dug ball by ball."""
    solid = cube()
    x = np.linspace(-23, 23, 80)
    solid.carve(np.stack([x, 0 * x, 0 * x], axis=1), np.full(80, 4.0), np.arange(80))
    return solid


def cheese() -> Volume:
    """A cube of thin walls, sharp ridges and narrow grooves."""
    solid, rng = cube(), np.random.default_rng(2)
    solid.carve(rng.uniform(-20, 20, (600, 3)), rng.uniform(1, 4, 600), np.arange(600))
    return solid


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1)[:, None]


def standing(solid: Volume, points: np.ndarray, up: np.ndarray, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places on the surface, normals and headings of those who found a place."""
    projection = solid.project(points, up, reach=50.0)
    assert projection.is_in_reach.mean() > 0.9
    place, normal = projection.points[projection.is_in_reach], projection.normals[projection.is_in_reach]
    return place, normal, unit(np.cross(normal, np.random.default_rng(seed).normal(size=place.shape)))


def wandering(
    solid: Volume, start: tuple[np.ndarray, np.ndarray, np.ndarray], steps: int, step: float = 1.0, turn: float = 0.1
) -> Iterator[tuple[np.ndarray, GroundMove]]:
    """Agents who go on and on, turning a little at random: where each was, and how it moved."""
    place, up, head = start
    rng = np.random.default_rng(7)
    for _ in range(steps):
        moved = move(solid, place, head * step, head, up, BODY)
        yield place, moved
        place, up, head = moved.position, moved.up, moved.heading
        angle = rng.normal(size=len(place))[:, None] * turn
        head = head * np.cos(angle) + np.cross(up, head) * np.sin(angle)


@pytest.mark.parametrize("shape", ["ball", "cube", "tunnel", "cheese"])
def test_walkers_stay_on_the_surface_for_thousands_of_steps(shape: str) -> None:
    directions = unit(np.random.default_rng(1).normal(size=(60, 3)))
    if shape == "ball":
        solid = make_solid(meshes.ball(20.0, rings=24))
        start = standing(solid, directions * 20, directions)
    elif shape == "cube":
        solid = cube()
        start = standing(solid, directions * 18, directions)
    elif shape == "tunnel":
        solid = tunnel()
        start = standing(solid, directions * [15, 1, 1], directions * [0.01, -1, -1])
    else:
        solid = cheese()
        start = standing(solid, directions * 18, directions[::-1])
    stopped = 0
    for previous_position, moved in wandering(solid, start, STEPS):
        assert np.abs(solid.sample(moved.position)).max() <= 1e-4 * BODY
        assert not moved.lost.any()
        assert np.abs((moved.heading * moved.up).sum(axis=1)).max() < 1e-9
        assert np.abs(np.linalg.norm(moved.heading, axis=1) - 1).max() < 1e-9
        assert np.linalg.norm(moved.position - previous_position, axis=1).max() < 1.35
        stopped += int(moved.blocked.sum())
        assert (moved.blocked | (np.abs(moved.travelled - 1) < 1e-6)).all()
    assert stopped <= STEPS * 60 * (1e-3 if shape == "cheese" else 0)


def test_who_walks_round_a_cube_comes_back_to_where_it_began() -> None:
    solid = cube()
    start = standing(solid, np.array([[0.0, 22.0, 0.3]]), np.array([[0.0, 1.0, 0.0]]))
    place, up, _ = start
    head = np.array([[1.0, 0, 0]])
    sides = set()
    for _ in range(170):
        moved = move(solid, place, head, head, up, BODY)
        place, up, head = moved.position, moved.up, moved.heading
        axis = int(np.abs(up[0]).argmax())
        sides.add((axis, bool(up[0, axis] > 0)))
        assert abs(place[0, 2] - 0.3) < 0.01, "the way is straight"
    assert sides == {(0, True), (0, False), (1, True), (1, False)}


def test_who_walks_into_a_hole_goes_through_the_tunnel_and_out() -> None:
    solid = tunnel()
    # On the left side above the mouth, heading down to it.
    place, up, head = standing(solid, np.array([[-20.5, 8.0, 0.0]]), np.array([[-1.0, 0, 0]]))
    head = np.array([[0.0, -1.0, 0]])
    positions = []
    for _ in range(60):
        moved = move(solid, place, head, head, up, BODY)
        place, up, head = moved.position, moved.up, moved.heading
        positions.append(place[0])
        assert solid.sample(place)[0] > -1e-4 * BODY
    inside = [p for p in positions if abs(p[0]) < 18]
    assert len(inside) > 25 and all(3.7 < np.hypot(p[1], p[2]) < 4.1 for p in inside)
    assert max(p[0] for p in positions) > 19.99 and positions[-1][0] > 19.8 and positions[-1][1] > 8, "up the other side"


def test_no_agent_passes_a_wall_of_less_than_a_voxel() -> None:
    """Two caves beside each other with little between."""
    solid = cube()
    middle = -0.37  # where nodes are: between nodes such a wall is not seen at all
    solid.carve(np.array([[middle - 6.1, 0, 0], [middle + 6.1, 0, 0]]), np.array([5.8, 5.8]), np.array([0, 1]))
    wall = np.stack(np.meshgrid([middle], np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9)), axis=-1).reshape(-1, 3)
    assert (solid.sample(wall) < 0).all() and (solid.sample(wall) > -0.5).all()
    directions = unit(np.random.default_rng(4).normal(size=(60, 3)))
    start = standing(solid, directions * 3 - [6.4, 0, 0], -directions)
    for _, moved in wandering(solid, start, STEPS // 4, turn=0.3):
        assert (moved.position[:, 0] < middle).all()


def test_a_step_keeps_its_length_and_is_laid_into_the_surface() -> None:
    solid = make_solid(meshes.ball(60.0, rings=60))
    place, up, head = standing(solid, np.array([[0.0, 60, 0]] * 5), np.array([[0.0, 1, 0]] * 5))
    wish = head * 2.0 + up * np.array([[0.0], [0.5], [-0.5], [2.0], [50.0]])
    wish[3] = np.nan
    moved = move(solid, place, wish, head, up, BODY)
    long = np.linalg.norm(wish[:3], axis=1)
    assert np.abs(moved.travelled[:3] - long).max() < 1e-6
    assert np.abs(np.linalg.norm(moved.position[:3] - place[:3], axis=1) - long).max() < 0.02
    assert moved.travelled[3] == 0 and moved.travelled[4] < 4.1


def test_who_loses_the_ground_goes_to_what_is_left() -> None:
    solid = make_solid(meshes.ball(20.0, rings=24))
    directions = unit(np.random.default_rng(1).normal(size=(40, 3)))
    place, up, head = standing(solid, directions * 20, directions)
    solid.carve(place[:20], np.full(20, 6.0), np.arange(20))
    assert (solid.sample(place[:20]) > 3).all()
    for step in (0.0, 1.0):
        moved = move(solid, place, head * step, head, up, BODY)
        assert not moved.lost.any() and np.abs(solid.sample(moved.position)).max() <= 1e-4 * BODY
    solid.carve(np.zeros((1, 3)), np.array([100.0]), np.array([0]))
    moved = move(solid, place, head, head, up, BODY)
    assert moved.lost.all() and (moved.position == place).all()


def test_one_agent_moves_as_it_does_among_many() -> None:
    solid = cheese()
    directions = unit(np.random.default_rng(1).normal(size=(50, 3)))
    place, up, head = standing(solid, directions * 15, directions[::-1])
    everyone = move(solid, place, head, head, up, BODY)
    for subset in (slice(7, 8), slice(20, 33), slice(None, None, -1)):
        few = move(solid, place[subset], head[subset], head[subset], up[subset], BODY)
        for all_, column in zip(everyone.columns(), few.columns(), strict=True):
            assert np.array_equal(all_[subset], column)
