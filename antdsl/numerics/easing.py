"""Smooth transitions of weights: from 0 to 1 at the beginning, and back to 0 at the end."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FrameValue = float | NDArray[np.float64]


def apply_smoothstep(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Apply the cubic smoothstep function to `share` [n], limited to 0 .. 1. The slope is 0 at both ends."""
    clamped = np.clip(share, 0.0, 1.0)
    smooth: NDArray[np.float64] = clamped * clamped * (3.0 - 2.0 * clamped)
    return smooth


def compute_ease_weight(first: FrameValue, last: FrameValue, ease_frames: int, frame: int) -> NDArray[np.float64]:
    """Return a weight that is 1 in the frames from `first` to `last`. It changes smoothly from and to 0 in the `ease_frames`
    frames around them. If `first` and `last` are arrays (n,), so is the result."""
    distance = np.maximum(np.maximum(np.subtract(first, frame), np.subtract(frame, last)), 0)
    return apply_smoothstep(np.asarray(1.0 - distance / (ease_frames + 1)))
