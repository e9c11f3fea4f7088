"""Stride, duty, lift and phases of gaits by speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.setting import LegsData

Floats = NDArray[np.float32]

MOST_CYCLES = 1 / 3  # of a gait in one frame: faster legs would seem to go backward or to stand (their stride grows instead)
REACHED = 0.97  # of a leg's length: how far its foot may be from its hip and stand
ROOM = 0.38  # of how far a foot can be ahead of its hip: so far it can go either way from where it rests
SINK = 0.12  # of a leg's length: how far the trunk may come down for a longer step
_RESTING = 0.5  # s, of one cycle in which feet are put back where they rest, where the slowest gait has no speed


@dataclass(frozen=True, slots=True, eq=False)
class Stepping:
    """The cycle of n agents: `stride` (body lengths), `duty`, `lift` (body lengths), float32[n], and `phases` float32[n, L]."""

    stride: Floats
    duty: Floats
    lift: Floats
    phases: Floats


class Gaits:
    """The gaits of a body by speed. `reach` float32[L]: how far from where it rests a foot may stand, in body lengths; `cycle`:
    seconds that one takes who only puts its feet back."""

    def __init__(self, legs: LegsData) -> None:
        gaits = legs.gaits
        self.speeds = np.array([g.speed for g in gaits], np.float32)
        self.values = np.array([[g.stride, g.duty, g.lift] for g in gaits], np.float32)
        self.phases = np.array([g.phases for g in gaits], np.float32)
        slow = gaits[0]
        self.cycle = max(2.0 * slow.stride / slow.speed if slow.speed > 0 else _RESTING, 1e-3)
        self.swing = (1.0 - slow.duty) * (slow.stride / slow.speed if slow.speed > 0 else _RESTING)  # s, at most
        self.reach = _reach(legs)

    def at(self, speed: Floats, most: Floats) -> Stepping:
        """The cycle at speeds (body lengths a second) of whom cover `most` body lengths in a frame."""
        last = len(self.speeds) - 1
        k = np.clip(np.searchsorted(self.speeds, speed, "right") - 1, 0, last)
        after = np.minimum(k + 1, last)
        gap = self.speeds[after] - self.speeds[k]
        share = np.clip((speed - self.speeds[k]) / np.where(gap > 0, gap, np.float32(1)), 0, 1) * (gap > 0)
        stride, duty, lift = (a + (b - a) * share for a, b in zip(self.values[k].T, self.values[after].T, strict=True))
        fastest = self.speeds[last]
        stride = np.where((speed > fastest) & (fastest > 0), stride * speed / np.where(fastest > 0, fastest, 1), stride)
        stride = np.maximum(stride, most * np.float32(1 / MOST_CYCLES))
        # A foot stands no longer than its leg can follow: who covers more ground in a cycle flies in between.
        duty = np.minimum(duty, 2 * self.reach.min() / stride)
        return Stepping(stride.astype(np.float32), duty.astype(np.float32), lift.astype(np.float32), self.phases.T[:, k].T)


def resting(legs: LegsData) -> tuple[Floats, Floats]:
    """Where feet rest, ahead and aside of the body, float32[L] each: as the body stands, and nearer to the hip where a leg is
    stretched out so far that it could not follow a step."""
    down, ahead = legs.foot - legs.hip, _ahead(legs)
    most = ahead * (1.0 - ROOM)
    x = legs.hip[:, 0] + np.clip(down[:, 0], -most, most)
    return np.asarray(x, np.float32), np.asarray(legs.foot[:, 2], np.float32)


def _ahead(legs: LegsData) -> NDArray[np.float64]:
    """How far ahead or behind of its hip each foot can be, with the trunk a little lower."""
    down = legs.hip - legs.foot
    length = legs.length * REACHED
    height = np.maximum(down[:, 1] - SINK * legs.length, 0.0)
    return np.asarray(np.sqrt(np.maximum(length * length - height * height - down[:, 2] * down[:, 2], 0.0)))


def _reach(legs: LegsData) -> Floats:
    """How far ahead or behind of where it rests each foot can be."""
    found = _ahead(legs) - np.abs(resting(legs)[0].astype(np.float64) - legs.hip[:, 0])
    return np.asarray(np.maximum(found, 0.05 * legs.length), np.float32)
