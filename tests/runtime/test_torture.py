"""Any surface: cube, plate, torus, bottle, can, stacked stones, Möbius strip, broken mesh: on it, not lost, through no wall."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from meshes import Mesh
from numpy.typing import NDArray
from torture_long import FINE, from_file, long_walk
from torture_walks import BODY, STEP, WalkMeasures, above, crowd, depth, inside, parts, shapes, wander, winding

from antdsl.casting.rays import RayScene
from antdsl.ground.mesh import self_cuts
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.moving import MovingGround
from antdsl.ground.protocol import GroundMove

SHAPES = shapes()
N, STEPS = 300, 120
OVER = 0.01  # mm: rays err by a hair
Floats = NDArray[np.float64]


def walked(name: str, n: int = N, steps: int = STEPS) -> WalkMeasures:
    """A crowd on a shape, held to what is true of any surface."""
    mesh = SHAPES.SHAPES[name]()
    ground, rng, measures = MeshGround({name: mesh}), np.random.default_rng(4), WalkMeasures()
    for previous, at in wander(ground, crowd(ground, [mesh], n, rng), steps, rng):
        measures.look(ground, [mesh], previous, at)
    measures.good()
    return measures


@pytest.mark.parametrize("name", SHAPES.SHAPES)
def test_a_crowd_stays_on_any_surface(name: str) -> None:
    measures = walked(name)
    assert measures.moved > (0.5 if name in ("rag", "moebius", "pot") else 0.9) * STEP * STEPS, measures  # borders hold some up


@pytest.mark.parametrize("name", ["cube", "plate", "torus", "rod", "boulder"])
def test_who_is_inside_what_is_closed_stays_inside_and_who_is_outside_outside(name: str) -> None:
    mesh = SHAPES.SHAPES[name]()
    ground, rng = MeshGround({name: mesh}), np.random.default_rng(5)
    begin = crowd(ground, [mesh], N, rng)
    began = inside(mesh, above(ground, begin))
    assert 0.3 * N < began.sum() < 0.7 * N
    for k, (_, at) in enumerate(wander(ground, begin, STEPS, rng)):
        if k % 10 == 9:
            assert np.array_equal(inside(mesh, above(ground, at)), began), (name, k)


def in_bottle(points: Floats) -> NDArray[np.bool_]:
    """Whether places are in the room that the inner wall of the bottle bounds."""
    inner = np.array(SHAPES.BOTTLE[10:][::-1])
    radius = np.interp(points[:, 1], inner[1:, 1], inner[1:, 0], left=0.0, right=0.0)
    return np.hypot(points[:, 0], points[:, 2]) < radius


def in_can(points: Floats, tin: float = 0.0) -> NDArray[np.bool_]:
    """Whether places are in the can with a wall of 30 flat sides."""
    angle = np.mod(np.arctan2(points[:, 2], points[:, 0]), 2 * np.pi / 30) - np.pi / 30
    wall = np.hypot(points[:, 0], points[:, 2]) * np.cos(angle)
    return (points[:, 1] > tin) & (points[:, 1] < SHAPES.CAN - tin) & (wall < (SHAPES.RIM - tin) * np.cos(np.pi / 30))


def test_into_a_can_and_out_of_it_leads_only_the_hole_in_its_lid() -> None:
    mesh = SHAPES.can()
    ground, rng = MeshGround({"can": mesh}), np.random.default_rng(7)
    begin = crowd(ground, [mesh], N, rng)
    begin = begin.select_rows(np.flatnonzero(~inside(mesh, above(ground, begin))))  # no agent in the tin
    was, crossed = in_can(above(ground, begin), SHAPES.TIN), 0
    assert 0.3 < was.mean() < 0.7
    for k, (previous, at) in enumerate(wander(ground, begin, 2 * STEPS, rng)):
        now = in_can(above(ground, at), SHAPES.TIN)
        through = np.flatnonzero(now != was)
        for place in (previous.position[through], at.position[through]):
            away = np.hypot(place[:, 0], place[:, 2])
            assert (place[:, 1] > SHAPES.CAN - SHAPES.TIN - 1e-6).all() and (away < SHAPES.LID + STEP).all()
        crossed, was = crossed + through.size, now
        if k % 20 == 19:
            assert not inside(mesh, above(ground, at)).any()
    assert crossed > 20


def test_a_sheet_without_thickness_is_gone_through_nowhere() -> None:
    mesh = SHAPES.pot()
    ground, rng = MeshGround({"pot": mesh}), np.random.default_rng(7)
    begin = crowd(ground, [mesh], N, rng)
    began = in_can(above(ground, begin))
    assert 0.3 < began.mean() < 0.7
    stopped = 0
    for _, at in wander(ground, begin, 2 * STEPS, rng):
        assert np.array_equal(in_can(above(ground, at)), began)
        stopped += int(at.is_blocked.sum())
    assert stopped > 20  # by its border


def test_no_agent_on_a_stack_of_stones_comes_into_a_stone() -> None:
    mesh = SHAPES.stones()
    stack = parts(mesh, len(SHAPES.STACK))
    ground, rng = MeshGround({"stones": mesh}), np.random.default_rng(8)
    begin = crowd(ground, [mesh], 2 * N, rng)
    begin = begin.select_rows(np.flatnonzero(~np.any([inside(s, above(ground, begin)) for s in stack], axis=0)))
    piece = ground.triangles[3].piece
    first, climbs = piece[ground.get_face_numbers(begin.footing)[0]], 0
    assert len(begin.up) > 0.6 * N
    for k, (_, at) in enumerate(wander(ground, begin, STEPS, rng)):
        now = piece[ground.get_face_numbers(at.footing)[0]]
        climbs, first = climbs + int((now != first).sum()), now
        if k % 10 == 9:
            assert max(depth(s, above(ground, at)) for s in stack) < OVER
    assert climbs > 30


@pytest.mark.slow
def test_no_agent_slips_from_the_ground_into_what_is_sunk_in_it_or_leans_on_it() -> None:
    meshes = {name: SHAPES.SHAPES[name]() for name in ("ground", "boulder", "stones", "cube")}
    meshes["stones"] = (meshes["stones"][0] + np.array([20.0, -3.0, 12.0]), meshes["stones"][1])  # against the boulder
    meshes["cube"] = (meshes["cube"][0] + np.array([-20.0, -5.0, 25.0]), meshes["cube"][1])
    twig, tilt = SHAPES.rod(), np.radians(-58)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    meshes["rod"] = (twig[0] @ turn.T + np.array([0.0, -1.5, -62.0]), twig[1])
    ground, rng, measures = MeshGround(meshes), np.random.default_rng(9), WalkMeasures()
    closed = [meshes["boulder"], meshes["cube"], meshes["rod"], *parts(meshes["stones"], len(SHAPES.STACK))]
    start_points = rng.uniform(-45, 45, (3 * N, 3)) + np.array([0.0, 40.0, -20.0])
    footing, is_placed = ground.place_points(start_points, np.array([0.0, 1.0, 0.0]))
    assert is_placed.all()
    begin = ground.move(
        footing,
        0 * start_points,
        rng.normal(size=start_points.shape),
        ground.compute_upright_normals(footing, np.array([0.0, 1, 0])),
        BODY,
    )
    mesh_changes = set()
    for k, (previous, at) in enumerate(wander(ground, begin, STEPS, rng)):
        measures.look(ground, list(meshes.values()), previous, at)
        changed = previous.footing.mesh != at.footing.mesh
        mesh_changes |= set(zip(previous.footing.mesh[changed].tolist(), at.footing.mesh[changed].tolist(), strict=True))
        if k % 10 == 9:
            assert max(depth(m, above(ground, at)) for m in closed) < OVER
            on_ground = at.footing.mesh == 0
            assert (at.up[on_ground][:, 1] > 0).all()  # no agent below the ground
    measures.good()
    assert (
        {(0, k) for k in range(1, 5)} <= mesh_changes
        and {(k, 0) for k in range(1, 5)} <= mesh_changes
        and len(mesh_changes) >= 10
    ), mesh_changes


def test_a_moebius_strip_is_walked_on_both_its_sides_which_are_one() -> None:
    mesh = SHAPES.moebius()
    ground = MeshGround({"strip": mesh})
    along = ground.find_nearest(np.array([[SHAPES.TWISTED[0], 12.0, 0.0]]))[0]
    start = ground.move(along, np.zeros((1, 3)), np.array([[0.0, 0, 1]]), np.array([[0.0, 1, 0]]), BODY)
    at, turns, ups = start, 0.0, []
    for _ in range(320):
        previous = at
        middle = np.array([at.position[0][0], 0, at.position[0][2]])
        middle *= SHAPES.TWISTED[0] / np.linalg.norm(middle)
        lean = (middle + np.array([0, 12.0, 0]) - at.position[0]) * 0.2  # keeps to the middle of the strip
        around = np.cross(middle, [0.0, 1.0, 0.0])
        heading = around / np.linalg.norm(around) + lean
        at = ground.move(at.footing, heading[None] * STEP, heading[None], at.up, BODY)
        assert not at.is_blocked.any()
        turned = np.arctan2(at.position[0][2], at.position[0][0]) - np.arctan2(previous.position[0][2], previous.position[0][0])
        turns += float(np.mod(turned + np.pi, 2 * np.pi) - np.pi)
        ups.append((turns, at.up[0] @ start.up[0]))
        if turns >= 4 * np.pi:
            break
    full_turn = min(ups, key=lambda entry: abs(entry[0] - 2 * np.pi))
    assert turns >= 4 * np.pi and full_turn[1] < -0.9 and ups[-1][1] > 0.9  # once round it hangs below


def test_a_broken_mesh_is_walked_like_the_mesh_that_was_meant() -> None:
    mesh = SHAPES.broken()
    plain = SHAPES.build_stone(65, (22.0, 20.0, 22.0), detail=2)
    plain = (plain[0] + np.array([0.0, 19.0, 0.0]), plain[1])
    ground, intact_ground, rng = MeshGround({"broken": mesh}), MeshGround({"whole": plain}), np.random.default_rng(10)
    outside = crowd(intact_ground, [plain], N, rng)
    outside = outside.select_rows(np.flatnonzero(winding(plain, above(intact_ground, outside)) < 0.5))
    footing = intact_ground.find_nearest(outside.position)[0], ground.find_nearest(outside.position)[0]
    outside, at = (
        g.move(f, 0 * outside.up, outside.heading, outside.up, BODY)
        for g, f in zip((intact_ground, ground), footing, strict=True)
    )
    *_, (_, one) = wander(intact_ground, outside, 60, np.random.default_rng(1))
    *_, (_, two) = wander(ground, at, 60, np.random.default_rng(1))
    distances = np.linalg.norm(one.position - two.position, axis=1)
    assert np.quantile(distances, 0.9) < 1e-2  # ways to either side of a corner part for good
    assert not inside(plain, above(ground, two)).any()


def held(name: str, mesh: Mesh, n: int, steps: int) -> None:
    """A crowd on a shape: on it, not lost, and no agent through a wall."""
    walked = long_walk(name, mesh, n, steps)
    walked.measures.good()
    assert walked.agents > 0.9 * n and walked.through == 0 and walked.missed == 0, walked


@pytest.mark.parametrize("name", ["eight", "bottle", "broken", "rag"])
def test_no_agent_goes_through_a_wall_or_round_the_border_of_a_sheet(name: str) -> None:
    held(name, SHAPES.SHAPES[name](), 2 * N, STEPS)


NOTCHES = {  # outlines across a block, with a roof that is folded down between (10, 10) and where it goes up again
    "through the floor": [[10, 10], [10, -6], [9.6, 10]],
    "sharp, just through the floor": [[10, 10], [10, -0.3], [9.9, 10]],
    "with corners in the plane of the floor": [[10, 10], [10, 0], [9.8, -3], [9.6, 10]],
    "upon the floor": [[10, 10], [10, 0], [9.9, 10]],
    "out through a wall and the floor": [[10, 10], [-4, 5], [-4, -2], [9, -2], [9.5, 10]],
}


def notched(outline: list[list[float]]) -> Mesh:
    """A block 12 mm long with such a notch and pointed ends: edges of walls go through edges of the floor and of each other."""
    corners = np.array([[0, 0], [20, 0], [20, 10], *outline, [0, 10]], float)
    k, rings = len(corners), (0, 4, 8, 12)
    vertices = [[x, y, z] for z in rings for x, y in corners] + [[5, 5, -4], [5, 5, 16]]
    faces, last = [], (len(rings) - 1) * k
    for i in range(k):
        j = (i + 1) % k
        for r in range(0, last, k):
            faces += [[r + i, r + j, r + k + j], [r + i, r + k + j, r + k + i]]
        faces += [[last + k, j, i], [last + k + 1, last + i, last + j]]
    return np.array(vertices), np.array(faces, np.int32)


@pytest.mark.parametrize("name", NOTCHES)
def test_no_wall_is_gone_through_where_sheets_that_cut_each_other_share_corners_and_edges(name: str) -> None:
    mesh = notched(NOTCHES[name])
    assert MeshGround({"block": mesh}).triangles[3].cuts.is_cut.any()
    held(name, mesh, 2 * N, STEPS)


def test_a_notch_is_gone_through_where_its_cuts_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_cuts, "_find_piercing_edges", lambda start, end, triangle, grain: np.zeros(len(start), bool))
    for outline in NOTCHES.values():
        if outline[1][1] < -1:
            assert long_walk("block", notched(outline), N, STEPS).through > 10


def test_who_comes_to_a_cut_goes_on_upon_what_cuts() -> None:
    ground = MeshGround({"block": notched(NOTCHES["through the floor"])})
    start = np.array([[14.0, 0.0, 6.0], [14.0, 0.0, 6.0]])
    footing, up = ground.find_nearest(start)[0], np.array([[0.0, 1, 0], [0.0, -1, 0]])  # in the block, and below it
    at = ground.move(footing, np.tile([-6.0, 0, 0], (2, 1)), np.tile([-1.0, 0, 0], (2, 1)), up, BODY)
    assert np.allclose(at.position, [[10, 2, 6], [10, -2, 6]], atol=1e-5)
    assert np.allclose(at.direction, [[0, 1, 0], [0, -1, 0]], atol=0.02)  # along the smoothed ground
    assert np.allclose(at.heading, at.direction, atol=0.02)
    assert np.allclose(at.travelled, 6.0) and not at.is_blocked.any()


def test_cuts_of_a_mesh_that_moves_are_not_gone_through() -> None:
    mesh, rng = notched(NOTCHES["through the floor"]), np.random.default_rng(12)
    moving = MovingGround({"block": mesh}, ["block"])
    at = crowd(moving, [mesh], N, rng)
    began = np.round(winding(mesh, above(moving, at, FINE)))
    for k in range(STEPS // 2):
        turn, shift = 0.05 * k, np.array([0.3 * k, 0.0, -0.2 * k])
        spin = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
        previous_axes = moving.compute_axes(at.footing)
        moving.set_mesh_vertices({"block": mesh[0] @ spin.T + shift})
        heading, up = (
            sum(
                axis * (was * v.T).sum(axis=0) for axis, was in zip(moving.compute_axes(at.footing), previous_axes, strict=True)
            ).T
            for v in (at.heading, at.up)
        )
        heading = heading + np.cross(up, heading) * rng.normal(0, 0.3, (len(up), 1))
        at = moving.move(at.footing, heading * STEP, heading, up, BODY)
    moving.set_mesh_vertices({"block": mesh[0]})
    rest_ground = MeshGround({"block": mesh})
    side = np.where(side_of(moving, at, spin) < 0, -1.0, 1.0)
    points = rest_ground.position(at.footing) + rest_ground.normal(at.footing) * (side * FINE)[:, None]
    assert np.array_equal(np.round(winding(mesh, points)), began)


def side_of(ground: MeshGround, at: GroundMove, spin: Floats) -> Floats:
    """On which side of their faces agents are, who were there when the mesh was turned by `spin`."""
    return (ground.normal(at.footing) @ spin.T * at.up).sum(axis=1)


def test_a_hose_through_itself_is_gone_through_where_its_cuts_are_not_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_cuts, "_find_piercing_edges", lambda start, end, triangle, grain: np.zeros(len(start), bool))
    assert long_walk("eight", SHAPES.eight(), N, STEPS // 2).through > 10


def test_faces_that_cut_each_other_are_known_and_no_others_are() -> None:
    for name, shape in SHAPES.SHAPES.items():
        assert MeshGround({name: shape()}).triangles[3].cuts.is_cut.any() == (name == "eight"), name
    mesh = SHAPES.eight()
    table = MeshGround({"eight": mesh}).triangles[3]
    corners, crossings = mesh[0][mesh[1]], 0
    near = np.flatnonzero(np.linalg.norm(corners.mean(axis=1) - [0.0, 12.0, 0.0], axis=1) < 16.0)
    for f in near:
        scene = RayScene(corners[f], np.arange(3, dtype=np.int32)[None])
        known = table.cuts.list_cutting_faces(np.array([f]))[1]
        assert all(f in table.cuts.list_cutting_faces(np.array([g]))[1] for g in known)
        for k in range(3):
            edge = corners[near][:, [k, (k + 1) % 3]]
            hit, part, _, _ = scene.find_hits_along_step(edge[:, 0], edge[:, 1] - edge[:, 0])
            through = near[hit[(part > 0.01) & (part < 0.99)]]
            through = through[[not np.isin(table.weld[f], table.weld[g]).any() for g in through]]
            assert np.isin(through, known).all(), (f, through)
            crossings += len(through)
    assert crossings > 50


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES.SHAPES)
def test_five_thousand_for_five_thousand_steps(name: str) -> None:
    held(name, SHAPES.SHAPES[name](), 5000, 5000)


@pytest.mark.slow
@pytest.mark.skipif("ANTDSL_MESHES" not in os.environ, reason="ANTDSL_MESHES names no folder of closed meshes")
def test_five_thousand_for_five_thousand_steps_on_meshes_of_ones_own() -> None:
    for path in sorted(Path(os.environ["ANTDSL_MESHES"]).glob("*.obj")):
        held(path.stem, from_file(path), 5000, 5000)
