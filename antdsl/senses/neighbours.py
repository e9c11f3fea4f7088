"""A sorted cell grid of agents' positions, which returns pairs (query, neighbour) within a radius.

The pairs have the same bits, in the same order, for any order of rows, chunk size or cell size."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.limits import MAX_QUERY_NEIGHBOURS
from antdsl.machine_code.kernels import F32, F64, I32, I64, Array1, as_bits, as_float, called, inlined, kernel
from antdsl.numerics import parallel
from antdsl.numerics.sorting import stable_order
from antdsl.senses.cell_order import NO_ORDER, CellOrder, Columns, Shape, Sizes, Three, agents_before, box_around, reorder_axes

Floats = NDArray[np.float32]
Rows = NDArray[np.intp]  # an index of another type is converted at every use

View = tuple[Floats, Floats, Floats, Floats]

SLACK = 1.0 + 1e-6  # float32 distances err by a few 2**-24; candidates must be a superset
_INWARD = 1.0 - 1e-6
BEYOND = np.float32(1.0 + 1e-5)  # a squared distance above this multiple of the squared radius has a root above the radius
LARGEST = np.int64((1 << 63) - 1)
_ZEROS = 29  # number of last bits of a float64 that are 0 for a float32 value

# Positions x, y, z and along the fast, middle and slow axis; ids; radius; heading; cosine of half the field of view
Query = tuple[Columns, Columns, Array1[I64], Array1[F32], Columns, Array1[F32]]
PairColumns = tuple[Array1[I64], Array1[I64], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]


class Grid(NamedTuple):
    """A `CellGrid` as kernels read it. Agents are in the order of cells.

    `positions`: x, y, z. `along`: the same along the fast, middle and slow axis. `fours`: four entries per agent.
    `rows`, `ids`, `keys`: row, id and cell of each agent. `starts`: the first agent of each cell.
    `low`, `inverse`, `width`, `size`: low corner (mm), cells per mm, cell width (mm) and number of cells along each axis."""

    positions: Columns
    along: Columns
    fours: Array1[F32]
    rows: Array1[I32]
    ids: Array1[I64]
    keys: Array1[I64]
    starts: Array1[I32]
    low: Three
    inverse: Three
    width: Three
    size: Sizes


class Progress(NamedTuple):
    """Progress of a search when it stops.

    `query`: the next query. `pairs`: the number of pairs so far.
    `spans`, `near`: the lengths that these buffers need to continue. `near` is -1 if a query has more others within its radius
        than allowed."""

    query: I64
    pairs: I64
    spans: I64
    near: I64


class TooManyNeighbours(Exception):
    """More agents are within the radius of one query than may be examined."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """Pairs within the radius, sorted by `i`, then by the neighbour's cell, then by its id. All arrays have one length.

    `i`: index of the query, from 0. `j`: row of the neighbour in the grid.
    `dx`, `dy`, `dz`: neighbour minus query, float32 mm. `distance`: the length of that vector.

    Pairs do not depend on the order of rows. The order within one `i` may change with the extent of the crowd."""

    i: Rows
    j: Rows
    dx: Floats
    dy: Floats
    dz: Floats
    distance: Floats


class CellGrid:
    """Agents sorted into cells. Cells form rows along the crowd's longest axis and are four times shorter along it than
    across.

    `x y z`: float32[n] in millimetres. `ids`: int64[n], unique.
    `cell`: the usual radius (mm) of a query. Queries with any radius work; this radius is the fastest.
    An agent with a position that is not finite is never a neighbour."""

    def __init__(self, x: Floats, y: Floats, z: Floats, ids: NDArray[np.int64], cell: float, threads: int = 1) -> None:
        self.x, self.y, self.z, self.ids = x, y, z, ids
        x, y, z = parallel.contiguous(x, y, z)
        shape = Shape.of(*box_around((x, y, z)), cell)
        self.shape = shape.as_sheet() if shape.is_sheet((x, y, z)) else shape
        self.order = CellOrder(x.size, threads)
        self.order.sort(self.shape, (x, y, z), NO_ORDER if (ids[1:] >= ids[:-1]).all() else stable_order(ids))

    def find_pairs(
        self,
        rows: Rows | None,
        radius: Floats | float,
        *,
        qx: Floats | None = None,
        qy: Floats | None = None,
        qz: Floats | None = None,
        qid: NDArray[np.int64] | None = None,
        view: View | None = None,
        threads: int = 1,
        limit: int | None = None,
    ) -> Pairs:
        """Return the neighbours of the agents `rows` (None: all) within `radius` (mm; one number, or one for each row).

        Without `qx qy qz`, queries are for the grid's own agents, and no agent is its own neighbour.
        With `qx qy qz`, queries are for agents at these positions: `rows` selects from them, and `qid` gives their ids if they
        are in the grid.
        `view`, one value per query, limits neighbours to its field of view.
        An agent gets at most `limits.NEIGHBOURS` neighbours, the nearest by (distance, id). Raises TooManyNeighbours early if
        an agent has more than `limit` others within its radius."""
        if qx is None or qy is None or qz is None:
            qx, qy, qz, qid = self.x, self.y, self.z, self.ids
        if rows is not None:
            qx, qy, qz = qx[rows], qy[rows], qz[rows]
            qid = None if qid is None else qid[rows]
        qx, qy, qz = (np.asarray(q, np.float32) for q in (qx, qy, qz))
        reach = np.asarray(radius, np.float32)
        if reach.shape != qx.shape:
            reach = np.broadcast_to(reach, qx.shape)
        return self._search((qx, qy, qz), reach, qid, view, threads, 1 << 62 if limit is None else limit)

    def table(self) -> Grid:
        """Return the cells and the agents in them as kernels read them."""
        order, shape, rows = self.order, self.shape, np.ascontiguousarray(self.order.rows)
        columns: Any = order.columns
        cells: Any = tuple(shape.low), shape.inverse, tuple(shape.width), tuple(shape.size)
        agents = order.fours, rows, self.ids.take(rows), order.keys, order.starts
        return Grid(columns, reorder_axes(shape.axes, columns), *agents, *cells)

    def _search(
        self,
        query: tuple[Floats, Floats, Floats],
        reach: Floats,
        qid: NDArray[np.int64] | None,
        view: View | None,
        threads: int,
        limit: int,
    ) -> Pairs:
        """Return the pairs of all queries, searched in parallel chunks. Arguments as for `find_pairs`."""
        none, grid, axes = np.empty(0, np.float32), self.table(), self.shape.axes
        who = np.empty(0, np.int64) if qid is None else qid
        values: tuple[NDArray[Any], ...] = (*query, who, reach, *(view or (none,) * 4))

        def part(begin: int, end: int) -> tuple[NDArray[Any], ...] | None:
            pair_columns = _find_pairs(grid, axes, [np.ascontiguousarray(value[begin:end]) for value in values], limit)
            if pair_columns is not None:
                pair_columns[0][:] += begin
            return pair_columns

        pair_columns = parallel.in_parts(part, query[0].size, threads)
        good = [columns for columns in pair_columns if columns is not None]
        if len(good) < len(pair_columns):
            raise TooManyNeighbours
        return Pairs(*good[0]) if len(good) == 1 else Pairs(*(np.concatenate(column) for column in zip(*good, strict=True)))


def _find_pairs(grid: Grid, axes: tuple[int, ...], query: list[NDArray[Any]], limit: int) -> tuple[NDArray[Any], ...] | None:
    """Return the pairs of all queries [m] as columns of `Pairs`; None if a query has more than `limit` others within its
    radius.

    `query`: x, y, z, ids (empty if they are not the grid's own), radius; then heading x, y, z and cosine of half the view,
        empty for all-round queries."""
    positions, (who, radius, hx, hy, hz, cosine) = query[:3], query[3:]
    asking = (tuple(positions), tuple(positions[axis] for axis in axes), who, radius, (hx, hy, hz), cosine)
    m = radius.size
    spans, near = np.empty(64, np.int64), np.empty(1024, np.int64)
    kinds = (np.int64, np.int64, np.float32, np.float32, np.float32, np.float32)
    pairs = tuple(np.empty(max(16 * m, 1024), kind) for kind in kinds)  # pages that are not written take no memory
    k, used, along, wide = _fill_pairs(grid, asking, limit, spans, near, pairs, 0, 0)
    while k < m:
        if wide < 0:
            return None
        if along > spans.size or wide > near.size:
            spans, near = np.empty(2 * along, np.int64), np.empty(2 * wide, np.int64)
        else:
            pairs = tuple(np.concatenate([a[:used], np.empty(a.size + near.size, a.dtype)]) for a in pairs)
        k, used, along, wide = _fill_pairs(grid, asking, limit, spans, near, pairs, k, used)
    return tuple(a[:used] for a in pairs)


@inlined
def lower_cell(q: F64, low: F64, inverse: F64, size: I64) -> I64:
    """Return the cell of the lower end of a span, at least 0 and at most `size`."""
    return math.floor(min(max((q - low) * inverse, 0.0), float(size)))


@inlined
def upper_cell(q: F64, low: F64, inverse: F64, size: I64) -> I64:
    """Return the cell of the upper end of a span, at least -1 and below `size`."""
    return math.floor(min(max((q - low) * inverse, -1.0), size - 1.0))


@inlined
def _axis_distance(q: F64, cell: I64, low: F64, width: F64) -> F64:
    """Return the least distance (mm) along an axis from coordinate q to a cell, rounded down."""
    edge = low + cell * width
    return max(max(edge - q, q - (edge + width)), 0.0) * _INWARD


@called
def _find_spans(
    a: F64,
    b: F64,
    c: F64,
    radius: F64,
    keys: Array1[I64],
    starts: Array1[I32],
    low: Three,
    inverse: Three,
    width: Three,
    size: Sizes,
    spans: Array1[I64],
) -> tuple[I64, I64]:
    """Find the agents in cells within the radius of a position, as spans (first, one past the last) of the sorted agents.

    `a`, `b`, `c`: the position along the fast, middle and slow axis of the grid.
    Returns the number of spans and of agents in them; or -1 and the required length of `spans`."""
    tiny = 1e-14 * max(max(abs(a), abs(b)), abs(c)) + 1e-18
    r = radius * SLACK + tiny
    b0, b1 = lower_cell(b - r, low[1], inverse[1], size[1]), upper_cell(b + r, low[1], inverse[1], size[1])
    sheet = size[2] == 1 and abs(c - low[2]) <= width[2]
    c0, c1 = (0, 0) if sheet else (lower_cell(c - r, low[2], inverse[2], size[2]), upper_cell(c + r, low[2], inverse[2], size[2]))
    number, total = 0, 0
    if b0 > b1 or c0 > c1:
        return 0, 0
    if 2 * (b1 - b0 + 1) * (c1 - c0 + 1) > spans.size:
        return -1, 2 * (b1 - b0 + 1) * (c1 - c0 + 1)
    for cz in range(c0, c1 + 1):
        off_z = 0.0 if sheet else _axis_distance(c, cz, low[2], width[2])
        for cy in range(b0, b1 + 1):
            off_y = _axis_distance(b, cy, low[1], width[1])
            left = r * r - off_y * off_y - off_z * off_z
            if not left >= 0:
                continue
            half = math.sqrt(left) * SLACK + tiny
            a0, a1 = lower_cell(a - half, low[0], inverse[0], size[0]), upper_cell(a + half, low[0], inverse[0], size[0])
            if a0 > a1:
                continue
            line = (cz * size[1] + cy) * size[0]
            first, last = agents_before(starts, keys, line + a0), agents_before(starts, keys, line + a1 + 1)
            if last > first:
                spans[2 * number], spans[2 * number + 1] = first, last
                number, total = number + 1, total + last - first
    return number, total


@called
def _nearest_bound(
    sx: Array1[F32], sy: Array1[F32], sz: Array1[F32], names: Array1[I64], near: Array1[I64], candidate_count: I64,
    x: F32, y: F32, z: F32,
    reach: F32, name: I64,
) -> tuple[F32, I64]:  # fmt: skip
    """Return distance and id of the last of the `NEIGHBOURS` agents nearest to a position.

    Only the first `candidate_count` agents of `near` count, without the agent with id `name`. The search bisects the bits of
    the distance, then the ids at that distance."""
    low, high = 0, as_bits(np.float64(reach)) >> _ZEROS
    nearer_count, closer = 0, 0
    while low < high:
        middle = (low + high) >> 1
        bound, nearer_count = as_float(middle << _ZEROS), 0
        for p in range(candidate_count):
            at = near[p]
            ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
            nearer_count += (np.float64(np.sqrt((ux * ux + uy * uy) + uz * uz)) <= bound) & (names[at] != name)
        if nearer_count >= MAX_QUERY_NEIGHBOURS:
            high = middle
        else:
            low, closer = middle + 1, nearer_count
    farthest = np.float32(as_float(low << _ZEROS))
    first, last = LARGEST, np.int64(-1)
    for p in range(candidate_count):
        first, last = min(first, names[near[p]]), max(last, names[near[p]])
    while first < last:
        middle = (first + last) >> 1
        nearer_count = closer
        for p in range(candidate_count):
            at = near[p]
            ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
            same = np.sqrt((ux * ux + uy * uy) + uz * uz) == farthest
            nearer_count += same & (names[at] <= middle) & (names[at] != name)
        if nearer_count >= MAX_QUERY_NEIGHBOURS:
            last = middle
        else:
            first = middle + 1
    return farthest, last


@kernel
def _fill_pairs(
    grid: Grid, query: Query, limit: I64, spans: Array1[I64], near: Array1[I64], pairs: PairColumns, k: I64, used: I64
) -> Progress:
    """Write pairs from query k on, after `used` earlier pairs, until all queries are done or an array is full.

    If a query has more than `NEIGHBOURS` others, the nearest by distance and id are used."""
    (sx, sy, sz), _, _, rows, names, keys, starts, low, inverse, width, size = grid
    (qx, qy, qz), (fast, middle, slow), who, radius, (hx, hy, hz), cosine = query
    i, j, dx, dy, dz, distance = pairs
    own, limited = who.size > 0, cosine.size > 0
    while k < qx.size:
        reach, x, y, z = radius[k], qx[k], qy[k], qz[k]
        if not (reach >= 0 and math.isfinite(x) and math.isfinite(y) and math.isfinite(z)):
            k += 1
            continue
        name = who[k] if own else np.int64(-1)
        if limited:
            gx, gy, gz, least = hx[k], hy[k], hz[k], cosine[k]
        number, total = _find_spans(
            float(fast[k]), float(middle[k]), float(slow[k]), float(reach), keys, starts, low, inverse, width, size, spans
        )
        if number < 0:
            return Progress(k, used, total, near.size)
        if total > near.size:
            return Progress(k, used, spans.size, total)
        beyond = reach * reach * BEYOND + np.float32(1e-30)
        candidate_count = 0
        for s in range(number):
            # Always written, and overwritten if too far: this avoids an unpredictable branch.
            for at in range(spans[2 * s], spans[2 * s + 1]):
                ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
                near[candidate_count] = at
                candidate_count += (ux * ux + uy * uy) + uz * uz <= beyond
        farthest, last = np.float32(np.inf), LARGEST
        if candidate_count > MAX_QUERY_NEIGHBOURS:
            count = 0
            for p in range(candidate_count):
                at = near[p]
                ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
                count += (np.sqrt((ux * ux + uy * uy) + uz * uz) <= reach) & (not own or names[at] != name)
            if count > limit:
                return Progress(k, used, spans.size, -1)
            if count > MAX_QUERY_NEIGHBOURS:
                farthest, last = _nearest_bound(sx, sy, sz, names, near, candidate_count, x, y, z, reach, name)
        if used + candidate_count > i.size:
            return Progress(k, used, spans.size, near.size)
        for p in range(candidate_count):
            at = near[p]
            ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
            length = np.sqrt((ux * ux + uy * uy) + uz * uz)
            good = length <= reach
            if own:
                good &= names[at] != name
            good &= (length < farthest) | ((length == farthest) & (names[at] <= last))
            if limited:
                good &= (ux * gx + uy * gy) + uz * gz >= least * length
            i[used], j[used] = k, rows[at]
            dx[used], dy[used], dz[used], distance[used] = ux, uy, uz, length
            used += good
        k += 1
    return Progress(k, used, spans.size, near.size)
