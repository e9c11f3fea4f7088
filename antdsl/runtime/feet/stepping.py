"""The kernels of one step of all feet of a species:

`plan_steps` runs before the search for ground, `take_steps` after it. The phase of a gait advances by the ground that the feet
covered, divided by the stride. Ground covered by turning is included. A foot lifts when its stance is over, or when its leg
would be too short. It swings in an arc to a point half a stance ahead of its rest position, and then stands. An agent that
does not move returns its feet to their rest positions, in the order of the gait. The use of phases, and of stance and swing by
duty factor, follows M. H. Raibert and J. K. Hodgins, Animation of Dynamic Legged Locomotion, SIGGRAPH 1991, and N. M. Thalmann
et al.'s survey of walking. Forces are not simulated. Arrays of legs are [..., L, n]. Lengths are body lengths, float32;
positions are mm, float64."""

from __future__ import annotations

from typing import Any

import numpy as np

from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I16,
    I64,
    U8,
    Array1,
    Array2,
    Array3,
    inlined,
    kernel,
    prefetch,
    simd_range,
)
from antdsl.numerics.kernel_vectors import dot, minus
from antdsl.runtime.feet import trunk
from antdsl.runtime.feet.body_tables import (
    TRUNK_PLAY_ROW,
    compute_orthonormal_axes,
    prefetch_columns,
    read_footed_body,
    transform_to_body,
    transform_to_world,
)
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, SWING_PHASE_OF_STANDING_FOOT
from antdsl.runtime.feet.gaits import (
    FOOT_Y_ROW,
    HIP_POSITION_ROW,
    LEG_LENGTH_ROW,
    LEG_REACH_ROW,
    MAX_CYCLES_PER_FRAME,
    MAX_LEG_STRETCH,
    MAX_SINK_SHARE,
    REST_OFFSET_ROW,
    REST_X_ROW,
    REST_Z_ROW,
    select_gait,
)

_F = np.float32
_ZERO, _HALF, _ONE, _TWO, _THREE, _FOUR = _F(0), _F(0.5), _F(1), _F(2), _F(3), _F(4)
_MAX_SINK_SHARE, _MAX_LEG_STRETCH, _MAX_CYCLES_PER_FRAME = _F(MAX_SINK_SHARE), _F(MAX_LEG_STRETCH), _F(MAX_CYCLES_PER_FRAME)

_SLOW_CYCLES_PER_FRAME = _F(0.02)  # cycles per frame; slower agents put their feet back to rest
_MAX_OFFSET_REACHES = _F(1.25)  # multiple of the reach: a foot farther from rest is lifted at any phase
_NEW_SEARCH_LEG_SHARE = _F(0.45)  # share of the leg length: a target farther from the needed position is searched again
_STRETCHED_LEG_SHARE = _F(0.99)  # share of the leg length: a foot farther from its hip is lifted
_SMALL_SWING_STRIDE_SHARE = _F(0.4)  # share of a stride: shorter swings are lower
_MAX_LATE_LIFT_SWING_SHARE = _F(0.6)  # share of a swing; a foot that missed its turn may lift until then
_MISSED_LIFT_REACH_SHARE = _F(0.3)  # share of the reach: a foot farther behind has missed its turn
_MIN_HIP_HEIGHT_SHARE = _F(0.1)  # share of the leg length: least height of the hip above the foot in distance tests
_PHASE_OVERSHOOT = _F(1e-3)  # share of a cycle; the phase starts this much after the turn of the first foot
_PREFETCH_GROUP_SIZE = 16  # number of agents that are prefetched together
_MIN_COVERED_DISTANCE, _MIN_DIVISOR, _MAX_STANCE_FRAMES = _F(1e-6), _F(1e-9), _F(1e4)

STAYING_FOOT, LIFTING_FOOT, LANDING_FOOT, SEARCHING_FOOT = 0, 1, 2, 3  # values of `what`: the action of a foot in this step
REQUEST_LEG_BITS, REQUEST_LEG_MASK = 16, 0xFFFF  # a request is: number of the agent << REQUEST_LEG_BITS | number of the leg

