"""Which agents are near enough to touch: every pair once, from cells as wide as two of them.

Method: a uniform grid and half of each cell's surroundings (C. Ericson, Real-Time Collision Detection, 2005, 7.1), one grid for
agents of much the same size, whom all smaller ones ask as well. Where agents lie in a heap, each is paired with a bounded number
of those in reach, so that many in one place cost no more than as many side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, consecutive, fetch_ahead, independent, kernel
from antdsl.numerics.parallel import plain
from antdsl.numerics.sorting import listed, stable_order

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Bounds = list[tuple[float, float]]
Cells = tuple[list[int], list[float], float, list[int]]
Column = Array1[F64]
Indices = Array1[I64]
Counts = Array1[I32]

_MOST = 48  # of one row of three cells, with whom an agent is paired: more than stand side by side in it
_ALONG = 1 << 20  # cells along an axis at most
_SHEET = 8  # pairs of cell mates for each agent, up to which layers above each other are not told apart
_ONE_LAYER = 3  # cells along the shortest axis where all lie in one layer: one is free at either end
_ANY = 1 << 62  # more than there are pairs of cell mates
_SIZES = 1  # powers of two that agents of one grid differ by at most
_TOGETHER = 64  # agents whose candidates are listed before these are measured
_FETCHED = 40  # agents whose places among the sorted ones are brought near before they are written
_WRITTEN = 4  # candidates of a span that are always written


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Rows `i` and `j` of pairs, each once and in no order. `all_of_them`: False where a heap was so dense that some are left
    out."""

    i: Rows
    j: Rows
    all_of_them: bool


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """Whom each agent of a species touches of one species, the deepest first, then by id: those of row r are `ids[starts[r]:
    starts[r + 1]]`. `near`: so deep that a contact may begin."""

    starts: Rows
    ids: NDArray[np.int64]
    near: NDArray[np.bool_]


def within_reach(
    place: tuple[Floats, Floats, Floats], reach: Floats, order: NDArray[np.int64], bounds: Bounds | None = None
) -> Pairs:
    """Pairs of agents that are no farther apart than the sum of their reaches (float64[n], mm). `place`: x, y and z float64[n],
    mm; `order` int64[n], different for all, says who counts first in a heap, whatever the rows. Agents without a finite place
    and reach are in no pair. `bounds`: the least and the greatest x, y, z and reach, where they are known, not finite where any
    of them is not."""
    if not len(reach):
        return Pairs(np.empty(0, np.intp), np.empty(0, np.intp), True)
    rows, bounds = None, _bounds((*place, reach)) if bounds is None else bounds
    if not (all(isfinite(low + high) for low, high in bounds) and bounds[3][0] > 0):
        fit = np.isfinite(place[0]) & np.isfinite(place[1]) & np.isfinite(place[2]) & np.isfinite(reach) & (reach > 0)
        rows = np.flatnonzero(fit)
        place, reach, order = (place[0][rows], place[1][rows], place[2][rows]), reach[rows], order[rows]
        if not len(rows):
            return Pairs(rows, rows, True)
        bounds = _bounds((*place, reach))
    found = _of_all(place, reach, None, bounds)
    if not found.all_of_them:  # who is left out goes by the order, not by rows
        found = _of_all(place, reach, order, bounds)
    if rows is None:
        return found
    return Pairs(rows[found.i], rows[found.j], found.all_of_them)


def _bounds(numbers: Sequence[Floats]) -> Bounds:
    """The least and the greatest of some numbers each."""
    return [(float(each.min()), float(each.max())) for each in numbers]


