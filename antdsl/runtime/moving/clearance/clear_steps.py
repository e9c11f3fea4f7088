"""Runs a substep of bodies that stay outside their ground. Before the walk, feet slow down for the body. After the walk,
bodies turn, rise and shift. A step is undone if it would move the body deeper into a surface. The body then turns on the spot.
If it cannot turn either, it keeps its pose. A body deep inside a surface, for example after a birth in a gap, moves freely
until it is outside."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.surface import SHARP_EDGE_REACH_BODY_LENGTHS, MeshGround
from antdsl.ground.mesh.walk_events import CrowdWalk
from antdsl.ground.mesh.walkers import SurfaceTables, get_footing_arrays
from antdsl.ground.protocol import Footing
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.moving.body_records import SHARP_BEND_LEVEL, BodyLimits, BodyPoses, BodyRows, BodyStances, FaceSearch
from antdsl.runtime.moving.clearance.body_lifts import LiftLists, lift_bodies, list_bodies_to_lift, select_bodies_near_bends
from antdsl.runtime.moving.clearance.body_tables import (
    ROWS_PER_THREAD,
    Rows,
    SurfaceStances,
    compute_row_dots,
    compute_unit_shapes,
    make_contact_faces,
    make_face_search,
    read_body_registers,
    read_lifts,
    select_stances,
    update_idle_times,
)
from antdsl.runtime.moving.clearance.clearance_kernels import aim_bodies, limit_steps, shift_bodies
from antdsl.runtime.moving.clearance.obstacle_clearance import mark_near_obstacles
from antdsl.runtime.moving.contacts.body_contacts import MAX_SHIFT_ROUNDS
from antdsl.runtime.moving.crouching import has_crouch
from antdsl.runtime.moving.obstacles import slide_rows
from antdsl.runtime.moving.postures import has_posture
from antdsl.runtime.moving.slopes import has_slope_limit
from antdsl.runtime.world import AXES, Population, World

_F = np.float32
_MAX_DEPTH = _F(0.008)  # body lengths; a shallower overlap has no effect
# body lengths; the allowed depth grows by this after each step in which a body could neither walk nor turn
_YIELD_DEPTH = _F(0.003)
_STRANDED_DEPTH = _F(0.08)  # body lengths; a body this deep inside moves freely
_MIN_LEAN_COSINE = _F(0.5)  # cosine of the angle between body and ground; contacts cannot tilt a body further
_MIN_RECOVERABLE_COSINE = _F(-0.087)  # the same at 95 degrees, an angle that no body has after a step over an edge
_POSE_REGISTERS = tuple(f"{name}.{axis}" for name in ("up", "heading", "~lift") for axis in AXES)
# body lengths per second; a body shifts at the first speed by choice, and never faster than the second
_SHIFT_SPEED, _JUMP_SPEED = 3.6, 8.4
# At birth, a body that does not fit tries so many directions, then steps of these lengths (body lengths) into each of them
_SETTLING_DISTANCES = (0.0, 0.5, 1.0, 1.5, 2.5, 4.0)
_SETTLING_DIRECTIONS = ((1, 0), (0, 1), (-1, 0), (0, -1), (0.707, 0.707), (-0.707, 0.707), (-0.707, -0.707), (0.707, -0.707))

# Directions (back, to the left) of steps of bodies that can neither walk nor turn, and the share of the largest step
_ESCAPE_DIRECTIONS = ((-1.0, 0.0), (0.0, 1.0), (0.0, -1.0), (1.0, 0.0))
_ESCAPE_SHARE = 0.5
_MAX_IDLE = _F(0.15)  # seconds; feet that cannot follow their velocity for longer step aside
_MAX_YIELD_DISTANCE = _F(0.012)  # body lengths; a body that is stuck may become so deep


def has_clearance(world: World, population: Population) -> bool:
    """Return whether the bodies of a species stay outside their ground.

    They do if the ground consists of meshes and the bodies follow it. Bodies that stand upright, limit their slope or crouch do
    not follow it."""
    follows_ground = not (has_posture(population) or has_slope_limit(population) or has_crouch(population))
    return population.plan.has_body_clearance and follows_ground and isinstance(world.ground, MeshGround)


@dataclass(slots=True)
class BodyClearanceStep:
    """One substep of the bodies of a species.

    `walk`: the tables of the ground. `rows`: agents on ground with bends, and agents with bodies that are not aligned with
    their feet. `bend_levels`: the bend level of the ground below each of `rows`, see `MeshGround.mark_bend_levels`."""

    world: World
    population: Population
    walk: CrowdWalk
    limits: BodyLimits
    threads: int
    rows: Rows
    bend_levels: NDArray[np.uint8]
    all_bend_levels: NDArray[np.uint8] = field(init=False)
    has_bend: NDArray[np.bool_] = field(init=False)
    state: NDArray[np.int32] = field(init=False)
    previous_poses: BodyPoses = field(init=False)
    start_positions: NDArray[np.float64] = field(init=False)
    level_headings: tuple[NDArray[np.float32], ...] = field(init=False)
    lifts: VectorArrays = field(init=False)
    climbers: Rows = field(init=False)
    climber_positions: NDArray[np.float64] = field(init=False)
    recorded_stances: tuple[tuple[Footing, NDArray[Any], NDArray[Any]], list[NDArray[np.float32]]] = field(init=False)

    @staticmethod
    def build(
        world: World, population: Population, walk: CrowdWalk, stance: tuple[NDArray[np.int32], VectorArrays],
        limits: tuple[NDArray[np.float32], NDArray[np.float32], np.float32]
    ) -> BodyClearanceStep:  # fmt: skip
        """Search for the bodies that cannot simply follow their feet, and return the substep of these bodies.

        `stance`: the states of bodies, and the headings of leaning bodies along the ground. `limits`: limits of tilt and turn,
        and the duration (s)."""
        now, n, threads = population.now, len(population), world.options.threads
        assert isinstance(world.ground, MeshGround)
        (levels,), (row_levels,) = (population.get_buffers(name, 1, (n,), np.uint8) for name in ("bends", "bends of rows"))
        size = np.where(now["size"] > 0, now["size"], 0).astype(np.float64)
        has_bend = world.ground.mark_bend_levels(population.footing, population.position, size, levels, threads)
        mark_near_obstacles(world, population, SHARP_EDGE_REACH_BODY_LENGTHS * size, levels, SHARP_BEND_LEVEL)
        (rows,), heading = population.get_buffers("uneven", 1, (n,), np.int64), vec.get_vector_registers(now, "heading")
        work = partial(select_bodies_near_bends, levels, heading, *stance, read_body_registers(population), rows, row_levels)
        rows, row_levels = parallel.join_parts(parallel.run_in_parts(work, n, threads), rows, row_levels)
        dt = float(limits[2])
        bounds = BodyLimits(
            *limits, now["size"], now["max_speed"], *compute_unit_shapes(world, population), _SHIFT_SPEED * dt, _JUMP_SPEED * dt
        )
        step = BodyClearanceStep(world, population, walk, bounds, threads, rows, row_levels)
        step.all_bend_levels, step.has_bend, step.state = levels, has_bend, stance[0]
        return step

    def limit_steps(self, step: VectorArrays, velocity: VectorArrays) -> None:
        """Shorten the steps (mm) and velocities of agents so that their bodies can follow."""
        if len(self.rows):
            p = self.population
            poses = BodyPoses(vec.get_vector_registers(p.now, "up"), vec.get_vector_registers(p.now, "heading"))
            at = get_footing_arrays(p.footing)
            inputs = (
                at, BodyRows(self.rows, self.bend_levels), poses, p.normal, step, velocity, self.limits,
                read_body_registers(p)
            )  # fmt: skip
            self._run_kernel(partial(limit_steps, self._surface, self._make_face_search(len(self.rows)), *inputs), len(self.rows))

    def turn_bodies_after_walk(
        self, previous_poses: BodyPoses, start_stances: tuple[Footing, NDArray[np.float64], NDArray[np.float32]]
    ) -> None:
        """Turn and shift bodies after the walk. `previous_poses`: poses before the walk. `start_stances`: footings, positions
        and normals before the walk."""
        p, now, n = self.population, self.population.now, len(self.population)
        self.previous_poses, self.start_positions = previous_poses, start_stances[1]
        (rows,), (climbers,) = (p.get_buffers(name, 1, (n,), np.int64) for name in ("uneven", "climbers"))
        (levels,), (kind,) = (p.get_buffers(name, 1, (n,), np.uint8) for name in ("bends of rows", "lifts"))
        lists = LiftLists(rows, levels, climbers, kind)
        inputs = (get_footing_arrays(p.footing), self.has_bend, self.state, self.all_bend_levels, read_body_registers(p), lists)
        parts = parallel.run_in_parts(partial(list_bodies_to_lift, self._surface, *inputs), n, self.threads)
        (self.climbers,) = parallel.join_parts([(begin, count) for begin, _, count in parts], climbers)
        rows, levels = parallel.join_parts(parts, rows, levels)
        order = np.argsort(p.footing.face.take(rows))  # neighbours one after another: they read the same faces
        self.rows, self.bend_levels = rows, levels = rows.take(order), levels.take(order)
        if not len(rows):
            return
        self.lifts = read_lifts(p, rows)
        held = (*vec.take_rows(previous_poses.up, rows), *vec.take_rows(previous_poses.heading, rows), *self.lifts)
        depths = now["~depth"].take(rows)
        self.level_headings = tuple(now[f"heading.{axis}"].take(rows) for axis in AXES)
        idle_times = now["~idle"].take(rows)
        idle = update_idle_times(p, rows, start_stances[1], self.limits.dt) > _MAX_IDLE
        self._aim_bodies(rows, self.bend_levels, previous_poses)
        uneven = np.flatnonzero(self.bend_levels == SHARP_BEND_LEVEL)
        old, footing, (position, normal) = depths[uneven], start_stances[0], (each[rows[uneven]] for each in start_stances[1:])
        depth, out = self._shift_bodies(rows[uneven], vec.take_rows(self.lifts, uneven), position)
        cosine = compute_row_dots(vec.take_rows(vec.get_vector_registers(now, "up"), rows[uneven]), p.normal[rows[uneven]])
        is_lost = (cosine < _MIN_RECOVERABLE_COSINE) & (
            compute_row_dots(vec.take_rows(previous_poses.up, rows[uneven]), normal) >= _MIN_RECOVERABLE_COSINE
        )
        out[:, is_lost] = (position - p.position[rows[uneven]])[is_lost].T
        too_deep = is_lost | ((depth > np.maximum(old, _MAX_DEPTH)) & (old < _STRANDED_DEPTH))
        deeper = np.flatnonzero(too_deep | idle[uneven])
        if deeper.size:
            at = uneven[deeper]
            back = rows[at]
            self._restore_rows(back, (footing.select_rows(back), position[deeper], normal[deeper]))
            now["~idle"][back] = idle_times[at] + self.limits.dt
            for k, axis in enumerate(AXES):
                now[f"~out.{axis}"][rows[uneven[too_deep]]] = out[k, too_deep]
            self._stand_up(at)
            self._aim_bodies(back, self.bend_levels[at], previous_poses)
            turned, _ = self._shift_bodies(back, vec.take_rows(self.lifts, at))
            worse = np.flatnonzero((turned > np.maximum(old[deeper], _MAX_DEPTH)) | idle[at])
            outset_rows = footing.select_rows(back[worse]), position[deeper[worse]], normal[deeper[worse]]
            own = [each[at[worse]] for each in held]
            turned[worse] = self._move_stuck_bodies(at[worse], old[deeper[worse]], turned[worse], own, outset_rows)
            depth[deeper] = turned
        now["~depth"][rows[uneven]] = depth

    def lift_climbers(self, rows: Rows) -> None:
        """Lift the climbing bodies at `rows`, once their poses are final. No edge near these bodies bends sharply, but they stand
        on a wide face next to an edge that does bend."""
        p, now = self.population, self.population.now
        poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
        inputs = (get_footing_arrays(p.footing), poses, self.limits, read_body_registers(p), rows)
        self._run_kernel(partial(lift_bodies, self._surface, *inputs), len(rows))

    def _move_stuck_bodies(
        self, subset: Rows, previous_depths: NDArray[np.float32], turned_depths: NDArray[np.float32],
        previous_poses: list[NDArray[np.float32]], start_stances: SurfaceStances
    ) -> NDArray[np.float32]:  # fmt: skip
        """Move bodies that can neither walk nor turn. Each moves one step back or to a side.

        Return their remaining depths. A body that cannot make any of these steps keeps its pose. `subset`: indices into `rows`.
        `previous_depths`: depths before the step. `turned_depths`: depths of the bodies at their current positions.
        `previous_poses`: poses before the step. `start_stances`: footings, positions and normals before the step."""
        p, now, most = self.population, self.population.now, np.maximum(previous_depths, _MAX_DEPTH)
        depths = np.where(turned_depths > most, np.minimum(most + _YIELD_DEPTH, _MAX_YIELD_DISTANCE), turned_depths)
        depths[previous_depths > _MAX_YIELD_DISTANCE] = _STRANDED_DEPTH
        left = np.arange(len(subset))
        for back, aside in _ESCAPE_DIRECTIONS:
            if not left.size:
                break
            rows, (footing, position, normal) = self.rows[subset[left]], select_stances(start_stances, left)
            self._restore_poses(rows, left, previous_poses)
            up, heading = normal.T.astype(np.float64), np.stack([each[left] for each in previous_poses[3:6]]).astype(np.float64)
            along = heading - up * vec.dot(up, heading)
            reach = np.nan_to_num(_ESCAPE_SHARE * now["max_speed"][rows].astype(np.float64) * self.limits.dt, posinf=0.0)
            step = (along * back + vec.compute_stacked_cross(up, along) * aside) * np.maximum(reach, 0.0)
            step = self._slide_along_obstacles(rows, step, up)
            size = now["size"][rows].astype(np.float64)
            moved = self.world.ground.move(footing, step, along.T, up.T, size, self.threads)
            self._restore_rows(rows, (moved.footing, moved.position, moved.up.astype(np.float32)))
            for k, axis in enumerate(AXES):
                now[f"up.{axis}"][rows], now[f"heading.{axis}"][rows] = moved.up[:, k], moved.heading[:, k]
            self._aim_bodies(rows, self.bend_levels[subset[left]], self.previous_poses)
            depth, _ = self._shift_bodies(rows, vec.take_rows(self.lifts, subset[left]), position)
            cosine = compute_row_dots(vec.take_rows(vec.get_vector_registers(now, "up"), rows), p.normal[rows])
            is_free = (depth <= most[left]) & (cosine >= _MIN_LEAN_COSINE) & ~moved.is_blocked
            depths[left[is_free]] = depth[is_free]
            self._restore_rows(rows[~is_free], select_stances((footing, position, normal), ~is_free))
            left = left[~is_free]
        self._restore_poses(self.rows[subset[left]], left, previous_poses)
        now["~wait"][self.rows[subset[left]]] = 0
        return depths

    def _slide_along_obstacles(self, rows: Rows, step: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return `step` (3, k) mm of the agents at `rows`, deflected along obstacles ahead, as array (k, 3)."""
        short, above = step.astype(np.float32), up.astype(np.float32)
        slid = slide_rows(self.world, self.population, rows, tuple(short), tuple(above))
        return np.stack(slid, axis=1).astype(np.float64)

    def _restore_poses(self, rows: Rows, selection: Rows, previous_poses: list[NDArray[np.float32]]) -> None:
        for name, values in zip(_POSE_REGISTERS, previous_poses, strict=True):
            self.population.now[name][rows] = values[selection]

    def record_stances(self) -> None:
        """Record positions and poses, before contacts move agents."""
        p, rows = self.population, self.rows
        self.climber_positions = p.position.take(self.climbers, axis=0)
        columns = [p.now[name].take(rows) for name in (*_POSE_REGISTERS, "~wait", "~depth")]
        self.recorded_stances = (p.footing.select_rows(rows), p.position[rows], p.normal[rows]), columns

    def correct_moved_bodies(self) -> None:
        """Turn and shift the bodies that contacts have moved.

        A move is undone if it brings the body deeper into a surface, or if the body then leans more than allowed."""
        p, now, rows, climbers = self.population, self.population.now, self.rows, self.climbers
        self.lift_climbers(climbers[(p.position.take(climbers, axis=0) != self.climber_positions).any(axis=1)])
        (footing, position, normal), columns = self.recorded_stances
        at = np.flatnonzero((p.position[rows] != position).any(axis=1))
        if not at.size:
            return
        moved, levels = rows[at], self.bend_levels[at]
        for values, axis in zip(self.level_headings, AXES, strict=True):
            values[at] = now[f"heading.{axis}"][moved]  # contacts may have turned bodies back
        self._stand_up(at)
        self._aim_bodies(moved, levels, self.previous_poses)
        sharp, depth = np.flatnonzero(levels == SHARP_BEND_LEVEL), np.zeros(len(at), np.float32)
        outset = self.start_positions[moved[sharp]]
        depth[sharp], _ = self._shift_bodies(moved[sharp], vec.take_rows(self.lifts, at[sharp]), outset)
        cosine = compute_row_dots(vec.take_rows(vec.get_vector_registers(now, "up"), moved), p.normal[moved])
        old_cosine = compute_row_dots([c[at] for c in columns[:3]], normal[at])
        old = columns[-1][at]
        bad = (depth > np.maximum(old, _MAX_DEPTH)) | (cosine < np.minimum(old_cosine, _MIN_LEAN_COSINE))
        now["~depth"][moved] = depth
        back, at = moved[bad], at[bad]
        self._restore_rows(back, (footing.select_rows(at), position[at], normal[at]))
        for name, values in zip((*_POSE_REGISTERS, "~wait", "~depth"), columns, strict=True):
            now[name][back] = values[at]

    def _stand_up(self, subset: Rows) -> None:
        """Reset some bodies to the poses of their feet, so that they can be turned again. `subset`: indices into `rows`."""
        p, rows = self.population, self.rows[subset]
        for k, axis in enumerate(AXES):
            p.now[f"up.{axis}"][rows] = p.normal[rows, k]
            p.now[f"heading.{axis}"][rows] = self.level_headings[k][subset]
            p.now[f"~lift.{axis}"][rows] = self.lifts[k][subset]

    def _restore_rows(self, rows: Rows, stances: tuple[Footing, NDArray[np.float64], NDArray[np.float32]]) -> None:
        """Restore the footings, positions and normals of agents."""
        p, (footing, position, normal) = self.population, stances
        p.footing.write_rows(rows, footing)
        p.position[rows], p.normal[rows] = position, normal
        for k, axis in enumerate(AXES):
            p.now[f"position.{axis}"][rows] = position[:, k]

    def settle_new_bodies(self) -> None:
        """Turn and shift new bodies immediately, without limits of speed. A body that does not fit tries several headings, and
        uses the one with the least depth. A body that fits in no direction is moved aside by up to four body lengths."""
        p, now, rows, n = self.population, self.population.now, self.rows, len(self.rows)
        heading = np.stack([now[f"heading.{axis}"].take(rows) for axis in AXES])
        best, pose = np.full(n, np.inf, np.float32), [now[name].take(rows) for name in _POSE_REGISTERS]
        stands = select_stances((p.footing, p.position, p.normal), rows)
        for reach in _SETTLING_DISTANCES:
            for along, aside in _SETTLING_DIRECTIONS:
                left = np.flatnonzero(best > _MAX_DEPTH)
                if not left.size:
                    break
                own, (footing, position, normal) = rows[left], select_stances(stands, left)
                up = normal.T
                ahead = heading[:, left] * _F(along) + vec.compute_stacked_cross(up, heading[:, left]) * _F(aside)
                place = footing, position, normal
                if reach > 0:
                    size = now["size"][own].astype(np.float64)
                    step = ahead.T * (reach * np.where(np.isfinite(size), np.maximum(size, 0.0), 0.0))[:, None]
                    step = self._slide_along_obstacles(own, step.T, up.astype(np.float64))
                    moved = self.world.ground.move(footing, step, ahead.T, up.T.astype(np.float64), size, self.threads)
                    place, ahead = (moved.footing, moved.position, moved.up.astype(np.float32)), moved.heading.T
                self._restore_rows(own, place)
                for k, axis in enumerate(AXES):
                    now[f"up.{axis}"][own], now[f"heading.{axis}"][own] = p.normal[own, k], ahead[k]
                    now[f"~lift.{axis}"][own] = 0
                previous = BodyPoses(
                    vec.copy(vec.get_vector_registers(now, "up")), vec.copy(vec.get_vector_registers(now, "heading"))
                )
                self._aim_bodies(own, self.bend_levels[left], previous)
                depth, _ = self._shift_bodies(own, read_lifts(p, own))
                better = depth < best[left] if reach == 0 else depth <= _MAX_DEPTH
                best[left[better]] = depth[better]
                for name, values in zip(_POSE_REGISTERS, pose, strict=True):
                    values[left[better]] = now[name][own[better]]
                undone = ~better if reach > 0 else slice(None)
                self._restore_rows(own[undone], select_stances(stands, left[undone]))
        self._restore_poses(rows, np.arange(n), pose)
        now["~depth"][rows], now["~wait"][rows] = best, 0

    @property
    def _surface(self) -> SurfaceTables:
        return self.walk.build_tables()[0]

    def _make_face_search(self, count: int) -> FaceSearch:
        return make_face_search(self.walk, count, self.threads)

    def _aim_bodies(self, rows: Rows, levels: NDArray[np.uint8], previous_poses: BodyPoses) -> None:
        p, now = self.population, self.population.now
        at = get_footing_arrays(p.footing)
        poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
        inputs = (at, BodyRows(rows, levels), previous_poses, poses, self.limits, read_body_registers(p))
        self._run_kernel(partial(aim_bodies, self._surface, self._make_face_search(len(rows)), *inputs), len(rows))

    def _shift_bodies(
        self, rows: Rows, previous_lifts: VectorArrays, start_positions: NDArray[np.float64] | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Shift bodies out of the faces around them. Return their remaining depths, and the directions out of the surface (3,
        k). `previous_lifts`: shifts before the step. `start_positions` (k, 3) mm: positions before the step, if feet have
        moved."""
        p, now = self.population, self.population.now
        if start_positions is not None:
            lifts = (np.stack(previous_lifts, axis=1) - p.position[rows]) + start_positions
            previous_lifts = vec.split_columns(lifts, np.float32)
        depths, outs = np.zeros(len(rows), np.float32), np.zeros((3, len(rows)), np.float32)
        poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
        inputs = (
            rows, BodyStances(p.position, p.normal, poses), self.limits, vec.get_vector_registers(now, "~lift"),
            previous_lifts, depths, outs, MAX_SHIFT_ROUNDS
        )  # fmt: skip
        ground, things = make_contact_faces(self.world, self.walk, len(rows), self.threads)
        self._run_kernel(partial(shift_bodies, ground, things, *inputs), len(rows))
        return depths, outs

    def _run_kernel(self, work: partial[object], count: int) -> None:
        if count:
            parallel.run_in_parts(work, count, self.threads, ROWS_PER_THREAD)


def settle_bodies_outside_ground(world: World, population: Population, rows: Rows) -> bool:
    """Turn and shift newly added bodies immediately, so that they are outside their ground. Return True if this was done.

    Return False, and change nothing, if bodies of the species need not stay outside or if the ground has no triangles."""
    if not has_clearance(world, population):
        return False
    assert isinstance(world.ground, MeshGround)
    now, n = population.now, len(population)
    walk = world.ground.build_crowd_walk(0.0, float(np.fmax.reduce(now["size"], initial=0.0)))
    if walk is None:
        return False
    free = np.full(n, np.inf, np.float32)
    limits = BodyLimits(
        np.full(n, np.pi, np.float32), free, _F(1), now["size"], free, *compute_unit_shapes(world, population), np.inf, np.inf
    )
    levels = np.full(len(rows), SHARP_BEND_LEVEL, np.uint8)
    step = BodyClearanceStep(world, population, walk, limits, world.options.threads, np.asarray(rows, np.int64), levels)
    step.settle_new_bodies()
    for name in ("up", "heading", "position"):
        for axis in AXES:
            population.start[f"{name}.{axis}"][rows] = now[f"{name}.{axis}"][rows]
    return True