LegTable = Array2[F32]  # as `Gaits.legs`
GaitTables = tuple[Array1[F32], Array2[F32], Array2[F32]]  # as `Gaits.tables`
FootPositions = tuple[Array3[F64], Array3[F64], Array3[F64]]  # `place`, `start` and `shown` of feet
FootStates = tuple[Array2[F32], Array2[I16], Array2[F32]]  # `swing`, `on` and `found` of feet
TrunkColumns = tuple[Array1[F32], Array1[F32], Array2[F32]]  # `phase`, `rise` and `slope`
FootColumns = tuple[FootPositions, FootStates, TrunkColumns]
# For each leg: target position ahead and aside, frames until landing, completed share of the swing at that time, distance
# from the rest position, position relative to the body [3, L, n], and the action.
FootTargets = tuple[Array2[F32], Array2[F32], Array2[F32], Array2[F32], Array2[F32], Array3[F32], Array2[U8]]
StepPaces = tuple[Array1[F32], Array1[F32], Array1[BOOL]]  # stride, lift, and whether the agent hardly moves


@kernel
def measure_ground_covered(
    bodies: Array2[F64],
    last_pose: tuple[Array2[F64], Array2[F32], Array2[F32]],
    legs: LegTable,
    new: Array1[BOOL],
    covered_ground: Array3[F32],
    begin: I64,
    end: I64,
) -> None:
    """Write to `covered_ground` [2, L, n] how far the rest position of each foot moved over the ground.

    The distances are ahead and aside in the current axes of the body, and 0 for `new` agents. `last_pose`: position, heading and
    up of bodies at the end of the last frame."""
    position, heading, up = last_pose
    for i in simd_range(begin, end):
        place, ahead, _, aside, size = read_footed_body(bodies, i)
        forward = np.float64(heading[0, i]), np.float64(heading[1, i]), np.float64(heading[2, i])
        above = np.float64(up[0, i]), np.float64(up[1, i]), np.float64(up[2, i])
        ahead_before, _, aside_before = compute_orthonormal_axes(forward, above)
        displacement = minus((position[0, i], position[1, i], position[2, i]), place)
        away = displacement[0] / size, displacement[1] / size, displacement[2] / size
        moved_x, along_x, across_x = _F(dot(away, ahead)), _F(dot(ahead_before, ahead)), _F(dot(aside_before, ahead))
        moved_z, along_z, across_z = _F(dot(away, aside)), _F(dot(ahead_before, aside)), _F(dot(aside_before, aside))
        for leg in range(legs.shape[1]):
            rest_x, rest_z = legs[REST_X_ROW, leg], legs[REST_Z_ROW, leg]
            x = rest_x - ((moved_x + along_x * rest_x) + across_x * rest_z)
            z = rest_z - ((moved_z + along_z * rest_x) + across_z * rest_z)
            covered_ground[0, leg, i] = x if np.isfinite(x) and not new[i] else _ZERO
            covered_ground[1, leg, i] = z if np.isfinite(z) and not new[i] else _ZERO


