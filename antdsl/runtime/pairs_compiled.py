"""Items near agents by a compiled loop: the same pairs, bits and order as `pairs` finds with NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, Array1, kernel
from antdsl.numerics.compiled import plain

Floats = NDArray[np.float32]
Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]
Found = tuple[Array1[I64], Array1[I64], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]


def within(ix: Floats, iy: Floats, iz: Floats, x: Floats, y: Floats, z: Floats, reach: Floats) -> tuple[NDArray[Any], ...]:
    """Pairs (asking row, item, item minus own place, distance) of items within the reach of each asking row, by row and item."""
    items, places = plain(ix, iy, iz), plain(x, y, z)
    (reach,) = plain(reach)
    pairs = tuple(np.empty(max(2 * x.size, 64), kind) for kind in (np.int64, np.int64, *(np.float32,) * 4))
    row, used = _fill(items, places, reach, pairs, 0, 0)
    while row < x.size:
        pairs = tuple(np.concatenate([a, np.empty(a.size + ix.size, a.dtype)]) for a in pairs)
        row, used = _fill(items, places, reach, pairs, row, used)
    return tuple(a[:used] for a in pairs)


@kernel
def _fill(items: Columns, places: Columns, reach: Array1[F32], pairs: Found, row: I64, used: I64) -> tuple[I64, I64]:
    """Go on with a row, with so many pairs found before it, until the arrays are too short."""
    ix, iy, iz = items
    x, y, z = places
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
