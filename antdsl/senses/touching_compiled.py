"""Agents near enough to touch by one loop over cells: the same pairs as `touching` finds with NumPy, in another order."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, consecutive, fetch_ahead, independent, kernel
from antdsl.numerics.compiled import plain
from antdsl.numerics.sorting_compiled import listed

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Column: TypeAlias = Array1[F64]
Indices: TypeAlias = Array1[I64]
Cells: TypeAlias = Array1[I32]
_TOGETHER = 64  # agents whose candidates are listed before these are measured
_FETCHED = 40  # agents whose places among the sorted ones are brought near before they are written
_WRITTEN = 4  # candidates of a span that are always written


def pairs(
    place: tuple[Floats, Floats, Floats], reach: Floats, cells: tuple[Any, ...], limit: int, sheet: int, most: int, heaps: bool
) -> tuple[Rows, Rows, bool] | int:
    """Pairs of agents no farther apart than their reaches add up to. `cells` as of `touching`: axes from the longest to the
    shortest, and along them where they begin and how wide (mm) and how many they are. Layers above each other are not told apart
    up to `sheet` pairs of cell mates. What comes last is whether these are all. Instead -1 where there are more than `limit`
    cells, and where there are more than `most` agents in three cells in a row -2, unless `heaps` are to be met in part, as
    `touching._Grid` does, of agents in the order in which they count."""
    axes, low, cell, size = cells
    count, rate, layer = len(reach), 1 / cell, size[0] * size[1]
    columns = plain(*place, reach)
    fast, middle, slow = (columns[axis] for axis in axes)
    if layer > limit:
        return -1
    keys, counts = np.empty(count, np.int32), np.zeros(layer + 1, np.int32)
    flat = _in_columns(fast, middle, low[0], low[1], rate, size[0], keys, counts) <= sheet
    if not flat:
        if layer * size[2] > limit:
            return -1
        counts = np.zeros(layer * size[2] + 1, np.int32)
        _in_layers(slow, low[2], rate, layer, keys, counts)
    ordered, rows, cell_of = np.empty(4 * count), *np.empty((2, count), np.int32)
    _sorted(keys, counts, *columns, rows, cell_of, ordered)
    spans = 2 if flat else 5
    room = np.empty((3, _TOGETHER * spans * most + _WRITTEN), np.int32)
    used, most_pairs = -3, 2 * count + 256
    while used == -3:
        i, j = np.empty((2, most_pairs), np.int64)
        used, left_out = _filled(ordered, rows, cell_of, counts, size[0], layer, spans, most, heaps, *room, i, j)
        most_pairs *= 4
    return used if used < 0 else (i[:used], j[:used], not left_out)


@kernel
def _in_columns(fast: Column, middle: Column, first: F64, second: F64, rate: F64, across: I64, keys: Cells, counts: Cells) -> I64:
    """The cell of each agent in a layer, and how many are in each; gives how many pairs of cell mates there are, either way."""
    mates = 0
    for k in range(fast.size):
        a, b = np.int64((fast[k] - first) * rate) + 1, np.int64((middle[k] - second) * rate) + 1
        at = b * across + a
        keys[k] = at
        mates += 2 * counts[at] + 1
        counts[at] += 1
    return mates


@kernel
def _in_layers(slow: Column, low: F64, rate: F64, layer: I64, keys: Cells, counts: Cells) -> None:
    """The cell of each agent, from that in its layer, and how many are in each."""
    for k in range(slow.size):
        at = keys[k] + (np.int64((slow[k] - low) * rate) + 1) * layer
        keys[k] = at
        counts[at] += 1


@kernel
def _sorted(
    keys: Cells, counts: Cells, x: Column, y: Column, z: Column, reach: Column, rows: Cells, cell_of: Cells,
    ordered: Column,
) -> None:  # fmt: skip
    """Rows by their cells, and in this order the cells, places and reaches; `counts` become where the agents of each cell begin,
    which is where those of the one before end."""
    total = 0
    for k in range(counts.size):
        count = counts[k]
        counts[k] = total
        total += count
    for k in range(keys.size):
        fetch_ahead(ordered, 4 * counts[keys[min(k + _FETCHED, keys.size - 1)]])
        key = keys[k]
        at = counts[key]
        rows[at], cell_of[at] = k, key
        ordered[4 * at], ordered[4 * at + 1], ordered[4 * at + 2], ordered[4 * at + 3] = x[k], y[k], z[k], reach[k]
        counts[key] = at + 1
    for k in range(counts.size - 1, 0, -1):
        counts[k] = counts[k - 1]
    counts[0] = 0


@kernel
def _filled(
    ordered: Column, rows: Cells, cell_of: Cells, starts: Cells, across: I64, layer: I64, spans: I64, most: I64, heaps: BOOL,
    one: Cells, other: Cells, near: Cells, i: Indices, j: Indices,
) -> tuple[I64, I64]:  # fmt: skip
    """Fill `i` and `j` with pairs and give how many there are (-3 where these are too short, -2 as `pairs`) and in how many spans
    some are left out. `one` and `other` are room for work: candidates of some agents, listed without a branch that is hard to
    foretell, and who is `near`."""
    used, cells, count, left_out = 0, starts.size - 1, rows.size, 0
    for begin in range(0, count, _TOGETHER):
        candidates = 0
        for at in range(begin, min(begin + _TOGETHER, count)):
            key = cell_of[at]
            for span in range(spans):
                first, last = at + 1, starts[min(key + 2, cells)]
                if span > 0:
                    shift = across if span == 1 else layer + (span - 3) * across
                    first, last = starts[min(key + shift - 1, cells)], starts[min(key + shift + 2, cells)]
                if last - first > most:
                    if not heaps:
                        return -2, 0
                    left_out += 1
                    turned = (at * most) % (last - first)
                    for k in range(most):
                        one[candidates + k], other[candidates + k] = at, first + (k + turned) % (last - first)
                    candidates += most
                    continue
                for k in range(4):  # written whatever it is, and written over where these were fewer
                    one[candidates + k], other[candidates + k] = at, first + k
                for k in range(4, last - first):
                    one[candidates + k], other[candidates + k] = at, first + k
                candidates += last - first
        for n in independent(0, candidates):
            p, q = one[n], other[n]
            (x, y, z, wide), (u, v, w, far) = consecutive(ordered, 4 * p, 4), consecutive(ordered, 4 * q, 4)
            x, y, z, room = u - x, v - y, w - z, wide + far
            near[n] = 1 if (x * x + y * y) + z * z <= room * room else 0
        found = listed(near, candidates)
        if used + found > i.size:
            return -3, 0
        for n in range(found):
            i[used + n], j[used + n] = rows[one[near[n]]], rows[other[near[n]]]
        used += found
    return used, left_out
