"""Agents near enough to touch: every pair once, from cells as wide as two agents.

Method: a uniform grid and half of each cell's surroundings (C. Ericson, Real-Time Collision Detection, 2005, 7.1). There is one
grid for agents of similar size; all smaller agents query it as well. In a dense cluster, each agent is paired with a bounded
number of those in reach. Thus many agents at one position cost no more than as many next to each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import fetch_ahead, independent, kernel, load_consecutive, nearest_integer
from antdsl.machine_code.kernels.types import BOOL, F64, I32, I64, Array1, Array2
from antdsl.numerics.parallel import contiguous
from antdsl.numerics.sorting import compact_indices, stable_order
from antdsl.senses.cell_order import (
    NO_ORDER,
    SHARES,
    SPARE,
    Sizes,
    accumulate_counts,
    agents_before,
    count_cells,
    position_of,
    reorder_axes,
)
from antdsl.senses.cell_order import Three as Corner

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Three = tuple[Floats, Floats, Floats]
Columns = tuple[Array1[F64], Array1[F64], Array1[F64]]
Bounds = list[tuple[float, float]]
# Places and reaches by fours, rows, and cells
Agents = tuple[Array1[F64], Array1[I32], Array1[I64]]
CandidateBuffers = tuple[Array1[I32], Array1[I32], Array1[I32]]

_MOST = 48  # agents of one row of three cells that an agent is paired with: more than fit next to each other in it
_ALONG = 1 << 20  # cells along an axis at most
_SHEET = 8  # pairs of cell mates for each agent, up to which layers above each other are not separated
_ONE_LAYER = 3  # cells along the shortest axis where all lie in one layer: one is free at either end
_TOGETHER = 64  # agents of which the candidates are listed before they are measured
_FETCHED = 40  # agents of which the positions are prefetched before they are written
_WRITTEN = 4  # candidates of a span that are always written


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Rows `i` and `j` of pairs, each once and in no order. `all_of_them`: False if a dense cluster led to omitted pairs."""

    i: Rows
    j: Rows
    all_of_them: bool


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """The agents of one species that each agent of a species touches, the deepest first, then by id. Those of row r are
    `ids[starts[r]:starts[r + 1]]`. `near`: deep enough that a contact may begin."""

    starts: Rows
    ids: NDArray[np.int64]
    near: NDArray[np.bool_]


def find_touching(place: Three, reach: Floats, order: NDArray[np.int64], bounds: Bounds | None = None) -> Pairs:
    """Return pairs of agents that are no farther apart than the sum of their reaches (float64[n], mm). `place`: x, y and z
    float64[n], mm. `order` int64[n], all different: which agents count first in a dense cluster, whatever the rows. Agents
    without a finite position and reach are in no pair. `bounds`: the least and the greatest x, y, z and reach, if known; not
    finite if any of them is not."""
    pairs = find_all_touching(place, reach, bounds)
    if pairs is None:
        pairs = _pairs_within_reach(place, reach, order, bounds, True)
    assert pairs is not None
    return pairs


def find_all_touching(place: Three, reach: Floats, bounds: Bounds | None = None) -> Pairs | None:
    """As `find_touching`, but return None unless all pairs are listed."""
    return _pairs_within_reach(place, reach, NO_ORDER, bounds, False)


def _pairs_within_reach(
    place: Three, reach: Floats, order: NDArray[np.int64], bounds: Bounds | None, heaps: bool
) -> Pairs | None:
    """Return pairs of all agents; None if there are dense clusters and `heaps` does not allow to leave out pairs."""
    rows, (x, y, z, reach) = NO_ORDER, contiguous(*place, reach)
    place = x, y, z
    if bounds is None and len(reach):
        bounds = _find_bounds((*place, reach))
    if bounds is None or not (all(isfinite(low + high) for low, high in bounds) and bounds[3][0] > 0):
        fit = np.isfinite(place[0]) & np.isfinite(place[1]) & np.isfinite(place[2]) & np.isfinite(reach) & (reach > 0)
        rows = np.flatnonzero(fit)
        if not len(rows):
            return Pairs(rows, rows, True)
        bounds = _find_bounds((*place, reach), rows)
    if heaps:  # who is left out goes by the order, not by rows
        rows = rows[stable_order(order[rows])] if rows.size else stable_order(order)
    return _pairs_among(place, reach, rows, bounds, heaps)


