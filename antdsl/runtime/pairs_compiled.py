"""Items near agents by a compiled loop: the same pairs, bits and order as `pairs` finds with NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.kernel_cache import njit

Floats = NDArray[np.float32]


def within(ix: Floats, iy: Floats, iz: Floats, x: Floats, y: Floats, z: Floats, reach: Floats) -> tuple[NDArray[Any], ...]:
    """Pairs (asking row, item, item minus own place, distance) of items within the reach of each asking row, by row and item."""
    pairs = tuple(np.empty(max(2 * x.size, 64), kind) for kind in (np.intp, np.intp, *(np.float32,) * 4))
    row, used = _fill(ix, iy, iz, x, y, z, reach, pairs, 0, 0)
    while row < x.size:
        pairs = tuple(np.concatenate([a, np.empty(a.size + ix.size, a.dtype)]) for a in pairs)
        row, used = _fill(ix, iy, iz, x, y, z, reach, pairs, row, used)
    return tuple(a[:used] for a in pairs)


@njit(cache=True, nogil=True, error_model="numpy")
def _fill(  # type: ignore[no-untyped-def]  # numba takes the types from the call
    ix, iy, iz, x, y, z, reach, pairs, row, used
):  # fmt: skip
    """Go on with a row, with so many pairs found before it, until the arrays are too short."""
    i, j, dx, dy, dz, distance = pairs
    while row < x.size:
        if used + ix.size > i.size:
            return row, used
        for k in range(ix.size):
            ux, uy, uz = ix[k] - x[row], iy[k] - y[row], iz[k] - z[row]
            length = np.sqrt((ux * ux + uy * uy) + uz * uz)
            if length <= reach[row]:
                i[used], j[used] = row, k
                dx[used], dy[used], dz[used], distance[used] = ux, uy, uz, length
                used += 1
        row += 1
    return row, used
