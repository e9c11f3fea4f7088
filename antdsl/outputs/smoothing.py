"""Orientations smoothed over the frames before and after: what a run could not do, which never knows the next frame (R10)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEAST, MOST = 3, 99  # frames


@dataclass(frozen=True, slots=True, eq=False)
class Oriented:
    """The agents of a frame: what tells one from all others, int64[n], each once, and unit quaternions float64[n,4]."""

    key: NDArray[np.int64]
    orient: NDArray[np.float64]


def smoothed(frames: Mapping[int, Oriented], frame: int, width: int) -> NDArray[np.float32]:
    """The orientations [n,4] of a frame as weighted means over `width` frames, half of them before it and half after.

    Weights fall off as a raised cosine (J. von Hann's window). An agent that is not in all of these frames without a break has
    as many of them as there are on both sides, so one that is born or dies stays as it was there, and nobody lags. Quaternions
    are added with the sign that lies nearer to the next frame's towards the middle, and brought to length 1: for small angles the
    mean of F. L. Markley et al., Averaging Quaternions, J. Guidance, Control, and Dynamics 30 (2007)."""
    here, half = frames[frame], width // 2
    sides = [_side(frames, frame, way, half) for way in (-1, 1)]
    reach = np.minimum(sides[0][1], sides[1][1])
    total = here.orient.copy()
    for k in range(half):
        angle = np.minimum((k + 1) / (reach + 1), 1.0) * np.pi  # beyond its reach an agent counts for nothing
        total += (0.5 + 0.5 * np.cos(angle))[:, None] * (sides[0][0][k] + sides[1][0][k])
    size = np.sqrt((total * total).sum(axis=1))
    good = np.isfinite(size) & (size > 1e-6)
    return np.where(good[:, None], total / np.where(good, size, 1.0)[:, None], here.orient).astype(np.float32)


def _side(frames: Mapping[int, Oriented], frame: int, way: int, half: int) -> tuple[list[NDArray[np.float64]], NDArray[np.int64]]:
    """The orientations of a frame's agents in `half` frames to one side, the nearest first, and for how many of them each is
    there."""
    here = frames[frame]
    last, there, count = here.orient, np.ones(len(here.key), np.bool_), np.zeros(len(here.key), np.int64)
    found = []
    for k in range(1, half + 1):
        other = frames.get(frame + way * k)
        if other is None or not len(other.key):
            there[:] = False
        else:
            order = np.argsort(other.key, kind="stable")
            at = order[np.minimum(np.searchsorted(other.key[order], here.key), len(order) - 1)]
            there &= other.key[at] == here.key
            orient = np.where(there[:, None], other.orient[at], last)
            last = np.where((orient * last).sum(axis=1)[:, None] < 0, -orient, orient)
        count[there] = k
        found.append(last)
    return found, count
