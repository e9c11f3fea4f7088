"""Walking on solids: on the zero level for thousands of steps, round edges, through tunnels, never through what is solid."""

from __future__ import annotations

from collections.abc import Iterator

import meshes
import numpy as np
import pytest

from antdsl.ground.protocol import GroundMove
from antdsl.ground.solid import Volume, move_over_solid
from antdsl.ground.solid.trilinear import BrickTables, make_brick_tables
from antdsl.ground.solid.walking import _project_to_surface
from antdsl.machine_code.kernels import F64, Array1, Array2, kernel

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
    solid.carve_balls(np.stack([x, 0 * x, 0 * x], axis=1), np.full(80, 4.0), np.arange(80))
    return solid


def cheese() -> Volume:
    """A cube of thin walls, sharp ridges and narrow grooves."""
    solid, rng = cube(), np.random.default_rng(2)
    solid.carve_balls(rng.uniform(-20, 20, (600, 3)), rng.uniform(1, 4, 600), np.arange(600))
    return solid


def unit(v: np.ndarray) -> np.ndarray:
    return v / np.linalg.norm(v, axis=1)[:, None]


def standing(solid: Volume, points: np.ndarray, up: np.ndarray, seed: int = 3) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places on the surface, normals and headings of those who found a place."""
    projection = solid.project_to_surface(points, up, reach=50.0)
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
        moved = move_over_solid(solid, place, head * step, head, up, BODY)
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
        assert np.abs(solid.sample_distances(moved.position)).max() <= 1e-4 * BODY
        assert not moved.is_lost.any()
        assert np.abs((moved.heading * moved.up).sum(axis=1)).max() < 1e-9
        assert np.abs(np.linalg.norm(moved.heading, axis=1) - 1).max() < 1e-9
        assert np.linalg.norm(moved.position - previous_position, axis=1).max() < 1.35
        stopped += int(moved.is_blocked.sum())
        assert (moved.is_blocked | (np.abs(moved.travelled - 1) < 1e-6)).all()
    assert stopped <= STEPS * 60 * (1e-3 if shape == "cheese" else 0)


def test_who_walks_round_a_cube_comes_back_to_where_it_began() -> None:
    solid = cube()
    start = standing(solid, np.array([[0.0, 22.0, 0.3]]), np.array([[0.0, 1.0, 0.0]]))
    place, up, _ = start
    head = np.array([[1.0, 0, 0]])
    sides = set()
    for _ in range(170):
        moved = move_over_solid(solid, place, head, head, up, BODY)
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
        moved = move_over_solid(solid, place, head, head, up, BODY)
        place, up, head = moved.position, moved.up, moved.heading
        positions.append(place[0])
        assert solid.sample_distances(place)[0] > -1e-4 * BODY
    inside = [p for p in positions if abs(p[0]) < 18]
    assert len(inside) > 25 and all(3.7 < np.hypot(p[1], p[2]) < 4.1 for p in inside)
    assert max(p[0] for p in positions) > 19.99 and positions[-1][0] > 19.8 and positions[-1][1] > 8, "up the other side"


def test_no_agent_passes_a_wall_of_less_than_a_voxel() -> None:
    """Two caves beside each other with little between."""
    solid = cube()
    middle = -0.37  # where nodes are: between nodes such a wall is not seen at all
    solid.carve_balls(np.array([[middle - 6.1, 0, 0], [middle + 6.1, 0, 0]]), np.array([5.8, 5.8]), np.array([0, 1]))
    wall = np.stack(np.meshgrid([middle], np.linspace(-0.5, 0.5, 9), np.linspace(-0.5, 0.5, 9)), axis=-1).reshape(-1, 3)
    assert (solid.sample_distances(wall) < 0).all() and (solid.sample_distances(wall) > -0.5).all()
    directions = unit(np.random.default_rng(4).normal(size=(60, 3)))
    start = standing(solid, directions * 3 - [6.4, 0, 0], -directions)
    for _, moved in wandering(solid, start, STEPS // 4, turn=0.3):
        assert (moved.position[:, 0] < middle).all()


def test_a_step_keeps_its_length_and_is_laid_into_the_surface() -> None:
    solid = make_solid(meshes.ball(60.0, rings=60))
    place, up, head = standing(solid, np.array([[0.0, 60, 0]] * 5), np.array([[0.0, 1, 0]] * 5))
    wish = head * 2.0 + up * np.array([[0.0], [0.5], [-0.5], [2.0], [50.0]])
    wish[3] = np.nan
    moved = move_over_solid(solid, place, wish, head, up, BODY)
    long = np.linalg.norm(wish[:3], axis=1)
    assert np.abs(moved.travelled[:3] - long).max() < 1e-6
    assert np.abs(np.linalg.norm(moved.position[:3] - place[:3], axis=1) - long).max() < 0.02
    assert moved.travelled[3] == 0 and moved.travelled[4] < 4.1


def rotated(v: np.ndarray, axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Vectors [n, 3] rotated about unit axes [n, 3] by angles [n], by Rodrigues' formula."""
    cosine, sine = np.cos(angle)[:, None], np.sin(angle)[:, None]
    return v * cosine + np.cross(axis, v) * sine + axis * (axis * v).sum(axis=1, keepdims=True) * (1 - cosine)