def _find_bounds(numbers: Sequence[Floats], rows: Rows = NO_ORDER) -> Bounds:
    """Return the least and the greatest value of each array, over some rows (none: over all)."""
    return [(float(each.min()), float(each.max())) for each in (n[rows] if rows.size else n for n in numbers)]


def _pairs_among(place: Three, reach: Floats, rows: Rows, bounds: Bounds, heaps: bool) -> Pairs | None:
    """Return pairs among rows (none: all) within bounds. Returns None if there are dense clusters and `heaps` is False. In a
    dense cluster the first rows count first."""
    low, high = bounds[3]
    if 2 * low >= high:
        return _join_pairs([_Grid.of(place, reach, rows, bounds).own_pairs(heaps)])
    rows = rows if rows.size else np.arange(len(reach))
    sizes, pair_lists = np.frexp(reach[rows])[1], []
    for size in np.unique(sizes):
        members, smaller = rows[sizes == size], rows[sizes < size]
        grid = _Grid.of(place, reach, members, _find_bounds((*place, reach), members))
        pair_lists += [grid.own_pairs(heaps)] + ([grid.pairs_with(place, reach, smaller, heaps)] if smaller.size else [])
        if None in pair_lists:
            return None
    return _join_pairs(pair_lists)


def _join_pairs(pair_lists: Sequence[Pairs | None]) -> Pairs | None:
    parts = [each for each in pair_lists if each is not None]
    if len(parts) < len(pair_lists) or len(parts) == 1:
        return pair_lists[0] if len(parts) == 1 else None
    i, j = (np.concatenate([getattr(each, name) for each in parts]) for name in ("i", "j"))
    return Pairs(i, j, all(each.all_of_them for each in parts))


