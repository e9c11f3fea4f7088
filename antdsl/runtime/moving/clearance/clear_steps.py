"""A substep of bodies that stay outside their ground. Feet slow down before the walk; bodies turn, lift and shift after it.

A step is undone if it would bring the body deeper into a surface. The body then turns on the spot. If it cannot turn either, it
keeps its pose. A body deep inside a surface, for example after a birth in a gap, moves freely until it is outside."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.walk_events import CrowdWalk
from antdsl.ground.mesh.walkers import SurfaceTables, get_footing_arrays
from antdsl.ground.protocol import Footing
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.body_rows import numbers_by_row
from antdsl.runtime.moving.body_records import (
    SHARP,
    BodyLimits,
    BodyPoses,
    BodyRegisters,
    BodyRows,
    BodyStances,
    FaceBuffers,
    FaceSearch,
)
from antdsl.runtime.moving.clearance.body_lifts import LiftLists, lift_bodies, select_rows
from antdsl.runtime.moving.clearance.body_paths import BodyShape
from antdsl.runtime.moving.clearance.clearance_kernels import aim_bodies, limit_steps, shift_bodies
from antdsl.runtime.moving.contacts.body_contacts import SHIFT_TURNS
from antdsl.runtime.moving.contacts.capsules import find_capsule
from antdsl.runtime.moving.postures import has_posture
from antdsl.runtime.moving.slopes import has_slope_limit
from antdsl.runtime.world import AXES, Population, World

_F = np.float32
_MAX_DEPTH = _F(0.008)  # body lengths; a shallower overlap has no effect
# body lengths; the allowed depth grows by this after each step in which a body could neither walk nor turn
_YIELD_DEPTH = _F(0.003)
_STRANDED_DEPTH = _F(0.08)  # body lengths; a body this deep inside moves freely
_MIN_LEAN_COSINE = _F(0.5)  # cosine of the angle between body and ground; contacts cannot tilt a body further
_LOST_COSINE = _F(-0.087)  # of the angle between body and ground, 95 degrees, that no body has after a step over an edge
_MARGIN_PER_BODY = 0.04  # body lengths that are added at both ends of the capsule
_ROWS_PER_THREAD = 32  # fewer rows are not worth another thread
_POSE_REGISTERS = tuple(f"{name}.{axis}" for name in ("up", "heading", "~lift") for axis in AXES)
# body lengths per second; a body shifts at the first speed by choice, and never faster than the second
_SHIFT_SPEED, _JUMP_SPEED = 3.6, 8.4
_QUARTER_TURNS = 3  # at birth, a body that does not fit tries these turns

Rows = NDArray[np.int64]


def has_clearance(world: World, population: Population) -> bool:
    """Return whether the bodies of a species stay outside their ground.

    The ground must consist of meshes, and the bodies must follow it. Bodies with a posture or a slope limit do not."""
    follows_ground = not has_posture(population) and not has_slope_limit(population)
    return population.plan.clears_body and follows_ground and isinstance(world.ground, MeshGround)


@dataclass(slots=True)
class ClearStep:
    """The substep of the bodies of a species.

    `walk`: the tables of the ground. `rows`: agents on ground with bends, and agents that are not aligned with their feet.
    `levels`: the bend of the ground below them, see `MeshGround.mark_bends`."""

    population: Population
    walk: CrowdWalk
    limits: BodyLimits
    threads: int
    rows: Rows
    levels: NDArray[np.uint8]
    all_levels: NDArray[np.uint8] = field(init=False)
    has_bend: NDArray[np.bool_] = field(init=False)
    state: NDArray[np.int32] = field(init=False)
    previous: BodyPoses = field(init=False)
    headings: tuple[NDArray[np.float32], ...] = field(init=False)
    lifts: VectorArrays = field(init=False)
    recorded: tuple[tuple[Footing, NDArray[np.float64], NDArray[np.float32]], list[NDArray[np.float32]]] = field(init=False)

    @staticmethod
    def build(
        world: World,
        population: Population,
        walk: CrowdWalk,
        stance: tuple[NDArray[np.int32], VectorArrays],
        limits: tuple[NDArray[np.float32], NDArray[np.float32], np.float32],
    ) -> ClearStep:
        """List the rows with bodies that need more than their feet.

        `stance`: the states of bodies, and the headings along the ground of leaning bodies. `limits`: tilt and turn limits, and
        the duration (s)."""
        now, n, threads = population.now, len(population), world.options.threads
        assert isinstance(world.ground, MeshGround)
        (levels,), (row_levels,) = (population.get_buffers(name, 1, (n,), np.uint8) for name in ("bends", "bends of rows"))
        size = np.where(now["size"] > 0, now["size"], 0).astype(np.float64)
        has_bend = world.ground.mark_bends(population.footing, population.position, size, levels, threads)
        (rows,), heading = population.get_buffers("uneven", 1, (n,), np.int64), vec.get_vector_registers(now, "heading")
        work = partial(select_rows, levels, heading, *stance, _retained_registers(population), rows, row_levels)
        rows, row_levels = parallel.join_parts(parallel.run_in_parts(work, n, threads), rows, row_levels)
        dt = float(limits[2])
        bounds = BodyLimits(*limits, now["size"], *body_shapes(world, population), _SHIFT_SPEED * dt, _JUMP_SPEED * dt)
        step = ClearStep(population, walk, bounds, threads, rows, row_levels)
        step.all_levels, step.has_bend, step.state = levels, has_bend, stance[0]
        return step

    def limit(self, step: VectorArrays, velocity: VectorArrays) -> None:
        """Shorten the steps (mm) and velocities of agents so that their bodies can follow."""
        if len(self.rows):
            p = self.population
            up = vec.get_vector_registers(p.now, "up")
            at = get_footing_arrays(p.footing)
            inputs = (at, BodyRows(self.rows, self.levels), up, p.normal, step, velocity, self.limits, _retained_registers(p))
            self._run(partial(limit_steps, self._surface, self._search(len(self.rows)), *inputs), len(self.rows))

    def follow(self, previous: BodyPoses, outset: tuple[Footing, NDArray[np.float64], NDArray[np.float32]]) -> None:
        """Turn and shift bodies after the walk. `previous`: poses before it. `outset`: footings, positions and normals before
        it."""
        p, now, n = self.population, self.population.now, len(self.population)
        self.previous = previous
        (rows,), (climbers,) = (p.get_buffers(name, 1, (n,), np.int64) for name in ("uneven", "climbers"))
        (levels,), (kind,) = (p.get_buffers(name, 1, (n,), np.uint8) for name in ("bends of rows", "lifts"))
        lists = LiftLists(rows, levels, climbers, kind)
        feet = get_footing_arrays(p.footing)
        poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
        inputs = (feet, self.has_bend, self.state, self.all_levels, poses, self.limits, _retained_registers(p), lists)
        parts = parallel.run_in_parts(partial(lift_bodies, self._surface, *inputs), n, self.threads)
        rows, levels = parallel.join_parts(parts, rows, levels)
        order = np.argsort(p.footing.face.take(rows))  # neighbours one after another: they read the same faces
        self.rows, self.levels = rows, levels = rows.take(order), levels.take(order)
        if not len(rows):
            return
        self.lifts = _read_lift(p, rows)
        held, depths = (
            (*vec.take_rows(previous.up, rows), *vec.take_rows(previous.heading, rows), *self.lifts),
            now["~depth"].take(rows),
        )
        self.headings = tuple(now[f"heading.{axis}"].take(rows) for axis in AXES)
        self._aim(rows, self.levels, previous)
        uneven = np.flatnonzero(self.levels == SHARP)
        depth, out = self._shift(rows[uneven], vec.take_rows(self.lifts, uneven))
        old, footing, (position, normal) = depths[uneven], outset[0], (each[rows[uneven]] for each in outset[1:])
        cosine = _dot_rows(vec.take_rows(vec.get_vector_registers(now, "up"), rows[uneven]), p.normal[rows[uneven]])
        is_lost = (cosine < _LOST_COSINE) & (_dot_rows(vec.take_rows(previous.up, rows[uneven]), normal) >= _LOST_COSINE)
        out[:, is_lost] = (position - p.position[rows[uneven]])[is_lost].T
        deeper = np.flatnonzero(is_lost | ((depth > np.maximum(old, _MAX_DEPTH)) & (old < _STRANDED_DEPTH)))
        if deeper.size:
            at = uneven[deeper]
            back = rows[at]
            self._put(back, (footing.take_rows(back), position[deeper], normal[deeper]))
            for k, axis in enumerate(AXES):
                now[f"~out.{axis}"][back] = out[k, deeper]
            self._stand_up(at)
            self._aim(back, self.levels[at], previous)
            turned, _ = self._shift(back, vec.take_rows(self.lifts, at))
            worse = np.flatnonzero(turned > np.maximum(old[deeper], _MAX_DEPTH))
            for name, values in zip(_POSE_REGISTERS, held, strict=True):
                now[name][back[worse]] = values[at[worse]]
            now["~wait"][back[worse]] = 0
            turned[worse] = np.maximum(old[deeper[worse]], _MAX_DEPTH) + _YIELD_DEPTH
            depth[deeper] = turned
        now["~depth"][rows[uneven]] = depth

    def record(self) -> None:
        """Record positions and poses before contacts move agents."""
        p, rows = self.population, self.rows
        columns = [p.now[name].take(rows) for name in (*_POSE_REGISTERS, "~wait", "~depth")]
        self.recorded = (p.footing.take_rows(rows), p.position[rows], p.normal[rows]), columns

    def correct(self) -> None:
        """Turn and shift the bodies that contacts have moved.

        A move is undone if it would bring the body deeper into a surface. It is also undone if the body would lean more than
        allowed."""
        p, now, rows = self.population, self.population.now, self.rows
        (footing, position, normal), columns = self.recorded
        at = np.flatnonzero((p.position[rows] != position).any(axis=1))
        if not at.size:
            return
        moved, levels = rows[at], self.levels[at]
        self._stand_up(at)
        self._aim(moved, levels, self.previous)
        sharp, depth = np.flatnonzero(levels == SHARP), np.zeros(len(at), np.float32)
        depth[sharp], _ = self._shift(moved[sharp], vec.take_rows(self.lifts, at[sharp]))
        cosine = _dot_rows(vec.take_rows(vec.get_vector_registers(now, "up"), moved), p.normal[moved])
        old_cosine = _dot_rows([c[at] for c in columns[:3]], normal[at])
        old = columns[-1][at]
        bad = (depth > np.maximum(old, _MAX_DEPTH)) | (cosine < np.minimum(old_cosine, _MIN_LEAN_COSINE))
        now["~depth"][moved] = depth
        back, at = moved[bad], at[bad]
        self._put(back, (footing.take_rows(at), position[at], normal[at]))
        for name, values in zip((*_POSE_REGISTERS, "~wait", "~depth"), columns, strict=True):
            now[name][back] = values[at]

    def _stand_up(self, at: Rows) -> None:
        """Set the poses of some of `rows` to the poses of the feet, so that bodies can be turned towards the feet again."""
        p, rows = self.population, self.rows[at]
        for k, axis in enumerate(AXES):
            p.now[f"up.{axis}"][rows] = p.normal[rows, k]
            p.now[f"heading.{axis}"][rows] = self.headings[k][at]
            p.now[f"~lift.{axis}"][rows] = self.lifts[k][at]

    def _put(self, rows: Rows, stands: tuple[Footing, NDArray[np.float64], NDArray[np.float32]]) -> None:
        """Restore the footings, positions and normals of agents."""
        p, (footing, position, normal) = self.population, stands
        p.footing.put_rows(rows, footing)
        p.position[rows], p.normal[rows] = position, normal
        for k, axis in enumerate(AXES):
            p.now[f"position.{axis}"][rows] = position[:, k]

    def settle(self) -> None:
        """Turn and shift new bodies at once. A body that does not fit tries quarter turns, and takes the one with the least
        depth."""
        p, now, rows = self.population, self.population.now, self.rows
        heading = [now[f"heading.{axis}"].take(rows) for axis in AXES]
        best, pose = np.full(len(rows), np.inf, np.float32), [now[name].take(rows) for name in _POSE_REGISTERS]
        normal = p.normal.take(rows, axis=0).T
        for turn in range(1 + _QUARTER_TURNS):
            for k, axis in enumerate(AXES):
                now[f"up.{axis}"][rows], now[f"heading.{axis}"][rows] = normal[k], heading[k]
            previous = BodyPoses(
                vec.copy(vec.get_vector_registers(now, "up")), vec.copy(vec.get_vector_registers(now, "heading"))
            )
            self._aim(rows, self.levels, previous)
            depth, _ = self._shift(rows, _read_lift(p, rows))
            better = np.flatnonzero(depth < best if turn == 0 else (depth < best) & (best > _MAX_DEPTH))
            best[better] = depth[better]
            for name, values in zip(_POSE_REGISTERS, pose, strict=True):
                values[better] = now[name][rows[better]]
            heading = list(vec.cross(tuple(normal), tuple(heading)))  # type: ignore[arg-type]
        for name, values in zip(_POSE_REGISTERS, pose, strict=True):
            now[name][rows] = values
        now["~depth"][rows], now["~wait"][rows] = best, 0

    @property
    def _surface(self) -> SurfaceTables:
        return self.walk.build_tables()[0]

    def _search(self, count: int) -> FaceSearch:
        return face_search(self.walk, count, self.threads)

    def _aim(self, rows: Rows, levels: NDArray[np.uint8], previous: BodyPoses) -> None:
        p, now = self.population, self.population.now
        at = get_footing_arrays(p.footing)
        poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
        inputs = (at, BodyRows(rows, levels), previous, poses, self.limits, _retained_registers(p))
        self._run(partial(aim_bodies, self._surface, self._search(len(rows)), *inputs), len(rows))

    def _shift(self, rows: Rows, old: VectorArrays) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Shift bodies outside the faces around them. Return the remaining depths and the directions out (3, k)."""
        p, now = self.population, self.population.now
        depths, outs = np.zeros(len(rows), np.float32), np.zeros((3, len(rows)), np.float32)
        poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
        inputs = (
            rows,
            BodyStances(p.position, p.normal, poses),
            self.limits,
            vec.get_vector_registers(now, "~lift"),
            old,
            depths,
            outs,
            SHIFT_TURNS,
        )
        self._run(partial(shift_bodies, self._surface.table, self._search(len(rows)), *inputs), len(rows))
        return depths, outs

    def _run(self, work: partial[object], count: int) -> None:
        if count:
            parallel.run_in_parts(work, count, self.threads, _ROWS_PER_THREAD)


