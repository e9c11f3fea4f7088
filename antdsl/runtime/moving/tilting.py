"""Bodies follow the ground below their feet smoothly, no faster than they can turn, and with the head out of walls ahead.

Feet are exact: at an edge, their footing and the normal below them (`Population.normal`) change at once, by any angle. The body's
up and heading turn gradually towards the feet. Frames store the body's values. Programs sense and push along the axes of the
feet. Before a wall, the body tilts ahead of the feet: by a right angle over about its own length. If it cannot tilt as fast as it
walks, the feet slow down."""

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
    find_posture,
    read_vector,
    stand_up,
    tilt_by_at_most,
    turn_by_at_most,
    turn_heading,
)
from antdsl.runtime.moving.velocities import LEANING_STATE, STANDING_STATE, maximum
from antdsl.runtime.world import Population, World

# Walls: normals (3, k), directions ahead (3, k), angles, distances, tilt distances.
WallArrays = tuple[Strided2[F64], Strided2[F64], Array1[F64], Array1[F64], Array1[F64]]

_F = np.float32
_FLOAT32_ZERO, _FLOAT32_ONE, _FLOAT32_PI, _RIGHT_ANGLE = _F(0), _F(1), _F(np.pi), _F(np.pi / 2)
_MIN_TILT_RATE = _F(np.pi / 4)  # rad/s; bodies tilt at least this fast, so that slow ones still get around edges
_WAITING_VELOCITY_SHARE = _F(0.05)  # share of the velocity that an agent retains while it waits for its body


def tilt_new_bodies(world: World, population: Population, rows: NDArray[np.intp]) -> None:
    """Tilt new bodies at once as far as their posture and the walls ahead require, so that their heads are free."""
    n, now = len(population), population.now
    state, reach, rest = np.full(n, STANDING_STATE, np.int32), np.empty(n), np.zeros(n, np.float32)
    x, y, z = np.empty((3, n), np.float32)
    write_wall_reach(now["size"], reach)
    *walls, _ = find_walls(world, population, (x, y, z), (rest, rest, rest), reach, state)
    start = population.start
    poses = *_pose_registers(start), *_pose_registers(now)
    tilt_rows(rows, state, population.normal, (x, y, z), tuple(walls), find_posture(world, population), *poses)


def level_headings(population: Population, threads: int = 1) -> None:
    """Replace heading and up of leaning bodies by those of the feet, along the ground, while programs run.

    So a push ahead continues over an edge while the body tilts."""
    n, start, now = len(population), population.start, population.now
    (leaning_rows,) = population.get_buffers("leaning", 1, (n,), np.int64)
    lean = population.get_buffers("laid", 3, (3, n), np.float32)
    work = partial(_level_rows, population.normal, *_pose_registers(start), *_pose_registers(now), leaning_rows, *lean)
    parts = parallel.run_in_parts(work, n, threads)
    population.replaced_poses = (
        tuple(parallel.join_parts(parts, leaning_rows, *lean)) if any([count for _, count in parts]) else None
    )


def restore_bodies(population: Population) -> None:
    """Restore the up and heading that `level_headings` replaced. Keep headings that have changed since."""
    if population.replaced_poses is not None:
        _restore_rows(*population.replaced_poses, *_pose_registers(population.start), *_pose_registers(population.now))
    population.replaced_poses = None


def _pose_registers(values: dict[str, NDArray[Any]]) -> tuple[VectorArrays, VectorArrays]:
    return vec.get_vector_registers(values, "up"), vec.get_vector_registers(values, "heading")


@inlined
def _is_leaning(up: VectorColumns, normal: Array2[F32], i: I64) -> BOOL:
    x, y, z = load3(normal, i)
    return up[0][i] != x or up[1][i] != y or up[2][i] != z


@inlined
def _measure_approach(displacement: Vec3, wall: Vec3, ahead: Vec3) -> F64:
    """Return by how much (mm) a displacement reduces the distance to the wall along `ahead`."""
    return dot(displacement, wall) / min(dot(ahead, wall), -1e-3)


