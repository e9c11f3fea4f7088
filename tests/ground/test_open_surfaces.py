"""Open and non-manifold surfaces: no agent comes to the other side of its surface unless edges lead there, goes
through a wall, is lost or stuck, or steps farther than requested."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from meshes import Mesh, box, grid
from numpy.typing import NDArray
from open_shapes import WORSE, Connectivity, find_connectivity, joined, ribbon, sheet, turned
from sampling import sampled
from torture_long import from_file
from torture_walks import BODY, STEP, crowd, shapes
from walked import Hop, Reference

from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.moving import MovingGround
from antdsl.ground.protocol import Footing, GroundMove

Floats = NDArray[np.float64]
HAIR = 1e-6  # mm off the surface
SMALL = 0.2  # mm: a step in which one walker steps over once at most, but for crumbs
BENDS = (1e-6, 1e-5, 1e-3, 5e-3, 0.02, 0.05, 0.1, 0.2, 0.4)  # mm: how far outside a corner the way round it may lead
ROUND = 1e-5  # mm beyond a border
WINDOW = 100
STILL = 0.05  # of a crowd, in corners too narrow for a step


@dataclass
class Watch:
    """Reports about a crowd: agents that stepped over, although their feet cannot have gone that way."""

    mesh: Mesh
    sides: Connectivity
    changed: list[tuple[int, int, int]] = field(default_factory=list)
    through: list[tuple[int, int, int]] = field(default_factory=list)
    farthest: float = 0.0
    lost: int = 0
    over: int = 0
    wish: Floats = field(default_factory=lambda: np.empty((0, 3)))

    def look(self, ground: MeshGround, previous_move: GroundMove, at: GroundMove, step: float, closely: bool) -> None:
        distances = np.linalg.norm(at.position - previous_move.position, axis=1)
        self.farthest = max(self.farthest, float(distances.max()) / step, float(at.travelled.max()) / step)
        self.lost += int((at.is_lost | ~np.isfinite(at.position).all(axis=1)).sum())
        (f, old_side), (g, new_side) = standing(ground, previous_move), standing(ground, at)
        component, part = self.sides.side_component, self.sides.part
        other = np.flatnonzero(component[old_side, f] != component[new_side, g])
        own = other[(part[f] == part[g])[other]]
        own = own[self.sides.open[f[own]]]
        self.changed += [(int(k), int(f[k]), int(g[k])) for k in own if not self.over_another(ground, previous_move, at, k)]
        over = other[part[f[other]] != part[g[other]]]
        self.over += over.size
        if closely:
            bad = over[
                ~self.free(
                    previous_move.position[over], facing(ground, previous_move)[over], at.position[over], facing(ground, at)[over]
                )
            ]
            self.through += [(int(k), int(f[k]), int(g[k])) for k in bad if not self.one_by_one(ground, previous_move, at, k)]

    def hops(self, ground: MeshGround, previous_move: GroundMove, at: GroundMove, who: int) -> list[Hop]:
        """The step once more, with all that it stepped over to."""
        face, over = int(standing(ground, previous_move)[0][who]), float(previous_move.footing.over[who])
        reference = Reference(ground)
        place, wish = previous_move.position[who] - over * reference.normal[face], self.wish[who]
        again = reference.step(face, place, over, wish, wish, previous_move.up[who], BODY)
        assert np.allclose(again.position, at.position[who], atol=HAIR) and again.face == standing(ground, at)[0][who]
        return again.hops

    def over_another(self, ground: MeshGround, previous_move: GroundMove, at: GroundMove, who: int) -> bool:
        """Whether the way of a step led over another part."""
        own = self.sides.part[standing(ground, previous_move)[0][who]]
        return any(self.sides.part[hop.face] != own for hop in self.hops(ground, previous_move, at, who))

    def one_by_one(self, ground: MeshGround, previous_move: GroundMove, at: GroundMove, who: int) -> bool:
        """Whether all ways are free that a step went over to other faces, or round the border from which it did."""
        for hop in self.hops(ground, previous_move, at, who):
            start, up, displacement, end, above = (v[None] for v in (hop.start, hop.up, hop.direction, hop.end, hop.above))
            if not (self.free(start, up, end, above) | self.free(start + displacement * ROUND, up, end, above))[0]:
                return False
        return True

    def free(self, start: Floats, up: Floats, end: Floats, above: Floats) -> NDArray[np.bool_]:
        """Whether a way is free from a hair above `start` to a hair above `end`, straight or with one bend."""
        start, end = start + up * HAIR, end + above * HAIR
        is_free = ~self.crosses(start, end)
        displacement = end - start
        flat = [displacement - (displacement * normal).sum(axis=1)[:, None] * normal for normal in (up, above)]
        for bend in BENDS:
            for corner in ((start + end) / 2, start, end, start + flat[0], end - flat[1], start + flat[0] / 2, end - flat[1] / 2):
                for off in (up, above, up + above):
                    rows = np.flatnonzero(~is_free)
                    bend_points = (corner + off * bend)[rows]
                    is_free[rows] = ~self.crosses(start[rows], bend_points) & ~self.crosses(bend_points, end[rows])
        return is_free

    def crosses(self, start: Floats, end: Floats) -> NDArray[np.bool_]:
        """Whether any face lies between places (Möller, Trumbore, as in `boxes`, but for all faces)."""
        a, b, c = (self.mesh[0][self.mesh[1][:, k]] for k in range(3))
        e1, e2 = b - a, c - a
        is_crossing = np.zeros(len(start), bool)
        for k, (o, d) in enumerate(zip(start, end - start, strict=True)):
            p = np.cross(d, e2)
            det = (e1 * p).sum(axis=1)
            safe = np.where(det == 0, 1.0, det)
            s = o - a
            q = np.cross(s, e1)
            u, v, t = (s * p).sum(axis=1) / safe, (q @ d) / safe, (e2 * q).sum(axis=1) / safe
            is_crossing[k] = ((det != 0) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & (t < 1)).any()
        return is_crossing


def standing(ground: MeshGround, at: GroundMove) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    return ground.get_face_numbers(at.footing)[0], ((ground.normal(at.footing) * at.up).sum(axis=1) < 0).astype(np.int64)


def facing(ground: MeshGround, at: GroundMove) -> Floats:
    normal = ground.normal(at.footing)
    return normal * np.where((normal * at.up).sum(axis=1) < 0, -1.0, 1.0)[:, None]


def watched(mesh: Mesh, n: int, steps: int, step: float = STEP, closely: bool = False) -> tuple[Watch, NDArray[np.bool_]]:
    """A crowd's walk, and who has hardly moved in its last `WINDOW` steps."""
    ground, rng = MeshGround({"mesh": mesh}), np.random.default_rng(4)
    watch, at = Watch(mesh, find_connectivity(mesh)), crowd(ground, [mesh], n, rng)
    positions = []
    for _ in range(steps):
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.3, (n, 1))
        heading *= np.where(at.is_blocked, -step, step)[:, None] / np.linalg.norm(heading, axis=1, keepdims=True)
        previous_move, at = at, ground.move(at.footing, heading, heading, at.up, BODY)
        watch.wish = heading
        watch.look(ground, previous_move, at, step, closely)
        positions.append(at.position)
    last = np.array(positions[-WINDOW:])
    return watch, np.linalg.norm(last.max(axis=0) - last.min(axis=0), axis=1) < 0.02 * step * min(steps, WINDOW)


