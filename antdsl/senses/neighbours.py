"""A sorted cell grid of agents' positions, which returns pairs (query, neighbour) within a radius.

The pairs have the same bits and the same order for any order of rows, chunk size or cell size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.limits import MAX_QUERY_NEIGHBOURS
from antdsl.machine_code.kernels import F32, F64, I32, I64, Array1, bits_to_float, float_to_bits, inlined, kernel, kernel_helper
from antdsl.numerics import parallel
from antdsl.numerics.sorting import sort_stably
from antdsl.senses.cell_order import (
    NO_ORDER,
    CellCounts,
    CellOrder,
    Columns,
    FloatTriple,
    GridShape,
    count_agents_before,
    find_bounding_box,
    reorder_axes,
)

Floats = NDArray[np.float32]
Rows = NDArray[np.intp]  # an index of another type is converted at every use

ViewConeColumns = tuple[Floats, Floats, Floats, Floats]  # heading x, y, z of each query, and the cosine of half its field of view

RADIUS_SLACK = 1.0 + 1e-6  # float32 distances err by a few 2**-24; candidates must be a superset
_DISTANCE_SLACK = 1.0 - 1e-6
# A squared distance above this multiple of the squared radius has a root above the radius
SQUARED_RADIUS_SLACK = np.float32(1.0 + 1e-5)
MAX_INT64 = np.int64((1 << 63) - 1)
_FLOAT32_ZERO_BITS = 29  # number of last bits of a float64 that are 0 for a float32 value

# Positions x, y, z and along the fast, middle and slow axis; ids; radius; heading; cosine of half the field of view
QueryColumns = tuple[Columns, Columns, Array1[I64], Array1[F32], Columns, Array1[F32]]
PairColumns = tuple[Array1[I64], Array1[I64], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]


class CellGridTables(NamedTuple):
    """The tables of a `CellGrid` for kernels. Agents are in the order of cells.

    `positions`: x, y, z of each agent (mm). `axis_positions`: the same arrays in the order of the fast, middle and slow axis.
    `packed_positions`: x, y, z and row of each agent, four entries per agent. `rows`, `ids`, `keys`: row, id and cell of each
    agent. `cell_starts`: the first agent of each cell. `low_corner`, `cells_per_mm`, `cell_widths`, `cells_per_axis`: low
    corner (mm), cells per mm, cell width (mm) and number of cells along each axis."""

    positions: Columns
    axis_positions: Columns
    packed_positions: Array1[F32]
    rows: Array1[I32]
    ids: Array1[I64]
    keys: Array1[I64]
    cell_starts: Array1[I32]
    low_corner: FloatTriple
    cells_per_mm: FloatTriple
    cell_widths: FloatTriple
    cells_per_axis: CellCounts


class SearchProgress(NamedTuple):
    """The progress of a search for pairs when its kernel returns.

    `next_query`: the query with which the search continues. `pair_count`: the number of pairs written so far. `needed_spans`,
    `needed_candidates`: the lengths of the buffers `spans` and `candidates` that the search needs to continue.
    `needed_candidates` is -1 if a query has more others within its radius than allowed."""

    next_query: I64
    pair_count: I64
    needed_spans: I64
    needed_candidates: I64


class TooManyNeighboursError(Exception):
    """Error raised if there are more agents within the radius of one query than may be examined."""


@dataclass(frozen=True, slots=True)
class NeighbourPairs:
    """Pairs of a query and a neighbour within its radius. They are sorted by query, then by the neighbour's cell, then by its
    id. `i`: the index of the query. `j`: the row of the neighbour in the grid. `dx`, `dy`, `dz`: the neighbour's position
    minus the query's, float32 mm. `distance`: the length of that vector (mm). The pairs do not depend on the order of rows.
    The order of a query's pairs may depend on the extent of the crowd."""

    i: Rows
    j: Rows
    dx: Floats
    dy: Floats
    dz: Floats
    distance: Floats


