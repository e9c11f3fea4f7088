"""Smooth beginnings and ends: shares that rise from 0 to 1 and fall again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def smooth_share(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return shares clamped to 0 .. 1, with slope 0 at both ends."""
    clamped = np.clip(share, 0.0, 1.0)
    smooth: NDArray[np.float64] = clamped * clamped * (3.0 - 2.0 * clamped)
    return smooth


def compute_ease(first: float, last: float, ease_frames: int, frame: int) -> float:
    """Return 1 in the frames from `first` to `last`, rising and falling smoothly in the `ease_frames` frames around them."""
    distance = max(first - frame, frame - last, 0)
    return float(smooth_share(np.array(1.0 - distance / (ease_frames + 1))))
