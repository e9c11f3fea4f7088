"""Stride, duty factor, lift and phases of gaits by speed, and the measures of legs."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, inlined
from antdsl.scene.setting import LegsData

Floats = NDArray[np.float32]
_F = np.float32
_ZERO, _ONE, _TWO = _F(0), _F(1), _F(2)

MOST_CYCLES = 1 / 3  # maximum cycles per frame; faster legs would appear to stand or move backward, so the stride grows
REACHED = 0.97  # share of the leg length: maximum distance of a standing foot from its hip
REACH_SHARE = 0.38  # reach ahead and behind the rest position, as a share of the reach ahead of the hip
SINK = 0.12  # share of the leg length: maximum lowering of the trunk for a longer step
_OFF = _F(0.12)  # share of the leg length: a standing agent's foot may stay this far from its rest position
_RESTING = 0.5  # s: cycle in which feet return to rest, if the slowest gait has speed 0
_PER_STRIDE = _F(1 / MOST_CYCLES)

# Rows of `Gaits.legs`, float32[10, L], in body lengths.
REST_X, REST_Z = 0, 1  # rest position of a foot, ahead and aside
OFF = 2  # maximum distance from the rest position while the body stands
LENGTH = 3  # from hip to foot joint when the leg is straight
REACH = 4  # maximum distance ahead of or behind the rest position
HIP = 5  # position of the hip, three rows
FOOT_Y = 8  # the height of the foot joint above its ground
SQUARE = 9  # square of the maximum distance of a standing foot from its hip


class Gaits:
    """The gaits of a body by speed, and its legs, as tables for kernels.

    `cycle`: duration (s) of the cycle in which a standing agent puts its feet back.
    `swing`: duration (s) of the longest swing."""

    def __init__(self, legs: LegsData) -> None:
        gaits = legs.gaits
        self.speeds = np.array([g.speed for g in gaits], np.float32)
        self.values = np.array([[g.stride, g.duty, g.lift] for g in gaits], np.float32)
        self.phases = np.array([g.phases for g in gaits], np.float32)
        slow = gaits[0]
        self.cycle = max(2.0 * slow.stride / slow.speed if slow.speed > 0 else _RESTING, 1e-3)
        self.swing = max((1.0 - slow.duty) * (slow.stride / slow.speed if slow.speed > 0 else _RESTING), 1e-3)
        reach = _reach(legs)
        self.least_reach = reach.min()
        longest = legs.length * REACHED
        rows = [*rest_positions(legs), _OFF * legs.length, legs.length, reach, *legs.hip.T, legs.foot[:, 1], longest * longest]
        self.legs: Floats = np.array(rows, np.float32)
        self.exact = np.array([legs.length, legs.foot[:, 1]])

    @property
    def tables(self) -> tuple[Floats, Floats, Floats]:
        """Return the speeds [g], the stride, duty factor and lift [g, 3], and the phases [g, L] of gaits, from slow to fast."""
        return self.speeds, self.values, self.phases


class Gait(NamedTuple):
    """A gait by number, with its stride and lift (body lengths) and its duty factor."""

    number: I64
    stride: F32
    duty: F32
    lift: F32


@inlined
def gait_at(gaits: Any, speed: F32, frame_distance: F32, reach: F32) -> Gait:
    """Return the gait of an agent at a speed (body lengths per second).

    `frame_distance`: the distance that the agent covers in a frame (body lengths). `reach`: the reach of its shortest leg."""
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
    stride = max(stride, frame_distance * _PER_STRIDE)
    # A foot stands only while its leg can reach it; an agent that covers more ground per cycle is in the air in between.
    return Gait(k, stride, min(duty, _TWO * reach / stride), lift)


def rest_positions(legs: LegsData) -> tuple[Floats, Floats]:
    """Return the rest positions of feet, ahead and aside of the body, float32[L] each, in body lengths.

    A foot rests where it is in the standing body. If a stretched leg could not make a step from that position, it rests nearer
    to the hip."""
    down, ahead = legs.foot - legs.hip, _ahead(legs)
    most = ahead * (1.0 - REACH_SHARE)
    x = legs.hip[:, 0] + np.clip(down[:, 0], -most, most)
    return np.asarray(x, np.float32), np.asarray(legs.foot[:, 2], np.float32)


def _ahead(legs: LegsData) -> NDArray[np.float64]:
    """Return how far ahead of or behind its hip each foot can be (body lengths), with a slightly lowered trunk."""
    down = legs.hip - legs.foot
    length = legs.length * REACHED
    height = np.maximum(down[:, 1] - SINK * legs.length, 0.0)
    return np.asarray(np.sqrt(np.maximum(length * length - height * height - down[:, 2] * down[:, 2], 0.0)))


def _reach(legs: LegsData) -> Floats:
    """Return how far ahead of or behind its rest position each foot can be (body lengths)."""
    reach = _ahead(legs) - np.abs(rest_positions(legs)[0].astype(np.float64) - legs.hip[:, 0])
    return np.asarray(np.maximum(reach, 0.05 * legs.length), np.float32)
