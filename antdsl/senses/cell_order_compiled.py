"""Agents by their cells in loops: the same bits in the same order as `cell_order` finds with NumPy."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, independent, inlined, kernel

Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]


@kernel
def box(x: Array1[F32], y: Array1[F32], z: Array1[F32], ids: Array1[I64], ends: Array2[F64]) -> tuple[I64, BOOL]:
    """How many places are finite, whose least and greatest x, y and z are put into `ends` (2, 3), 0 where there are none; and
    whether the ids of all ascend."""
    count, ascending = 0, True
    low_x, low_y, low_z = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
    high_x, high_y, high_z = np.float32(-np.inf), np.float32(-np.inf), np.float32(-np.inf)
    for k in range(x.size):
        if k > 0 and ids[k] < ids[k - 1]:
            ascending = False
        if np.isfinite(x[k]) and np.isfinite(y[k]) and np.isfinite(z[k]):
            count += 1
            low_x, low_y, low_z = min(low_x, x[k]), min(low_y, y[k]), min(low_z, z[k])
            high_x, high_y, high_z = max(high_x, x[k]), max(high_y, y[k]), max(high_z, z[k])
    ends[0, 0], ends[0, 1], ends[0, 2] = np.float64(low_x), np.float64(low_y), np.float64(low_z)
    ends[1, 0], ends[1, 1], ends[1, 2] = np.float64(high_x), np.float64(high_y), np.float64(high_z)
    if count == 0:
        for k in range(3):
            ends[0, k], ends[1, k] = 0.0, 0.0
    return count, ascending


@inlined
def _along(place, low, width):  # type: ignore[no-untyped-def]
    return np.int64(np.floor((np.float64(place) - low) / width))


@kernel
def numbered(
    along: Columns,
    order: Array1[I64],
    low: tuple[F64, F64, F64],
    width: tuple[F64, F64, F64],
    rows: Array1[I64],
    fast: Array1[I64],
    middle: Array1[I64],
    slow: Array1[I64],
) -> None:
    """The `rows` of agents at finite places, in an `order` of all (empty: as they are), and the numbers of their cells along the
    three axes."""
    count = 0
    for k in range(along[0].size):
        row = order[k] if order.size > 0 else k
        if np.isfinite(along[0][row]) and np.isfinite(along[1][row]) and np.isfinite(along[2][row]):
            rows[count] = row
            count += 1
    for n in independent(0, count):
        own = rows[n]
        fast[n] = _along(along[0][own], low[0], width[0])
        middle[n] = _along(along[1][own], low[1], width[1])
        slow[n] = _along(along[2][own], low[2], width[2])


@kernel
def put(
    rows: Array1[I64],
    fast: Array1[I64],
    middle: Array1[I64],
    slow: Array1[I64],
    across: I64,
    broad: I64,
    order: Array1[I64],
    places: Columns,
    starts: Array1[I32],
    ordered: Array1[I64],
    keys: Array1[I64],
    found: Array2[F32],
) -> None:
    """Put `rows` in the order of their cells, with the keys of these and their places (3, n): by counting how many are in each,
    which fills `starts`, or where there is no room for that as `order` says."""
    n = rows.size
    if starts.size > 0:
        for k in range(n):
            key = (slow[k] * broad + middle[k]) * across + fast[k]
            if key + 2 < starts.size:
                starts[key + 2] += 1
        for k in range(2, starts.size):
            starts[k] += starts[k - 1]
        for k in range(n):  # where a cell begins goes on to where it ends, which is where the next one begins
            key = (slow[k] * broad + middle[k]) * across + fast[k]
            place = starts[key + 1]
            ordered[place], keys[place] = rows[k], key
            starts[key + 1] += 1
    else:
        for k in range(n):
            other = order[k]
            ordered[k], keys[k] = rows[other], (slow[other] * broad + middle[other]) * across + fast[other]
    for at in independent(0, n):
        row = ordered[at]
        found[0, at], found[1, at], found[2, at] = places[0][row], places[1][row], places[2][row]