def _of_all(place: tuple[Floats, Floats, Floats], reach: Floats, order: NDArray[np.int64] | None, bounds: Bounds) -> Pairs:
    low, high = bounds[3]
    if low * (1 << _SIZES) >= high:
        return _of_class(place, reach, order, None, None, bounds)
    sizes = np.frexp(reach)[1] // _SIZES
    found = []
    for size in np.unique(sizes):
        members, smaller = np.flatnonzero(sizes == size), np.flatnonzero(sizes < size)
        own = _bounds([v[members] for v in (*place, reach)])
        found.append(_of_class(place, reach, order, members, smaller if len(smaller) else None, own))
    i, j = (np.concatenate([getattr(each, name) for each in found]) for name in ("i", "j"))
    return Pairs(i, j, all(each.all_of_them for each in found))


def _of_class(
    place: tuple[Floats, Floats, Floats],
    reach: Floats,
    order: NDArray[np.int64] | None,
    rows: Rows | None,
    smaller: Rows | None,
    bounds: Bounds,
) -> Pairs:
    """The pairs among some rows of much the same size (None: all), and of those with all `smaller` ones. `bounds` of places and
    reaches are those of these rows."""
    cells = _cells(bounds[:3], 2 * bounds[3][1])
    if smaller is None:
        found = _by_loop(place, reach, order, rows, cells)
        if found is not None:
            return found
    grid = _Grid.of(place, cells, np.arange(len(reach)) if rows is None else rows, order)
    i, j, whole = grid.among_themselves()
    i, j = _near(place, reach, i, j)
    if smaller is None:
        return Pairs(i, j, whole)
    if order is not None:
        smaller = smaller[stable_order(order[smaller])]
    near, far, entire = grid.asked_by(place, smaller)
    near, far = _near(place, reach, near, far)
    return Pairs(np.concatenate([i, near]), np.concatenate([j, far]), whole and entire)


def _by_loop(
    place: tuple[Floats, Floats, Floats], reach: Floats, order: NDArray[np.int64] | None, rows: Rows | None, cells: Cells
) -> Pairs | None:
    """The pairs among some rows, as `_of_class`; None where there are too many cells for a table."""
    if order is not None:
        rows = stable_order(order) if rows is None else rows[stable_order(order[rows])]
    x, y, z, wide = (v if rows is None else v[rows] for v in (*place, reach))
    sheet = _SHEET * len(wide) if cells[3][2] > _ONE_LAYER else _ANY
    found = _pairs((x, y, z), wide, cells, _limit(len(wide)), sheet, _MOST, order is not None)
    if isinstance(found, tuple):
        i, j, whole = found
        return Pairs(i, j, whole) if rows is None else Pairs(rows.take(i), rows.take(j), whole)
    none = np.empty(0, np.intp)
    return Pairs(none, none, False) if found == -2 else None


def _cells(bounds: Bounds, cell: float) -> Cells:
    """Axes from the longest to the shortest, and along them where cells begin, how wide (mm) and how many they are: about places
    of these bounds along x, y and z, for cells of a width at least."""
    low, extent = [low for low, _ in bounds], [high - low for low, high in bounds]
    axes = sorted(range(3), key=lambda axis: -extent[axis])
    cell = max(cell, extent[axes[0]] / _ALONG, 1e-9)
    size = [int(extent[axis] / cell) + 3 for axis in axes]  # one is free at either end
    return axes, [low[axis] for axis in axes], cell, size


def _limit(agents: int) -> int:
    """How many cells there may be in a table, for so many agents."""
    return max(1 << 16, 16 * agents)


