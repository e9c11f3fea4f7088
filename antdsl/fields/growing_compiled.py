"""Cells around cells and places, compiled: as `growing` and `cells` find them, the same bits. Imported only where wanted."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F64, I32, I64, Array1, Array2, inlined, kernel, scratch

_MOST = 27 * 6  # cells in 3³ voxels
Numbers = tuple[Array1[I64], Array1[I64]]  # voxels and keys of cells


@inlined
def _square(position, at, x, y, z):  # type: ignore[no-untyped-def]
    """The square of a cell's distance from a place."""
    dx, dy, dz = position[at, 0] - x, position[at, 1] - y, position[at, 2] - z
    return (dx * dx + dy * dy) + dz * dz


@kernel
def nearest(
    direct: Array1[I32], numbers: Numbers, size: Array1[I64], position: Array2[F64], cells: Array1[I64], k: I64, none: I64,
    table: Array2[I32],
) -> None:  # fmt: skip
    """Fill the rows `cells` of `table` with the nearest `k` cells of their 3³ block, ascending; `none` where there are fewer."""
    gaps, found = scratch(_MOST, F64), scratch(_MOST, I64)
    voxels, keys = numbers
    across = size[1] * size[2]
    for own in cells:
        voxel, side = voxels[own], keys[own] % 6
        x, y, z = voxel // across, voxel // size[2] % size[1], voxel % size[2]
        count = 0
        for i in range(max(x - 1, 0), min(x + 2, size[0])):
            for j in range(max(y - 1, 0), min(y + 2, size[1])):
                for m in range(max(z - 1, 0), min(z + 2, size[2])):
                    for s in range(6):
                        at = direct[((i * size[1] + j) * size[2] + m) * 6 + s]
                        if at < 0 or (s ^ 1) == side:
                            continue
                        gap = _square(position, at, position[own, 0], position[own, 1], position[own, 2])
                        place = count
                        while place > 0 and (gaps[place - 1] > gap or (gaps[place - 1] == gap and found[place - 1] > at)):
                            gaps[place], found[place] = gaps[place - 1], found[place - 1]
                            place -= 1
                        gaps[place], found[place] = gap, at
                        count += 1
        count = min(count, k)
        for n in range(1, count):
            at = found[n]
            place = n
            while place > 0 and found[place - 1] > at:
                found[place] = found[place - 1]
                place -= 1
            found[place] = at
        for n in range(k):
            table[own, n] = found[n] if n < count else none


@kernel
def nearby(
    direct: Array1[I32], size: Array1[I64], position: Array2[F64], points: Array2[F64], voxel: Array2[I64], side: Array1[I64],
    best: Array1[I64],
) -> None:  # fmt: skip
    """Fill `best` with the nearest cell of a compatible side in the 27 voxels about that of each point, -1 for none."""
    for n in range(best.size):
        least = np.inf
        best[n] = -1
        for i in range(voxel[n, 0] - 1, voxel[n, 0] + 2):
            for j in range(voxel[n, 1] - 1, voxel[n, 1] + 2):
                for m in range(voxel[n, 2] - 1, voxel[n, 2] + 2):
                    if i < 0 or j < 0 or m < 0 or i >= size[0] or j >= size[1] or m >= size[2]:
                        continue
                    for s in range(6):
                        at = direct[((i * size[1] + j) * size[2] + m) * 6 + s]
                        if at < 0 or (s ^ 1) == side[n]:
                            continue
                        gap = _square(position, at, points[n, 0], points[n, 1], points[n, 2])
                        if gap < least:
                            least, best[n] = gap, at