def settle_clear(world: World, population: Population, rows: Rows) -> bool:
    """Turn and shift new bodies at once, so that they are outside their ground.

    Returns False if the bodies of the species need not stay outside, or if the ground does not consist of triangles."""
    if not has_clearance(world, population):
        return False
    assert isinstance(world.ground, MeshGround)
    now, n = population.now, len(population)
    walk = world.ground.build_crowd_walk(0.0, float(np.fmax.reduce(now["size"], initial=0.0)))
    if walk is None:
        return False
    free = np.full(n, np.inf, np.float32)
    limits = BodyLimits(np.full(n, np.pi, np.float32), free, _F(1), now["size"], *body_shapes(world, population), np.inf, np.inf)
    ClearStep(
        population, walk, limits, world.options.threads, np.asarray(rows, np.int64), np.full(len(rows), SHARP, np.uint8)
    ).settle()
    for name in ("up", "heading"):
        for axis in AXES:
            population.start[f"{name}.{axis}"][rows] = now[f"{name}.{axis}"][rows]
    return True


def face_search(walk: CrowdWalk, count: int, threads: int) -> FaceSearch:
    """Return the tables for a search of faces for `count` rows."""
    several = parallel.count_parts(count, threads, _ROWS_PER_THREAD)
    table, boxes = walk.walk.table, walk.boxes
    buffers = FaceBuffers(np.empty(several * boxes.triangle_order.size, np.int64), several, count)
    several, near = table.piece_count > 1 or bool(table.cuts.first[-1]), walk.build_tables()[1]
    return FaceSearch(several, near, table.piece, table.cuts.first, boxes.to_box_tree(), buffers)


