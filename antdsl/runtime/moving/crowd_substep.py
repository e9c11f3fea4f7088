"""Runs a substep of a crowd, from pushes to positions: acceleration, limits of speed and turn, obstacles, walk, headings and
bodies. a = push * max_force / mass; v += a dt; P += v dt (explicit Euler, row T20 of docs/parity.md). An agent with a `response`
of at most one step changes its velocity immediately, and faces its direction of motion. The headings of other agents follow
within 0.1 s. An agent with a direction to face turns to that direction instead, so it may walk backward or sideways. The first
loop over all agents computes everything that does not depend on obstacles or walls. The second loop walks all agents that stay on
their own surface, and updates them after the walk (`substep_kernels`). Separate loops process the few agents that may touch an
obstacle, search for walls, lean or have a wall ahead."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from math import inf, nan

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh import walk as loop
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.walk_events import CrowdWalk, PendingWalkArrays
from antdsl.ground.mesh.walkers import PoseArrays, get_footing_arrays
from antdsl.ground.plane import PlaneGround
from antdsl.ground.protocol import Footing, Ground, GroundMove
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays, VectorComponents
from antdsl.runtime.moving.body_records import BodyPoses
from antdsl.runtime.moving.clearance.clear_steps import BodyClearanceStep, has_clearance
from antdsl.runtime.moving.clearance.clearance_kernels import PATH_LENGTH_BODY_LENGTHS
from antdsl.runtime.moving.clearance.head_clearance import MIN_BODY_HEIGHT_SHARE
from antdsl.runtime.moving.clearance.solid_clearance import has_solid_clearance, shift_bodies_outside_solids
from antdsl.runtime.moving.clearance.walls_ahead import NO_WALLS, WallsAhead, find_walls
from antdsl.runtime.moving.crouching import crouch_below_ceilings, has_crouch
from antdsl.runtime.moving.falling import limit_fall_speed
from antdsl.runtime.moving.obstacles import scale_velocities_with_steps, slide_steps
from antdsl.runtime.moving.orienting import orient_bodies
from antdsl.runtime.moving.pacing import find_speed_shares
from antdsl.runtime.moving.postures import Posture, read_posture
from antdsl.runtime.moving.scripted_walks import compute_scripted_velocities, find_scripted_agents, find_scripted_walks_by_line
from antdsl.runtime.moving.slopes import (
    StepStartStance,
    deflect_pushes_along_slopes,
    deflect_steps_along_slopes,
    find_rows_blocked_by_slope,
    has_slope_limit,
)
from antdsl.runtime.moving.substep_kernels import IntendedMotion, PendingWalkStates, prepare_steps, walk_plane, walk_triangles
from antdsl.runtime.moving.tilting import PreviousBodyPose, TurnLimits, limit_steps_of_tilting_bodies, tilt_bodies_towards_ground
from antdsl.runtime.moving.velocities import (
    FACE_REGISTER,
    MAX_INSTANT_RESPONSE_STEPS,
    STANDING_BODY_STATE,
    ArrivalArrays,
    ArrivedBodies,
    FacingDirections,
    MotionInputs,
    MotionLimits,
    MotionRegisters,
    PushTimes,
    SpeedAndTurnLimits,
    TurnTimes,
    WalkedPoses,
    compute_heading_turn_share,
    update_arrived_rows,
)
from antdsl.runtime.world import Population, World

MIN_SPEED_REGISTER = "min_speed"  # only species that use it have this register
_F = np.float32
_ARRIVALS_PER_THREAD = 64  # fewer agents with separate arrival are not worth another thread


def move_agents(world: World, population: Population, substep_index: int) -> BodyClearanceStep | None:
    """Move all agents of a species by one substep. This changes position, velocity, heading, up and footing.

    If the bodies of the species stay outside their ground, return their clearance step, which is used again after contacts.
    Otherwise return None."""
    if not len(population):
        return None
    dt = _F(world.dt / world.setting.substeps)
    clear = _move_bodies_outside_ground(world, population, dt, substep_index) if has_clearance(world, population) else None
    if clear is not None:
        return clear
    posture = read_posture(world, population)
    others = world.setting.orient != "normal"
    limits_slope, crouches = has_slope_limit(population), has_crouch(population)
    crowd = _CrowdSubstep.build(world, population, dt, others or posture.has_posture or limits_slope or crouches)
    previous_pose = (vec.copy(crowd.registers[1]), vec.copy(crowd.registers[3]), population.normal) if others else None
    start = StepStartStance.from_population(population) if limits_slope or crouches else None
    if limits_slope:
        deflect_pushes_along_slopes(world, population)
    crowd.prepare_steps(substep_index)
    crowd.deflect_at_obstacles()
    up = crowd.registers[3]
    walls = find_walls(world, population, crowd.level_headings, crowd.step, crowd.wall_reach, crowd.state)
    n, threads = len(population), crowd.threads
    work = partial(
        limit_steps_of_tilting_bodies,
        crowd.state,
        crowd.step,
        crowd.velocity,
        up,
        population.normal,
        crowd.max_tilts,
        tuple(walls[:-1]),
        posture,
    )
    parallel.run_in_parts(work, n, threads)
    came_from = population.position
    arrival = crowd.walk_agents(world.ground)
    if start is not None and limits_slope:
        crowd.stop_at_slopes(start, arrival)
    if start is not None and crouches:
        crowd.crouch_below_ceilings(start, arrival)
    if previous_pose is not None:
        orient_bodies(world, population, *previous_pose)
    crowd.tilt_bodies_after_walk(came_from, walls, posture)
    if has_solid_clearance(world, population):
        shift_bodies_outside_solids(world, population, came_from, float(dt))
    return None


def _move_bodies_outside_ground(world: World, population: Population, dt: np.float32, substep: int) -> BodyClearanceStep | None:
    """Move the agents of a species with bodies that stay outside their ground. Return their clearance step, or None if the ground
    does not consist of triangles."""
    crowd = _CrowdSubstep.build(world, population, dt, False)
    crowd.prepare_steps(substep)
    crowd.deflect_at_obstacles()
    assert isinstance(world.ground, MeshGround)
    window = PATH_LENGTH_BODY_LENGTHS * np.fmax(crowd.max_size, 0.0)
    walk = world.ground.build_crowd_walk(max(crowd.max_step_length, window), crowd.max_size)
    if walk is None:
        return None
    limits = crowd.max_tilts, population.now["max_turn"], dt
    clear = BodyClearanceStep.build(world, population, walk, (crowd.state, crowd.level_headings), limits)
    clear.limit_steps(crowd.step, crowd.velocity)
    outset = population.footing, population.position, population.normal
    crowd.walk_agents(world.ground)
    clear.turn_bodies_after_walk(BodyPoses(*crowd.previous_axes), outset)
    crowd.tilt_bodies_after_walk(outset[1], NO_WALLS, read_posture(world, population))
    clear.lift_climbers(clear.climbers)
    return clear


@dataclass(slots=True)
class _CrowdSubstep:
    """One substep of a crowd. It lasts `dt` seconds; a frame lasts `frame_time` seconds. `registers`: position, velocity,
    heading and up. The other arrays receive results of the kernels in `substep_kernels`. `must_align_all`: whether the bodies
    of all agents must be aligned with their feet after the walk. `previous_axes`: buffers for the previous up and heading of
    bodies that must be aligned."""

    world: World
    population: Population
    dt: np.float32
    frame_time: np.float32
    must_align_all: bool
    registers: tuple[VectorArrays, VectorArrays, VectorArrays, VectorArrays]
    velocity: VectorArrays
    step: VectorArrays
    level_headings: VectorArrays
    previous_axes: tuple[VectorArrays, VectorArrays]
    step_lengths: NDArray[np.float32]
    max_tilts: NDArray[np.float32]
    wall_reach: NDArray[np.float64]
    state: NDArray[np.int32]
    max_step_length: float = 0.0  # largest finite step (mm)
    max_size: float = nan  # largest size (mm); NaN without a valid size

    @staticmethod
    def build(world: World, population: Population, dt: np.float32, align_all: bool) -> _CrowdSubstep:
        """Return a new substep, before its first stage."""
        now, n = population.now, len(population)
        buffer = population.get_buffers("on the way", 17, (n,), np.float32)
        (reach,), (state,) = (
            population.get_buffers("reach", 1, (n,), np.float64),
            population.get_buffers("state", 1, (n,), np.int32),
        )
        registers = tuple(vec.get_vector_registers(now, name) for name in ("position", "velocity", "heading", "up"))
        velocity, step, looking, up, heading = (buffer[k : k + 3] for k in range(0, 15, 3))
        columns = (registers, velocity, step, looking, (up, heading), *buffer[15:], reach, state)
        return _CrowdSubstep(world, population, dt, _F(world.dt), align_all, *columns)  # type: ignore[arg-type]

    @property
    def threads(self) -> int:
        return self.world.options.threads

    def prepare_steps(self, substep: int) -> None:
        """Compute the intended motion of all agents, without regard to obstacles."""
        p, now, frame_time = self.population, self.population.now, self.frame_time
        drive = MotionInputs(vec.get_vector_registers(now, "push"), *self.registers[1:], p.normal)
        abilities = MotionLimits(now["max_speed"], now["max_force"], now["mass"], now["response"], now["max_turn"])
        keeps = MIN_SPEED_REGISTER in now
        least = now[MIN_SPEED_REGISTER] if keeps else now["max_speed"]
        times = PushTimes(frame_time * MAX_INSTANT_RESPONSE_STEPS, frame_time if substep == 0 else _F(0), self.dt)
        outset = IntendedMotion(
            self.velocity, self.step, self.level_headings, self.step_lengths, self.max_tilts, self.wall_reach, self.state
        )
        paces = find_speed_shares(self.world, p)
        if paces is not None:
            paces.prepare_substep(p, substep, self.dt)
        work = partial(prepare_steps, drive, abilities, keeps, least, now["size"], p.quarantined, times, outset)
        results = parallel.run_in_parts(work, len(p), self.threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
        self.max_step_length, self.max_size = results[0] if len(results) == 1 else map(max, zip(*results, strict=True))
        if self.max_size == -inf:
            self.max_size = nan
        if find_scripted_walks_by_line(self.world, p):
            velocity = compute_scripted_velocities(self.world, p, self.velocity, vec.split_columns(p.normal, np.float32))
            zero = np.zeros(len(p), np.float32)
            self.velocity = vec.select_vectors(p.quarantined, (zero, zero, zero), velocity)
            self.step = vec.scale(self.velocity, self.dt)
            self.step_lengths = vec.length(self.step)
            self.max_step_length = float(self.step_lengths.max(initial=0.0, where=np.isfinite(self.step_lengths)))
        if paces is not None:
            paces.scale_motions(p, self.velocity, self.step, self.step_lengths)
        if self.world.notes is not None:
            self.world.notes.limit_steps(self.world, p, (self.step, self.velocity), float(self.dt))

    def deflect_at_obstacles(self) -> None:
        """Deflect steps along obstacles, and update the velocities of agents with deflected steps."""
        world, p = self.world, self.population
        if not world.plan.obstacles:
            return
        intended_step, up = self.step, p.normal.T
        step = raise_to_min_speed(world, p, slide_steps(world, p, intended_step, up, p.now["radius"]), up, self.dt)
        if step is not intended_step:
            work = partial(scale_velocities_with_steps, intended_step, step, self.velocity, _F(1) / self.dt)
            parallel.run_in_parts(work, len(p), self.threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
            self.step = step

    def tilt_bodies_after_walk(self, previous_positions: NDArray[np.float64], walls: WallsAhead, posture: Posture) -> None:
        """Turn bodies that are not aligned with their feet towards the pose of the feet. `previous_positions` (n, 3):
        positions before the walk (mm)."""
        p, n = self.population, len(self.population)
        previous, limits = (
            PreviousBodyPose(*self.previous_axes, previous_positions),
            TurnLimits(self.max_tilts, p.now["max_turn"], self.dt, posture),
        )
        (rows,) = p.get_buffers("following", 1, (n,), np.int64)
        ahead, (_, _, heading, up) = (previous, p.position, limits, tuple(walls[:-1]), walls.half_lengths), self.registers
        work = partial(tilt_bodies_towards_ground, self.state, *ahead, MIN_BODY_HEIGHT_SHARE, up, heading, rows)
        parallel.run_in_parts(work, n, self.threads)

    def walk_agents(self, ground: Ground) -> ArrivalArrays:
        """Walk all agents over a ground to their new positions, and update their registers. Return the arrays from which later
        stages update the registers again."""
        now = self.population.now
        limits = SpeedAndTurnLimits(now["max_speed"], now["max_turn"], now["response"])
        times = TurnTimes(self.frame_time * MAX_INSTANT_RESPONSE_STEPS, self.dt, compute_heading_turn_share(self.dt))
        facing = FacingDirections(
            FACE_REGISTER in now,
            vec.get_vector_registers(now, "~face") if FACE_REGISTER in now else self.registers[1],
            self.must_align_all,
        )
        bodies, registers = (
            ArrivedBodies(self.max_tilts, self.state, *self.previous_axes),
            MotionRegisters._make(self.registers),
        )
        normals, old = np.empty((len(self.population), 3), np.float32), self.population.position
        arrival = ArrivalArrays(old, self.step, self.velocity, limits, bodies, times, facing, registers, normals)
        if isinstance(ground, PlaneGround):
            self._walk_plane(ground, arrival)
        elif not isinstance(ground, MeshGround) or not self._walk_meshes(ground, arrival):
            self._walk_ground(ground, arrival)
        return arrival

    def stop_at_slopes(self, start: StepStartStance, arrival: ArrivalArrays) -> None:
        """Replace the walks of agents that would step onto ground too steep for them. They walk along the slope instead."""
        p = self.population
        rows = find_rows_blocked_by_slope(self.world, p, start)
        if not len(rows):
            return
        self._replace_walks(
            rows, *deflect_steps_along_slopes(self.world, p, start, rows, vec.stack_rows(vec.take_rows(self.step, rows))), arrival
        )

    def crouch_below_ceilings(self, start: StepStartStance, arrival: ArrivalArrays) -> None:
        """Lower the bodies of agents below low ceilings. Replace the walks of agents that do not fit there yet."""
        changes = crouch_below_ceilings(self.world, self.population, start, vec.stack_rows(self.step), float(self.dt))
        if changes is not None:
            self._replace_walks(*changes, arrival)

    def _replace_walks(
        self, rows: NDArray[np.intp], step: NDArray[np.float64], moved: GroundMove, arrival: ArrivalArrays
    ) -> None:
        """Replace the walks of agents. `step` (k, 3): their steps (mm). `moved`: the ends of these steps."""
        p = self.population
        for k in range(3):
            self.step[k][rows] = step[:, k]
            self.velocity[k][rows] = step[:, k] / self.dt
            for registers, previous in zip(self.registers[2:], reversed(self.previous_axes), strict=True):
                registers[k][rows] = previous[k][rows]
        n = len(p)
        p.footing.write_rows(rows, moved.footing)
        p.position[rows] = moved.position
        place, above, ahead, direction = np.empty((4, 3, n))
        blocked = np.zeros(n, np.bool_)
        for to, values in ((place, moved.position), (above, moved.up), (ahead, moved.heading), (direction, moved.direction)):
            to[:, rows] = values.T
        self._update_arrived(rows, WalkedPoses(place, above, ahead, direction, blocked), arrival)

    def _walk_plane(self, plane: PlaneGround, arrival: ArrivalArrays) -> None:
        p, n = self.population, len(self.population)
        place = np.empty((n, 3))
        work = partial(walk_plane, plane.up, self.level_headings, arrival._replace(start=p.footing.point), place)
        parallel.run_in_parts(work, n, self.threads)
        p.footing, p.position, p.normal = Footing.from_plane(place), place, arrival.normals

    def _walk_meshes(self, ground: MeshGround, arrival: ArrivalArrays) -> bool:
        """Walk all agents over the triangles of the ground. Return False, and walk no agent, if the ground does not consist of
        triangles."""
        p, n = self.population, len(self.population)
        walk = ground.build_crowd_walk(self.max_step_length, self.max_size)
        if walk is None:
            return False
        tables = walk.build_tables()
        to = Footing.from_faces(np.empty(n, np.int32), np.empty(n, np.int32), *np.empty((3, n)))
        at, placed = get_footing_arrays(p.footing), get_footing_arrays(to)
        place = np.empty((3, n))
        (how,) = p.get_buffers("how", 1, (n,), np.uint8)
        (reals,), (wholes,) = (
            p.get_buffers("reals", 1, (loop.FLOAT_ROW_COUNT, n), np.float64),
            p.get_buffers("wholes", 1, (loop.INTEGER_ROW_COUNT, n), np.int64),
        )
        stride_inputs, held = (at, p.now["size"], p.normal, self.level_headings), PendingWalkStates(reals, wholes, how)
        work = partial(walk_triangles, *tables, *stride_inputs, arrival, held, placed, place)
        parts = parallel.run_in_parts(work, n, self.threads)
        if any([waiting or left for _, waiting, left in parts]):
            self._walk_pending(ground, arrival, walk, PendingWalkArrays.merge_parts(parts, reals, wholes), to, place, how)
        p.footing, p.position, p.normal = to, place.T, arrival.normals
        return True

    def _walk_pending(
        self,
        ground: MeshGround,
        arrival: ArrivalArrays,
        walk: CrowdWalk,
        waiting_agents: PendingWalkArrays,
        footing: Footing,
        place: NDArray[np.float64],
        statuses: NDArray[np.uint8],
    ) -> None:
        """Move the agents that `walk_triangles` left out, and update their registers.

        These agents walk off the faces of their surface, have no footing, or have NaN values."""
        p, n = self.population, len(self.population)
        above, ahead, direction = p.get_buffers("walked", 3, (3, n), np.float64)
        (distance,), (blocked,) = p.get_buffers("gone", 1, (n,), np.float64), p.get_buffers("blocked", 1, (n,), np.bool_)
        placed, moved = get_footing_arrays(footing), PoseArrays(place, above, ahead, direction, distance)
        rows = walk.continue_waiting_agents(waiting_agents, statuses, placed, moved, blocked, self.threads)
        if waiting_agents.left_out_count:
            others = np.flatnonzero(statuses != loop.FINISHED_STATUS)
            result = GroundMove(footing, place.T, above.T, ahead.T, direction.T, distance, blocked, np.zeros(n, np.bool_))
            result.write_rows(others, self._move_rows_over_ground(ground, others))
            rows = np.union1d(rows, others)
        if len(rows):
            self._update_arrived(rows, WalkedPoses(place, above, ahead, direction, blocked), arrival)

    def _walk_ground(self, ground: Ground, arrival: ArrivalArrays) -> None:
        p, rows = self.population, np.arange(len(self.population))
        moved = self._move_rows_over_ground(ground, slice(None))
        if self.world.solids:
            moved = limit_fall_speed(self.world, p, moved, self.dt)
        walked = WalkedPoses(moved.position.T, moved.up.T, moved.heading.T, moved.direction.T, moved.is_blocked)
        self._update_arrived(rows, walked, arrival)
        p.footing, p.position, p.normal = moved.footing, moved.position, arrival.normals

    def _move_rows_over_ground(self, ground: Ground, rows: NDArray[np.intp] | slice) -> GroundMove:
        """Return the result of walking the agents at `rows` over the ground."""
        p = self.population
        stands = self.state[rows] == STANDING_BODY_STATE
        heading = vec.select_vectors(stands, vec.take_rows(self.registers[2], rows), vec.take_rows(self.level_headings, rows))
        vectors = vec.stack_rows(vec.take_rows(self.step, rows)), vec.stack_rows(heading), p.normal[rows].astype(np.float64)
        size = p.now["size"][rows].astype(np.float64)
        return ground.move(p.footing.select_rows(rows), *vectors, size, self.threads)

    def _update_arrived(self, rows: NDArray[np.intp], walked_poses: WalkedPoses, arrival: ArrivalArrays) -> None:
        work = partial(update_arrived_rows, rows, walked_poses, arrival)
        parallel.run_in_parts(work, len(rows), self.threads, _ARRIVALS_PER_THREAD)


def raise_to_min_speed(
    world: World, population: Population, step: VectorArrays, up: VectorComponents, dt: np.float32
) -> VectorArrays:
    """Return the steps (mm) in which agents that obstacles slow down below their minimum speed walk farther.

    Such a step gets the length of the minimum speed, in the same direction, if the path is free."""
    now = population.now
    if MIN_SPEED_REGISTER not in now or not world.plan.obstacles:
        return step
    size, least_length = (
        vec.length(step),
        np.minimum(np.maximum(now[MIN_SPEED_REGISTER], _F(0)), np.maximum(now["max_speed"], _F(0))) * dt,
    )
    short = (
        (size > _F(1e-9)) & (size < least_length * _F(0.999)) & ~population.quarantined & ~find_scripted_agents(world, population)
    )
    if not short.any():
        return step
    longer = vec.scale(step, np.where(short, least_length / np.where(size > 0, size, _F(1)), _F(0)))
    return vec.select_vectors(short, slide_steps(world, population, longer, up, now["radius"]), step)