def _near(place: tuple[Floats, Floats, Floats], reach: Floats, i: Rows, j: Rows) -> tuple[Rows, Rows]:
    x, y, z = (p.take(j) - p.take(i) for p in place)
    room = reach.take(i) + reach.take(j)
    keep = np.flatnonzero((x * x + y * y) + z * z <= room * room)
    return i.take(keep), j.take(keep)


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Rows sorted by cells: `low` and `cell` (mm), the `axes` from the longest to the shortest, numbers of cells along them, and
    the cells of all, ascending."""

    axes: list[int]
    low: list[float]
    cell: float
    size: list[int]
    rows: Rows
    keys: NDArray[np.int64]
    starts: NDArray[np.intp] | None

    @staticmethod
    def of(place: tuple[Floats, Floats, Floats], cells: Cells, rows: Rows, order: NDArray[np.int64] | None) -> _Grid:
        """The grid of some rows, of which those in one cell are in an order."""
        if order is not None:
            rows = rows[stable_order(order[rows])]
        every = len(rows) == len(place[0]) and order is None
        own = [p if every else p[rows] for p in place]
        axes, low, cell, size = cells[0], cells[1], cells[2], list(cells[3])
        number = [((own[axis] - b) * (1 / cell)).astype(np.int64) + 1 for axis, b in zip(axes, low, strict=True)]
        keys = number[1] * size[0] + number[0]
        flat = size[2] == _ONE_LAYER
        if not flat and size[0] * size[1] <= _limit(len(rows)):
            mates = np.bincount(keys)
            flat = int((mates * mates).sum()) <= _SHEET * len(rows)
        if flat:
            size[2] = 1
        else:
            keys += number[2] * (size[0] * size[1])
        order_of_keys = stable_order(keys)
        keys, rows = keys.take(order_of_keys), rows.take(order_of_keys)
        count = size[0] * size[1] * size[2]
        starts = None
        if count <= _limit(len(rows)):
            starts = np.zeros(count + 1, np.intp)
            np.cumsum(np.bincount(keys, minlength=count), out=starts[1:])
        return _Grid(axes, low, cell, size, rows, keys, starts)

    def among_themselves(self) -> tuple[Rows, Rows, bool]:
        """Candidates: each with those after it in its cell and in the half of the surroundings that comes after."""
        n, across, layer = len(self.rows), self.size[0], self.size[0] * self.size[1]
        number = np.arange(n)
        spans = [(number + 1, self._before(self.keys + 2))]
        shifts = [across] if self.size[2] == 1 else [across, layer - across, layer, layer + across]
        spans += [(self._before(self.keys + (shift - 1)), self._before(self.keys + (shift + 2))) for shift in shifts]
        return self._listed(self.rows, spans)

    def asked_by(self, place: tuple[Floats, Floats, Floats], rows: Rows) -> tuple[Rows, Rows, bool]:
        """Candidates of others: all in the cells about them."""
        at = [
            np.clip(np.floor((place[axis][rows] - low) * (1 / self.cell)), -2.0, float(size)).astype(np.int64) + 1
            for axis, low, size in zip(self.axes, self.low, self.size, strict=True)
        ]
        inside = [(a >= 0) & (a < size) for a, size in zip(at, self.size, strict=True)]
        flat = self.size[2] == 1
        known = inside[0] & inside[1] if flat else inside[0] & inside[1] & inside[2]
        rows, at = rows[known], [a[known] for a in at]
        spans = []
        for deep in (0,) if flat else (-1, 0, 1):
            for aside in (-1, 0, 1):
                y, z = at[1] + aside, 0 if flat else at[2] + deep
                first = (z * self.size[1] + y) * self.size[0]
                last = first + np.minimum(at[0] + 1, self.size[0] - 1) + 1
                first = first + np.maximum(at[0] - 1, 0)
                there = (y >= 0) & (y < self.size[1]) & ((z >= 0) & (z < self.size[2]))
                spans.append((self._before(np.where(there, first, 0)), self._before(np.where(there, last, 0))))
        return self._listed(rows, spans)

    def _before(self, key: NDArray[Any]) -> Rows:
        """How many rows lie in cells before others."""
        if self.starts is not None:
            known: Rows = self.starts.take(np.minimum(key, len(self.starts) - 1))
            return known
        found: Rows = np.searchsorted(self.keys, key)
        return found

    def _listed(self, asking: Rows, spans: list[tuple[Rows, Rows]]) -> tuple[Rows, Rows, bool]:
        """Pairs of who asks and who is in its spans of sorted rows: of one span at most _MOST, from another place on for each."""
        i, j, whole = [], [], True
        for first, last in spans:
            count = last - first
            dense = int(count.max(initial=0)) > _MOST
            kept = np.minimum(count, _MOST) if dense else count
            who = np.repeat(np.arange(len(asking)), kept)
            at = np.arange(len(who)) - np.repeat(np.cumsum(kept) - kept, kept)
            if dense:
                whole = False
                turned = (np.arange(len(asking)) * _MOST) % np.maximum(count, 1)
                at = np.where(count.take(who) > _MOST, (at + turned.take(who)) % count.take(who), at)
            at += first.take(who)
            i.append(asking.take(who))
            j.append(self.rows.take(at))
        return np.concatenate(i), np.concatenate(j), whole


def _pairs(
    place: tuple[Floats, Floats, Floats], reach: Floats, cells: Cells, limit: int, sheet: int, most: int, heaps: bool
) -> tuple[Rows, Rows, bool] | int:
    """Pairs of agents no farther apart than their reaches add up to. `cells` as of `touching`: axes from the longest to the
    shortest, and along them where they begin and how wide (mm) and how many they are. Layers above each other are not told apart
    up to `sheet` pairs of cell mates. What comes last is whether these are all. Instead -1 where there are more than `limit`
    cells, and where there are more than `most` agents in three cells in a row -2, unless `heaps` are to be met in part, as
    `_Grid` does, of agents in the order in which they count."""
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
    work = Candidates(*np.empty((3, _TOGETHER * spans * most + _WRITTEN), np.int32))
    in_cells = InCells(ordered, rows, cell_of, counts)
    used, most_pairs = -3, 2 * count + 256
    while used == -3:
        i, j = np.empty((2, most_pairs), np.int64)
        used, left_out = _filled(in_cells, size[0], layer, spans, most, heaps, work, i, j)
        most_pairs *= 4
    return used if used < 0 else (i[:used], j[:used], not left_out)


@kernel
def _in_columns(
    fast: Column, middle: Column, first: F64, second: F64, rate: F64, across: I64, keys: Counts, counts: Counts
) -> I64:
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
def _in_layers(slow: Column, low: F64, rate: F64, layer: I64, keys: Counts, counts: Counts) -> None:
    """The cell of each agent, from that in its layer, and how many are in each."""
    for k in range(slow.size):
        at = keys[k] + (np.int64((slow[k] - low) * rate) + 1) * layer
        keys[k] = at
        counts[at] += 1


@kernel
def _sorted(
    keys: Counts, counts: Counts, x: Column, y: Column, z: Column, reach: Column, rows: Counts, cell_of: Counts,
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


class InCells(NamedTuple):
    """Places and reaches in the order of cells, their rows and cells, and where the agents of each cell begin."""

    ordered: Column
    rows: Counts
    cell_of: Counts
    starts: Counts


class Candidates(NamedTuple):
    """Memory for work: pairs of some agents, listed without a branch that is hard to foretell, and who is `near`."""

    one: Counts
    other: Counts
    near: Counts


@kernel
def _filled(
    cells: InCells, across: I64, layer: I64, spans: I64, most: I64, heaps: BOOL, work: Candidates, i: Indices, j: Indices
) -> tuple[I64, I64]:
    """Fill `i` and `j` with pairs and give how many there are (-3 where these are too short, -2 as `_pairs`) and in how many
    spans some are left out."""
    ordered, rows, cell_of, starts = cells
    one, other, near = work
    used, last_cell, count, left_out = 0, starts.size - 1, rows.size, 0
    for begin in range(0, count, _TOGETHER):
        candidates = 0
        for at in range(begin, min(begin + _TOGETHER, count)):
            key = cell_of[at]
            for span in range(spans):
                first, last = at + 1, starts[min(key + 2, last_cell)]
                if span > 0:
                    shift = across if span == 1 else layer + (span - 3) * across
                    first, last = starts[min(key + shift - 1, last_cell)], starts[min(key + shift + 2, last_cell)]
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
