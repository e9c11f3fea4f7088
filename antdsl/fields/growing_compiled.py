"""Cells around cells and places, compiled: as `growing` and `cells` find them, the same bits. Imported only where wanted."""

from __future__ import annotations

import numpy as np
from numba import njit

_MOST = 27 * 6  # cells in 3³ voxels


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(direct, voxels, keys, size, position, cells, k, none, table):  # type: ignore[no-untyped-def]
    """Fill the rows `cells` of `table` with the nearest `k` cells of their 3³ block, ascending; `none` where there are fewer."""
    gaps, found = np.empty(_MOST), np.empty(_MOST, np.int64)
    across = size[1] * size[2]
    for own in cells:
        voxel, side = voxels[own], keys[own] % 6
        x, y, z = voxel // across, voxel // size[2] % size[1], voxel % size[2]
        count = 0
        for i in range(max(x - 1, 0), min(x + 2, size[0])):
            for j in range(max(y - 1, 0), min(y + 2, size[1])):
                for m in range(max(z - 1, 0), min(z + 2, size[2])):
                    for s in range(6):
                        at = np.int64(direct[((i * size[1] + j) * size[2] + m) * 6 + s])
                        if at < 0 or (s ^ 1) == side:
                            continue
                        dx = position[at, 0] - position[own, 0]
                        dy = position[at, 1] - position[own, 1]
                        dz = position[at, 2] - position[own, 2]
                        gap = (dx * dx + dy * dy) + dz * dz
                        place = count
                        while place > 0 and (gaps[place - 1] > gap or (gaps[place - 1] == gap and found[place - 1] > at)):
                            gaps[place], found[place] = gaps[place - 1], found[place - 1]
                            place -= 1
                        gaps[place], found[place] = gap, at
                        count += 1
        count = min(count, k)
        chosen = np.sort(found[:count])
        for n in range(k):
            table[own, n] = chosen[n] if n < count else none


@njit(cache=True, nogil=True, error_model="numpy")
def nearby(direct, size, position, points, voxel, side, best):  # type: ignore[no-untyped-def]
    """Fill `best` with the nearest cell of a compatible side in the 27 voxels about that of each point, -1 for none."""
    for n in range(len(points)):
        least = np.inf
        best[n] = -1
        for i in range(voxel[n, 0] - 1, voxel[n, 0] + 2):
            for j in range(voxel[n, 1] - 1, voxel[n, 1] + 2):
                for m in range(voxel[n, 2] - 1, voxel[n, 2] + 2):
                    if i < 0 or j < 0 or m < 0 or i >= size[0] or j >= size[1] or m >= size[2]:
                        continue
                    for s in range(6):
                        at = np.int64(direct[((i * size[1] + j) * size[2] + m) * 6 + s])
                        if at < 0 or (s ^ 1) == side[n]:
                            continue
                        dx = position[at, 0] - points[n, 0]
                        dy = position[at, 1] - points[n, 1]
                        dz = position[at, 2] - points[n, 2]
                        gap = (dx * dx + dy * dy) + dz * dz
                        if gap < least:
                            least, best[n] = gap, at
