"""Computes velocities after a push, and velocities and headings after a walk. Agents are processed one by one in float32.

This module also defines how fast headings follow the movement, and the states of bodies. The `state` of a body is the number of a
wall ahead, or one of three values: the body leans, is aligned with its feet, or hastens. A body hastens if it is aligned with its
feet, but would then turn faster than it can."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, Strided2, inlined, kernel, kernel_helper, store3
from antdsl.numerics import elementary
from antdsl.numerics.elementary_loops import atan2, compute_cos_and_sin
from antdsl.numerics.kernel_vectors import AgentPose, Vec3F32, VectorColumns, cross, dot, minus, plus, project_to_plane, times

_F = np.float32
_FLOAT32_ZERO, _FLOAT32_HALF, _FLOAT32_ONE = _F(0), _F(0.5), _F(1)
_MIN_VECTOR_LENGTH, _STEEP_COSINE = _F(1e-12), _F(0.9)  # as in `vectors.normalise_or_fallback` and `find_perpendicular`
_FLOAT32_PI = _F(np.pi)
_SAFE_COSINE_MARGIN = _F(1e-3)  # an angle with a cosine smaller by this margin needs no inverse tangent
_HEADING_TURN_SECONDS = 0.1  # s; time constant of the heading towards the direction of movement (T22)
FACE_REGISTER = "~face.x"  # only species that use it have this register
SLOW_SPEED_SHARE = _F(0.1)  # share of max_speed; below it, the heading follows more and more slowly
BOUNCE_SPEED_SHARE = _F(0.3)  # share of the speed into the border of an open surface that is reflected
MAX_TURN_SLACK_FACTOR = _F(1.005)  # factor of the largest turn; smaller excesses are rounding
MIN_FACE_SINE = _F(1e-3)  # sine of the angle between the body's up and a direction to face; a smaller one gives no heading
MAX_INSTANT_RESPONSE_STEPS = _F(1.0001)  # steps; agents with a shorter response are kinematic
MIN_SQUARED_TURN = _F(1e-12)  # rad2 above the largest turn; smaller excesses are rounding
ANGLE_COEFFICIENT_1_12, ANGLE_COEFFICIENT_1_90 = _F(1 / 12), _F(1 / 90)  # coefficients of the series for a squared angle

LEANING_BODY_STATE, STANDING_BODY_STATE, HURRYING_BODY_STATE = -1, -2, -3


@cache
def compute_heading_turn_share(dt: np.float32) -> np.float32:
    """Return the fraction of the turn towards the direction of motion that an agent makes in a substep of `dt` s."""
    return _F(1.0 - float(elementary.exp(_F(-float(dt) / _HEADING_TURN_SECONDS))))


class MotionInputs(NamedTuple):
    """The values that determine the motion of agents: push, velocity (mm/s), heading, up, and the normals (n, 3) of the
    ground."""

    push: VectorColumns
    velocity: VectorColumns
    heading: VectorColumns
    up: VectorColumns
    ground_normal: Array2[F32]


class MotionLimits(NamedTuple):
    """Limits of agents' motion, with the names that programs use."""

    max_speed: Array1[F32]
    max_force: Array1[F32]
    mass: Array1[F32]
    response: Array1[F32]
    max_turn: Array1[F32]


class PushTimes(NamedTuple):
    """Durations (s) of a push in a substep. `instant_response`: agents with a `response` of at most this (s) receive the push
    of the complete step in the first substep. `first_push_time`: the duration of their push in this substep, 0 in later ones.
    `dt`: the duration for all other agents."""

    instant_response: F32
    first_push_time: F32
    dt: F32


class SpeedAndTurnLimits(NamedTuple):
    """The limits of agents' speeds and turns after a walk. The names are those that programs use."""

    max_speed: Array1[F32]
    max_turn: Array1[F32]
    response: Array1[F32]


class ArrivedBodies(NamedTuple):
    """The bodies of agents after a walk: tilt limits `max_tilt` (radians), states, and buffers for the up direction and the
    heading before the walk."""

    max_tilt: Array1[F32]
    state: Array1[I32]
    previous_up: VectorColumns
    previous_heading: VectorColumns


class TurnTimes(NamedTuple):
    """The times that control how agents turn after a walk.

    `instant_response`: agents with a `response` of at most this (s) turn to their direction of motion immediately. `dt`: the
    duration (s). `turn_share`: the fraction of the turn that all others make in this time."""

    instant_response: F32
    dt: F32
    turn_share: F32


class FacingDirections(NamedTuple):
    """The directions that agents face. `is_set`: whether the species sets these directions. `direction`: the directions.
    `must_align_all`: whether all bodies must be aligned with their feet."""

    is_set: BOOL
    direction: VectorColumns
    must_align_all: BOOL


