"""The cell of each agent as one pass: as `cells` finds it, the same bits. Imported only where `compiled.wanted` says so."""

import numpy as np

from antdsl.machine_code.kernels import F64, I8, I32, I64, Array1, Strided2, independent, inlined, kernel, scratch

_PART = 512  # points, whose keys are worked out before they are looked up


@inlined
def _along(place, cell, low):  # type: ignore[no-untyped-def]
    """The number of a voxel along one axis of the box, as float64."""
    return np.floor(place / cell + 0.5) - np.float64(low)


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
) -> int:
    """Write the cell of the voxel and side of each point into `found` [n]; gives how many have none, which get -1.

    `points` [n,3] mm, `low` and `size` [3] of the box. Cells stand in `direct` by key, or where that is empty, by halving among
    the `keys` of their block: these begin at `start` [blocks + 1], of 2**shift keys each. `known` and `here` [n]: keys of the
    points before, -1 outside the box, and their cells; they are renewed."""
    missed, listed, count = 0, direct.size > 0, found.size
    x, y, z, others = scratch(_PART, F64), scratch(_PART, F64), scratch(_PART, F64), scratch(_PART, I64)
    wide, deep, tall = np.float64(size[0]), np.float64(size[1]), np.float64(size[2])
    for begin in range(0, count, 512):
        end = min(begin + _PART, count)
        for n in independent(begin, end):
            x[n - begin] = _along(points[n, 0], cell, low[0])
            y[n - begin] = _along(points[n, 1], cell, low[1])
            z[n - begin] = _along(points[n, 2], cell, low[2])
        changed = 0
        for n in range(begin, end):
            i, j, k = x[n - begin], y[n - begin], z[n - begin]
            inside = i >= 0.0 and i < wide and j >= 0.0 and j < deep and k >= 0.0 and k < tall
            key = ((np.int64(i) * size[1] + np.int64(j)) * size[2] + np.int64(k)) * 6 + side[n]
            key = key if inside else -1
            others[changed] = n  # written over where it has the key of before: no branch that is hard to foretell
            changed += 1 if key != known[n] or (key >= 0 and here[n] < 0) else 0
            known[n] = key
        for m in range(changed):
            n = others[m]
            at, key = -1, known[n]
            if key >= 0:
                if listed:
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
            here[n] = at
        for n in range(begin, end):
            found[n] = here[n]
            missed += 1 if here[n] < 0 else 0
    return missed