class _Grid(NamedTuple):
    """Agents of similar size in the order of their cells, with one free cell at either end of each axis. `axes`: from the longest
    to the shortest. Along them: low corners (mm), cells per millimetre, and numbers of cells, 1 if layers are not separated.
    `agents`: as in kernels. `starts`: the first agent of each cell, empty if there are too many for a table."""

    axes: tuple[int, ...]
    low: tuple[float, ...]
    rate: float
    size: tuple[int, int, int]
    agents: tuple[Floats, NDArray[np.int32], NDArray[np.int64]]
    starts: NDArray[np.int32]

    @staticmethod
    def of(place: Three, reach: Floats, rows: Rows, bounds: Bounds) -> _Grid:
        """That of rows (none: all) within bounds."""
        low, extent = [low for low, _ in bounds[:3]], [high - low for low, high in bounds[:3]]
        axes = tuple(sorted(range(3), key=lambda axis: -extent[axis]))
        cell = max(2 * bounds[3][1], extent[axes[0]] / _ALONG, 1e-9)
        across, broad, depth = (int(extent[axis] / cell) + 3 for axis in axes)
        count = rows.size or reach.size
        agents = np.empty(4 * count), np.empty(count, np.int32), np.empty(count, np.int64)
        start = tuple(low[axis] for axis in axes)
        grid = _Grid(axes, start, 1 / cell, (across, broad, 1), agents, np.empty(0, np.int32))
        most, flat, keys = max(1 << 16, 16 * count), depth == _ONE_LAYER, np.empty(count, np.int64)
        counts, mates = grid._count_agents(place, rows, keys, most)
        if not (flat or (counts.size and mates <= _SHEET * count)):
            grid = grid._replace(size=(across, broad, depth))
            counts, _ = grid._count_agents(place, rows, keys, most)
        if counts.size:
            accumulate_counts(counts, grid.cell_count)
        else:
            order = stable_order(keys)
            keys, rows = keys.take(order), rows.take(order) if rows.size else order
        _store_agents(place, reach, rows, keys, counts, *agents)
        return grid._replace(starts=counts[0])

    @property
    def cell_count(self) -> int:
        return self.size[0] * self.size[1] * self.size[2]

    def _cell_numbering(self) -> tuple[Any, ...]:
        """Return what kernels need to number cells: low corners, cells per millimetre, sizes, and the index of the first cell in
        use."""
        across, broad, depth = self.size
        first, rate = (broad + 1) * across + 1 if depth > 1 else across + 1, self.rate
        return self.low, (rate, rate, rate if depth > 1 else 0.0), self.size, first

    def _count_agents(self, place: Three, rows: Rows, keys: NDArray[np.int64], most: int) -> tuple[NDArray[np.int32], int]:
        """Store the cells of rows. Returns a table of the number of rows in each, empty if there are more than `most` cells, and
        the number of pairs that share one."""
        counts = np.empty((1, self.cell_count + SPARE if self.cell_count <= most else 0), np.int32)
        return counts, _count_cells(reorder_axes(self.axes, place), *self._cell_numbering(), rows, keys, counts, 0, SHARES)

    def own_pairs(self, heaps: bool) -> Pairs | None:
        """Return the pairs among the grid's agents: each agent with later ones in its cell, and with those in the later half of
        its neighbour cells."""
        across, layer = self.size[0], self.size[0] * self.size[1]
        return self._find_pairs(self.agents, [0, across, layer - across, layer, layer + across], True, heaps)

    def pairs_with(self, place: Three, reach: Floats, rows: Rows, heaps: bool) -> Pairs | None:
        """Return the pairs of other rows with the grid's agents: each row with all agents in its cell and the neighbour cells."""
        across, layer = self.size[0], self.size[0] * self.size[1]
        around = [depth * layer + aside * across for depth in (0, -1, 1) for aside in (-1, 0, 1)]
        positions, own, keys = np.empty(4 * rows.size), np.empty(rows.size, np.int32), np.empty(rows.size, np.int64)
        used = _store_queries(place, reorder_axes(self.axes, place), reach, *self._cell_numbering(), rows, positions, own, keys)
        return self._find_pairs((positions, own[:used], keys), around, False, heaps)

    def _find_pairs(
        self, asking: tuple[Floats, NDArray[np.int32], NDArray[np.int64]], around: list[int], own: bool, heaps: bool
    ) -> Pairs | None:
        """Return the pairs of requesting agents with others in rows of three cells, at the offsets `around` from their own
        cell."""
        if self.size[2] == 1:
            around = around[: 2 if own else 3]
        count, shifts = asking[1].size, np.array(around, np.int64)
        buffers = tuple(np.empty((3, _TOGETHER * len(around) * _MOST + _WRITTEN), np.int32))
        used, most_pairs, left_out = -3, 4 * count + 256, 0
        while used == -3:
            i, j = np.empty((2, most_pairs), np.int64)
            used, left_out = _fill_pairs(
                asking, self.agents, self.starts, self.cell_count, shifts, own, _MOST, heaps, buffers, i, j
            )
            most_pairs *= 4
        return None if used < 0 else Pairs(i[:used], j[:used], not left_out)


@kernel
def _count_cells(
    along: Columns, low: Corner, inverse: Corner, size: Sizes, shift: I64, order: Array1[I64], keys: Array1[I64],
    counts: Array2[I32], begin: I64, end: I64,
) -> I64:  # fmt: skip
    """As `counted`."""
    return count_cells(along, low, inverse, size, shift, order, keys, counts, begin, end)