class CellGrid:
    """Agents sorted into the cells of a grid. Cells are four times shorter along the crowd's longest axis than along the other
    axes.

    `x`, `y`, `z`: float32[n] mm. `ids`: int64[n], unique. `cell`: the usual radius (mm) of a query. Queries can have any
    radius, and are fastest with this one. An agent with a position that is not finite is never a neighbour."""

    def __init__(self, x: Floats, y: Floats, z: Floats, ids: NDArray[np.int64], cell: float, threads: int = 1) -> None:
        self.x, self.y, self.z, self.ids = x, y, z, ids
        x, y, z = parallel.make_contiguous(x, y, z)
        shape = GridShape.from_bounds(*find_bounding_box((x, y, z)), cell)
        self.shape = shape.flatten_to_one_layer() if shape.is_one_layer_enough((x, y, z)) else shape
        self.order = CellOrder(x.size, threads)
        self.order.sort(self.shape, (x, y, z), NO_ORDER if (ids[1:] >= ids[:-1]).all() else sort_stably(ids))

    def find_pairs(
        self, rows: Rows | None, radius: Floats | float, *, qx: Floats | None = None, qy: Floats | None = None,
        qz: Floats | None = None, qid: NDArray[np.int64] | None = None, view: ViewConeColumns | None = None, threads: int = 1,
        limit: int | None = None
    ) -> NeighbourPairs:  # fmt: skip
        """Return the neighbours of the agents `rows` (None: all) within `radius` (mm; one number, or one for each row).

        Without `qx`, `qy` and `qz`, queries are for the grid's own agents, and no agent is its own neighbour. With them,
        queries are for agents at these positions; `rows` selects some of them, and `qid` has their ids if they are in the
        grid. `view`: limits the neighbours of each query to a field of view. An agent gets at most
        `limits.MAX_QUERY_NEIGHBOURS` neighbours, the nearest by (distance, id). Raises TooManyNeighboursError early if an
        agent has more than `limit` others within its radius."""
        if qx is None or qy is None or qz is None:
            qx, qy, qz, qid = self.x, self.y, self.z, self.ids
        if rows is not None:
            qx, qy, qz = qx[rows], qy[rows], qz[rows]
            qid = None if qid is None else qid[rows]
        qx, qy, qz = (np.asarray(q, np.float32) for q in (qx, qy, qz))
        reach = np.asarray(radius, np.float32)
        if reach.shape != qx.shape:
            reach = np.broadcast_to(reach, qx.shape)
        return self._search_pairs((qx, qy, qz), reach, qid, view, threads, 1 << 62 if limit is None else limit)

    def make_tables(self) -> CellGridTables:
        """Return the tables of the grid for kernels."""
        order, shape, rows = self.order, self.shape, np.ascontiguousarray(self.order.rows)
        columns: Any = order.columns
        cells: Any = tuple(shape.low_corner), shape.cells_per_mm, tuple(shape.cell_widths), tuple(shape.cells_per_axis)
        agents = order.packed_positions, rows, self.ids.take(rows), order.keys, order.cell_starts
        return CellGridTables(columns, reorder_axes(shape.axes, columns), *agents, *cells)

    def _search_pairs(
        self,
        query: tuple[Floats, Floats, Floats],
        reach: Floats,
        qid: NDArray[np.int64] | None,
        view: ViewConeColumns | None,
        threads: int,
        limit: int,
    ) -> NeighbourPairs:
        """Return the pairs of queries at `query` (x, y, z) with radii `reach` (mm). The other arguments are those of
        `find_pairs`."""
        none, grid, axes = np.empty(0, np.float32), self.make_tables(), self.shape.axes
        ids = np.empty(0, np.int64) if qid is None else qid
        values: tuple[NDArray[Any], ...] = (*query, ids, reach, *(view or (none,) * 4))

        def search_part(begin: int, end: int) -> tuple[NDArray[Any], ...] | None:
            pair_columns = _find_pairs(grid, axes, [np.ascontiguousarray(value[begin:end]) for value in values], limit)
            if pair_columns is not None:
                pair_columns[0][:] += begin
            return pair_columns

        pair_columns = parallel.run_in_parts(search_part, query[0].size, threads)
        filled = [columns for columns in pair_columns if columns is not None]
        if len(filled) < len(pair_columns):
            raise TooManyNeighboursError
        return (
            NeighbourPairs(*filled[0])
            if len(filled) == 1
            else NeighbourPairs(*(np.concatenate(column) for column in zip(*filled, strict=True)))
        )