class MotionRegisters(NamedTuple):
    """The registers that a step changes."""

    position: VectorColumns
    velocity: VectorColumns
    heading: VectorColumns
    up: VectorColumns


class ArrivalArrays(NamedTuple):
    """The inputs and outputs of `update_arrived_rows`.

    `start` (n, 3), `step`, `velocity`: positions, steps and velocities before the walk.
    `registers`, `normals` (n, 3): receive the results. The other fields are inputs."""

    start: Strided2[F64]
    step: VectorColumns
    velocity: VectorColumns
    limits: SpeedAndTurnLimits
    body_stances: ArrivedBodies
    times: TurnTimes
    facing: FacingDirections
    registers: MotionRegisters
    normals: Array2[F32]


class WalkedPoses(NamedTuple):
    """The poses of agents after a walk: position, up, heading and direction of motion, each (3, n). Also whether something
    blocked each walk."""

    position: Strided2[F64]
    up: Strided2[F64]
    heading: Strided2[F64]
    direction: Strided2[F64]
    is_blocked: Array1[BOOL]


@inlined
def apply_push(
    inputs: MotionInputs,
    up: Vec3F32,
    limits: MotionLimits,
    has_min_speed: BOOL,
    min_speed: Array1[F32],
    push_times: PushTimes,
    row: I64,
) -> Vec3F32:
    """Return the velocity of the agent at `row` after its push along the ground, within its limits of speed and turn. `up`:
    the normal of the ground.

    `has_min_speed`: whether `min_speed` applies."""
    push, velocity, heading, _, _ = inputs
    max_speed, max_force, mass, response, max_turn = limits
    at_once, first, dt = push_times
    wish = project_to_plane((push[0][row], push[1][row], push[2][row]), up)
    wish = times(wish, _FLOAT32_ONE / maximum(length(wish), _FLOAT32_ONE))
    previous_velocity = project_to_plane((velocity[0][row], velocity[1][row], velocity[2][row]), up)
    time = first if response[row] <= at_once else dt
    gain = max_force[row] / mass[row]
    gain = (gain if np.isfinite(gain) else _FLOAT32_ZERO) * time
    v = plus(previous_velocity, times(wish, gain))
    speed, most = length(v), maximum(max_speed[row], _FLOAT32_ZERO)
    if speed > most:
        v = times(v, most / (speed if speed > 0 else _FLOAT32_ONE))
    v = (
        v[0] if np.isfinite(v[0]) else _FLOAT32_ZERO,
        v[1] if np.isfinite(v[1]) else _FLOAT32_ZERO,
        v[2] if np.isfinite(v[2]) else _FLOAT32_ZERO,
    )
    if has_min_speed:
        least = _minimum(maximum(min_speed[row], _FLOAT32_ZERO), maximum(max_speed[row], _FLOAT32_ZERO))
        v = _raise_speed(v, previous_velocity, project_to_plane((heading[0][row], heading[1][row], heading[2][row]), up), least)
    if np.isfinite(max_turn[row]):
        most = maximum(max_turn[row], _FLOAT32_ZERO) * time
        turn = min(most, _FLOAT32_PI)
        both = length(v) * length(previous_velocity)
        if not (
            dot(v, previous_velocity) > (compute_cos_and_sin(turn)[0] + _SAFE_COSINE_MARGIN) * both and both > _MIN_VECTOR_LENGTH
        ):
            v = _limit_velocity_turn(
                v, previous_velocity, up, most, length(v) if response[row] <= at_once else SLOW_SPEED_SHARE * max_speed[row]
            )
    return v


@inlined
def _raise_speed(velocity: Vec3F32, previous_velocity: Vec3F32, heading: Vec3F32, min_speed: F32) -> Vec3F32:
    """Return `velocity`, increased to at least `min_speed`.

    A slower agent is accelerated in its previous direction, or along its heading if it was at rest. A sideways push still turns
    such an agent, and braking never reverses its direction."""
    square = dot(velocity, velocity)
    if not square < min_speed * min_speed:
        return velocity
    ahead, good = _normalise(previous_velocity)
    if not good:
        ahead, good = _normalise(heading)
        if not good:
            ahead = (_FLOAT32_ZERO * min_speed, _FLOAT32_ZERO * min_speed, _FLOAT32_ZERO * min_speed)
    along = dot(velocity, ahead)
    increase = np.sqrt(maximum((min_speed * min_speed - square) + along * along, _FLOAT32_ZERO)) - along
    return plus(velocity, times(ahead, increase))


