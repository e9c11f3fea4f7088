"""Finds pairs of agents that are near enough to touch. Every pair occurs once. Method: a uniform grid with cells as wide as
two agents, and a search of half of each cell's neighbours (C. Ericson, Real-Time Collision Detection, 2005, 7.1). Agents of
similar size share a grid; all smaller agents query this grid, too. In a dense cluster, each agent is paired with a limited
number of the agents in reach. So many agents at one position take no more time than the same number next to each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import inlined, kernel, load_consecutive, prefetch, round_to_int, simd_range
from antdsl.machine_code.kernels.types import BOOL, F64, I32, I64, Array1, Array2
from antdsl.numerics.parallel import make_contiguous
from antdsl.numerics.sorting import compact_indices, sort_stably
from antdsl.senses.cell_order import (
    NO_ORDER,
    SPARE_TABLE_ENTRIES,
    WORK_UNITS_PER_CHUNK,
    CellCounts,
    convert_counts_to_starts,
    count_agents_before,
    count_cells,
    reorder_axes,
    take_next_sorted_index,
)
from antdsl.senses.cell_order import FloatTriple as Corner

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
PositionColumns = tuple[Floats, Floats, Floats]
Columns = tuple[Array1[F64], Array1[F64], Array1[F64]]
Bounds = list[tuple[float, float]]  # the least and the greatest x, y, z and reach
# Position and reach (four entries per agent), row, and cell of each agent
Agents = tuple[Array1[F64], Array1[I32], Array1[I64]]
# For each candidate pair: the searching agent, the other agent, and whether both are in reach
CandidateBuffers = tuple[Array1[I32], Array1[I32], Array1[I32]]

_MAX_PARTNERS_PER_SPAN = 48  # maximum number of partners of an agent in a span of three cells; more than fit next to each other
_MAX_CELLS_PER_AXIS = 1 << 20  # maximum number of cells along an axis
_MAX_SHARED_CELL_PAIRS_PER_AGENT = 8  # pairs per agent in the same cell; up to this number, layers are not separated
_PADDED_LAYER_CELLS = 3  # cells along the shortest axis for a single layer; one cell is free at either end
_AGENTS_PER_BATCH = 64  # agents with candidates listed before distances are measured
_PREFETCH_DISTANCE = 40  # agents between a prefetch and its use
_MIN_WRITTEN_CANDIDATES = 4  # number of candidates of a span that are always written


@dataclass(frozen=True, slots=True, eq=False)
class TouchingPairs:
    """Pairs of agents, each pair once, in no particular order.

    `i`, `j`: the rows of both agents. `is_complete`: False if pairs were omitted in a dense cluster."""

    i: Rows
    j: Rows
    is_complete: bool


@dataclass(frozen=True, slots=True, eq=False)
class TouchingAgents:
    """The partners of each agent of one species: the agents of another species that it touches.

    Those of row r have the ids `partner_ids[partner_starts[r]:partner_starts[r + 1]]`. They are sorted by overlap, deepest
    first, then by id. `can_start_contact`: for each entry of `partner_ids`, whether the overlap is deep enough for a new
    contact."""

    partner_starts: Rows
    partner_ids: NDArray[np.int64]
    can_start_contact: NDArray[np.bool_]


def find_touching_pairs(
    positions: PositionColumns, reach: Floats, order: NDArray[np.int64], bounds: Bounds | None = None
) -> TouchingPairs:
    """Return the pairs of agents that are closer than the sum of their reaches (float64[n], mm).

    `positions`: x, y and z float64[n], mm. Agents without a finite position and reach are in no pair. `order` int64[n], all
    different: determines which pairs are omitted in a dense cluster, independent of the order of rows. `bounds`: the least and
    the greatest x, y, z and reach, if known; not finite if any of the values is not finite."""
    x, y, z, reach = make_contiguous(*positions, reach)
    rows, bounds = _find_usable_rows((x, y, z), reach, bounds)
    if bounds is None:
        return TouchingPairs(rows, rows, True)
    rows = rows[sort_stably(order[rows])] if rows.size else sort_stably(order)  # `order` decides which agents are omitted
    pair_lists = [_find_pairs(search) for search in _iterate_searches((x, y, z), reach, rows, bounds, False)]
    if len(pair_lists) == 1:
        return pair_lists[0]
    i, j = (np.concatenate([getattr(each, name) for each in pair_lists]) for name in ("i", "j"))
    return TouchingPairs(i, j, all(each.is_complete for each in pair_lists))


def iterate_neighbour_searches(place: PositionColumns, reach: Floats) -> Iterator[PairSearch]:
    """Yield searches that together visit each touching pair of agents exactly once. Two agents touch if they are within the sum
    of their reaches.

    The arguments are those of `find_touching_pairs`. Sparse crowds get wider cells, so that a table of all cells stays small."""
    x, y, z, reach = make_contiguous(*place, reach)
    rows, bounds = _find_usable_rows((x, y, z), reach, None)
    if bounds is not None:
        yield from _iterate_searches((x, y, z), reach, rows, bounds, True)


def _find_usable_rows(place: PositionColumns, reach: Floats, bounds: Bounds | None) -> tuple[Rows, Bounds | None]:
    """Return the rows with a finite position and a finite reach above 0, and the bounds of their values.

    An empty array of rows stands for all rows. If no row is usable, the bounds are None."""
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


def _iterate_searches(
    place: PositionColumns, reach: Floats, rows: Rows, bounds: Bounds, widen_cells: bool
) -> Iterator[PairSearch]:
    """Yield searches that together visit each near pair of `rows` (empty: all rows) once.

    `bounds`: the bounds of the values of these rows. `widen_cells`: whether sparse grids get wider cells."""
    low, high = bounds[3]
    if 2 * low >= high:
        yield _ContactGrid.build(place, reach, rows, bounds, widen_cells).build_own_search()
        return
    rows = rows if rows.size else np.arange(len(reach))
    sizes = np.frexp(reach[rows])[1]
    for size in np.unique(sizes):
        members, smaller = rows[sizes == size], rows[sizes < size]
        grid = _ContactGrid.build(place, reach, members, _find_bounds((*place, reach), members), widen_cells)
        yield grid.build_own_search()
        if smaller.size:
            yield grid.build_query_search(place, reach, smaller)


def _find_pairs(search: PairSearch) -> TouchingPairs:
    """Return the pairs of a search with a distance of at most the sum of their reaches."""
    count = search.searching_agents[1].size
    buffers = tuple(
        np.empty((3, _AGENTS_PER_BATCH * search.span_offsets.size * _MAX_PARTNERS_PER_SPAN + _MIN_WRITTEN_CANDIDATES), np.int32)
    )
    pair_count, most_pairs, left_out = -1, 4 * count + 256, 0
    while pair_count < 0:
        i, j = np.empty((2, most_pairs), np.int64)
        pair_count, left_out = _fill_pairs(*search, _MAX_PARTNERS_PER_SPAN, buffers, i, j)
        most_pairs *= 4
    return TouchingPairs(i[:pair_count], j[:pair_count], not left_out)


class PairSearch(NamedTuple):
    """The inputs of a kernel that visits pairs of neighbours.

    `searching_agents`, `agents`: the agents that search, and the agents that can be found, each sorted by cell. `cell_starts`:
    the first of `agents` in each cell. `cell_count`: the number of cells. `span_offsets`: the offsets from the cell of a
    searching agent to the middle cells of the spans. A span is three consecutive cells. `is_self_search`: whether the agents
    search among themselves; then each pair is visited once."""

    searching_agents: Agents
    agents: Agents
    cell_starts: Array1[I32]
    cell_count: I64
    span_offsets: Array1[I64]
    is_self_search: BOOL


class _ContactGrid(NamedTuple):
    """A grid of agents of similar size, sorted by cell. At either end of each axis, one row of cells is empty.

    `axes`: the axes from the longest to the shortest; `low_corner` and `cells_per_axis` use this order. `low_corner`: the low
    corner of the grid (mm). `cells_per_mm`: the inverse of a cell's width. `cells_per_axis`: the number of cells along each axis;
    1 for the shortest if layers are not separated. `agents`: position and reach (four entries per agent), row, and cell of each
    agent. `cell_starts`: the first agent of each cell, empty if there are too many cells for a table."""

    axes: tuple[int, ...]
    low_corner: tuple[float, ...]
    cells_per_mm: float
    cells_per_axis: tuple[int, int, int]
    agents: tuple[Floats, NDArray[np.int32], NDArray[np.int64]]
    cell_starts: NDArray[np.int32]

    @staticmethod
    def build(place: PositionColumns, reach: Floats, rows: Rows, bounds: Bounds, widen_cells: bool) -> _ContactGrid:
        """Return the grid of the agents `rows` (empty: all rows). `bounds`: the bounds of their positions and reaches.
        `widen_cells`: whether cells are made wider until a table can hold all of them."""
        low, extent = [low for low, _ in bounds[:3]], [high - low for low, high in bounds[:3]]
        axes = tuple(sorted(range(3), key=lambda axis: -extent[axis]))
        cell = max(2 * bounds[3][1], extent[axes[0]] / _MAX_CELLS_PER_AXIS, 1e-9)
        count = rows.size or reach.size
        if widen_cells:
            cell = max(cell, (extent[axes[0]] * extent[axes[1]] / max(1 << 14, 8 * count)) ** 0.5)
        width, broad, depth = (int(extent[axis] / cell) + 3 for axis in axes)
        agents = np.empty(4 * count), np.empty(count, np.int32), np.empty(count, np.int64)
        start = tuple(low[axis] for axis in axes)
        grid = _ContactGrid(axes, start, 1 / cell, (width, broad, 1), agents, np.empty(0, np.int32))
        max_cells, flat, keys = max(1 << 16, 16 * count), depth == _PADDED_LAYER_CELLS, np.empty(count, np.int64)
        counts, shared_cell_pairs = grid._count_agents(place, rows, keys, max_cells)
        if not (flat or (counts.size and shared_cell_pairs <= _MAX_SHARED_CELL_PAIRS_PER_AGENT * count)):
            grid = grid._replace(cells_per_axis=(width, broad, depth))
            counts, _ = grid._count_agents(place, rows, keys, max_cells)
        if counts.size:
            convert_counts_to_starts(counts, grid.cell_count)
        else:
            order = sort_stably(keys)
            keys, rows = keys.take(order), rows.take(order) if rows.size else order
        _store_agents(place, reach, rows, keys, counts, *agents)
        return grid._replace(cell_starts=counts[0])

    @property
    def cell_count(self) -> int:
        """Return the number of cells."""
        return self.cells_per_axis[0] * self.cells_per_axis[1] * self.cells_per_axis[2]

    def _make_cell_parameters(self) -> tuple[Any, ...]:
        """Return the arguments `low`, `inverse`, `size` and `shift` of kernels that number cells.

        They are the low corner (mm), cells per mm, numbers of cells, and the number of the first cell that can have agents."""
        width, broad, depth = self.cells_per_axis
        first, rate = (broad + 1) * width + 1 if depth > 1 else width + 1, self.cells_per_mm
        return self.low_corner, (rate, rate, rate if depth > 1 else 0.0), self.cells_per_axis, first

    def _count_agents(
        self, place: PositionColumns, rows: Rows, keys: NDArray[np.int64], max_cells: int
    ) -> tuple[NDArray[np.int32], int]:
        """Write the cell of each row to `keys`. Return the counts of all cells, and the number of pairs that share a cell.

        The counts are a table as `cell_order.count_cells` writes it, empty if there are more than `max_cells` cells."""
        counts = np.empty((1, self.cell_count + SPARE_TABLE_ENTRIES if self.cell_count <= max_cells else 0), np.int32)
        return counts, _count_cells(
            reorder_axes(self.axes, place), *self._make_cell_parameters(), rows, keys, counts, 0, WORK_UNITS_PER_CHUNK
        )

    def build_own_search(self) -> PairSearch:
        """Return the search for pairs among the grid's agents.

        Each agent is paired with later agents of its cell, and with all agents in the later half of the neighbour cells."""
        width, layer = self.cells_per_axis[0], self.cells_per_axis[0] * self.cells_per_axis[1]
        shifts = [0, width, layer - width, layer, layer + width][: 2 if self.cells_per_axis[2] == 1 else 5]
        return PairSearch(self.agents, self.agents, self.cell_starts, self.cell_count, np.array(shifts), True)

    def build_query_search(self, place: PositionColumns, reach: Floats, rows: Rows) -> PairSearch:
        """Return the search for pairs of the agents `rows`, which are not in the grid, with the grid's agents.

        Each of these agents is paired with all agents of the grid in its cell and in the neighbour cells."""
        width, layer = self.cells_per_axis[0], self.cells_per_axis[0] * self.cells_per_axis[1]
        shifts = [depth * layer + row_offset * width for depth in (0, -1, 1) for row_offset in (-1, 0, 1)][
            : 3 if self.cells_per_axis[2] == 1 else 9
        ]
        positions, query_rows, keys = np.empty(4 * rows.size), np.empty(rows.size, np.int32), np.empty(rows.size, np.int64)
        query_count = _store_queries(
            place, reorder_axes(self.axes, place), reach, *self._make_cell_parameters(), rows, positions, query_rows, keys
        )
        return PairSearch(
            (positions, query_rows[:query_count], keys), self.agents, self.cell_starts, self.cell_count, np.array(shifts), False
        )


@kernel
def _count_cells(
    axis_positions: Columns, low: Corner, inverse: Corner, size: CellCounts, shift: I64, order: Array1[I64], keys: Array1[I64],
    counts: Array2[I32], begin: I64, end: I64,
) -> I64:  # fmt: skip
    """Write cell numbers and counts as `cell_order.count_cells` does, for float64 positions."""
    return count_cells(axis_positions, low, inverse, size, shift, order, keys, counts, begin, end)


@kernel
def _store_agents(
    positions: Columns, reach: Array1[F64], order: Array1[I64], keys: Array1[I64], counts: Array2[I32],
    ordered_agents: Array1[F64], rows: Array1[I32], cells: Array1[I64],
) -> None:  # fmt: skip
    """Store each agent at its position in the order of cells: x, y, z and reach in `ordered_agents`, its row in `rows`, and
    its cell in `cells`. `order`: the rows of the agents; empty for all rows. `keys`: the cell of each agent. `counts`: see
    `convert_counts_to_starts`."""
    for k in range(keys.size):
        if counts.shape[1] > 0:
            prefetch(ordered_agents, 4 * counts[0, keys[min(k + _PREFETCH_DISTANCE, keys.size - 1)] + 1])
        row = order[k] if order.size > 0 else k
        position = take_next_sorted_index(counts, 0, k, keys[k])
        ordered_agents[4 * position], ordered_agents[4 * position + 1] = positions[0][row], positions[1][row]
        ordered_agents[4 * position + 2], ordered_agents[4 * position + 3] = positions[2][row], reach[row]
        rows[position], cells[position] = row, keys[k]


@kernel
def _store_queries(
    positions: Columns, axis_positions: Columns, reach: Array1[F64], low: Corner, inverse: Corner, size: CellCounts, shift: I64,
    order: Array1[I64], searching_agents: Array1[F64], rows: Array1[I32], cells: Array1[I64],
) -> I64:  # fmt: skip
    """Write the agents that are in the grid's cells or at most one cell outside. Return their number. `order`: the rows to
    test. `searching_agents`, `rows`, `cells`: receive position and reach (four entries), row and cell of each agent."""
    count = 0
    for k in range(order.size):
        row = order[k]
        a, b = (
            np.floor((axis_positions[0][row] - low[0]) * inverse[0]),
            np.floor((axis_positions[1][row] - low[1]) * inverse[1]),
        )
        c = np.floor((axis_positions[2][row] - low[2]) * inverse[2])
        if not (a >= -1.0 and b >= -1.0 and c >= -1.0):
            continue
        if not (a <= np.float64(size[0] - 2) and b <= np.float64(size[1] - 2) and c <= np.float64(max(size[2] - 2, 0))):
            continue
        searching_agents[4 * count], searching_agents[4 * count + 1] = positions[0][row], positions[1][row]
        searching_agents[4 * count + 2], searching_agents[4 * count + 3] = positions[2][row], reach[row]
        rows[count], cells[count] = row, (round_to_int(c) * size[1] + round_to_int(b)) * size[0] + round_to_int(a) + shift
        count += 1
    return count


@inlined
def find_span_start(
    agents: Agents, cell_starts: Array1[I32], cells: I64, is_self_search: BOOL, position: I64, span: I64, key: I64
) -> I64:
    """Return the position of the first agent in the three cells around cell `key`. `position`: the position of the searching
    agent. If the searching agent may itself be in these cells (`is_self_search`), only agents after it are returned, so that
    each pair is visited once."""
    return (
        position + 1 if is_self_search and span == 0 else count_agents_before(cell_starts, agents[2], min(max(key - 1, 0), cells))
    )


@inlined
def find_span_end(agents: Agents, cell_starts: Array1[I32], cells: I64, key: I64) -> I64:
    """Return the position after the last agent in the three cells around cell `key`."""
    return count_agents_before(cell_starts, agents[2], min(max(key + 2, 0), cells))


@kernel
def _fill_pairs(
    searching_agents: Agents, agents: Agents, cell_starts: Array1[I32], cell_count: I64, span_offsets: Array1[I64],
    is_self_search: BOOL,
    max_partners: I64, buffers: CandidateBuffers, i: Array1[I64], j: Array1[I64],
) -> tuple[I64, I64]:  # fmt: skip
    """Write the rows of pairs to `i` and `j`. Return the number of pairs, and the number of spans in which pairs were omitted.

    The number of pairs is -1 if the arrays are too short. A span is three consecutive cells near an agent. The agent is paired
    with at most `max_partners` agents of each span. `span_offsets`: the offsets from the agent's cell to the middle cells of
    the spans. `buffers`: work memory."""
    (query_positions, query_rows, query_keys), (ordered, rows, _), (one, other, near) = searching_agents, agents, buffers
    pair_count, count, left_out = 0, query_rows.size, 0
    for begin in range(0, count, _AGENTS_PER_BATCH):
        candidates = 0
        for agent in range(begin, min(begin + _AGENTS_PER_BATCH, count)):
            for span in range(span_offsets.size):
                key = query_keys[agent] + span_offsets[span]
                last = find_span_end(agents, cell_starts, cell_count, key)
                first = find_span_start(agents, cell_starts, cell_count, is_self_search, agent, span, key)
                if last - first > max_partners:
                    left_out += 1
                    rotation = (agent * max_partners) % (last - first)
                    for k in range(max_partners):
                        one[candidates + k], other[candidates + k] = agent, first + (k + rotation) % (last - first)
                    candidates += max_partners
                    continue
                for k in range(4):  # always written, and overwritten if there were fewer
                    one[candidates + k], other[candidates + k] = agent, first + k
                for k in range(4, last - first):
                    one[candidates + k], other[candidates + k] = agent, first + k
                candidates += last - first
        for n in simd_range(0, candidates):
            p, q = one[n], other[n]
            (x, y, z, wide), (u, v, w, far) = load_consecutive(query_positions, 4 * p, 4), load_consecutive(ordered, 4 * q, 4)
            x, y, z, reach = u - x, v - y, w - z, wide + far
            near[n] = 1 if (x * x + y * y) + z * z <= reach * reach else 0
        near_count = compact_indices(near, candidates)
        if pair_count + near_count > i.size:
            return -1, 0
        for n in range(near_count):
            i[pair_count + n], j[pair_count + n] = query_rows[one[near[n]]], rows[other[near[n]]]
        pair_count += near_count
    return pair_count, left_out
