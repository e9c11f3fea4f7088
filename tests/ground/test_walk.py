"""Steps over triangles are those of `walked`, which goes over all faces for each agent, on every sort of ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from open_shapes import WORSE
from sampling import sampled
from torture_walks import shapes
from walked import Reference

from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_BODY_LENGTHS
from antdsl.ground.moving import MovingGround
from antdsl.ground.protocol import Footing, GroundMove
from tests.meshes import ball, box, grid, terrain

Floats = NDArray[np.float64]
UP = np.array([0.0, 1.0, 0.0])
N = 500
FEW, STEPS = 50, 4
# Of so many steps on a ground, those that rounding takes another way, past a corner or along an edge that two pieces share.
ROUNDED = {"bows": 4, "slivers": 3, "book": 5, "a hose through itself": 1}


def rumpled() -> dict:
    vertices, faces = ball(12, rings=9)
    odd = faces.copy()
    odd[::3] = odd[::3][:, ::-1]
    lines = np.array([[0, 0, 1], [2, 2, 2], [0, 1, 1]], np.int32)
    return {"ball": (vertices, np.concatenate([odd, faces[:20, [1, 2, 0]], faces[:9, ::-1], lines]).astype(np.int32))}


def forked() -> dict:
    vertices = np.array([[x, 0, z] for x in (-10, 0, 10) for z in (-10, 10)] + [[0, 10, -10], [0, 10, 10]], np.float64)
    faces = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4], [2, 3, 7], [2, 7, 6]], np.int32)
    return {"room": (vertices, faces)}


def sheets() -> dict:
    vertices, faces = box((-10, -10, -10), (10, 10, 10))
    return {str(k): (vertices[faces[2 * k : 2 * k + 2]].reshape(-1, 3), np.arange(6).reshape(2, 3)) for k in range(6)}


GROUNDS = {
    "hills": lambda: {"hills": terrain(120, 40)},
    "open sheet": lambda: {"sheet": grid(14, 7)},
    "thin plate": lambda: {"plate": box((-8, 0, -8), (8, 0.05, 8))},
    "flipped, doubled and flat faces": rumpled,
    "a wall on a floor": forked,
    "loose sheets": sheets,
    "a hose through itself": lambda: {"eight": shapes().eight(), "floor": grid(60, 9)},
    **{name: (lambda build=build: {"worse": build()}) for name, build in WORSE.items()},
    "boulders": lambda: {"hills": terrain(100, 30), "a": ball(14, (8, 4, 3), 9), "b": box((-30, -20, -30), (-18, 15, -14))},
    "tiles and a fan of slivers": lambda: {
        "left": grid(30, 6),
        "right": (grid(30, 5)[0] + np.array([30.0, 0, 0]), grid(30, 5)[1]),
        "fan": (ball(6, (0, 5, 0), 3)[0] * np.array([1, 0.02, 1]), ball(6, (0, 5, 0), 3)[1]),
    },
}


def crowd(ground: MeshGround, rng: np.random.Generator, n: int = N) -> GroundMove:
    """Agents all over a ground, some below it, as after a step of no length."""
    footing, _ = ground.find_nearest(rng.uniform(ground.low - 1, ground.high + 1, (n, 3)))
    up = ground.normal(footing) * rng.choice([-1.0, 1.0], (n, 1), p=[0.2, 0.8])
    return ground.move(footing, np.zeros((n, 3)), rng.normal(size=(n, 3)), up, 4.0)


def differing(
    ground: MeshGround, previous_move: GroundMove, wish: Floats, heading: Floats, body: Floats, straight: bool = False
) -> int:
    """How many agents a step takes elsewhere than `walked` says; and one that is turned by a hair, too, else it is rounding that
    takes them past a corner on another side."""
    rows, rng, reference = np.arange(len(wish)), np.random.default_rng(1), Reference(ground)
    for hair in (0.0, 1e-6, 1e-6):
        turned = wish + np.cross(previous_move.up, wish) * hair * rng.normal(size=(len(wish), 1))
        next_move = ground.move(previous_move.footing, turned, heading, previous_move.up, body, stop_at_borders=straight)
        rows = rows[
            [not _same(reference, ground, previous_move, next_move, turned, heading, body, straight, int(k)) for k in rows]
        ]
        if not rows.size:
            break
    return len(rows)


def _same(
    reference: Reference,
    ground: MeshGround,
    previous_move: GroundMove,
    next_move: GroundMove,
    wish: Floats,
    heading: Floats,
    body: Floats,
    straight: bool,
    k: int,
) -> bool:
    near = 1e-7 * ground.extent
    face, over = int(ground.get_face_numbers(previous_move.footing)[0][k]), float(previous_move.footing.over[k])
    place = previous_move.position[k] - over * reference.normal[face]
    step = reference.step(face, place, over, wish[k], heading[k], previous_move.up[k], float(body[k]), straight)
    same = next_move.is_blocked[k] == step.blocked and abs(next_move.travelled[k] - step.travelled) <= near
    for one, other in ((next_move.position, step.position), (next_move.up, step.up), (next_move.heading, step.heading)):
        same = same and np.abs(one[k] - other).max() <= max(near, 1e-6)
    if step.travelled > near:  # in a corner the last border decides, and rounding which that is
        same = same and np.abs(next_move.direction[k] - step.direction).max() <= 1e-6
    return bool(same and abs(next_move.footing.over[k] - step.over) <= near)


@pytest.mark.parametrize("name", sampled(GROUNDS, GROUNDS.keys() - {"book", "bows"}))
def test_each_step_is_that_of_a_walk_against_all_faces(name: str) -> None:
    ground, rng = MeshGround(GROUNDS[name]()), np.random.default_rng(5)
    at, body, wrong = crowd(ground, rng, FEW), rng.uniform(0, 5, FEW), 0
    for k in range(STEPS):
        length = rng.choice([0.0, 1e-9, 0.4, 1.5, 6.0], (FEW, 1), p=[0.04, 0.04, 0.22, 0.3, 0.4])
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.5, (FEW, 1)) + at.up * rng.normal(0, 0.3, (FEW, 1))
        wrong += differing(ground, at, heading * length, heading, body, straight=k == STEPS - 1)
        at = ground.move(at.footing, heading * length, heading, at.up, body)
    assert wrong <= ROUNDED.get(name, 0)


def test_each_step_beside_a_mesh_that_moves_is_that_against_all_faces() -> None:
    meshes = {"sheet": grid(30, 12), "stone": ball(5, (0, 1, 0), 7)}
    ground, rng = MovingGround(meshes, ["stone"]), np.random.default_rng(16)
    at, blocked, carried = crowd(ground, rng, 4 * FEW), 0, 0
    for frame in range(6):
        ground.set_mesh_vertices({"stone": meshes["stone"][0] + np.array([1.5 * frame, 0.1 * frame, 0])})
        at = replace(at, position=ground.position(at.footing))
        wish, body = at.heading * 1.1, rng.uniform(0, 5, 4 * FEW)
        assert differing(ground, at, wish, at.heading, body) == 0
        at = ground.move(at.footing, wish, at.heading, at.up, body)
        blocked, carried = blocked + at.is_blocked.sum(), carried + (at.footing.mesh == 1).sum()
    assert blocked > 50 and carried > 100


def test_who_hangs_over_a_border_moves_as_against_all_faces() -> None:
    ground, rng = MeshGround({"high": grid(14, 7, lambda x, z: 3 + 0 * x), "low": grid(30, 9)}), np.random.default_rng(2)
    at, hung, wrong = crowd(ground, rng, 4 * FEW), 0, 0
    for _ in range(12):
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.5, (4 * FEW, 1))
        wish, body = heading * rng.choice([0.3, 1.5], (4 * FEW, 1)), np.full(4 * FEW, 8.0)
        hung += np.count_nonzero(at.footing.over)
        wrong += differing(
            ground, at, wish, heading, body
        )  # by rounding, looks straight down end on what they look for or before
        at = ground.move(at.footing, wish, heading, at.up, body)
    assert hung > 60 and wrong <= 2


def test_a_corner_of_many_faces_is_left() -> None:
    """Who goes to and fro between faces at the tip of a narrow cone is moved off it, and goes on."""
    vertices = np.array([[0, 0, 0]] + [[np.cos(a), 1e3, np.sin(a)] for a in np.linspace(0, 2 * np.pi, 8)[:-1]])
    faces = np.array([[0, 1 + (k + 1) % 7, 1 + k] for k in range(7)], np.int32)
    ground, rng = MeshGround({"cone": (vertices, faces)}), np.random.default_rng(1)
    footing = Footing.from_faces(np.zeros(FEW, np.int32), rng.integers(0, 7, FEW).astype(np.int32), *np.full((3, FEW), 1e-7))
    at = ground.move(footing, np.zeros((FEW, 3)), rng.normal(size=(FEW, 3)), ground.normal(footing), 4.0)
    wish = at.heading * 0.7
    assert differing(ground, at, wish, at.heading, np.full(FEW, 4.0)) <= 2


def test_odd_wishes_count_as_none_and_lost_agents_stay_lost() -> None:
    ground, rng = MeshGround(GROUNDS["boulders"]()), np.random.default_rng(6)
    at = crowd(ground, rng)
    values = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e-160, 1.0, 30.0])
    wish, heading, up = (rng.choice(values, (N, 3)) for _ in range(3))
    up[::2], heading[::3] = at.up[::2], at.heading[::3]
    lost = rng.random(N) < 0.1
    footing = Footing.from_faces(
        np.where(lost & (rng.random(N) < 0.8), -1, at.footing.mesh).astype(np.int32),
        np.where(lost & (rng.random(N) < 0.8), -1, at.footing.face).astype(np.int32),
        np.where(lost & (rng.random(N) < 0.9), np.nan, np.where(rng.random(N) < 0.2, -0.0, at.footing.b1)),
        np.where(rng.random(N) < 0.2, 1.0, at.footing.b2),
    )
    lost = (footing.mesh < 0) | (footing.face < 0) | np.isnan(footing.b1)
    next_move = ground.move(footing, wish, heading, up, 4.0)
    assert np.array_equal(next_move.is_lost, lost) and 10 < lost.sum() < N // 4
    assert (next_move.footing.mesh[lost] == -1).all() and (next_move.footing.face[lost] == -1).all()
    assert not next_move.position[lost].any() and not next_move.travelled[lost].any() and not next_move.is_blocked[lost].any()
    for one, other in ((next_move.up, up), (next_move.heading, heading), (next_move.direction, heading)):
        assert np.array_equal(one[lost], other[lost], equal_nan=True)
    sound = ~lost & np.isfinite(up).all(axis=1)
    for column in next_move.list_columns():
        assert np.isfinite(column[sound]).all()
    odd = ~np.isfinite(wish).all(axis=1) & sound
    still = ground.move(footing, np.zeros((N, 3)), heading, up, 4.0)
    assert np.array_equal(next_move.position[odd], still.position[odd]) and not next_move.travelled[odd].any()
    bare = ground.move(footing, np.full((N, 3), np.inf), np.full((N, 3), np.nan), np.where(lost[:, None], 1.0, at.up), 1e300)
    assert np.isfinite(bare.heading[~lost]).all() and not bare.travelled.any()


def test_how_far_agents_look_out_is_their_longest_way_and_widest_body() -> None:
    ground, rng = MeshGround(GROUNDS["boulders"]()), np.random.default_rng(8)
    for values in ([0.0, 1.0, 3.0], [np.nan, np.inf, -np.inf, 1e200, 2.0]):
        wish, body = rng.choice(values, (3, 40)), rng.choice([*values, 2.5], 40)
        with np.errstate(all="ignore"):
            square = wish[0] * wish[0] + wish[1] * wish[1] + wish[2] * wish[2]
        most = np.sqrt(square[square < np.inf].max(initial=0.0))
        assert (
            ground._compute_search_reach(wish, body)
            == most + EYE_HEIGHT_BODY_LENGTHS * np.nanmax(body) + 3 * ground._scale.distance_noise
        )
    assert np.isnan(ground._compute_search_reach(np.ones((3, 2)), np.full(2, np.nan)))


@pytest.mark.parametrize("name", ["boulders", "loose sheets", "tiles and a fan of slivers"])
def test_clearances_are_below_the_distance_to_other_pieces(name: str) -> None:
    ground = MeshGround(GROUNDS[name]())
    rng = np.random.default_rng(7)
    corners = ground._vertices[ground._faces]
    for reach in (0.5, 3.0):
        parts = ground._clearances.get_face_parts(reach)
        assert parts.reach >= reach
        face = rng.integers(0, len(corners), 2000)
        b1 = rng.random(2000)
        b2 = rng.random(2000) * (1 - b1)
        n = parts.parts_per_edge[face]
        part = parts.first_parts[face] + np.minimum((b1 * n).astype(int), n - 1) * n + np.minimum((b2 * n).astype(int), n - 1)
        clear = np.where(n > 0, parts.clearances[np.where(n > 0, part, 0)], parts.reach)
        a, b, c = (corners[face, k] for k in range(3))
        place = a + b1[:, None] * (b - a) + b2[:, None] * (c - a)
        for piece in range(ground._topology.piece_count):
            other = corners[(ground._topology.piece != piece) & (ground._topology.piece >= 0)]
            scene = RayScene(other.reshape(-1, 3), np.arange(3 * len(other), dtype=np.int32).reshape(-1, 3))
            own = ground._topology.piece[face] == piece
            distance = scene.find_closest(place[own])[3]
            assert (clear[own] <= distance + 1e-9).all()
        assert (clear > 0).any()


def test_finer_distances_of_an_obstacle_are_still_below_the_true_ones() -> None:
    (one, faces), (two, _) = ball(3, (300, 5, 0), 5), ball(3, (420, 90, 80), 5)
    scene = RayScene(np.concatenate([one, two]), np.concatenate([faces, faces + len(one)]))
    positions = (
        one[np.random.default_rng(11).integers(0, len(one), 3000)] * 1.01 + np.random.default_rng(12).normal(size=(3000, 3)) * 2
    )
    coarse = np.concatenate([scene.measure_clearance(*chunk.T) for chunk in np.split(positions, 6)])
    fine = scene.measure_clearance(*positions.T)
    distance = scene.find_closest(positions)[3]
    assert (fine <= distance).all() and (fine >= coarse).all() and (fine > coarse).mean() > 0.2


@pytest.mark.parametrize("name", ["hills", "flipped, doubled and flat faces", "loose sheets", "a mesh that moves"])
def test_places_and_sides_of_footings_are_those_of_their_corners(name: str) -> None:
    rng = np.random.default_rng(3)
    if name == "a mesh that moves":
        stone = ball(14, (8, 4, 3), 9)
        ground: MeshGround = MovingGround({"stone": stone, "floor": grid(60, 9)}, ["stone"])
        ground.set_mesh_vertices({"stone": stone[0] * 1.25 + np.array([3.0, 0.1, -0.0])})  # type: ignore[attr-defined]
    else:
        ground = MeshGround(GROUNDS[name]())
    footing = crowd(ground, rng).footing
    for column in (footing.b1, footing.b2):  # corners and the far side of zero too
        column[:60] = rng.choice([0.0, -0.0, 1.0, np.nan, np.inf], 60)
    footing.over[::3] = rng.choice([-0.0, 0.3, -2.0, np.nan], len(footing.over[::3]))
    footing.mesh[5], footing.face[5:7] = -1, -1
    vertices, faces, _, table = ground.triangles
    known = (footing.mesh >= 0) & (footing.face >= 0)
    face = np.where(known, ground._first_face[np.maximum(footing.mesh, 0)] + footing.face, 0)
    a, b, c = (vertices[faces[face, k]] for k in range(3))
    with np.errstate(invalid="ignore"):
        place = (a + footing.b1[:, None] * (b - a)) + footing.b2[:, None] * (c - a)
        expected = np.where(known[:, None], place + footing.over[:, None] * table.normal[:, face].T, 0.0)
    positions, unknown = ground.position(footing), np.isnan(expected)
    assert (positions.view(np.int64) == expected.view(np.int64))[~unknown].all() and np.isnan(positions[unknown]).all()
    most = np.abs(table.normal[:, face]).argmax(axis=0)
    sides = 2 * most + (table.normal[most, face] < 0)
    assert np.array_equal(ground.find_sides(footing, 2), np.where(known, sides, 0))
    assert not len(ground.position(footing.select_rows(slice(0, 0)))) and not len(
        ground.find_sides(footing.select_rows(slice(0, 0)))
    )
    for column, wrong in ((footing.face, len(faces)), (footing.mesh, len(ground.names) + 1)):
        cached, column[9] = column[9], wrong
        with pytest.raises(IndexError):
            ground.position(footing)
        column[9] = cached