def _find_pairs(
    grid: CellGridTables, axes: tuple[int, ...], query: list[NDArray[Any]], limit: int
) -> tuple[NDArray[Any], ...] | None:
    """Return the columns of `NeighbourPairs` for all queries [m]; None if a query has more than `limit` others within its
    radius. `query`: x, y, z, ids (empty for agents outside the grid) and radius. Then follow x, y and z of the heading and the
    cosine of half the view angle, empty for all-round queries."""
    positions, (ids, radius, hx, hy, hz, cosine) = query[:3], query[3:]
    queries = (tuple(positions), tuple(positions[axis] for axis in axes), ids, radius, (hx, hy, hz), cosine)
    m = radius.size
    spans, near = np.empty(64, np.int64), np.empty(1024, np.int64)
    kinds = (np.int64, np.int64, np.float32, np.float32, np.float32, np.float32)
    pairs = tuple(np.empty(max(16 * m, 1024), kind) for kind in kinds)  # pages that are not written take no memory
    k, pair_count, span_length, wide = _fill_pairs(grid, queries, limit, spans, near, pairs, 0, 0)
    while k < m:
        if wide < 0:
            return None
        if span_length > spans.size or wide > near.size:
            spans, near = np.empty(2 * span_length, np.int64), np.empty(2 * wide, np.int64)
        else:
            pairs = tuple(np.concatenate([a[:pair_count], np.empty(a.size + near.size, a.dtype)]) for a in pairs)
        k, pair_count, span_length, wide = _fill_pairs(grid, queries, limit, spans, near, pairs, k, pair_count)
    return tuple(a[:pair_count] for a in pairs)


@inlined
def find_first_cell(coordinate: F64, low: F64, inverse: F64, size: I64) -> I64:
    """Return the index, 0 to `size`, of the first cell in a range of cells that starts at `coordinate` (mm) along an axis.

    `low`: the lowest coordinate of the grid (mm). `inverse`: cells per mm. `size`: the number of cells."""
    return math.floor(min(max((coordinate - low) * inverse, 0.0), float(size)))


@inlined
def find_last_cell(coordinate: F64, low: F64, inverse: F64, size: I64) -> I64:
    """Return the index, -1 to `size` - 1, of the last cell in a range of cells that ends at `coordinate` (mm) along an axis."""
    return math.floor(min(max((coordinate - low) * inverse, -1.0), size - 1.0))


@inlined
def _compute_axis_distance(q: F64, cell: I64, low: F64, width: F64) -> F64:
    """Return the distance (mm) along an axis from the coordinate `q` to the nearest point of a cell, rounded down."""
    edge = low + cell * width
    return max(max(edge - q, q - (edge + width)), 0.0) * _DISTANCE_SLACK