def test_walks_on_a_ball_follow_great_circles() -> None:
    """Positions, normals, headings and directions are those of rotations about the axis of the circle, for leaning bodies too."""
    radius, count = 40.0, 48
    solid, rng = make_solid(meshes.ball(radius, rings=60)), np.random.default_rng(5)
    directions = unit(rng.normal(size=(count, 3)))
    place, _, _ = standing(solid, directions * radius, directions)
    normal = unit(place)
    head, travel = (unit(np.cross(normal, rng.normal(size=(count, 3)))) for _ in range(2))
    far = rng.choice([0.004, 0.3, 2.5, 7.0], count)
    lean_axis, lean = unit(np.cross(normal, rng.normal(size=(count, 3)))), rng.choice([0.0, 0.4], count)
    inputs = [rotated(each, lean_axis, -lean) for each in (travel * far[:, None], head, normal)]
    moved = move_over_solid(solid, place, *inputs, BODY)

    axis, angle = np.cross(normal, travel), far / radius
    expected = [rotated(each, axis, angle) for each in (place, normal, head, travel)]
    assert not moved.is_blocked.any() and not moved.is_lost.any()
    assert np.abs(moved.travelled - far).max() < 1e-5
    assert np.abs(moved.position - expected[0]).max() < 0.06
    assert np.abs(moved.position - expected[0])[far < 0.01].max() < 5e-4
    for result, vectors in zip((moved.up, moved.heading, moved.direction), expected[1:], strict=True):
        assert np.abs(result - vectors).max() < 0.06
        assert np.abs(np.linalg.norm(result, axis=1) - 1).max() < 1e-9


def test_a_body_upside_down_turns_over_its_heading() -> None:
    """On a flat face, with the normal exactly opposite: half a turn about the axis across the heading."""
    solid, rng = cube(), np.random.default_rng(6)
    place = np.stack([rng.uniform(-9, 9, 12), np.full(12, 20.0), rng.uniform(-9, 9, 12)], axis=1)
    up = np.tile([0.0, -1.0, 0.0], (12, 1))
    head, travel = (unit(rng.normal(size=(12, 3)) * [1, 0, 1]) for _ in range(2))
    moved = move_over_solid(solid, place, travel * 2, head, up, BODY)
    turned = [rotated(each, np.cross(up, head), np.full(12, np.pi)) for each in (travel, head)]
    assert np.abs(moved.position - (place + 2 * turned[0])).max() < 1e-3
    assert np.abs(moved.heading - turned[1]).max() < 1e-6 and np.abs(moved.direction - turned[0]).max() < 1e-6
    assert np.abs(moved.up + up).max() < 1e-6


