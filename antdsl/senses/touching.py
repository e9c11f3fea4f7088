"""Pairs of agents that are near enough to touch. Every pair occurs once; cells are as wide as two agents.

Method: a uniform grid and half of each cell's surroundings (C. Ericson, Real-Time Collision Detection, 2005, 7.1). Agents of
similar size have one grid; all smaller agents query it as well. In a dense cluster, each agent is paired with a bounded number
of the agents in reach. Thus many agents at one position need no more time than as many agents next to each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import fetch_ahead, independent, inlined, kernel, load_consecutive, nearest_integer
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
# Position and reach (four entries per agent), row, and cell of each agent
Agents = tuple[Array1[F64], Array1[I32], Array1[I64]]
CandidateBuffers = tuple[Array1[I32], Array1[I32], Array1[I32]]

_MOST = 48  # most partners of an agent in a span of three cells: more than fit next to each other
_ALONG = 1 << 20  # most cells along an axis
_SHEET = 8  # pairs per agent in the same cell up to which layers are not separated
_ONE_LAYER = 3  # cells along the shortest axis for a single layer; one cell is free at either end
_TOGETHER = 64  # agents with candidates listed before distances are measured
_FETCHED = 40  # number of agents by which prefetches are ahead
_WRITTEN = 4  # number of candidates of a span that are always written


@dataclass(frozen=True, slots=True, eq=False)
class Pairs:
    """Rows `i` and `j` of pairs, each pair once, in no order. `all_of_them`: False if pairs were omitted in a dense cluster."""

    i: Rows
    j: Rows
    all_of_them: bool


@dataclass(frozen=True, slots=True, eq=False)
class Touching:
    """The agents of one species that each agent of a species touches, sorted by penetration depth, the deepest first, then by
    id.

    `ids[starts[r]:starts[r + 1]]`: ids of the agents that row r touches.
    `near`: whether the pair is deep enough for a new contact."""

    starts: Rows
    ids: NDArray[np.int64]
    near: NDArray[np.bool_]


def find_touching(place: Three, reach: Floats, order: NDArray[np.int64], bounds: Bounds | None = None) -> Pairs:
    """Return the pairs of agents at a distance of at most the sum of their reaches (float64[n], mm).

    `place`: x, y and z float64[n], mm. Agents without a finite position and reach are in no pair.
    `order` int64[n], all different: which agents take precedence in a dense cluster, independent of rows.
    `bounds`: the least and the greatest x, y, z and reach, if known. They are not finite if any value is not finite."""
    x, y, z, reach = contiguous(*place, reach)
    rows, bounds = _usable_rows((x, y, z), reach, bounds)
    if bounds is None:
        return Pairs(rows, rows, True)
    rows = rows[stable_order(order[rows])] if rows.size else stable_order(order)  # `order` decides which agents are omitted
    pair_lists = [_find_pairs(search) for search in _searches((x, y, z), reach, rows, bounds, False)]
    if len(pair_lists) == 1:
        return pair_lists[0]
    i, j = (np.concatenate([getattr(each, name) for each in pair_lists]) for name in ("i", "j"))
    return Pairs(i, j, all(each.all_of_them for each in pair_lists))


def neighbour_searches(place: Three, reach: Floats) -> Iterator[Search]:
    """Yield searches that together meet each pair within the sum of both reaches exactly once. Arguments as for
    `find_touching`.

    Sparse crowds get wider cells, so that a table of all cells stays small."""
    x, y, z, reach = contiguous(*place, reach)
    rows, bounds = _usable_rows((x, y, z), reach, None)
    if bounds is not None:
        yield from _searches((x, y, z), reach, rows, bounds, True)


def _usable_rows(place: Three, reach: Floats, bounds: Bounds | None) -> tuple[Rows, Bounds | None]:
    """Return the rows with a finite position and reach (empty: all rows), and their bounds; None if there is no such row."""
    if bounds is None and len(reach):
        bounds = _find_bounds((*place, reach))
    if bounds is not None and all(isfinite(low + high) for low, high in bounds) and bounds[3][0] > 0:
        return NO_ORDER, bounds
    fit = np.isfinite(place[0]) & np.isfinite(place[1]) & np.isfinite(place[2]) & np.isfinite(reach) & (reach > 0)
    rows = np.flatnonzero(fit)
    return rows, _find_bounds((*place, reach), rows) if len(rows) else None


def _find_bounds(numbers: Sequence[Floats], rows: Rows = NO_ORDER) -> Bounds:
    """Return the least and the greatest value of each array, over the given rows (empty: all rows)."""
    return [(float(each.min()), float(each.max())) for each in (n[rows] if rows.size else n for n in numbers)]


def _searches(place: Three, reach: Floats, rows: Rows, bounds: Bounds, widens: bool) -> Iterator[Search]:
    """Yield the searches for pairs among rows (empty: all) within bounds. `widens`: whether sparse grids get wider cells."""
    low, high = bounds[3]
    if 2 * low >= high:
        yield _Grid.of(place, reach, rows, bounds, widens).own_search()
        return
    rows = rows if rows.size else np.arange(len(reach))
    sizes = np.frexp(reach[rows])[1]
    for size in np.unique(sizes):
        members, smaller = rows[sizes == size], rows[sizes < size]
        grid = _Grid.of(place, reach, members, _find_bounds((*place, reach), members), widens)
        yield grid.own_search()
        if smaller.size:
            yield grid.search_for(place, reach, smaller)


def _find_pairs(search: Search) -> Pairs:
    """Return the pairs of a search that are within the sum of their reaches."""
    count = search.asking[1].size
    buffers = tuple(np.empty((3, _TOGETHER * search.shifts.size * _MOST + _WRITTEN), np.int32))
    used, most_pairs, left_out = -1, 4 * count + 256, 0
    while used < 0:
        i, j = np.empty((2, most_pairs), np.int64)
        used, left_out = _fill_pairs(*search, _MOST, buffers, i, j)
        most_pairs *= 4
    return Pairs(i[:used], j[:used], not left_out)


class Search(NamedTuple):
    """The input of a kernel that visits pairs of neighbours.

    `asking`, `agents`: the agents that search, and the agents that can be found. Each: position and reach (four entries per
        agent), row, cell.
    `starts`: the first of `agents` in each cell. `cells`: the number of cells.
    `shifts`: offsets from an agent's own cell to spans of three cells.
    `own`: both are the same agents, and each pair is visited once."""

    asking: Agents
    agents: Agents
    starts: Array1[I32]
    cells: I64
    shifts: Array1[I64]
    own: BOOL


class _Grid(NamedTuple):
    """Agents of similar size in the order of their cells. At either end of each axis, one row of cells is free.

    `axes`: from the longest to the shortest; the following values are in this order.
    `low`: low corner (mm). `rate`: cells per mm. `size`: numbers of cells, 1 if layers are not separated.
    `agents`: position and reach, row, and cell of each agent, as kernels read them.
    `starts`: the first agent of each cell, empty if there are too many cells for a table."""

    axes: tuple[int, ...]
    low: tuple[float, ...]
    rate: float
    size: tuple[int, int, int]
    agents: tuple[Floats, NDArray[np.int32], NDArray[np.int64]]
    starts: NDArray[np.int32]

    @staticmethod
    def of(place: Three, reach: Floats, rows: Rows, bounds: Bounds, widens: bool) -> _Grid:
        """Return the grid of rows (empty: all) within bounds. `widens`: whether cells become wider until a table can hold all
        of them."""
        low, extent = [low for low, _ in bounds[:3]], [high - low for low, high in bounds[:3]]
        axes = tuple(sorted(range(3), key=lambda axis: -extent[axis]))
        cell = max(2 * bounds[3][1], extent[axes[0]] / _ALONG, 1e-9)
        count = rows.size or reach.size
        if widens:
            cell = max(cell, (extent[axes[0]] * extent[axes[1]] / max(1 << 14, 8 * count)) ** 0.5)
        across, broad, depth = (int(extent[axis] / cell) + 3 for axis in axes)
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
        """Return the number of cells."""
        return self.size[0] * self.size[1] * self.size[2]

    def _cell_numbering(self) -> tuple[Any, ...]:
        """Return the inputs of kernels that number cells: low corners, cells per mm, sizes, and the index of the first cell in
        use."""
        across, broad, depth = self.size
        first, rate = (broad + 1) * across + 1 if depth > 1 else across + 1, self.rate
        return self.low, (rate, rate, rate if depth > 1 else 0.0), self.size, first

    def _count_agents(self, place: Three, rows: Rows, keys: NDArray[np.int64], most: int) -> tuple[NDArray[np.int32], int]:
        """Store the cell of each row in `keys`. Return the number of rows per cell as a table, and the number of pairs that
        share a cell.

        The table is empty if there are more than `most` cells."""
        counts = np.empty((1, self.cell_count + SPARE if self.cell_count <= most else 0), np.int32)
        return counts, _count_cells(reorder_axes(self.axes, place), *self._cell_numbering(), rows, keys, counts, 0, SHARES)

    def own_search(self) -> Search:
        """Return the search for pairs among the grid's agents.

        Each agent is paired with later agents of its cell, and with all agents in the later half of the neighbour cells."""
        across, layer = self.size[0], self.size[0] * self.size[1]
        shifts = [0, across, layer - across, layer, layer + across][: 2 if self.size[2] == 1 else 5]
        return Search(self.agents, self.agents, self.starts, self.cell_count, np.array(shifts), True)

    def search_for(self, place: Three, reach: Floats, rows: Rows) -> Search:
        """Return the search for pairs of other rows with the grid's agents. Each row is paired with all agents in and around
        its cell."""
        across, layer = self.size[0], self.size[0] * self.size[1]
        shifts = [depth * layer + aside * across for depth in (0, -1, 1) for aside in (-1, 0, 1)][: 3 if self.size[2] == 1 else 9]
        positions, own, keys = np.empty(4 * rows.size), np.empty(rows.size, np.int32), np.empty(rows.size, np.int64)
        used = _store_queries(place, reorder_axes(self.axes, place), reach, *self._cell_numbering(), rows, positions, own, keys)
        return Search((positions, own[:used], keys), self.agents, self.starts, self.cell_count, np.array(shifts), False)


@kernel
def _count_cells(
    along: Columns, low: Corner, inverse: Corner, size: Sizes, shift: I64, order: Array1[I64], keys: Array1[I64],
    counts: Array2[I32], begin: I64, end: I64,
) -> I64:  # fmt: skip
    """Store and count cells as `cell_order.count_cells` does, with float64 positions."""
    return count_cells(along, low, inverse, size, shift, order, keys, counts, begin, end)


@kernel
def _store_agents(
    positions: Columns, reach: Array1[F64], order: Array1[I64], keys: Array1[I64], counts: Array2[I32], ordered: Array1[F64],
    rows: Array1[I32], cells: Array1[I64],
) -> None:  # fmt: skip
    """Write position and reach (four entries per agent), row and cell of each agent at its position in the order."""
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
    """Write the rows that are at most one cell away from used cells; return their number."""
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


@inlined
def span_start(agents: Agents, starts: Array1[I32], cells: I64, own: BOOL, at: I64, span: I64, key: I64) -> I64:
    """Return the position of the first agent in the three cells around cell `key`, for the agent at position `at`."""
    return at + 1 if own and span == 0 else agents_before(starts, agents[2], min(max(key - 1, 0), cells))


@inlined
def span_end(agents: Agents, starts: Array1[I32], cells: I64, key: I64) -> I64:
    """Return the position after the last agent in the three cells around cell `key`."""
    return agents_before(starts, agents[2], min(max(key + 2, 0), cells))


@kernel
def _fill_pairs(
    asking: Agents, agents: Agents, starts: Array1[I32], cells: I64, shifts: Array1[I64], own: BOOL, most: I64,
    buffers: CandidateBuffers, i: Array1[I64], j: Array1[I64],
) -> tuple[I64, I64]:  # fmt: skip
    """Write pairs into `i` and `j`. Return their number (-1 if the arrays are too short), and how many spans have omitted
    pairs.

    An agent is paired with at most `most` agents of a span. `buffers`: work memory for candidates and for those in reach."""
    (asks, asking_rows, asking_keys), (ordered, rows, _), (one, other, near) = asking, agents, buffers
    used, count, left_out = 0, asking_rows.size, 0
    for begin in range(0, count, _TOGETHER):
        candidates = 0
        for at in range(begin, min(begin + _TOGETHER, count)):
            for span in range(shifts.size):
                key = asking_keys[at] + shifts[span]
                last = span_end(agents, starts, cells, key)
                first = span_start(agents, starts, cells, own, at, span, key)
                if last - first > most:
                    left_out += 1
                    turned = (at * most) % (last - first)
                    for k in range(most):
                        one[candidates + k], other[candidates + k] = at, first + (k + turned) % (last - first)
                    candidates += most
                    continue
                for k in range(4):  # always written, and overwritten if there were fewer
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
            return -1, 0
        for n in range(near_count):
            i[used + n], j[used + n] = asking_rows[one[near[n]]], rows[other[near[n]]]
        used += near_count
    return used, left_out
