"""Smooth beginnings and ends: shares that rise from 0 to 1 and fall again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FrameValue = float | NDArray[np.float64]


def apply_smoothstep(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `share` [n] limited to 0 .. 1 and mapped by the cubic smoothstep function, with slope 0 at both ends."""
    clamped = np.clip(share, 0.0, 1.0)
    smooth: NDArray[np.float64] = clamped * clamped * (3.0 - 2.0 * clamped)
    return smooth


def compute_ease_weight(first: FrameValue, last: FrameValue, ease_frames: int, frame: int) -> NDArray[np.float64]:
    """Return 1 in the frames from `first` to `last`, rising and falling smoothly in the `ease_frames` frames around them.

    `first` and `last` can be arrays (n,): then the result is one too."""
    distance = np.maximum(np.maximum(np.subtract(first, frame), np.subtract(frame, last)), 0)
    return apply_smoothstep(np.asarray(1.0 - distance / (ease_frames + 1)))