def body_shapes(
    world: World, population: Population, margin: float = _MARGIN_PER_BODY
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the capsules (k, 4) of a species' bodies, and the index of each agent's body, uint8[n].

    A row has the numbers of a `BodyShape` for a body of 1 mm, extended by `margin` at both ends."""
    capsules = [find_capsule(world, key) for key in world.setting.list_body_keys(population.name)]
    shapes = [
        BodyShape(max(each.length - each.width, 0.0) / 2 + margin, each.width / 2, each.height, each.forward_offset)
        for each in capsules
    ]
    return np.array(shapes, np.float64), numbers_by_row(population, world.setting)


def _dot_rows(columns: Sequence[NDArray[np.float32]], vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the dot products of vectors, given as three columns, with vectors (k, 3)."""
    result: NDArray[np.float32] = (columns[0] * vectors[:, 0] + columns[1] * vectors[:, 1]) + columns[2] * vectors[:, 2]
    return result


def _read_lift(population: Population, rows: Rows) -> VectorArrays:
    return vec.take_rows(vec.get_vector_registers(population.now, "~lift"), rows)


def _retained_registers(population: Population) -> BodyRegisters:
    now = population.now
    lift, out = vec.get_vector_registers(now, "~lift"), vec.get_vector_registers(now, "~out")
    return BodyRegisters(lift, now["~wait"], now["~depth"], out)
