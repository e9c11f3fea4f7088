"""Tilts bodies smoothly to the ground below their feet, no faster than they can turn, and so that heads stay out of walls.

Feet follow the ground exactly: at an edge, the footing and its normal (`Population.normal`) change immediately, by any angle. The
body's up and heading turn gradually towards the feet. Frames store the up and heading of the body. Programs sense and push along
the axes of the feet. Before a wall, the body tilts earlier than the feet: by a right angle over about its own length. If it
cannot tilt as fast as it walks, the feet slow down."""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import inlined, kernel, kernel_helper, load3, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, Array1, Array2, Strided2
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.elementary_loops import atan2, compute_cos_and_sin
from antdsl.numerics.kernel_vectors import (
    Vec3,
    VectorColumns,
    cross,
    divide_vector,
    dot,
    get_column64,
    get_row64,
    plus,
    times,
)  # fmt: skip
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.moving.clearance.walls_ahead import find_walls, write_wall_reach
from antdsl.runtime.moving.postures import (
    Posture,
    compute_perpendicular_direction,
    read_posture,
    read_vector,
    set_upright_share,
    tilt_body_towards,
    turn_heading,
    turn_heading_towards,
)
from antdsl.runtime.moving.velocities import LEANING_BODY_STATE, STANDING_BODY_STATE, maximum
from antdsl.runtime.world import Population, World

# Walls: normals (3, k), directions ahead (3, k), angles, distances, tilt distances.
WallArrays = tuple[Strided2[F64], Strided2[F64], Array1[F64], Array1[F64], Array1[F64]]

_F = np.float32
_FLOAT32_ZERO, _FLOAT32_ONE, _FLOAT32_PI, _RIGHT_ANGLE = _F(0), _F(1), _F(np.pi), _F(np.pi / 2)
_MIN_TILT_RATE = _F(np.pi / 4)  # rad/s; bodies tilt at least this fast, so that slow ones still get around edges
_WAITING_VELOCITY_SHARE = _F(0.05)  # share of the velocity that an agent retains while it waits for its body


def tilt_new_bodies(world: World, population: Population, rows: NDArray[np.intp]) -> None:
    """Tilt new bodies immediately, as far as their posture and the walls ahead require, so that their heads are not in a wall."""
    n, now = len(population), population.now
    state, reach, rest = np.full(n, STANDING_BODY_STATE, np.int32), np.empty(n), np.zeros(n, np.float32)
    x, y, z = np.empty((3, n), np.float32)
    write_wall_reach(now["size"], reach)
    *walls, _ = find_walls(world, population, (x, y, z), (rest, rest, rest), reach, state)
    start = population.start
    poses = *_get_pose_registers(start), *_get_pose_registers(now)
    tilt_bodies_at_walls(rows, state, population.normal, (x, y, z), tuple(walls), read_posture(world, population), *poses)


def align_leaning_bodies_with_ground(population: Population, threads: int = 1) -> None:
    """While programs run, give leaning bodies the heading and up of their feet, which follow the ground.

    So a push straight ahead leads over an edge even while the body is still tilting."""
    n, start, now = len(population), population.start, population.now
    (leaning_rows,) = population.get_buffers("leaning", 1, (n,), np.int64)
    lean = population.get_buffers("laid", 3, (3, n), np.float32)
    work = partial(
        _align_leaning_rows, population.normal, *_get_pose_registers(start), *_get_pose_registers(now), leaning_rows, *lean
    )
    parts = parallel.run_in_parts(work, n, threads)
    population.replaced_poses = (
        tuple(parallel.join_parts(parts, leaning_rows, *lean)) if any([count for _, count in parts]) else None
    )


def restore_leaning_bodies(population: Population) -> None:
    """Restore the up and heading that `align_leaning_bodies_with_ground` replaced. Headings that have changed since are not
    restored."""
    if population.replaced_poses is not None:
        _restore_leaning_rows(
            *population.replaced_poses, *_get_pose_registers(population.start), *_get_pose_registers(population.now)
        )
    population.replaced_poses = None