@kernel_helper
def _limit_velocity_turn(velocity: Vec3F32, previous_velocity: Vec3F32, up: Vec3F32, max_turn: F32, creep_speed: F32) -> Vec3F32:
    """Return `velocity`, turned by at most `max_turn` (radians) from the previous one. From rest, it may have any direction.
    The result has the length of its component in the new direction. So a push against the motion first brakes, and does not
    accelerate an agent that cannot turn. Below the speed `creep_speed` (mm/s), the length of the velocity does not change, so
    the agent turns almost on the spot."""
    if not length(previous_velocity) > 0:
        max_turn = _F(4.0)
    ahead, good = _normalise(previous_velocity)
    if not good:
        ahead, good = _normalise(velocity)
        if not good:
            ahead = _find_perpendicular(up)
    direction, good = _normalise(velocity)
    if not good:
        direction = ahead
    left = cross(up, ahead)
    side, good = _normalise(project_to_plane(direction, ahead))
    if not good:
        side = left
    sine, cosine = length(cross(ahead, direction)), dot(ahead, direction)
    if not (np.isfinite(sine) and np.isfinite(cosine)) or not atan2(sine, cosine) > max_turn:
        return velocity
    c, s = compute_cos_and_sin(max_turn)
    turned = plus(times(ahead, c), times(side, s))
    return times(turned, maximum(dot(velocity, turned), _minimum(length(velocity), creep_speed)))


@inlined
def update_arrived_agent(row: I64, pose: AgentPose, is_blocked: BOOL, arrival: ArrivalArrays) -> None:
    """Write velocity, heading, position and up of the agent at `row` after its walk, as described for `update_arrived_rows`.
    `pose`: the float64 result of the walk. `is_blocked`: whether something blocked the walk."""
    place, above, ahead, direction = pose
    old, step, velocity, limits, bodies, times_of, facing, registers, normals = arrival
    max_speed, max_turn, response = limits
    most, state, to_up, to_heading = bodies
    at_once, dt, part = times_of
    faces, face, everyone = facing
    position, to, heading, up = registers
    u = (_F(above[0]), _F(above[1]), _F(above[2]))
    v = (velocity[0][row], velocity[1][row], velocity[2][row])
    v = times((_F(direction[0]), _F(direction[1]), _F(direction[2])), length(v))
    if is_blocked:
        rate = _FLOAT32_ONE / dt
        travel = (_F(place[0] - old[row, 0]), _F(place[1] - old[row, 1]), _F(place[2] - old[row, 2]))
        travel = times(travel, rate)
        lost = minus(times((step[0][row], step[1][row], step[2][row]), rate), travel)
        v = minus(travel, times(lost, BOUNCE_SPEED_SHARE))
    v = project_to_plane(v, u)
    h = (_F(ahead[0]), _F(ahead[1]), _F(ahead[2]))
    previous_heading, was = (heading[0][row], heading[1][row], heading[2][row]), (up[0][row], up[1][row], up[2][row])
    chord = minus(u, was)
    free = most[row] if state[row] == STANDING_BODY_STATE else _FLOAT32_ZERO
    square, limit = dot(chord, chord), free * free
    tilt = _compute_squared_angle(square)
    hasty = tilt > limit
    wish = (face[0][row], face[1][row], face[2][row])
    h = _turn_heading_to_velocity(
        h, v, u, faces, wish, max_speed[row], max_turn[row], response[row] <= at_once, _minimum(tilt, limit), dt, part
    )
    heading_change, aside = minus(h, previous_heading), minus(cross(u, h), cross(was, previous_heading))
    square = (dot(heading_change, heading_change) + dot(chord, chord) + dot(aside, aside)) * _FLOAT32_HALF
    limit = maximum(max_turn[row], _FLOAT32_ZERO) * dt * MAX_TURN_SLACK_FACTOR
    hasty = hasty or _compute_squared_angle(square) > limit * limit + MIN_SQUARED_TURN
    if (hasty or everyone) and state[row] == STANDING_BODY_STATE:
        state[row] = HURRYING_BODY_STATE
    if state[row] != STANDING_BODY_STATE:
        for k in range(3):
            to_up[k][row], to_heading[k][row] = was[k], previous_heading[k]
    for k in range(3):
        to[k][row], heading[k][row], up[k][row], position[k][row] = v[k], h[k], u[k], _F(place[k])
    store3(normals, row, u)


