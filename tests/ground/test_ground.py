"""Grounds: footings exact on their triangle, paths as long as requested over slopes, edges, overhangs, boulders and thin
plates."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.ground.combined import CombinedGround
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.moving import MovingGround
from antdsl.ground.plane import PlaneGround
from antdsl.ground.protocol import Footing, Ground, GroundMove
from antdsl.ground.solid import Volume
from tests.meshes import ball, box, grid, terrain

UP = np.array([0.0, 1.0, 0.0])


def start(ground: MeshGround, positions: list | np.ndarray, headings: list | np.ndarray, up: np.ndarray = UP) -> GroundMove:
    """Agents at the nearest points of a ground, as after a step of no length."""
    positions, headings = np.array(positions, np.float64), np.array(headings, np.float64)
    footing, _ = ground.find_nearest(positions)
    ups = np.broadcast_to(up, positions.shape)
    return ground.move(footing, np.zeros_like(positions), headings, ups, 4.0)


def step(ground: MeshGround, at: GroundMove, length: float, threads: int = 1) -> GroundMove:
    return ground.move(at.footing, at.heading * length, at.heading, at.up, 4.0, threads)


def check(ground: MeshGround, meshes: list, at: GroundMove) -> None:
    assert not at.is_lost.any()
    assert np.isfinite(at.position).all() and np.array_equal(at.position, ground.position(at.footing))
    corners = np.stack([meshes[m][0][meshes[m][1][f]] for m, f in zip(at.footing.mesh, at.footing.face, strict=True)])
    assert np.abs(find_nearest_on_triangle(at.position, corners) - at.position).max() < 1e-9
    assert np.allclose(np.linalg.norm(at.up, axis=1), 1) and np.allclose(np.linalg.norm(at.heading, axis=1), 1)
    assert np.abs((at.up * at.heading).sum(axis=1)).max() < 1e-9
    assert np.allclose(np.linalg.norm(at.direction, axis=1), 1) and np.abs((at.up * at.direction).sum(axis=1)).max() < 1e-9
    assert (np.abs((ground.normal(at.footing) * at.up).sum(axis=1)) > 0.5).all()


def test_place_is_the_first_surface_from_above_or_the_nearest_point():
    meshes = {"ground": grid(100, 5), "shelf": box((10, 20, -10), (30, 22, 10))}
    ground = MeshGround(meshes)
    points = np.array([[0, -500, 0], [20, 1, 0], [70, 30, 0]], np.float64)
    footing, is_placed = ground.place_points(points, UP)
    assert is_placed.tolist() == [True, True, False]
    assert np.allclose(ground.position(footing), [[0, 0, 0], [20, 22, 0], [50, 0, 0]], atol=1e-5)
    assert footing.mesh.tolist() == [0, 1, 0]
    footing, is_placed = ground.place_points(points, UP, surface_names=["ground"])
    assert np.allclose(ground.position(footing)[1], [20, 0, 0], atol=1e-5)
    with pytest.raises(KeyError, match="has no surface `moon`"):
        ground.place_points(points, UP, surface_names=["moon"])
    tilted = MeshGround({"z up": (grid(100, 4)[0][:, [0, 2, 1]], grid(100, 4)[1])})
    footing, is_placed = tilted.place_points(np.array([[3.0, 4.0, 50.0]]), np.array([0, 0, 1.0]))
    assert is_placed[0] and np.allclose(tilted.position(footing), [[3, 4, 0]], atol=1e-5)


@pytest.mark.parametrize("degrees", [0, 30, 60, 85, 120, 180])
def test_a_slope_neither_speeds_up_nor_slows_down(degrees):
    turn = np.radians(degrees)
    vertices, faces = grid(100, 30)
    vertices = vertices @ np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    ground = MeshGround({"slope": (vertices, faces)})
    normal = np.array([-np.sin(turn), np.cos(turn), 0])
    along = np.array([np.cos(turn), np.sin(turn), 0])
    at = start(ground, [along * -40], [along], normal)
    for _ in range(60):
        previous_move = at
        at = step(ground, at, 1.25)
        assert np.linalg.norm(at.position - previous_move.position) == pytest.approx(1.25, abs=1e-9)
        assert at.travelled[0] == pytest.approx(1.25, abs=1e-12)
    assert np.allclose(at.position, along * 35, atol=1e-6) and np.allclose(at.heading, along) and np.allclose(at.up, normal)


@pytest.mark.parametrize("inside", [False, True])
def test_around_a_cube_and_back_outside_and_inside(inside):
    mesh = box((-10, -10, -10), (10, 10, 10))
    ground = MeshGround({"cube": mesh})
    at = start(ground, [[0.3, 10, 1.0]], [[1, 0, 0]], -UP if inside else UP)
    first, up_vectors = at.position, set()
    for _ in range(64):
        at = step(ground, at, 1.25)
        up_vectors.add(tuple(np.round(at.up[0]).astype(int)))
        assert at.travelled[0] == pytest.approx(1.25, abs=1e-12)
        check(ground, [mesh], at)
    assert np.allclose(at.position, first, atol=1e-9) and np.allclose(at.heading, [[1, 0, 0]])
    sign = -1 if inside else 1
    assert up_vectors == {(0, sign, 0), (sign, 0, 0), (0, -sign, 0), (-sign, 0, 0)}


def test_a_plate_thinner_than_a_step_is_walked_round_its_rim():
    mesh = box((-20, 0, -20), (20, 0.05, 20))
    ground = MeshGround({"plate": mesh})
    at = start(ground, [[0, 0.05, 0.5]], [[1, 0, 0]])
    for _ in range(20):
        at = step(ground, at, 1.25)
    assert at.position[0][0] == pytest.approx(40.05 - 25, abs=1e-6) and at.position[0][1] == pytest.approx(0)
    assert np.allclose(at.up, [[0, -1, 0]]) and np.allclose(at.heading, [[-1, 0, 0]])


def test_a_box_of_six_loose_sheets_is_walked_round_like_one():
    vertices, faces = box((-10, -10, -10), (10, 10, 10))
    sheets = {
        f"side {k}": (vertices[faces[2 * k : 2 * k + 2]].reshape(-1, 3), np.arange(6, dtype=np.int32).reshape(2, 3))
        for k in range(6)
    }
    ground = MeshGround(sheets)
    at = start(ground, [[0.3, 10, 1.0]], [[1, 0, 0]])
    ups = set()
    for _ in range(70):
        at = step(ground, at, 1.25)
        check(ground, list(sheets.values()), at)
        ups.add(tuple(np.round(at.up[0]).astype(int)))
    assert ups == {(0, 1, 0), (1, 0, 0), (0, -1, 0), (-1, 0, 0)}
    assert abs(at.position[0][2] - 1.0) < 1e-3


def test_at_an_open_border_an_agent_slides_or_stops_and_says_so():
    ground = MeshGround({"sheet": grid(40, 8)})
    at = start(ground, [[18, 0, 0], [18, 0, 1]], [[1, 0, 0], [0.6, 0, 0.8]])
    for _ in range(8):
        at = step(ground, at, 1.0)
    assert at.is_blocked.all() and not at.is_lost.any()
    assert at.position[0] == pytest.approx([20, 0, 0], abs=1e-4)
    assert at.position[1][0] == pytest.approx(20, abs=1e-4) and 4 < at.position[1][2] < 10
    assert at.travelled[0] < 0.01
    corner = start(ground, [[19.5, 0, 19.5]], [[0.6, 0, 0.8]])
    for _ in range(6):
        corner = step(ground, corner, 1.0)
    assert np.allclose(corner.position, [[20, 0, 20]], atol=0.5) and corner.is_blocked.all()


def test_tiles_laid_edge_to_edge_are_one_ground():
    left, right = grid(40, 8), grid(40, 10)
    ground = MeshGround({"left": left, "right": (right[0] + np.array([40.0, 0, 0]), right[1])})
    at = start(ground, [[10, 0, 0.3]], [[1, 0, 0.01]])
    for _ in range(20):
        at = step(ground, at, 1.25)
    assert at.position[0][0] == pytest.approx(35, abs=0.3) and at.footing.mesh[0] == 1 and not at.is_blocked[0]


def test_up_a_half_sunk_boulder_over_it_and_down_again():
    ground_mesh, boulder = grid(200, 40), ball(15, (0, 3, 0), 16)
    ground = MeshGround({"ground": ground_mesh, "boulder": boulder})
    at = start(ground, [[-30, 0, 1.3]], [[1, 0, 0]])
    path, meshes = [at.position[0]], []
    for _ in range(100):
        at = step(ground, at, 1.25)
        check(ground, [ground_mesh, boulder], at)
        path.append(at.position[0])
        meshes.append(int(at.footing.mesh[0]))
    path = np.array(path)
    assert path[:, 1].max() == pytest.approx(18, abs=0.3) and path[:, 1].min() > -1e-6
    first, last = meshes.index(1), len(meshes) - meshes[::-1].index(1)
    assert set(meshes[first:last]) == {1} and set(meshes[:first] + meshes[last:]) == {0}
    assert path[-1][0] > 25 and at.up[0][1] == pytest.approx(1)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 1.25 + 0.25


def test_a_wall_that_shares_its_edge_with_the_floor_is_climbed_from_either_side():
    vertices = np.array([[x, 0, z] for x in (-10, 0, 10) for z in (-10, 10)] + [[0, 10, -10], [0, 10, 10]], np.float64)
    faces = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4], [2, 3, 7], [2, 7, 6]], np.int32)
    ground = MeshGround({"room": (vertices, faces)})
    at = start(ground, [[-2, 0, 1], [2, 0, 1], [-2, 0, 1]], [[1, 0, 0], [-1, 0, 0], [1, 0, 0]], UP)
    below = ground.move(at.footing, at.heading * 0, at.heading, -at.up, 4.0)
    up, down = step(ground, at, 5.0), step(ground, below, 5.0)
    assert np.allclose(up.position, [[0, 3, 1]] * 3, atol=1e-9)
    assert np.allclose(up.up, [[-1, 0, 0], [1, 0, 0], [-1, 0, 0]])
    assert np.allclose(down.position, [[3, 0, 1], [-3, 0, 1], [3, 0, 1]], atol=1e-9)


def test_faces_wound_the_other_way_and_doubled_faces_change_nothing():
    mesh = box((-10, -10, -10), (10, 10, 10))
    faces = mesh[1].copy()
    faces[::3] = faces[::3][:, ::-1]
    odd = MeshGround(
        {"cube": (mesh[0], np.concatenate([faces, faces[:, [1, 2, 0]], faces[:4, ::-1], [[0, 0, 1]]]).astype(np.int32))}
    )
    plain = MeshGround({"cube": mesh})
    one, two = (start(g, [[1, 10, 2]], [[0.8, 0, 0.6]]) for g in (plain, odd))
    for _ in range(80):
        one, two = step(plain, one, 1.3), step(odd, two, 1.3)
    assert np.allclose(one.position, two.position, atol=1e-6) and np.allclose(one.up, two.up)


def test_a_crowd_on_all_sorts_of_ground_is_never_lost():
    meshes = [terrain(300, 40), ball(30, (40, 10, 20), 12), box((-80, -30, -80), (-60, 40, -50)), ball(12, (-20, 0, 60), 9)]
    ground = MeshGround({str(k): m for k, m in enumerate(meshes)})
    rng = np.random.default_rng(8)
    n = 400
    footing, _ = ground.place_points(rng.uniform(-150, 150, (n, 3)), UP)
    at = ground.move(footing, np.zeros((n, 3)), rng.normal(size=(n, 3)), ground.compute_upright_normals(footing, UP), 4.0)
    for k in range(100):
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.3, (n, 1))
        previous_move = at
        at = ground.move(at.footing, heading / np.linalg.norm(heading, axis=1, keepdims=True) * 1.25, heading, at.up, 4.0)
        distances = np.linalg.norm(at.position - previous_move.position, axis=1)
        assert distances.max() < 1.25 + 1.1
        assert np.allclose(at.travelled[~at.is_blocked], 1.25, atol=1.1)
        if k % 20 == 0:
            check(ground, meshes, at)
    assert np.unique(at.footing.mesh).size == 4


def test_same_bits_in_any_batch_order_and_thread_count():
    ground = MeshGround({"ground": terrain(200, 30), "boulder": ball(25, (0, 0, 0), 12)})
    n = 1500
    rng = np.random.default_rng(9)
    footing, _ = ground.place_points(rng.uniform(-60, 60, (n, 3)), UP)
    at = ground.move(footing, np.zeros((n, 3)), rng.normal(size=(n, 3)), ground.compute_upright_normals(footing, UP), 4.0)
    order = rng.permutation(n)
    one = step(ground, at, 3.0)
    two = ground.move(at.footing.select_rows(order), at.heading[order] * 3.0, at.heading[order], at.up[order], 4.0, threads=2)
    for name in ("position", "up", "heading", "direction", "travelled", "is_blocked"):
        assert np.array_equal(getattr(one, name)[order], getattr(two, name)), name
    for k in range(0, n, 101):
        alone = ground.move(at.footing.select_rows(np.array([k])), at.heading[[k]] * 3.0, at.heading[[k]], at.up[[k]], 4.0)
        assert np.array_equal(alone.position[0], one.position[k]) and np.array_equal(alone.heading[0], one.heading[k])


def test_odd_wishes_leave_an_agent_where_it_is():
    ground = MeshGround({"ground": grid(100, 10)})
    at = start(ground, [[1, 0, 1]] * 4, [[1, 0, 0]] * 4)
    wish = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -5, 0], [0, 0, 0]])
    next_move = ground.move(at.footing, wish, at.heading, at.up, 4.0)
    assert np.array_equal(next_move.position, at.position) and np.allclose(next_move.heading, at.heading)
    assert not next_move.travelled.any() and not next_move.is_blocked.any()
    nowhere = ground.move(Footing.create_unplaced(2), np.ones((2, 3)), np.ones((2, 3)), np.ones((2, 3)), 4.0)
    assert nowhere.is_lost.all() and (nowhere.footing.face == -1).all() and np.isfinite(nowhere.position).all()
    empty = MeshGround({})
    footing, is_placed = empty.place_points(np.zeros((3, 3)), UP)
    assert not is_placed.any() and empty.move(footing, np.ones((3, 3)), np.ones((3, 3)), np.ones((3, 3)), 4.0).is_lost.all()


def test_the_smooth_normal_is_steady_on_a_ball_and_flat_on_a_cube():
    mesh = ball(20, rings=24)
    ground = MeshGround({"ball": mesh})
    points = np.random.default_rng(3).normal(size=(3000, 3)) * 30
    footing, _ = ground.find_nearest(points)
    place = ground.position(footing)
    out = place / np.linalg.norm(place, axis=1, keepdims=True)
    smooth = ground.compute_upright_normals(footing, out)
    assert np.degrees(np.arccos((smooth * out).sum(axis=1).clip(-1, 1))).max() < 1.5
    assert np.degrees(np.arccos((ground.normal(footing) * out).sum(axis=1).clip(-1, 1))).max() > 3
    assert np.array_equal(ground.compute_upright_normals(footing, -out), -smooth)
    cube = MeshGround({"cube": box((-1, -1, -1), (1, 1, 1))})
    footing, _ = cube.find_nearest(np.array([[0.99, 1.5, 0.99]]))
    assert np.allclose(cube.compute_upright_normals(footing, UP), [[0, 1, 0]])


@pytest.mark.parametrize("middle", [-11.0, -5.0, 3.0, 13.0])
def test_no_agent_slips_under_the_ground_or_into_a_boulder_however_deep_it_is_sunk(middle):
    meshes = [grid(160, 30), ball(15, (0.3, middle, 0.2), 14)]
    ground = MeshGround({"ground": meshes[0], "boulder": meshes[1]})
    rng = np.random.default_rng(2)
    n = 300
    turn, rim = rng.uniform(0, 2 * np.pi, n), np.sqrt(225 - middle**2)
    out = rim + rng.uniform(2, 8, n)
    footing, _ = ground.place_points(
        np.stack([out * np.cos(turn), 0 * out, out * np.sin(turn)], axis=1), UP, surface_names=["ground"]
    )
    at = ground.move(footing, np.zeros((n, 3)), -ground.position(footing), ground.compute_upright_normals(footing, UP), 4.0)
    boulder_before, climbs = np.zeros(n, bool), 0
    for _ in range(120):
        home = -at.position * np.array([1, 0, 1]) * (np.linalg.norm(at.position, axis=1, keepdims=True) > rim + 8)
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.4, (n, 1)) + 0.02 * home
        heading -= at.up * (heading * at.up).sum(axis=1, keepdims=True)
        heading /= np.linalg.norm(heading, axis=1, keepdims=True)
        at = ground.move(at.footing, heading * 1.25, heading, at.up, 4.0)
        boulder = at.footing.mesh == 1
        climbs += np.count_nonzero(boulder != boulder_before)
        boulder_before = boulder
        assert (at.position[boulder][:, 1] > -0.1).all()  # looks ahead from a fiftieth of a body above the ground
        assert (at.up[~boulder][:, 1] > 0.99).all()
        if middle > -11:
            assert (np.hypot(*(at.position[~boulder][:, [0, 2]] - [0.3, 0.2]).T) > rim - 0.8).all()
    assert climbs > 200


def test_steps_on_a_plane_are_taken_back() -> None:
    plane, start = PlaneGround(UP), np.zeros((3, 3))
    ahead, up = np.tile([1.0, 0.0, 0.0], (3, 1)), np.tile(UP, (3, 1))
    moved = plane.move(plane.create_unplaced(3), 5 * ahead, ahead, up, 1.0)
    subset = np.array([0, 2])
    back = moved.select_rows(subset)
    moved.write_rows(subset, plane.move(back.footing, -3 * ahead[subset], back.heading, back.up, 1.0))
    assert (moved.position - start)[:, 0].tolist() == [2, 5, 2] and (moved.up == UP).all()
    assert moved.travelled.tolist() == [3, 5, 3]


def test_every_ground_has_the_same_doors() -> None:
    """What mypy proves by the assignments, for a footing of every kind."""
    sheet, cube = grid(100.0, 4), Volume.from_mesh(*box((-6.0, -6.0, -6.0), (6.0, 6.0, 6.0)), 2.0)
    assert isinstance(cube, Volume)
    plane: Ground = PlaneGround(UP)
    still: Ground = MeshGround({"sheet": sheet})
    moving: Ground = MovingGround({"sheet": sheet}, ["sheet"])
    both: Ground = CombinedGround(MeshGround({"sheet": sheet}), {"cube": cube}, UP)
    positions = np.array([[0.0, 9.0, 0.0], [40.0, 3.0, 9.0]])
    for ground in (plane, still, moving, both):
        dropped, is_placed = ground.place_points(positions, UP)
        near, distance = ground.find_nearest(positions)
        footing = Footing.concatenate(ground.create_unplaced(0), dropped, near)
        assert is_placed.all() and distance.shape == (2,) and len(footing) == 4
        assert footing.columns.keys() == ground.create_unplaced(3).columns.keys() and len(ground.create_unplaced(3)) == 3
        assert {name: column.dtype for name, column in footing.columns.items()} == {
            name: column.dtype for name, column in ground.create_unplaced(1).columns.items()
        }
        at = ground.position(footing)
        assert at.shape == (4, 3) and ground.normal(footing).shape == (4, 3) and (ground.find_sides(footing) == 2).all()
        assert np.allclose(ground.compute_upright_normals(footing, UP), UP)
        moved = ground.move(footing, np.full((4, 3), (1.0, 0.0, 0.0)), np.full((4, 3), (1.0, 0.0, 0.0)), np.tile(UP, (4, 1)), 4.0)
        assert np.allclose(moved.position - at, (1.0, 0.0, 0.0)) and not moved.is_lost.any()
        footing.write_rows(np.array([0, 1]), moved.footing.select_rows(np.array([2, 3])))
        assert np.allclose(ground.position(footing)[:2], moved.position[2:])
    assert both.place_points(positions, UP)[0].mesh.tolist() == [1, 0]