def test_directions_along_the_normal_become_tangents() -> None:
    solid, rng = make_solid(meshes.ball(20.0, rings=24)), np.random.default_rng(7)
    directions = unit(np.concatenate([np.eye(3), -np.eye(3), rng.normal(size=(20, 3))]))
    place, up, _ = standing(solid, directions * 20, directions)
    moved = move_over_solid(solid, place, 0 * up, up, up, BODY)
    assert not moved.travelled.any() and not moved.is_lost.any()
    for vectors in (moved.heading, moved.direction):
        assert np.abs((vectors * moved.up).sum(axis=1)).max() < 1e-9 and np.abs(np.linalg.norm(vectors, axis=1) - 1).max() < 1e-9


@kernel
def project_all(
    bricks: BrickTables,
    place: Array2[F64],
    normal: Array2[F64],
    direction: Array2[F64],
    length: Array1[F64],
    close: F64,
    points: Array2[F64],
    slopes: Array2[F64],
    distances: Array1[F64],
) -> None:
    """Project the ends of all paths, (n, 3) each."""
    for i in range(length.size):
        p, n = (place[i, 0], place[i, 1], place[i, 2]), (normal[i, 0], normal[i, 1], normal[i, 2])
        along = direction[i, 0], direction[i, 1], direction[i, 2]
        q, g, distances[i] = _project_to_surface(bricks[0], bricks[1], bricks[2:], p, n, along, length[i], close)
        for k in range(3):
            points[i, k], slopes[i, k] = q[k], g[k]


def test_ends_of_steps_are_brought_to_the_surface_at_sharp_edges_too() -> None:
    """If the surface is between the end and a point beside the start, the result is on it, with its own slope and distance."""
    solid, rng = cheese(), np.random.default_rng(8)
    directions = unit(rng.normal(size=(3000, 3)))
    place, normal, head = standing(solid, directions * 18, directions[::-1])
    assert np.abs(solid.sample_distances(place)).max() < 1e-3
    length, close, count = rng.uniform(0.05, 1, len(place)), 1.5e-4, len(place)
    points, slopes, distances = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    project_all(make_brick_tables(solid.bricks), place, normal, head, length, close, points, slopes, distances)
    own_distance, own_slope = solid.sample_with_gradients(points)
    assert np.abs(distances - own_distance).max() < 1e-5 and np.abs(slopes - own_slope).max() < 1e-3
    end = place + head * length[:, None]
    beyond = solid.sample_distances(end) > 0
    near = place - np.where(beyond, 0.5, -0.5)[:, None] * length[:, None] * normal
    bracketed = (solid.sample_distances(near) > 0) != beyond
    assert (np.abs(distances) <= close)[bracketed].mean() > 0.999 and bracketed.mean() > 0.9


def test_who_loses_the_ground_goes_to_what_is_left() -> None:
    solid = make_solid(meshes.ball(20.0, rings=24))
    directions = unit(np.random.default_rng(1).normal(size=(40, 3)))
    place, up, head = standing(solid, directions * 20, directions)
    solid.carve_balls(place[:20], np.full(20, 6.0), np.arange(20))
    assert (solid.sample_distances(place[:20]) > 3).all()
    for step in (0.0, 1.0):
        moved = move_over_solid(solid, place, head * step, head, up, BODY)
        assert not moved.is_lost.any() and np.abs(solid.sample_distances(moved.position)).max() <= 1e-4 * BODY
    solid.carve_balls(np.zeros((1, 3)), np.array([100.0]), np.array([0]))
    moved = move_over_solid(solid, place, head, head, up, BODY)
    assert moved.is_lost.all() and (moved.position == place).all()


def test_one_agent_moves_as_it_does_among_many() -> None:
    solid = cheese()
    directions = unit(np.random.default_rng(1).normal(size=(50, 3)))
    place, up, head = standing(solid, directions * 15, directions[::-1])
    everyone = move_over_solid(solid, place, head, head, up, BODY)
    for subset in (slice(7, 8), slice(20, 33), slice(None, None, -1)):
        few = move_over_solid(solid, place[subset], head[subset], head[subset], up[subset], BODY)
        for all_, column in zip(everyone.list_columns(), few.list_columns(), strict=True):
            assert np.array_equal(all_[subset], column)
