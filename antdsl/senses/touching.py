"""Which agents are near enough to touch: every pair once, from cells as wide as two of them.

Method: a uniform grid and half of each cell's surroundings (C. Ericson, Real-Time Collision Detection, 2005, 7.1), one grid for
agents of much the same size, whom all smaller ones ask as well. Where agents lie in a heap, each is paired with a bounded number
of those in reach, so that many in one place cost no more than as many side by side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics.sorting import stable_order

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Bounds = list[tuple[float, float]]
Cells = tuple[list[int], list[float], float, list[int]]

_MOST = 48  # of one row of three cells, with whom an agent is paired: more than stand side by side in it
_ALONG = 1 << 20  # cells along an axis at most
_SHEET = 8  # pairs of cell mates for each agent, up to which layers above each other are not told apart
_ONE_LAYER = 3  # cells along the shortest axis where all lie in one layer: one is free at either end
_ANY = 1 << 62  # more than there are pairs of cell mates
_SIZES = 1  # powers of two that agents of one grid differ by at most


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
    if smaller is None and compiled.wanted(len(reach) if rows is None else len(rows)):
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
    from antdsl.senses.touching_compiled import pairs

    if order is not None:
        rows = stable_order(order) if rows is None else rows[stable_order(order[rows])]
    x, y, z, wide = (v if rows is None else v[rows] for v in (*place, reach))
    sheet = _SHEET * len(wide) if cells[3][2] > _ONE_LAYER else _ANY
    found = pairs((x, y, z), wide, cells, _limit(len(wide)), sheet, _MOST, order is not None)
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