@kernel_helper
def _find_spans(
    a: F64,
    b: F64,
    c: F64,
    radius: F64,
    keys: Array1[I64],
    cell_starts: Array1[I32],
    low: FloatTriple,
    inverse: FloatTriple,
    width: FloatTriple,
    size: CellCounts,
    spans: Array1[I64],
) -> tuple[I64, I64]:
    """Find all cells within the radius of a position, and write the ranges of their sorted agents to `spans`.

    Returns the number of spans, and the number of agents in all spans. If `spans` is too short, returns -1 and the required
    length. A span is a range of sorted agents. It has two entries in `spans`: its first agent, and the agent after its last
    one. `a`, `b`, `c`: the position along the fast, middle and slow axis of the grid (mm)."""
    tiny = 1e-14 * max(max(abs(a), abs(b)), abs(c)) + 1e-18
    r = radius * RADIUS_SLACK + tiny
    b0, b1 = find_first_cell(b - r, low[1], inverse[1], size[1]), find_last_cell(b + r, low[1], inverse[1], size[1])
    sheet = size[2] == 1 and abs(c - low[2]) <= width[2]
    c0, c1 = (
        (0, 0)
        if sheet
        else (find_first_cell(c - r, low[2], inverse[2], size[2]), find_last_cell(c + r, low[2], inverse[2], size[2]))
    )
    number, total = 0, 0
    if b0 > b1 or c0 > c1:
        return 0, 0
    if 2 * (b1 - b0 + 1) * (c1 - c0 + 1) > spans.size:
        return -1, 2 * (b1 - b0 + 1) * (c1 - c0 + 1)
    for cz in range(c0, c1 + 1):
        off_z = 0.0 if sheet else _compute_axis_distance(c, cz, low[2], width[2])
        for cy in range(b0, b1 + 1):
            off_y = _compute_axis_distance(b, cy, low[1], width[1])
            left = r * r - off_y * off_y - off_z * off_z
            if not left >= 0:
                continue
            half = math.sqrt(left) * RADIUS_SLACK + tiny
            a0, a1 = (
                find_first_cell(a - half, low[0], inverse[0], size[0]),
                find_last_cell(a + half, low[0], inverse[0], size[0]),
            )
            if a0 > a1:
                continue
            line = (cz * size[1] + cy) * size[0]
            first, last = count_agents_before(cell_starts, keys, line + a0), count_agents_before(cell_starts, keys, line + a1 + 1)
            if last > first:
                spans[2 * number], spans[2 * number + 1] = first, last
                number, total = number + 1, total + last - first
    return number, total


@kernel_helper
def _find_last_neighbour(
    sx: Array1[F32], sy: Array1[F32], sz: Array1[F32], ids: Array1[I64], candidates: Array1[I64], candidate_count: I64,
    x: F32, y: F32, z: F32,
    reach: F32, own_id: I64,
) -> tuple[F32, I64]:  # fmt: skip
    """Return the distance and the id of the farthest neighbour that is used: number `MAX_QUERY_NEIGHBOURS` in the order of
    distance and id. The candidates are the first `candidate_count` entries of `candidates`, except the agent with the id
    `own_id`. The search bisects the bits of the distance, then the ids of agents at this distance."""
    low, high = 0, float_to_bits(np.float64(reach)) >> _FLOAT32_ZERO_BITS
    nearer_count, closer_count = 0, 0
    while low < high:
        middle = (low + high) >> 1
        bound, nearer_count = bits_to_float(middle << _FLOAT32_ZERO_BITS), 0
        for p in range(candidate_count):
            candidate = candidates[p]
            ux, uy, uz = sx[candidate] - x, sy[candidate] - y, sz[candidate] - z
            nearer_count += (np.float64(np.sqrt((ux * ux + uy * uy) + uz * uz)) <= bound) & (ids[candidate] != own_id)
        if nearer_count >= MAX_QUERY_NEIGHBOURS:
            high = middle
        else:
            low, closer_count = middle + 1, nearer_count
    farthest = np.float32(bits_to_float(low << _FLOAT32_ZERO_BITS))
    first, last = MAX_INT64, np.int64(-1)
    for p in range(candidate_count):
        first, last = min(first, ids[candidates[p]]), max(last, ids[candidates[p]])
    while first < last:
        middle = (first + last) >> 1
        nearer_count = closer_count
        for p in range(candidate_count):
            candidate = candidates[p]
            ux, uy, uz = sx[candidate] - x, sy[candidate] - y, sz[candidate] - z
            is_at_distance = np.sqrt((ux * ux + uy * uy) + uz * uz) == farthest
            nearer_count += is_at_distance & (ids[candidate] <= middle) & (ids[candidate] != own_id)
        if nearer_count >= MAX_QUERY_NEIGHBOURS:
            last = middle
        else:
            first = middle + 1
    return farthest, last


