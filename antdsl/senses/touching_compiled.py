"""Agents near enough to touch by one loop over cells: the same pairs as `touching` finds with NumPy, in another order."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, kernel
from antdsl.numerics.compiled import plain

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Column, Indices = Array1[F64], Array1[I64]


def pairs(
    place: tuple[Floats, Floats, Floats], reach: Floats, cells: tuple[Any, ...], limit: int, sheet: int, most: int
) -> tuple[Rows, Rows] | int:
    """Pairs of agents no farther apart than their reaches add up to. `cells` as of `touching`: axes from the longest to the
    shortest, and along them where they begin and how wide (mm) and how many they are. Layers above each other are not told apart
    up to `sheet` pairs of cell mates for each agent. Instead -1 where there are more than `limit` cells, -2 where there are more
    than `most` agents in three cells in a row."""
    axes, low, cell, size = cells
    count, rate, layer = len(reach), 1 / cell, size[0] * size[1]
    columns = plain(*place, reach)
    fast, middle, slow = (columns[axis] for axis in axes)
    if layer > limit:
        return -1
    keys, counts = np.empty(count, np.int64), np.zeros(layer + 1, np.int64)
    flat = _in_columns(fast, middle, low[0], low[1], rate, size[0], keys, counts) <= sheet * count
    if not flat:
        if layer * size[2] > limit:
            return -1
        counts = np.zeros(layer * size[2] + 1, np.int64)
        _in_layers(slow, low[2], rate, layer, keys, counts)
    starts, rows, ordered = np.empty(len(counts), np.int64), np.empty(count, np.int64), np.empty((count, 4))
    _sorted(keys, counts, *columns, starts, rows, ordered)
    used, most_pairs = -3, 2 * count + 256
    while used == -3:
        i, j = np.empty((2, most_pairs), np.int64)
        used, most_pairs = _filled(ordered, rows, keys, starts, size[0], layer, flat, most, i, j), 4 * most_pairs
    return used if used < 0 else (i[:used], j[:used])


@kernel
def _in_columns(
    fast: Column, middle: Column, first: F64, second: F64, rate: F64, across: I64, keys: Indices, counts: Indices
) -> I64:
    """The cell of each agent in a layer, and how many are in each; gives how many pairs of cell mates there are, either way."""
    mates = 0
    for k in range(fast.size):
        a, b = np.int64((fast[k] - first) * rate) + 1, np.int64((middle[k] - second) * rate) + 1
        keys[k] = b * across + a
        mates += 2 * counts[keys[k]] + 1
        counts[keys[k]] += 1
    return mates


@kernel
def _in_layers(slow: Column, low: F64, rate: F64, layer: I64, keys: Indices, counts: Indices) -> None:
    """The cell of each agent, from that in its layer, and how many are in each."""
    for k in range(slow.size):
        keys[k] += (np.int64((slow[k] - low) * rate) + 1) * layer
        counts[keys[k]] += 1


@kernel
def _sorted(
    keys: Indices, counts: Indices, x: Column, y: Column, z: Column, reach: Column, starts: Indices, rows: Indices,
    ordered: Array2[F64],
) -> None:  # fmt: skip
    """Where agents of each cell begin, and rows, places and reaches in this order; `counts` become where they end."""
    total = 0
    for k in range(counts.size):
        starts[k] = total
        total += counts[k]
        counts[k] = starts[k]
    for k in range(keys.size):
        at = counts[keys[k]]
        rows[at], ordered[at, 0], ordered[at, 1], ordered[at, 2], ordered[at, 3] = k, x[k], y[k], z[k], reach[k]
        counts[keys[k]] = at + 1


@kernel
def _filled(
    ordered: Array2[F64], rows: Indices, keys: Indices, starts: Indices, across: I64, layer: I64, flat: BOOL, most: I64,
    i: Indices, j: Indices,
) -> I64:  # fmt: skip
    """Fill `i` and `j` with pairs and give how many there are; -3 where these are too short, -2 as `pairs`."""
    spans, used, cells = 2 if flat else 5, 0, starts.size - 1
    for at in range(rows.size):
        key, x, y, z, far = keys[rows[at]], ordered[at, 0], ordered[at, 1], ordered[at, 2], ordered[at, 3]
        for span in range(spans):
            first, last = at + 1, starts[min(key + 2, cells)]
            if span > 0:
                shift = across if span == 1 else layer + (span - 3) * across
                first, last = starts[min(key + shift - 1, cells)], starts[min(key + shift + 2, cells)]
            if last - first > most:
                return -2
            if used + last - first > i.size:
                return -3
            # Written whatever it is, and written over where it was too far: no branch that is hard to foretell.
            for other in range(first, last):
                ux, uy, uz = ordered[other, 0] - x, ordered[other, 1] - y, ordered[other, 2] - z
                room = far + ordered[other, 3]
                i[used], j[used] = rows[at], rows[other]
                used += (ux * ux + uy * uy) + uz * uz <= room * room
    return used