@kernel
def update_arrived_rows(rows: Array1[I64], walked_poses: WalkedPoses, arrival: ArrivalArrays, begin: I64, end: I64) -> None:
    """Write velocity, heading, position and up of agents after the walk into the registers.

    Entries `begin` to before `end` of `rows` are processed. The state of a body that is aligned with its feet becomes
    "hastens" in two cases. Either its up turns by more than `max_tilt`, or it turns more than `MAX_TURN_SLACK_FACTOR` times as
    fast as `max_turn` allows. For bodies that are then not aligned, the previous up and heading are stored."""
    place, above, ahead, direction, blocked = walked_poses
    for j in range(begin, end):
        i = rows[j]
        pose = AgentPose(
            (place[0, i], place[1, i], place[2, i]),
            (above[0, i], above[1, i], above[2, i]),
            (ahead[0, i], ahead[1, i], ahead[2, i]),
            (direction[0, i], direction[1, i], direction[2, i]),
        )
        update_arrived_agent(i, pose, blocked[i], arrival)


@inlined
def _compute_squared_angle(squared_chord: F32) -> F32:
    """Return the squared angle (rad²) between two unit vectors, given their squared distance.

    It is computed by the first terms of a series, so the result is too small for angles above 1 rad."""
    return squared_chord * (_FLOAT32_ONE + squared_chord * (ANGLE_COEFFICIENT_1_12 + squared_chord * ANGLE_COEFFICIENT_1_90))


@inlined
def _turn_heading_to_velocity(
    heading: Vec3F32, velocity: Vec3F32, up: Vec3F32, has_facing: BOOL, facing_direction: Vec3F32, max_speed: F32,
    max_turn: F32, is_immediate: BOOL, tilt: F32, dt: F32, turn_share: F32
) -> Vec3F32:  # fmt: skip
    """Return the heading turned towards the velocity, or towards the direction to face.

    It turns completely if `is_immediate`, else by the fraction `turn_share`. `max_turn` limits the sum of this turn and the tilt
    of the body. `tilt`: the squared angle of the tilt. A turn by more than a right angle first leads to the side."""
    heading, good = _normalise(project_to_plane(heading, up))
    if not good:
        heading = _find_perpendicular(up)
    direction, good = _normalise(velocity)
    if not good:
        direction = heading
    faced = False
    if has_facing:
        facing, good = _normalise(facing_direction)
        along = project_to_plane(facing if good else up, up)
        faced = length(along) > MIN_FACE_SINE
        facing, good = _normalise(along)
        if faced and good:
            direction = facing
    if dot(heading, direction) < 0 and not (is_immediate and not np.isfinite(max_turn)):
        left = cross(up, heading)
        side, good = _normalise(project_to_plane(direction, heading))
        if not good:
            side = left
        direction, good = _normalise(project_to_plane(side, up))
        if not good:
            direction = left
    eager = _minimum(length(velocity) / maximum(max_speed * SLOW_SPEED_SHARE, _F(1e-6)), _FLOAT32_ONE)
    if faced:
        eager = _FLOAT32_ONE
    change = times(minus(direction, heading), _FLOAT32_ONE if is_immediate else turn_share * eager)
    if np.isfinite(max_turn):
        size, most = length(change), maximum(max_turn, _FLOAT32_ZERO) * dt
        most = np.sqrt(maximum(most * most - tilt, _FLOAT32_ZERO))
        if size > most:
            change = times(change, most / (size if size > 0 else _FLOAT32_ONE))
    turned, good = _normalise(project_to_plane(plus(heading, change), up))
    if not good:
        return heading
    return turned


@inlined
def maximum(a: F32, b: F32) -> F32:
    """Return the greater of two numbers; NaN if `a` is NaN."""
    return b if a <= b else a


@inlined
def _minimum(a: F32, b: F32) -> F32:
    """Return the lesser of two numbers; NaN if one of them is NaN, as in NumPy."""
    return a if a < b or a != a else b


@inlined
def length(a: Vec3F32) -> F32:
    return np.sqrt(dot(a, a))


@inlined
def _normalise(a: Vec3F32) -> tuple[Vec3F32, BOOL]:
    """Return a vector scaled to length 1, and whether it has a direction (is not zero)."""
    size = length(a)
    good = size > _MIN_VECTOR_LENGTH and np.isfinite(size)
    return times(a, _FLOAT32_ONE / (size if good else _FLOAT32_ONE)), good


@inlined
def _find_perpendicular(up: Vec3F32) -> Vec3F32:
    steep = abs(up[0]) > _STEEP_COSINE
    side = project_to_plane(
        (_FLOAT32_ZERO if steep else _FLOAT32_ONE, _FLOAT32_ONE if steep else _FLOAT32_ZERO, _FLOAT32_ZERO), up
    )
    return times(side, _FLOAT32_ONE / length(side))