def held(mesh: Mesh, n: int, steps: int) -> None:
    watch, still = watched(mesh, n, steps)
    assert not watch.changed and watch.lost == 0 and watch.farthest <= 1.01, watch
    assert still.mean() < STILL, still.mean()
    watch, _ = watched(mesh, n // 4, steps, SMALL, closely=True)
    assert not (watch.changed or watch.through) and watch.lost == 0 and watch.farthest <= 1.01, watch


@pytest.mark.parametrize("name", sampled(WORSE, ("tees", "slivers", "ribbon")))
def test_a_few_walk_on_open_surfaces(name: str) -> None:
    held(WORSE[name](), 80, 24)


@pytest.mark.slow
@pytest.mark.parametrize("name", WORSE)
def test_two_thousand_walk_on_open_surfaces(name: str) -> None:
    held(WORSE[name](), 2000, 500)


@pytest.mark.slow
@pytest.mark.skipif("ANTDSL_MESHES" not in os.environ, reason="ANTDSL_MESHES names no folder of meshes")
def test_two_thousand_walk_on_meshes_of_ones_own() -> None:
    for path in sorted(Path(os.environ["ANTDSL_MESHES"]).glob("*.obj")):
        watch, still = watched(from_file(path), 2000, 500)
        assert not watch.changed and watch.lost == 0 and watch.farthest <= 1.01, (path, watch)
        assert still.mean() < STILL, (path, still.mean())


def test_the_account_of_sides_knows_sheets_strips_balls_and_walls() -> None:
    def count_sides(mesh: Mesh) -> int:
        return len(np.unique(find_connectivity(mesh).side_component))

    assert (
        count_sides(grid(10.0, 3)) == 2
        and count_sides(shapes().moebius(12, 2)) == 1
        and count_sides(box((0, 0, 0), (1, 1, 1))) == 2
    )
    wall = turned(grid(10.0, 2), (0, 0, 1), 90.0, (0, 5, 0))
    assert count_sides(joined([grid(10.0, 2), wall])) == 3  # below, and a corner on each side of the wall
    assert find_connectivity(grid(10.0, 3)).open.all() and not find_connectivity(box((0, 0, 0), (1, 1, 1))).open.any()


def test_a_ribbon_that_crosses_itself_is_walked_all_over_on_either_side() -> None:
    ground = MeshGround({"ribbon": ribbon()})
    assert ground.triangles[3].cuts.is_cut.any()
    watch, still = watched(ribbon(), 60, 60)
    assert not watch.changed and not still.any()


@cache
def over(at: float, rise: float) -> MeshGround:
    """A sheet, and beyond its border at x = 0 another, so much higher or lower."""
    return MeshGround({"near": sheet(20.0, 4, by=(-10.0, 0.0, 0.0)), "far": sheet(20.0, 3, by=(10.0 + at, rise, 0.0))})


def on(ground: MeshGround, x: float) -> GroundMove:
    footing = ground.find_nearest(np.array([[x, 0.0, 1.3]]))[0]
    up = np.array([[0.0, 1, 0]])
    return ground.move(footing, np.zeros((1, 3)), np.array([[1.0, 0, 0]]), up, BODY)


def walk_straight(ground: MeshGround, at: GroundMove, x: float, steps: int) -> tuple[GroundMove, Floats]:
    positions = [at.position[0]]
    for _ in range(steps):
        heading = np.array([[np.sign(x), 0.0, 0.0]])
        at = ground.move(at.footing, heading * abs(x), heading, at.up, BODY)
        assert at.travelled[0] <= abs(x) * 1.0001 and not at.is_blocked.any()
        positions.append(at.position[0])
    return at, np.array(positions)


@pytest.mark.parametrize("gap", [0.0, 0.05])
@pytest.mark.parametrize("rise", [-1.7, -0.05, 0.0, 0.3, 1.7])
@pytest.mark.parametrize("step", [0.1, 3.0])
def test_stepping_over_takes_the_steps_that_it_takes(rise: float, step: float, gap: float) -> None:
    ground = over(gap, rise)
    at, positions = walk_straight(ground, on(ground, -1.0), step, round(4 / step) + 2)
    assert at.footing.mesh[0] == 1 and at.footing.over[0] == 0 and abs(at.position[0, 1] - rise) < 1e-9
    assert at.position[0, 0] > 2.5 - 2 * abs(rise) - step
    assert np.linalg.norm(np.diff(positions, axis=0), axis=1).max() <= step * 1.01


def test_who_stops_half_way_down_hangs_there_and_goes_on_or_back() -> None:
    ground = over(0.0, -1.5)
    at, _ = walk_straight(ground, on(ground, -0.2), 0.5, 2)
    assert abs(at.footing.over[0] + 0.8) < 1e-9 and np.allclose(at.position[0], [0, -0.8, 1.3]) and at.footing.mesh[0] == 0
    still = ground.move(at.footing, np.zeros((1, 3)), at.heading, at.up, BODY)
    assert np.allclose(still.position, at.position) and np.allclose(ground.position(still.footing), at.position)
    down, _ = walk_straight(ground, still, 0.5, 3)
    assert down.footing.mesh[0] == 1 and down.position[0, 1] == pytest.approx(-1.5)
    back, _ = walk_straight(ground, still, -0.5, 2)
    assert back.footing.mesh[0] == 0 and np.allclose(back.position[0], [-0.2, 0, 1.3])


def test_who_hangs_over_a_border_moves_with_it_and_climbs_back_when_nothing_is_left_to_step_onto() -> None:
    near, far = sheet(20.0, 4, by=(-10.0, 0.0, 0.0)), sheet(20.0, 3, by=(10.0, -1.5, 0.0))
    ground = MovingGround({"near": near, "far": far}, ["near"])
    at, _ = walk_straight(ground, on(ground, -0.2), 0.5, 2)
    lifted = (near[0] + np.array([0.0, 5.0, 0.0]), near[1])
    ground.set_mesh_vertices({"near": lifted[0]})
    assert np.allclose(ground.position(at.footing), [[0, 4.2, 1.3]])
    for _ in range(2):
        at = ground.move(at.footing, np.array([[0.5, 0, 0]]), at.heading, at.up, BODY)
    assert at.footing.over[0] == 0 and np.allclose(at.position[0], [0, 5, 1.3], atol=0.5) and at.position[0, 1] == 5.0


def test_footings_over_a_border_stay_where_there_are_solids_too() -> None:
    footing = Footing.from_faces(np.zeros(3, np.int32), np.arange(3, dtype=np.int32), *np.random.default_rng(1).random((3, 3)))
    face_footing = footing.with_position_columns().select_rows_on_meshes(np.arange(3))
    assert list(face_footing.columns) == ["mesh", "face", "b1", "b2", "over"]
    assert all(np.array_equal(column, footing.columns[name]) for name, column in face_footing.columns.items())


def test_a_box_of_loose_sheets_is_walked_round_its_edges_and_never_into() -> None:
    vertices, faces = box((-5, -5, -5), (5, 5, 5))
    corners = vertices[faces].reshape(6, 6, 3)
    corners = corners * 0.995 + corners.mean(axis=1, keepdims=True) * 0.005  # a slit at every edge
    sides = (corners.reshape(-1, 3), np.arange(36).reshape(-1, 3))
    ground, rng = MeshGround({"box": sides}), np.random.default_rng(3)
    at, visits = crowd(ground, [sides], 60, rng), set()
    out = (at.position * facing(ground, at)).sum(axis=1) > 0
    for _ in range(120):
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.3, (60, 1))
        at = ground.move(at.footing, heading, heading, at.up, BODY)
        visits |= set(zip(np.flatnonzero(out), standing(ground, at)[0][out] // 2, strict=True))
        assert np.array_equal((at.position * facing(ground, at)).sum(axis=1) > 0, out)
    assert len(visits) > 3 * out.sum()


def test_nothing_behind_a_roof_or_a_wall_is_stepped_onto_over_a_border() -> None:
    floor, beyond = sheet(20.0, 4, by=(-10.0, 0.0, 0.0)), sheet(20.0, 4, by=(10.5, 1.2, 0.0))
    roof = sheet(8.0, 2, by=(-3.0, 0.7, 0.0))  # over the border, with the other sheet above it
    wall = turned(grid(8.0, 2), (0, 0, 1), 90.0, (0.03, -1.1, 0.0))  # beside it, up to the roof, with a sheet behind
    ground = MeshGround({"floor": floor, "beyond": beyond, "roof": roof, "wall": wall})
    at = on(ground, -0.5)
    for _ in range(4):
        at = ground.move(at.footing, np.array([[0.4, 0, 0]]), at.heading, at.up, BODY)
        assert ground.names[at.footing.mesh[0]] in ("floor", "wall")
        assert (at.position[0] - [0.03, 0, 0])[0] < 1e-9


def test_corners_that_are_nearly_at_one_place_are_one_wherever_that_is() -> None:
    vertices, faces = grid(20.0, 12)
    rng = np.random.default_rng(6)
    loose = vertices[faces].reshape(-1, 3)
    loose = loose + rng.uniform(-1, 1, loose.shape) * 1e-8 * 20.0
    ground = MeshGround({"sheet": (loose, np.arange(len(loose)).reshape(-1, 3))})
    table = ground.triangles[3]
    assert table.piece_count == 1 and len(np.unique(table.weld)) == len(vertices)
