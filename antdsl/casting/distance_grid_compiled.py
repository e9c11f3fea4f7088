"""`DistanceGrid.at_least` for one place at a time, in a compiled loop: the same operations in the same order, and so bits."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.kernel_cache import njit


@njit(cache=True, nogil=True, error_model="numpy")
def at_least(x, y, z, low, high, size, width, least, found):  # type: ignore[no-untyped-def]
    """Writes the distances; False where a place is no place."""
    part = 1.0 / width
    for n in range(x.size):
        flat, outside = 0, 0.0
        for axis in range(3):
            place = np.float64(x[n] if axis == 0 else y[n] if axis == 1 else z[n])
            if not abs(place) < np.inf:
                return False
            inside = min(max(place, low[axis]), high[axis])
            gap = place - inside
            outside = outside + gap * gap
            flat = flat * size[axis] + min(np.int64((inside - low[axis]) * part), size[axis] - 1)
        away = least[flat]
        found[n] = np.float32(np.sqrt(away * away + outside) * (1 - 1e-5)) if outside > 0 else away
    return True