@kernel_helper
def _tilt_up(n: Vec3, wall: Vec3, ahead: Vec3, angle: F64, wall_distance: F64, tilt_distance: F64, displacement: Vec3) -> Vec3:
    """Return the up of a body after a displacement, on ground with normal `n`, tilted towards a wall ahead if needed."""
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
    i: I64,
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
    """Compute the stance of body i at the start of a step.

    Writes its tilt limit (radians) to `max_tilts`, its `state` without walls, and, if it leans, its heading along the ground to
    `level_headings`."""
    walking = maximum(max_speed[i], _FLOAT32_ZERO) / (size[i] if size[i] > 0 else _FLOAT32_ONE) * _RIGHT_ANGLE
    rate = maximum(max_turn[i], _FLOAT32_ZERO)
    if not rate < walking and rate == rate:
        rate = walking
    if walking != walking:
        rate = walking
    rate = maximum(rate, _MIN_TILT_RATE)
    max_tilts[i] = (rate if np.isfinite(rate) else _FLOAT32_PI / dt) * dt
    state[i] = STANDING_STATE
    if _is_leaning(up, normal, i):
        state[i] = LEANING_STATE
        level_heading = turn_heading(read_vector(heading, i), read_vector(up, i), get_row64(normal, i))
        level_headings[0][i], level_headings[1][i], level_headings[2][i] = (
            _F(level_heading[0]),
            _F(level_heading[1]),
            _F(level_heading[2]),
        )


@kernel
def tilt_rows(
    rows: Array1[I64], state: Array1[I32], normal: Array2[F32], level_headings: VectorColumns, walls: WallArrays,
    posture: Posture, start_up: VectorColumns, start_heading: VectorColumns, now_up: VectorColumns, now_heading: VectorColumns,
) -> None:  # fmt: skip
    """Tilt the bodies of `rows` that have a wall ahead according to `state`, or a posture."""
    wall, ahead, angle, far, over = walls
    for i in rows:
        j = state[i]
        if j >= 0 or posture.is_set:
            ground = get_row64(normal, i)
            heading, up = read_vector(now_heading, i), ground
            if j >= 0:
                heading = read_vector(level_headings, i)
                up = _tilt_up(ground, get_column64(wall, j), get_column64(ahead, j), angle[j], far[j], over[j], (0.0, 0.0, 0.0))
            if posture.is_set:
                up = stand_up(up, posture, i)
            facing = turn_heading(heading, ground, up)
            for k in range(3):
                start_up[k][i] = _F(up[k])
                now_up[k][i] = _F(up[k])
                start_heading[k][i] = _F(facing[k])
                now_heading[k][i] = _F(facing[k])