@kernel
def plan_steps(
    bodies: Array2[F64],
    covered_ground: Array3[F32],
    legs: LegTable,
    gaits: GaitTables,
    times: tuple[F32, F32, F32, F32],
    undermined: Array2[BOOL],
    feet: FootColumns,
    pace: StepPaces,
    targets: FootTargets,
    requests: Array1[I64],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Advance the phase of agents from `begin` to before `end`, and decide which of their feet lift and land, and where.

    Returns the index of the first request in `requests`, and the number of requests. `requests`: receives the feet that need
    ground, from index L * `begin` on, encoded as `REQUEST_LEG_BITS` describes. `undermined`: flags of feet that lost their
    ground to digging. `times`: the frame duration (s), gait cycles per frame while feet return to rest, least swing fraction
    per frame, and least reach (body lengths)."""
    count = legs.shape[1]
    dt, rests, swings, shortest = times
    place, start, _ = feet[0]
    swing, on, rest_offset = feet[1]
    phase, rise, slope = feet[2]
    target_x, target_z, left, share, off, at, what = targets
    stride, lift, slow = pace
    for group in range(begin, end, _PREFETCH_GROUP_SIZE):
        stop = min(group + _PREFETCH_GROUP_SIZE, end)
        until = min(stop + _PREFETCH_GROUP_SIZE, end)
        prefetch_columns(place, 3 * count, 8, stop, until)
        prefetch_columns(bodies, 13, 8, stop, until)
        prefetch_columns(covered_ground, 2 * count, 16, stop, until)
        prefetch_columns(at, 3 * count, 16, stop, until)
        for each in (swing, rest_offset, target_x, target_z, left, share, off):
            prefetch_columns(each, count, 16, stop, until)
        for each in (on, what, undermined):
            prefetch_columns(each, count, 64, stop, until)
        prefetch_columns(slope, 2, 16, stop, until)
        for each in (rise, phase, stride, lift):
            prefetch(each, stop)
        for i in simd_range(group, stop):
            body = read_footed_body(bodies, i)
            lean, raised = (slope[0, i], slope[1, i]), rise[i] / _F(body.size)
            frame_distance = _ZERO
            for leg in range(count):
                frame_distance = frame_distance + np.sqrt(
                    covered_ground[0, leg, i] * covered_ground[0, leg, i] + covered_ground[1, leg, i] * covered_ground[1, leg, i]
                )
            frame_distance = frame_distance / _F(max(1, count))
            gait, long, duty, high = select_gait(gaits, frame_distance / dt, frame_distance, shortest)
            stride[i], lift[i] = long, high
            ahead = frame_distance / long
            still = ahead < _SLOW_CYCLES_PER_FRAME
            slow[i] = still
            restless, stands = False, True
            for leg in range(count):
                local_foot = transform_to_body(body, (place[0, leg, i], place[1, leg, i], place[2, leg, i]))
                at[0, leg, i], at[1, leg, i], at[2, leg, i] = local_foot
                away = _compute_rest_distance(legs, leg, local_foot, _compute_hip_position(legs, leg, lean, raised))
                off[leg, i] = away
                down = swing[leg, i] == SWING_PHASE_OF_STANDING_FOOT
                if swing[leg, i] >= _ZERO or (down and away > legs[REST_OFFSET_ROW, leg] + rest_offset[leg, i]):
                    restless = True
                if not down or not away <= legs[REST_OFFSET_ROW, leg]:
                    stands = False
            if still and restless:
                ahead = max(ahead, rests)
            ahead = min(ahead, _MAX_CYCLES_PER_FRAME)
            # An agent that starts to walk immediately lifts the foot with the next turn, so that no foot is left behind.
            gap = _F(np.inf)
            for leg in range(count):
                leg_phase = _wrap_phase(phase[i] + gaits[2][gait, leg])
                wait = duty - leg_phase
                wait = wait if wait > _ZERO else wait + _ONE
                gap = min(gap, wait)
            advance = gap + _PHASE_OVERSHOOT if stands and not still and gap > ahead else ahead
            rate = min(max(ahead / (_ONE - duty), swings), _ONE)
            stance = max(_ONE / max(ahead, _MIN_COVERED_DISTANCE) - _ONE / rate, _ZERO)  # number of frames of the stance
            for leg in range(count):
                local_foot = at[0, leg, i], at[1, leg, i], at[2, leg, i]
                hip = _compute_hip_position(legs, leg, lean, raised)
                x, z = local_foot[0] - legs[REST_X_ROW, leg], local_foot[2] - legs[REST_Z_ROW, leg]
                cover_x, cover_z = covered_ground[0, leg, i], covered_ground[1, leg, i]
                leg_phase = _wrap_phase(phase[i] + gaits[2][gait, leg])
                next_phase = leg_phase + advance
                crosses = (leg_phase < duty and next_phase >= duty) or next_phase >= _ONE + duty
                # The foot missed its turn, for example because the gait changed: it is behind its rest position and may still
                # swing.
                behind = x * cover_x + z * cover_z < _ZERO
                late = leg_phase >= duty and leg_phase < duty + _MAX_LATE_LIFT_SWING_SHARE * (_ONE - duty)
                late = late and behind and off[leg, i] > _MISSED_LIFT_REACH_SHARE * legs[LEG_REACH_ROW, leg]
                due = (crosses or late) and (not still or off[leg, i] > _HALF * legs[REST_OFFSET_ROW, leg] + rest_offset[leg, i])
                lost = (
                    off[leg, i] > _MAX_OFFSET_REACHES * legs[LEG_REACH_ROW, leg]
                    or undermined[leg, i]
                    or _is_foot_too_far(legs, leg, local_foot, hip, _STRETCHED_LEG_SHARE)
                )
                down = swing[leg, i] == SWING_PHASE_OF_STANDING_FOOT
                lifts = down and (due or lost)
                flies = lifts or swing[leg, i] >= _ZERO
                if lifts:
                    for axis in range(3):
                        start[axis, leg, i] = place[axis, leg, i]
                progress, increment = SWING_PHASE_OF_STANDING_FOOT, rate
                frames = _ZERO
                if flies:
                    over = next_phase - duty
                    over = over - _ONE if over >= _ONE else over
                    if lifts and crosses and over >= _ZERO:
                        increment = over / (_ONE - duty)
                    progress = min((_ZERO if lifts else swing[leg, i]) + increment, _ONE)
                    frames = (_ONE - progress) / rate
                half_x, half_z = (
                    min(stance, _MAX_STANCE_FRAMES) * cover_x * _HALF,
                    min(stance, _MAX_STANCE_FRAMES) * cover_z * _HALF,
                )
                by = min(_ONE, legs[LEG_REACH_ROW, leg] / max(np.sqrt(half_x * half_x + half_z * half_z), _MIN_DIVISOR))
                to_x = legs[REST_X_ROW, leg] + cover_x * frames + half_x * by
                to_z = legs[REST_Z_ROW, leg] + cover_z * frames + half_z * by
                lands = flies and progress >= _ONE
                past = ((_ZERO if lifts else swing[leg, i]) + increment - _ONE if lands else _ZERO) / rate  # frames since landing
                to_x, to_z = to_x - cover_x * past, to_z - cover_z * past
                target_x[leg, i], target_z[leg, i], left[leg, i], share[leg, i] = to_x, to_z, frames, progress
                miss_x, miss_z = local_foot[0] - to_x, local_foot[2] - to_z
                most = legs[REST_OFFSET_ROW, leg] if still else _NEW_SEARCH_LEG_SHARE * legs[LEG_LENGTH_ROW, leg]
                again = miss_x * miss_x + miss_z * miss_z > most * most or on[leg, i] == NO_GROUND_NUMBER
                again = lands and (again or _is_foot_too_far(legs, leg, local_foot, hip, _MAX_LEG_STRETCH))
                what[leg, i] = (SEARCHING_FOOT if again else LANDING_FOOT) if lands else (LIFTING_FOOT if lifts else STAYING_FOOT)
            phase[i] = _wrap_phase(phase[i] + advance)
    many = 0
    for i in range(begin, end):
        for leg in range(count):
            if what[leg, i] == LIFTING_FOOT or what[leg, i] == SEARCHING_FOOT:
                requests[begin * count + many] = i << REQUEST_LEG_BITS | leg
                many += 1
    return begin * count, many


@kernel
def take_steps(
    bodies: Array2[F64],
    legs: LegTable,
    trunk_steps: tuple[F32, F32, F32],
    feet: FootColumns,
    pace: StepPaces,
    targets: FootTargets,
    last: tuple[Array2[F64], Array2[F32], Array2[F32]],
    begin: I64,
    end: I64,
) -> None:
    """Swing feet to their new footholds, move the trunks over them, and write the positions of all feet. `trunk_steps`: how
    much of a change the trunk makes per frame. The first fraction is for tilt and downward changes, the second for upward
    changes. The third number is the largest difference from the rest height. `last`: receives position, heading and up of
    bodies for the next frame."""
    count = legs.shape[1]
    slower, faster, highest = trunk_steps
    place, start, current_place = feet[0]
    swing, on, rest_offset = feet[1]
    _, rise, slope = feet[2]
    share, at, what = targets[3], targets[5], targets[6]
    stride, lift, slow = pace
    for group in range(begin, end, _PREFETCH_GROUP_SIZE):
        stop = min(group + _PREFETCH_GROUP_SIZE, end)
        until = min(stop + _PREFETCH_GROUP_SIZE, end)
        for each in (place, start, current_place):
            prefetch_columns(each, 3 * count, 8, stop, until)
        prefetch_columns(bodies, 13, 8, stop, until)
        prefetch_columns(at, 3 * count, 16, stop, until)
        for each in (swing, share, rest_offset):
            prefetch_columns(each, count, 16, stop, until)
        for each in (on, what):
            prefetch_columns(each, count, 64, stop, until)
        prefetch_columns(slope, 2, 16, stop, until)
        for each in (rise, stride, lift):
            prefetch(each, stop)
        for i in simd_range(group, stop):
            body = read_footed_body(bodies, i)
            size = _F(body.size)
            lean, raised = (slope[0, i], slope[1, i]), rise[i] / size
            for leg in range(count):
                lands = what[leg, i] >= LANDING_FOOT
                swing[leg, i] = SWING_PHASE_OF_STANDING_FOOT if lands and on[leg, i] != NO_GROUND_NUMBER else share[leg, i]
                local_foot = transform_to_body(body, (place[0, leg, i], place[1, leg, i], place[2, leg, i]))
                at[0, leg, i], at[1, leg, i], at[2, leg, i] = local_foot
                if not slow[i]:
                    rest_offset[leg, i] = _ZERO
                elif lands:
                    rest_offset[leg, i] = _compute_rest_distance(
                        legs, leg, local_foot, _compute_hip_position(legs, leg, lean, raised)
                    )
            height, ahead, aside = trunk.fit_plane_to_feet(at, on, count, i)
            play = _F(bodies[TRUNK_PLAY_ROW, i])
            height, ahead, aside = min(max(height, -highest * play), highest), ahead * play, aside * play
            tilt = lean[0] + (ahead - lean[0]) * slower, lean[1] + (aside - lean[1]) * slower
            raised = raised + (height - raised) * (faster if height > raised else slower)
            high = trunk.compute_lowered_trunk_rise(at, swing, legs, raised, tilt, -highest * play, i) * size
            torn = False
            for leg in range(count):
                local_foot = at[0, leg, i], at[1, leg, i], at[2, leg, i]
                if swing[leg, i] == SWING_PHASE_OF_STANDING_FOOT and _is_foot_too_far(
                    legs, leg, local_foot, _compute_hip_position(legs, leg, tilt, high / size), _STRETCHED_LEG_SHARE
                ):
                    torn = True
            if not torn:  # otherwise the trunk stays, so that all standing feet remain in reach
                rise[i], slope[0, i], slope[1, i] = high, tilt[0], tilt[1]
            lean, raised = (slope[0, i], slope[1, i]), rise[i] / size
            for leg in range(count):
                if swing[leg, i] >= _ZERO:
                    swing_start = transform_to_body(body, (start[0, leg, i], start[1, leg, i], start[2, leg, i]))
                    local_foot = at[0, leg, i], at[1, leg, i], at[2, leg, i]
                    hip = _compute_hip_position(legs, leg, lean, raised)
                    x, y, z = _compute_swing_position(
                        legs, leg, (swing_start, local_foot, hip), swing[leg, i], stride[i], lift[i]
                    )
                    foot = transform_to_world(body, x, y, z)
                    current_place[0, leg, i], current_place[1, leg, i], current_place[2, leg, i] = foot
                else:
                    for axis in range(3):
                        current_place[axis, leg, i] = place[axis, leg, i]
            for axis in range(3):
                last[0][axis, i] = bodies[axis, i]
                last[1][axis, i], last[2][axis, i] = _F(bodies[3 + axis, i]), _F(bodies[6 + axis, i])


@inlined
def _wrap_phase(turns: Any) -> Any:
    """Return the phase (0 to 1) in the current gait cycle after `turns` cycles, that is, the fractional part."""
    return turns - np.floor(turns)


@inlined
def _compute_hip_position(legs: Any, leg: Any, slope: Any, rise: Any) -> Any:
    """Return the position of a leg's hip in body coordinates, for a trunk that leans by `slope` and is raised by `rise`."""
    x, y, z = trunk.rotate_point_by_slope(
        slope, (legs[HIP_POSITION_ROW, leg], legs[HIP_POSITION_ROW + 1, leg], legs[HIP_POSITION_ROW + 2, leg])
    )
    return x, y + rise, z


@inlined
def _compute_rest_distance(legs: Any, leg: Any, local_foot: Any, hip: Any) -> Any:
    """Return the distance (body lengths) of a foot from its rest position.

    It is the lesser of two distances: the horizontal distance, and the distance from the line through the hip and the rest
    position."""
    rest_x, rest_z = legs[REST_X_ROW, leg], legs[REST_Z_ROW, leg]
    x, z = local_foot[0] - rest_x, local_foot[2] - rest_z
    by = hip[1] / max(hip[1] - local_foot[1], _MIN_HIP_HEIGHT_SHARE * legs[LEG_LENGTH_ROW, leg])
    a, c = hip[0] + (local_foot[0] - hip[0]) * by - rest_x, hip[2] + (local_foot[2] - hip[2]) * by - rest_z
    return np.sqrt(min(x * x + z * z, a * a + c * c))


@inlined
def _is_foot_too_far(legs: Any, leg: Any, local_foot: Any, hip: Any, max_share: Any) -> Any:
    """Return whether a foot is farther from its hip than `max_share` times the leg length, even if the trunk is as low as
    allowed."""
    length = legs[LEG_LENGTH_ROW, leg]
    x, z = local_foot[0] - hip[0], local_foot[2] - hip[2]
    y = local_foot[1] - hip[1] + legs[FOOT_Y_ROW, leg]
    high = max(abs(y) - (_MAX_SINK_SHARE * length if y < _ZERO else _ZERO), _ZERO)
    far = max_share * length
    return (x * x + high * high) + z * z > far * far


@inlined
def _compute_swing_position(legs: Any, leg: Any, end_points: Any, progress: Any, stride: Any, lift: Any) -> Any:
    """Return the position of a swinging foot on its arc, within the reach of the leg. `end_points`: start of the swing,
    foothold and hip. `progress`: the completed fraction of the swing."""
    swing_start, local_foot, hip = end_points
    eased = progress * progress * (_THREE - _TWO * progress)
    dx, dy, dz = local_foot[0] - swing_start[0], local_foot[1] - swing_start[1], local_foot[2] - swing_start[2]
    far = np.sqrt((dx * dx + dy * dy) + dz * dz)
    arc = lift * min(_ONE, far / (stride * _SMALL_SWING_STRIDE_SHARE)) * (_FOUR * progress * (_ONE - progress))
    # The foot joint is above the ground. For the distance test, the hip is lowered by the joint's height.
    a, b, c = hip[0], hip[1] - legs[FOOT_Y_ROW, leg], hip[2]
    x, y, z = swing_start[0] + dx * eased - a, swing_start[1] + dy * eased + arc - b, swing_start[2] + dz * eased - c
    long = np.sqrt((x * x + y * y) + z * z)
    by = min(_ONE, legs[LEG_LENGTH_ROW, leg] * _MAX_LEG_STRETCH / max(long, _MIN_DIVISOR))
    return a + x * by, b + y * by, c + z * by
