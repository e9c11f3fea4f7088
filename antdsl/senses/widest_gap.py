"""The widest gap between neighbours, in the plane of the ground of who asks: the way out of a crowd."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary

Floats = NDArray[np.float64]

_TURN = 2 * np.pi
_ALIKE = 1e-4  # rad: gaps that differ by less are equally wide


def widest_gaps(x: Floats, y: Floats, there: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Unit ways, float64[n] ahead and to the left, into the middle of the widest gap between the bearings of neighbours, who are
    at `x` ahead and `y` to the left, float64[n,m], where they are `there`. One neighbour leaves a gap all round, whose middle is
    straight away from it; of equally wide gaps that nearest to straight ahead, then that to the left. 0 without neighbours."""
    n, most = x.shape
    if not most:
        return np.zeros(n), np.zeros(n)
    there = there & ((x != 0) | (y != 0))  # who stands on the same spot has no bearing
    bearing = elementary.atan2(y.astype(np.float32), x.astype(np.float32)).astype(np.float64)
    bearing = np.sort(np.where(there, bearing, np.inf), axis=1)
    known = np.isfinite(bearing)
    count = known.sum(axis=1)
    following = np.concatenate([bearing[:, 1:], np.full((n, 1), np.inf)], axis=1)
    last = known & ~np.isfinite(following)
    following = np.where(last, bearing[:, :1] + _TURN, following)
    gap = np.where(known, following, 0.0) - np.where(known, bearing, 0.0)
    middle = np.where(known, bearing, 0.0) + gap / 2
    middle = np.where(middle > np.pi, middle - _TURN, middle)
    wide = known & (gap >= gap.max(axis=1, keepdims=True) - _ALIKE)
    off = np.where(wide, np.abs(middle), np.inf)
    best = wide & (off <= off.min(axis=1, keepdims=True) + _ALIKE)
    chosen = np.where(best, middle, -np.inf).max(axis=1)  # to the left is above 0
    angle = np.where(count > 0, chosen, 0.0).astype(np.float32)
    some = np.where(count > 0, 1.0, 0.0)
    return elementary.cos(angle).astype(np.float64) * some, elementary.sin(angle).astype(np.float64) * some
