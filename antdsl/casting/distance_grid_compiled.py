"""`DistanceGrid.at_least` for one place at a time, in a compiled loop: the same operations in the same order, and so bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, kernel

Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]
Cells = tuple[Array1[F64], Array1[F64], Array1[I64], F64]  # where they begin and end, how many along each axis, and how wide


@kernel
def at_least(places: Columns, cells: Cells, least: Array1[F32], found: Array1[F32]) -> BOOL:
    """Writes the distances; False where a place is no place."""
    low, high, size, width = cells
    part = 1.0 / width
    for n in range(found.size):
        flat, outside = 0, 0.0
        for axis in range(3):
            place = np.float64(places[axis][n])
            if not abs(place) < np.inf:
                return False
            inside = min(max(place, low[axis]), high[axis])
            gap = place - inside
            outside = outside + gap * gap
            flat = flat * size[axis] + min(np.int64((inside - low[axis]) * part), size[axis] - 1)
        away = least[flat]
        found[n] = np.float32(np.sqrt(away * away + outside) * (1 - 1e-5)) if outside > 0 else away
    return True
