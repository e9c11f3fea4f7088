"""Agents near enough to touch by one loop over cells: the same pairs as `touching` finds with NumPy, in another order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.kernel_cache import njit

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


def pairs(
    place: tuple[Floats, Floats, Floats], reach: Floats, cells: tuple[Any, ...], limit: int, sheet: int, most: int
) -> tuple[Rows, Rows] | int:
    """Pairs of agents no farther apart than their reaches add up to. `cells` as of `touching`: axes from the longest to the
    shortest, and along them where they begin and how wide (mm) and how many they are. Layers above each other are not told apart
    up to `sheet` pairs of cell mates for each agent. Instead -1 where there are more than `limit` cells, -2 where there are more
    than `most` agents in three cells in a row."""
    axes, low, cell, size = cells
    used, most_pairs = -3, 2 * len(reach) + 256
    grid = (tuple(axes), tuple(low), 1 / cell, tuple(size), limit, sheet, most)
    while used == -3:
        i, j = np.empty((2, most_pairs), np.intp)
        used, most_pairs = _filled(*place, reach, *grid, i, j), 4 * most_pairs
    return used if used < 0 else (i[:used], j[:used])


@njit(cache=True, nogil=True, error_model="numpy")
def _filled(x, y, z, reach, axes, low, rate, size, limit, sheet, most, i, j):  # type: ignore[no-untyped-def]
    """Fill `i` and `j` with pairs and give how many there are; -3 where these are too short, else as `pairs`."""
    n, along = x.size, (x, y, z)
    fast, middle, slow = along[axes[0]], along[axes[1]], along[axes[2]]
    across, layer = size[0], size[0] * size[1]
    cells = layer
    if cells > limit:
        return -1
    keys = np.empty(n, np.int64)
    for k in range(n):
        a, b = np.int64((fast[k] - low[0]) * rate) + 1, np.int64((middle[k] - low[1]) * rate) + 1
        keys[k] = b * across + a
    counts = np.zeros(layer + 1, np.int64)
    for k in range(n):
        counts[keys[k]] += 1
    mates = 0
    for k in range(layer):
        mates += counts[k] * counts[k]
    flat = mates <= sheet * n
    if not flat:
        cells = layer * size[2]
        if cells > limit:
            return -1
        counts = np.zeros(cells + 1, np.int64)
        for k in range(n):
            keys[k] += (np.int64((slow[k] - low[2]) * rate) + 1) * layer
            counts[keys[k]] += 1
    starts, total = np.empty(cells + 1, np.int64), 0
    for k in range(cells + 1):
        starts[k] = total
        total += counts[k]
    ends = starts.copy()
    rows = np.empty(n, np.intp)
    for k in range(n):
        rows[ends[keys[k]]] = k
        ends[keys[k]] += 1
    sx, sy, sz, far = x[rows], y[rows], z[rows], reach[rows]
    shifts = (across, layer - across, layer, layer + across)
    spans, used = 2 if flat else 5, 0
    for at in range(n):
        key = keys[rows[at]]
        for span in range(spans):
            if span == 0:
                first, last = at + 1, starts[min(key + 2, cells)]
            else:
                shift = shifts[span - 1]
                first, last = starts[min(key + shift - 1, cells)], starts[min(key + shift + 2, cells)]
            if last - first > most:
                return -2
            if used + last - first > i.size:
                return -3
            # Written whatever it is, and written over where it was too far: no branch that is hard to foretell.
            for other in range(first, last):
                ux, uy, uz = sx[other] - sx[at], sy[other] - sy[at], sz[other] - sz[at]
                room = far[at] + far[other]
                i[used], j[used] = rows[at], rows[other]
                used += (ux * ux + uy * uy) + uz * uz <= room * room
    return used
