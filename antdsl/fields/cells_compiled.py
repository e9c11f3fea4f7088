"""The cell of each agent as one pass: as `cells` finds it, the same bits. Imported only where `compiled.wanted` says so."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.kernel_cache import njit


@njit(inline="always")
def _along(place, cell, low, size):  # type: ignore[no-untyped-def]
    """The number of a voxel along one axis of the box, -1 outside."""
    step = np.floor(place / cell + 0.5) - low
    if step >= 0.0 and step < size:
        return np.int64(step)
    return np.int64(-1)


@njit(cache=True, nogil=True, error_model="numpy")
def located(points, side, cell, low, size, direct, keys, shift, start, known, here, found):  # type: ignore[no-untyped-def]
    """Write the cell of the voxel and side of each point into `found` int32[n]; gives how many have none, which get -1.

    points float64[n,3] mm, side int8[n], low and size int64[3] of the box. Cells stand in `direct` int32 by key, or where that is
    empty, by halving among the `keys` int64 in their block: these begin at `start` int32[blocks + 1], of 2**shift keys each.
    `known` int64[n] and `here` int32[n]: keys of the points before, -1 outside the box, and their cells; they are renewed."""
    lx, ly, lz = np.float64(low[0]), np.float64(low[1]), np.float64(low[2])
    sx, sy, sz = np.float64(size[0]), np.float64(size[1]), np.float64(size[2])
    missed = np.int64(0)
    for n in range(found.size):
        x = _along(points[n, 0], cell, lx, sx)
        y = _along(points[n, 1], cell, ly, sy)
        z = _along(points[n, 2], cell, lz, sz)
        at = np.int64(-1)
        if x >= 0 and y >= 0 and z >= 0:
            key = ((x * size[1] + y) * size[2] + z) * 6 + np.int64(side[n])
            if direct.size > 0:
                at = np.int64(direct[key])
            elif key == known[n] and here[n] >= 0:
                at = np.int64(here[n])
            else:
                block = key >> shift
                a, b = np.int64(start[block]), np.int64(start[block + 1])
                while a < b:
                    middle = (a + b) >> 1
                    if keys[middle] < key:
                        a = middle + 1
                    else:
                        b = middle
                if a < keys.size and keys[a] == key:
                    at = a
            if direct.size == 0:
                known[n] = key
        elif direct.size == 0:
            known[n] = -1
        if direct.size == 0:
            here[n] = np.int32(at)
        found[n] = np.int32(at)
        if at < 0:
            missed += 1
    return missed