@kernel
def _level_rows(
    normal: Array2[F32],
    start_up: VectorColumns,
    start_heading: VectorColumns,
    now_up: VectorColumns,
    now_heading: VectorColumns,
    rows: Array1[I64],
    up: Array2[F32],
    heading: Array2[F32],
    replaced_headings: Array2[F32],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Replace the headings and ups of leaning agents, from `begin` to before `end`, by those along the ground.

    Returns `begin` and the number of leaning agents. From index `begin` on, writes their `rows`, and their `up`, `heading` and
    replaced heading `replaced_headings` (3, n)."""
    count = begin
    for i in range(begin, end):
        if not _is_leaning(now_up, normal, i):
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
            now_up[k][i] = normal[i, k]
            start_heading[k][i] = _F(level_heading[k])
            now_heading[k][i] = _F(level_heading[k])
        count += 1
    return begin, count - begin


@kernel
def _restore_rows(
    rows: Array1[I64],
    up: Strided2[F32],
    heading: Strided2[F32],
    replaced_headings: Strided2[F32],
    start_up: VectorColumns,
    start_heading: VectorColumns,
    now_up: VectorColumns,
    now_heading: VectorColumns,
) -> None:
    """Restore up and heading of the given rows. A heading that differs from the replaced one, `replaced_headings`, is not
    restored."""
    for j in range(rows.size):
        i = rows[j]
        has_turned = (
            now_heading[0][i] != replaced_headings[0, j]
            or now_heading[1][i] != replaced_headings[1, j]
            or now_heading[2][i] != replaced_headings[2, j]
        )
        for k in range(3):
            start_up[k][i] = up[k, j]
            now_up[k][i] = up[k, j]
            start_heading[k][i] = heading[k, j]
            if not has_turned:
                now_heading[k][i] = heading[k, j]


@kernel
def limit_steps(
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
    """Shorten steps and reduce velocities of agents from `begin` to before `end` so that bodies can follow the feet.

    This applies to agents that lean or have a wall ahead, according to `state`."""
    wall, ahead, angle, far, over = walls
    zero = (0.0, 0.0, 0.0)
    for i in range(begin, end):
        j = state[i]
        if j == STANDING_STATE:
            continue
        own_step, stands = read_vector(step, i), read_vector(up, i)
        size = np.sqrt(dot(own_step, own_step))
        target_up = get_row64(normal, i)
        limit = np.inf
        if j >= 0 and not (posture.is_set and posture.upright[i] > 0):  # upright bodies do not tilt before walls
            w, a = get_column64(wall, j), get_column64(ahead, j)
            target_up = _tilt_up(target_up, w, a, angle[j], far[j], over[j], zero)
            towards = _measure_approach(divide_vector(own_step, max(size, 1e-300)), w, a)
            across = cross(stands, w)
            left = np.float64(atan2(_F(np.sqrt(dot(across, across))), _F(dot(stands, w))))
            tilt = angle[j] - left + np.float64(max_tilts[i])
            free = max(over[j] * (tilt / angle[j] - 1.0) + far[j], 0.0)
            limit = free / max(towards, 0.05) if towards > 0.05 else np.inf
        if posture.is_set:
            target_up = stand_up(target_up, posture, i)
        lag = min(1.0, 2.0 * max(dot(stands, target_up), 0.0))
        part = _F(min(lag, min(max(limit / max(size, 1e-300), 0.0), 1.0)))
        speed_part = maximum(part, _WAITING_VELOCITY_SHARE)
        for k in range(3):
            step[k][i] = step[k][i] * part
            velocity[k][i] = velocity[k][i] * speed_part


class BodyPosture(NamedTuple):
    """Postures of bodies: `up`, `heading`, and position `position` (n, 3) mm."""

    up: VectorColumns
    heading: VectorColumns
    position: Strided2[F64]


class TurnLimits(NamedTuple):
    """Limits of turns: `max_tilt` of each body (radians), `max_turn` (rad/s), duration `dt` (s), and how the bodies stand."""

    max_tilt: Array1[F32]
    max_turn: Array1[F32]
    dt: F32
    posture: Posture


@kernel
def follow_ground(
    state: Array1[I32],
    previous_posture: BodyPosture,
    place: Strided2[F64],
    limits: TurnLimits,
    walls: WallArrays,
    half: Array1[F64],
    rise: F64,
    now_up: VectorColumns,
    now_heading: VectorColumns,
    rows: Array1[I64],
    begin: I64,
    end: I64,
) -> None:
    """Turn the bodies from `begin` to before `end` after their feet; changes `now_up` and `now_heading`.

    `previous_posture`: postures before the step. `place`: new positions of the feet. `rows`: a work buffer. Bodies that are
    aligned with their feet, according to `state`, are skipped. A body tilts first if a turn would move its head into a wall."""
    before_up, before_heading, before = previous_posture
    most, max_turn, dt, posture = limits
    wall, ahead, angle, far, over = walls
    count = begin
    for row in range(begin, end):
        rows[count] = row
        count += state[row] != STANDING_STATE
    for k in simd_range(begin, count):
        i = rows[k]
        j = state[i]
        stands = read_vector(before_up, i)
        look = compute_perpendicular_direction(read_vector(before_heading, i), stands)
        normal, looking = read_vector(now_up, i), read_vector(now_heading, i)
        displacement = (place[i, 0] - before[i, 0], place[i, 1] - before[i, 1], place[i, 2] - before[i, 2])
        target_up = normal
        if j >= 0:
            target_up = _tilt_up(normal, get_column64(wall, j), get_column64(ahead, j), angle[j], far[j], over[j], displacement)
        if posture.is_set:
            target_up = stand_up(target_up, posture, i)
        up, one, (tilt, _) = tilt_by_at_most(stands, look, target_up, most[i])
        other = turn_heading(turn_heading(looking, normal, target_up), target_up, up)
        yaw_limit = 4.0
        if np.isfinite(max_turn[i]):
            turn = np.float64(max(max_turn[i], _F(0)) * dt)
            yaw_limit = np.sqrt(max(turn * turn - np.float64(tilt) * np.float64(tilt), 0.0))
        facing = turn_by_at_most(one, other, up, min(yaw_limit, 4.0))
        if j >= 0:
            w, a = get_column64(wall, j), get_column64(ahead, j)
            middle = plus(times(up, 2 * rise * half[j]), times(a, _measure_approach(displacement, w, a) - far[j]))
            with_turn = dot(plus(middle, times(facing, half[j])), w)
            without = dot(plus(middle, times(one, half[j])), w)
            if with_turn < min(without, 0.0):
                facing = one
        now_up[0][i], now_up[1][i], now_up[2][i] = _F(up[0]), _F(up[1]), _F(up[2])
        now_heading[0][i], now_heading[1][i], now_heading[2][i] = _F(facing[0]), _F(facing[1]), _F(facing[2])
