"""Smooth beginnings and ends: shares that rise from 0 to 1 and fall again."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def apply_smoothstep(share: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return `share` [n] limited to 0 .. 1 and mapped by the cubic smoothstep function, with slope 0 at both ends."""
    clamped = np.clip(share, 0.0, 1.0)
    smooth: NDArray[np.float64] = clamped * clamped * (3.0 - 2.0 * clamped)
    return smooth


def compute_ease_weight(first: float, last: float, ease_frames: int, frame: int) -> float:
    """Return a weight from 0 to 1 for a frame. It is 1 from `first` to `last`, and rises and falls smoothly in the `ease_frames`
    frames before and after."""
    distance = max(first - frame, frame - last, 0)
    return float(apply_smoothstep(np.array(1.0 - distance / (ease_frames + 1))))
