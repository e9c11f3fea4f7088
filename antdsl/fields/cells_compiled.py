"""The cell of each agent as one pass: as `cells` finds it, the same bits. Imported only where `compiled.wanted` says so."""

import numpy as np

from antdsl.machine_code.kernels import F64, I8, I32, I64, Array1, Strided2, independent, inlined, kernel


@inlined
def _along(place, cell, low, size):  # type: ignore[no-untyped-def]
    """The number of a voxel along one axis of the box, -1 outside."""
    step = np.floor(place / cell + 0.5) - np.float64(low)
    if step >= 0.0 and step < np.float64(size):
        return np.int64(step)
    return -1


@kernel
def located(
    points: Strided2[F64],
    side: Array1[I8],
    cell: F64,
    low: Array1[I64],
    size: Array1[I64],
    direct: Array1[I32],
    keys: Array1[I64],
    shift: I64,
    start: Array1[I32],
    known: Array1[I64],
    here: Array1[I32],
    found: Array1[I32],
    begin: I64,
    end: I64,
) -> int:
    """Write the cell of the voxel and side of each point from `begin` to before `end` into `found` [n]; gives how many have
    none, which get -1.

    `points` [n,3] mm, `low` and `size` [3] of the box. Cells stand in `direct` by key, or where that is empty, by halving among
    the `keys` of their block: these begin at `start` [blocks + 1], of 2**shift keys each. `known` and `here` [n]: keys of the
    points before, -1 outside the box, and their cells; they are renewed."""
    listed = direct.size > 0
    for n in independent(begin, end):
        x = _along(points[n, 0], cell, low[0], size[0])
        y = _along(points[n, 1], cell, low[1], size[1])
        z = _along(points[n, 2], cell, low[2], size[2])
        at, key = -1, -1
        if x >= 0 and y >= 0 and z >= 0:
            key = ((x * size[1] + y) * size[2] + z) * 6 + side[n]
            if key == known[n] and here[n] >= 0:
                at = here[n]
            elif listed:
                at = direct[key]
            else:
                a, b = start[key >> shift], start[(key >> shift) + 1]
                while a < b:
                    middle = (a + b) >> 1
                    if keys[middle] < key:
                        a = middle + 1
                    else:
                        b = middle
                if a < keys.size and keys[a] == key:
                    at = a
        known[n], here[n], found[n] = key, at, at
    missed = 0
    for n in range(begin, end):
        missed += 1 if found[n] < 0 else 0
    return missed