@kernel
def _fill_pairs(
    grid: CellGridTables,
    query: QueryColumns,
    limit: I64,
    spans: Array1[I64],
    candidates: Array1[I64],
    pairs: PairColumns,
    first_query: I64,
    pair_count: I64,
) -> SearchProgress:
    """Write the pairs of the queries from `first_query` on to `pairs`, after `pair_count` earlier pairs. Return the progress.

    The search stops when all queries are done, or when an array is too short. If a query has more than `MAX_QUERY_NEIGHBOURS`
    others, the nearest by distance and id are used."""
    (sx, sy, sz), _, _, rows, names, keys, cell_starts, low, inverse, width, size = grid
    (qx, qy, qz), (fast, middle, slow), query_ids, radius, (hx, hy, hz), cosine = query
    i, j, dx, dy, dz, distance = pairs
    has_ids, limited = query_ids.size > 0, cosine.size > 0
    while first_query < qx.size:
        reach, x, y, z = radius[first_query], qx[first_query], qy[first_query], qz[first_query]
        if not (reach >= 0 and math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            first_query += 1
            continue
        name = query_ids[first_query] if has_ids else np.int64(-1)
        if limited:
            gx, gy, gz, min_cosine = hx[first_query], hy[first_query], hz[first_query], cosine[first_query]
        number, total = _find_spans(
            float(fast[first_query]), float(middle[first_query]), float(slow[first_query]), float(reach),
            keys, cell_starts, low, inverse, width, size, spans,
        )  # fmt: skip
        if number < 0:
            return SearchProgress(first_query, pair_count, total, candidates.size)
        if total > candidates.size:
            return SearchProgress(first_query, pair_count, spans.size, total)
        square_limit = reach * reach * SQUARED_RADIUS_SLACK + np.float32(1e-30)
        candidate_count = 0
        for s in range(number):
            # Always written, and overwritten if too far: this avoids an unpredictable branch.
            for agent in range(spans[2 * s], spans[2 * s + 1]):
                ux, uy, uz = sx[agent] - x, sy[agent] - y, sz[agent] - z
                candidates[candidate_count] = agent
                candidate_count += (ux * ux + uy * uy) + uz * uz <= square_limit
        farthest, last = np.float32(np.inf), MAX_INT64
        if candidate_count > MAX_QUERY_NEIGHBOURS:
            count = 0
            for p in range(candidate_count):
                agent = candidates[p]
                ux, uy, uz = sx[agent] - x, sy[agent] - y, sz[agent] - z
                count += (np.sqrt((ux * ux + uy * uy) + uz * uz) <= reach) & (not has_ids or names[agent] != name)
            if count > limit:
                return SearchProgress(first_query, pair_count, spans.size, -1)
            if count > MAX_QUERY_NEIGHBOURS:
                farthest, last = _find_last_neighbour(sx, sy, sz, names, candidates, candidate_count, x, y, z, reach, name)
        if pair_count + candidate_count > i.size:
            return SearchProgress(first_query, pair_count, spans.size, candidates.size)
        for p in range(candidate_count):
            agent = candidates[p]
            ux, uy, uz = sx[agent] - x, sy[agent] - y, sz[agent] - z
            length = np.sqrt((ux * ux + uy * uy) + uz * uz)
            is_pair = length <= reach
            if has_ids:
                is_pair &= names[agent] != name
            is_pair &= (length < farthest) | ((length == farthest) & (names[agent] <= last))
            if limited:
                is_pair &= (ux * gx + uy * gy) + uz * gz >= min_cosine * length
            i[pair_count], j[pair_count] = first_query, rows[agent]
            dx[pair_count], dy[pair_count], dz[pair_count], distance[pair_count] = ux, uy, uz, length
            pair_count += is_pair
        first_query += 1
    return SearchProgress(first_query, pair_count, spans.size, candidates.size)