def _get_pose_registers(values: dict[str, NDArray[Any]]) -> tuple[VectorArrays, VectorArrays]:
    return vec.get_vector_registers(values, "up"), vec.get_vector_registers(values, "heading")


@inlined
def _is_leaning(up: VectorColumns, normal: Array2[F32], i: I64) -> BOOL:
    x, y, z = load3(normal, i)
    return up[0][i] != x or up[1][i] != y or up[2][i] != z


@inlined
def _measure_approach(displacement: Vec3, wall: Vec3, ahead: Vec3) -> F64:
    """Return by how much (mm) a displacement reduces the distance to a wall, where distances are measured along `ahead`."""
    return dot(displacement, wall) / min(dot(ahead, wall), -1e-3)


@kernel_helper
def _tilt_up(n: Vec3, wall: Vec3, ahead: Vec3, angle: F64, wall_distance: F64, tilt_distance: F64, displacement: Vec3) -> Vec3:
    """Return the up direction of a body after a displacement, on ground with the normal `n`, tilted if necessary for a wall
    ahead."""
    part = min(max(1.0 - (wall_distance - _measure_approach(displacement, wall, ahead)) / tilt_distance, 0.0), 1.0) * angle
    axis, cosine = cross(n, wall), dot(n, wall)
    sine = np.sqrt(dot(axis, axis))
    left = np.float64(atan2(_F(sine), _F(cosine)))
    least = _F(min(part, left))
    if not (least > 0 and sine > 1e-6):
        return n
    side = cross(divide_vector(axis, max(sine, 1e-300)), n)
    c, s = compute_cos_and_sin(least)
    turned = plus(times(n, np.float64(c)), times(side, np.float64(s)))
    return divide_vector(turned, np.sqrt(dot(turned, turned)))


@inlined
def compute_stance(
    row: I64,
    up: VectorColumns,
    heading: VectorColumns,
    normal: Array2[F32],
    max_speed: Array1[F32],
    size: Array1[F32],
    max_turn: Array1[F32],
    dt: F32,
    max_tilts: Array1[F32],
    level_headings: VectorColumns,
    state: Array1[I32],
) -> None:
    """Compute the stance of the body at `row` at the start of a step.

    Write to `max_tilts` the body's tilt limit (radians), and to `state` its state without regard to walls. If it leans, write to
    `level_headings` its heading along the ground."""
    walking = maximum(max_speed[row], _FLOAT32_ZERO) / (size[row] if size[row] > 0 else _FLOAT32_ONE) * _RIGHT_ANGLE
    rate = maximum(max_turn[row], _FLOAT32_ZERO)
    if not rate < walking and rate == rate:
        rate = walking
    if walking != walking:
        rate = walking
    rate = maximum(rate, _MIN_TILT_RATE)
    max_tilts[row] = (rate if np.isfinite(rate) else _FLOAT32_PI / dt) * dt
    state[row] = STANDING_BODY_STATE
    if _is_leaning(up, normal, row):
        state[row] = LEANING_BODY_STATE
        level_heading = turn_heading(read_vector(heading, row), read_vector(up, row), get_row64(normal, row))
        level_headings[0][row], level_headings[1][row], level_headings[2][row] = (
            _F(level_heading[0]),
            _F(level_heading[1]),
            _F(level_heading[2]),
        )


@kernel
def tilt_bodies_at_walls(
    rows: Array1[I64], state: Array1[I32], normal: Array2[F32], level_headings: VectorColumns, walls: WallArrays,
    posture: Posture, start_up: VectorColumns, start_heading: VectorColumns, current_up: VectorColumns,
    current_heading: VectorColumns,
) -> None:  # fmt: skip
    """Tilt the bodies at `rows` that have a wall ahead according to `state`, or that have a posture."""
    wall, ahead, angle, far, over = walls
    for i in rows:
        j = state[i]
        if j >= 0 or posture.has_posture:
            ground = get_row64(normal, i)
            heading, up = read_vector(current_heading, i), ground
            if j >= 0:
                heading = read_vector(level_headings, i)
                up = _tilt_up(ground, get_column64(wall, j), get_column64(ahead, j), angle[j], far[j], over[j], (0.0, 0.0, 0.0))
            if posture.has_posture:
                up = set_upright_share(up, posture, i)
            facing = turn_heading(heading, ground, up)
            for k in range(3):
                start_up[k][i] = _F(up[k])
                current_up[k][i] = _F(up[k])
                start_heading[k][i] = _F(facing[k])
                current_heading[k][i] = _F(facing[k])