@kernel
def _store_agents(
    positions: Columns, reach: Array1[F64], order: Array1[I64], keys: Array1[I64], counts: Array2[I32], ordered: Array1[F64],
    rows: Array1[I32], cells: Array1[I64],
) -> None:  # fmt: skip
    """Write x, y, z and reach (in groups of four), the row and the cell of each agent at its position."""
    for k in range(keys.size):
        if counts.shape[1] > 0:
            fetch_ahead(ordered, 4 * counts[0, keys[min(k + _FETCHED, keys.size - 1)] + 1])
        row = order[k] if order.size > 0 else k
        position = position_of(counts, 0, k, keys[k])
        ordered[4 * position], ordered[4 * position + 1] = positions[0][row], positions[1][row]
        ordered[4 * position + 2], ordered[4 * position + 3] = positions[2][row], reach[row]
        rows[position], cells[position] = row, keys[k]


@kernel
def _store_queries(
    positions: Columns, along: Columns, reach: Array1[F64], low: Corner, inverse: Corner, size: Sizes, shift: I64,
    order: Array1[I64], asking: Array1[F64], rows: Array1[I32], cells: Array1[I64],
) -> I64:  # fmt: skip
    """List the rows that are at most one cell away from cells in use; return their number."""
    used = 0
    for k in range(order.size):
        row = order[k]
        a, b = np.floor((along[0][row] - low[0]) * inverse[0]), np.floor((along[1][row] - low[1]) * inverse[1])
        c = np.floor((along[2][row] - low[2]) * inverse[2])
        if not (a >= -1.0 and b >= -1.0 and c >= -1.0):
            continue
        if not (a <= np.float64(size[0] - 2) and b <= np.float64(size[1] - 2) and c <= np.float64(max(size[2] - 2, 0))):
            continue
        asking[4 * used], asking[4 * used + 1] = positions[0][row], positions[1][row]
        asking[4 * used + 2], asking[4 * used + 3] = positions[2][row], reach[row]
        rows[used], cells[used] = row, (nearest_integer(c) * size[1] + nearest_integer(b)) * size[0] + nearest_integer(a) + shift
        used += 1
    return used


@kernel
def _fill_pairs(
    asking: Agents, agents: Agents, starts: Array1[I32], cells: I64, shifts: Array1[I64], own: BOOL, most: I64, heaps: BOOL,
    buffers: CandidateBuffers, i: Array1[I64], j: Array1[I64],
) -> tuple[I64, I64]:  # fmt: skip
    """Fill `i` and `j` with pairs. Returns their number, and in how many spans some are left out.

    Instead of the number: -3 if `i` and `j` are too short; -2 if three cells in a row have more than `most` agents, and `heaps`
    does not allow to leave out pairs. `shifts`: offsets of the middle of three cells from the agent's own cell. `own`: pairs only
    with later agents, first in the agent's own cell. `buffers`: buffers for candidates, listed without an unpredictable branch,
    and for those that are near."""
    (asks, asking_rows, asking_keys), (ordered, rows, keys), (one, other, near) = asking, agents, buffers
    used, count, left_out = 0, asking_rows.size, 0
    for begin in range(0, count, _TOGETHER):
        candidates = 0
        for at in range(begin, min(begin + _TOGETHER, count)):
            middle = asking_keys[at]
            for span in range(shifts.size):
                key = middle + shifts[span]
                last = agents_before(starts, keys, min(max(key + 2, 0), cells))
                if own and span == 0:
                    first = at + 1
                else:
                    first = agents_before(starts, keys, min(max(key - 1, 0), cells))
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
            (x, y, z, wide), (u, v, w, far) = load_consecutive(asks, 4 * p, 4), load_consecutive(ordered, 4 * q, 4)
            x, y, z, reach = u - x, v - y, w - z, wide + far
            near[n] = 1 if (x * x + y * y) + z * z <= reach * reach else 0
        near_count = compact_indices(near, candidates)
        if used + near_count > i.size:
            return -3, 0
        for n in range(near_count):
            i[used + n], j[used + n] = asking_rows[one[near[n]]], rows[other[near[n]]]
        used += near_count
    return used, left_out
