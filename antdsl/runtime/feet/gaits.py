"""Tables of stride, duty factor, lift and phases of gaits by speed, and the dimensions of legs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, inlined
from antdsl.scene.setting import LegsData

Floats = NDArray[np.float32]
_F = np.float32
_ZERO, _ONE, _TWO = _F(0), _F(1), _F(2)

MAX_CYCLES_PER_FRAME = 1 / 3  # maximum cycles per frame; faster legs would appear to stand or move backward, so the stride grows
MAX_LEG_STRETCH = 0.97  # share of the leg length: maximum distance of a standing foot from its hip
REST_REACH_SHARE = 0.38  # reach ahead and behind the rest position, as a share of the reach ahead of the hip
MAX_SINK_SHARE = 0.12  # share of the leg length: maximum lowering of the trunk for a longer step
_MAX_REST_OFFSET_SHARE = _F(0.12)  # share of the leg length: a standing agent's foot may stay this far from its rest position
_REST_CYCLE_SECONDS = 0.5  # s: cycle in which feet return to rest, if the slowest gait has speed 0
_MIN_FRAMES_PER_CYCLE = _F(1 / MAX_CYCLES_PER_FRAME)

# Rows of `Gaits.legs`, float32[10, L], in body lengths.
REST_X_ROW, REST_Z_ROW = 0, 1  # rest position of a foot, ahead and aside
REST_OFFSET_ROW = 2  # maximum distance from the rest position while the body stands
LEG_LENGTH_ROW = 3  # from hip to foot joint when the leg is straight
LEG_REACH_ROW = 4  # maximum distance ahead of or behind the rest position
HIP_POSITION_ROW = 5  # position of the hip, three rows
FOOT_Y_ROW = 8  # the height of the foot joint above its ground
SQUARED_LENGTH_ROW = 9  # square of the maximum distance of a standing foot from its hip


class Gaits:
    """The gaits of a body by speed, and the dimensions of its legs, as tables for kernels.

    `rest_cycle_seconds`: the duration (s) of the cycle in which a standing agent moves its feet back to rest.
    `max_swing_seconds`: the duration (s) of the longest swing."""

    def __init__(self, legs: LegsData) -> None:
        gaits = legs.gaits
        self.speeds = np.array([g.speed for g in gaits], np.float32)
        self.values = np.array([[g.stride, g.duty, g.lift] for g in gaits], np.float32)
        self.phases = np.array([g.phases for g in gaits], np.float32)
        slow = gaits[0]
        self.rest_cycle_seconds = max(2.0 * slow.stride / slow.speed if slow.speed > 0 else _REST_CYCLE_SECONDS, 1e-3)
        self.max_swing_seconds = max(
            (1.0 - slow.duty) * (slow.stride / slow.speed if slow.speed > 0 else _REST_CYCLE_SECONDS), 1e-3
        )
        reach = _compute_rest_reach(legs)
        self.least_reach = reach.min()
        longest = legs.length * MAX_LEG_STRETCH
        rows = [
            *compute_rest_positions(legs),
            _MAX_REST_OFFSET_SHARE * legs.length,
            legs.length,
            reach,
            *legs.hip.T,
            legs.foot[:, 1],
            longest * longest,
        ]
        self.legs: Floats = np.array(rows, np.float32)
        self.exact_legs = np.array([legs.length, legs.foot[:, 1]])

    @property
    def kernel_tables(self) -> tuple[Floats, Floats, Floats]:
        """Return three tables of the gaits, from slow to fast. These are speeds [g]; stride, duty factor and lift [g, 3]; and
        phases [g, L]."""
        return self.speeds, self.values, self.phases


class SelectedGait(NamedTuple):
    """A gait for a given speed: its number, stride (body lengths), duty factor, and the lift of its feet (body lengths)."""

    number: I64
    stride: F32
    duty: F32
    lift: F32


@inlined
def select_gait(gaits: Any, speed: F32, frame_distance: F32, reach: F32) -> SelectedGait:
    """Return the gait of an agent at a speed (body lengths per second).

    `frame_distance`: the agent's displacement per frame (body lengths). `reach`: the least reach of its legs (body lengths)."""
    speeds, values = gaits[0], gaits[1]
    last, k = speeds.size - 1, 0
    for each in range(1, speeds.size):
        if speed >= speeds[each]:
            k = each
    next_index = min(k + 1, last)
    gap = speeds[next_index] - speeds[k]
    share = min(max((speed - speeds[k]) / gap, _ZERO), _ONE) if gap > _ZERO else _ZERO
    stride = values[k, 0] + (values[next_index, 0] - values[k, 0]) * share
    duty = values[k, 1] + (values[next_index, 1] - values[k, 1]) * share
    lift = values[k, 2] + (values[next_index, 2] - values[k, 2]) * share
    fastest = speeds[last]
    if speed > fastest and fastest > _ZERO:
        stride = stride * speed / fastest
    stride = max(stride, frame_distance * _MIN_FRAMES_PER_CYCLE)
    # A foot stands only while its leg can reach it; an agent that covers more ground per cycle is in the air in between.
    return SelectedGait(k, stride, min(duty, _TWO * reach / stride), lift)


def compute_rest_positions(legs: LegsData) -> tuple[Floats, Floats]:
    """Return the rest positions of feet in two arrays float32[L]: ahead and aside, in body lengths.

    The rest position is that of the foot in the standing body. If the leg could not step from there, even stretched, the rest
    position is nearer to the hip."""
    down, ahead = legs.foot - legs.hip, _compute_hip_reach(legs)
    most = ahead * (1.0 - REST_REACH_SHARE)
    x = legs.hip[:, 0] + np.clip(down[:, 0], -most, most)
    return np.asarray(x, np.float32), np.asarray(legs.foot[:, 2], np.float32)


def _compute_hip_reach(legs: LegsData) -> NDArray[np.float64]:
    """Return how far ahead of its hip, or behind it, each foot can be if the trunk is slightly lowered (body lengths)."""
    down = legs.hip - legs.foot
    length = legs.length * MAX_LEG_STRETCH
    height = np.maximum(down[:, 1] - MAX_SINK_SHARE * legs.length, 0.0)
    return np.asarray(np.sqrt(np.maximum(length * length - height * height - down[:, 2] * down[:, 2], 0.0)))


def _compute_rest_reach(legs: LegsData) -> Floats:
    """Return how far ahead of its rest position, or behind it, each foot can be (body lengths)."""
    reach = _compute_hip_reach(legs) - np.abs(compute_rest_positions(legs)[0].astype(np.float64) - legs.hip[:, 0])
    return np.asarray(np.maximum(reach, 0.05 * legs.length), np.float32)
