"""Weights that rise smoothly from 0 to 1 at the beginning of a range of frames and return to 0 at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FrameValue = float | NDArray[np.float64]


def apply_smoothstep(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cubic smoothstep of `share` [n], which is first clamped to 0 .. 1. The slope is 0 at both ends."""
    clamped = np.clip(share, 0.0, 1.0)
    smooth: NDArray[np.float64] = clamped * clamped * (3.0 - 2.0 * clamped)
    return smooth


def compute_ease_weight(first: FrameValue, last: FrameValue, ease_frames: int, frame: int) -> NDArray[np.float64]:
    """Return the weight at `frame`: 1 from frame `first` to `last`, with smooth transitions from and to 0. Each transition
    takes `ease_frames` frames, before `first` and after `last`. If `first` and `last` are arrays (n,), so is the result."""
    distance = np.maximum(np.maximum(np.subtract(first, frame), np.subtract(frame, last)), 0)
    return apply_smoothstep(np.asarray(1.0 - distance / (ease_frames + 1)))