@kernel
def _align_leaning_rows(
    normal: Array2[F32],
    start_up: VectorColumns,
    start_heading: VectorColumns,
    current_up: VectorColumns,
    current_heading: VectorColumns,
    rows: Array1[I64],
    up: Array2[F32],
    heading: Array2[F32],
    replaced_headings: Array2[F32],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Replace the headings and up directions of leaning agents from `begin` to before `end` by those of their feet.

    Returns `begin` and the number of leaning agents. From index `begin` on, writes their rows to `rows`, their old values to
    `up` and `heading`, and the new headings to `replaced_headings` (3, n)."""
    count = begin
    for i in range(begin, end):
        if not _is_leaning(current_up, normal, i):
            continue
        level_heading = turn_heading(read_vector(start_heading, i), read_vector(start_up, i), get_row64(normal, i))
        rows[count] = i
        for k in range(3):
            up[k, count], heading[k, count], replaced_headings[k, count] = (
                start_up[k][i],
                start_heading[k][i],
                _F(level_heading[k]),
            )
            start_up[k][i] = normal[i, k]
            current_up[k][i] = normal[i, k]
            start_heading[k][i] = _F(level_heading[k])
            current_heading[k][i] = _F(level_heading[k])
        count += 1
    return begin, count - begin


@kernel
def _restore_leaning_rows(
    rows: Array1[I64],
    up: Strided2[F32],
    heading: Strided2[F32],
    replaced_headings: Strided2[F32],
    start_up: VectorColumns,
    start_heading: VectorColumns,
    current_up: VectorColumns,
    current_heading: VectorColumns,
) -> None:
    """Restore the up and heading of the agents at `rows`. A heading that has changed, so that it differs from
    `replaced_headings`, is not restored."""
    for j in range(rows.size):
        i = rows[j]
        has_turned = (
            current_heading[0][i] != replaced_headings[0, j]
            or current_heading[1][i] != replaced_headings[1, j]
            or current_heading[2][i] != replaced_headings[2, j]
        )
        for k in range(3):
            start_up[k][i] = up[k, j]
            current_up[k][i] = up[k, j]
            start_heading[k][i] = heading[k, j]
            if not has_turned:
                current_heading[k][i] = heading[k, j]


@kernel
def limit_steps_of_tilting_bodies(
    state: Array1[I32],
    step: VectorColumns,
    velocity: VectorColumns,
    up: VectorColumns,
    normal: Array2[F32],
    max_tilts: Array1[F32],
    walls: WallArrays,
    posture: Posture,
    begin: I64,
    end: I64,
) -> None:
    """Shorten the steps and velocities of agents that lean or have a wall ahead, so that bodies can follow the feet.

    Agents from `begin` to before `end` are processed; `state` tells which of them lean or have a wall."""
    wall, ahead, angle, far, over = walls
    zero = (0.0, 0.0, 0.0)
    for i in range(begin, end):
        j = state[i]
        if j == STANDING_BODY_STATE:
            continue
        own_step, stands = read_vector(step, i), read_vector(up, i)
        size = np.sqrt(dot(own_step, own_step))
        target_up = get_row64(normal, i)
        limit = np.inf
        if j >= 0 and not (posture.has_posture and posture.upright[i] > 0):  # upright bodies do not tilt before walls
            w, a = get_column64(wall, j), get_column64(ahead, j)
            target_up = _tilt_up(target_up, w, a, angle[j], far[j], over[j], zero)
            towards = _measure_approach(divide_vector(own_step, max(size, 1e-300)), w, a)
            across = cross(stands, w)
            left = np.float64(atan2(_F(np.sqrt(dot(across, across))), _F(dot(stands, w))))
            tilt = angle[j] - left + np.float64(max_tilts[i])
            free = max(over[j] * (tilt / angle[j] - 1.0) + far[j], 0.0)
            limit = free / max(towards, 0.05) if towards > 0.05 else np.inf
        if posture.has_posture:
            target_up = set_upright_share(target_up, posture, i)
        lag = min(1.0, 2.0 * max(dot(stands, target_up), 0.0))
        part = _F(min(lag, min(max(limit / max(size, 1e-300), 0.0), 1.0)))
        speed_part = maximum(part, _WAITING_VELOCITY_SHARE)
        for k in range(3):
            step[k][i] = step[k][i] * part
            velocity[k][i] = velocity[k][i] * speed_part


class PreviousBodyPose(NamedTuple):
    """The poses of bodies before a step: `up`, `heading`, and `position` (n, 3) mm."""

    up: VectorColumns
    heading: VectorColumns
    position: Strided2[F64]


class TurnLimits(NamedTuple):
    """Limits of turns: `max_tilt` of each body (radians), `max_turn` (rad/s), the duration `dt` (s), and the posture of
    bodies."""

    max_tilt: Array1[F32]
    max_turn: Array1[F32]
    dt: F32
    posture: Posture


@kernel
def tilt_bodies_towards_ground(
    state: Array1[I32],
    previous_posture: PreviousBodyPose,
    position: Strided2[F64],
    limits: TurnLimits,
    walls: WallArrays,
    half_lengths: Array1[F64],
    rise: F64,
    current_up: VectorColumns,
    current_heading: VectorColumns,
    rows: Array1[I64],
    begin: I64,
    end: I64,
) -> None:
    """Turn the bodies from `begin` to before `end` towards their feet, by changing `current_up` and `current_heading`.

    Bodies that are aligned with their feet according to `state` are skipped. `previous_posture`: poses before the step.
    `position`: new positions of the feet. `rows`: a work buffer. A body tilts first if a turn would move its head into a wall."""
    before_up, before_heading, before = previous_posture
    most, max_turn, dt, posture = limits
    wall, ahead, angle, far, over = walls
    count = begin
    for row in range(begin, end):
        rows[count] = row
        count += state[row] != STANDING_BODY_STATE
    for k in simd_range(begin, count):
        i = rows[k]
        j = state[i]
        stands = read_vector(before_up, i)
        look = compute_perpendicular_direction(read_vector(before_heading, i), stands)
        normal, looking = read_vector(current_up, i), read_vector(current_heading, i)
        displacement = (position[i, 0] - before[i, 0], position[i, 1] - before[i, 1], position[i, 2] - before[i, 2])
        target_up = normal
        if j >= 0:
            target_up = _tilt_up(normal, get_column64(wall, j), get_column64(ahead, j), angle[j], far[j], over[j], displacement)
        if posture.has_posture:
            target_up = set_upright_share(target_up, posture, i)
        up, one, (tilt, _) = tilt_body_towards(stands, look, target_up, most[i])
        other = turn_heading(turn_heading(looking, normal, target_up), target_up, up)
        yaw_limit = 4.0
        if np.isfinite(max_turn[i]):
            turn = np.float64(max(max_turn[i], _F(0)) * dt)
            yaw_limit = np.sqrt(max(turn * turn - np.float64(tilt) * np.float64(tilt), 0.0))
        facing = turn_heading_towards(one, other, up, min(yaw_limit, 4.0))
        if j >= 0:
            w, a = get_column64(wall, j), get_column64(ahead, j)
            middle = plus(times(up, 2 * rise * half_lengths[j]), times(a, _measure_approach(displacement, w, a) - far[j]))
            with_turn = dot(plus(middle, times(facing, half_lengths[j])), w)
            without = dot(plus(middle, times(one, half_lengths[j])), w)
            if with_turn < min(without, 0.0):
                facing = one
        current_up[0][i], current_up[1][i], current_up[2][i] = _F(up[0]), _F(up[1]), _F(up[2])
        current_heading[0][i], current_heading[1][i], current_heading[2][i] = _F(facing[0]), _F(facing[1]), _F(facing[2])
