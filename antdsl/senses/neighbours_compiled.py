"""The compiled half of the cell grid: candidates of each query are measured, and only pairs that count are written down.

The same bits in the same order as `neighbours.CellGrid` finds with NumPy. Imported only where `compiled.wanted` says so.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, F64, I32, I64, Array1, called, inlined, kernel
from antdsl.numerics.sorting_compiled import place_among

Floats = NDArray[np.float32]
Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]
# Places x, y, z, rows, ids and keys of the agents sorted by cell, the table of starts; then low, width and size of the cells
Grid = tuple[
    Columns, Array1[I64], Array1[I64], Array1[I64], Array1[I32], tuple[F64, F64, F64], tuple[F64, F64, F64], tuple[I64, I64, I64]
]
# Places x, y, z and along the fast, middle and slow axis, ids, radius, heading and the cosine of the field of view
Query = tuple[Columns, Columns, Array1[I64], Array1[F32], Columns, Array1[F32]]
Found = tuple[Array1[I64], Array1[I64], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]
_SLACK = 1.0 + 1e-6  # as in `neighbours`
_INWARD = 1.0 - 1e-6
_BEYOND = np.float32(1.0 + 1e-5)  # a squared distance over this many squared radii has a root over the radius


@inlined
def _lower(q: float, low: float, width: float, size: int) -> int:
    """Cell of the lower end of a span, at least 0 and at most `size`."""
    return math.floor(min(max((q - low) / width, 0.0), float(size)))


@inlined
def _upper(q: float, low: float, width: float, size: int) -> int:
    """Cell of the upper end of a span, at least -1 and below `size`."""
    return math.floor(min(max((q - low) / width, -1.0), size - 1.0))


@inlined
def _off(q: float, cell: int, low: float, width: float) -> float:
    """Least distance along an axis from q to a cell, rounded down."""
    edge = low + cell * width
    return max(max(edge - q, q - (edge + width)), 0.0) * _INWARD


@called
def _before(starts: NDArray[np.int32], keys: NDArray[np.int64], key: int) -> int:
    """How many sorted agents lie in cells before `key`; by bisection where there is no table."""
    if starts.size:
        return int(starts[key])
    return int(place_among(keys, key, 0, keys.size))


@called
def _spans(
    a: float,
    b: float,
    c: float,
    radius: float,
    keys: NDArray[np.int64],
    starts: NDArray[np.int32],
    low: tuple[float, float, float],
    width: tuple[float, float, float],
    size: tuple[int, int, int],
    spans: NDArray[np.int64],
) -> tuple[int, int]:
    """Sorted agents in reach of a place as spans (first, beyond the last); a, b, c along the grid's fast, middle and slow axis.

    Gives the number of spans and of agents in them; or -1 and how long `spans` must be.
    """
    tiny = 1e-14 * max(max(abs(a), abs(b)), abs(c)) + 1e-18
    r = radius * _SLACK + tiny
    b0, b1 = _lower(b - r, low[1], width[1], size[1]), _upper(b + r, low[1], width[1], size[1])
    sheet = size[2] == 1 and abs(c - low[2]) <= width[2]
    c0, c1 = (0, 0) if sheet else (_lower(c - r, low[2], width[2], size[2]), _upper(c + r, low[2], width[2], size[2]))
    number, total = 0, 0
    if b0 > b1 or c0 > c1:
        return 0, 0
    if 2 * (b1 - b0 + 1) * (c1 - c0 + 1) > spans.size:
        return -1, 2 * (b1 - b0 + 1) * (c1 - c0 + 1)
    for cz in range(c0, c1 + 1):
        off_z = 0.0 if sheet else _off(c, cz, low[2], width[2])
        for cy in range(b0, b1 + 1):
            off_y = _off(b, cy, low[1], width[1])
            left = r * r - off_y * off_y - off_z * off_z
            if not left >= 0:
                continue
            half = math.sqrt(left) * _SLACK + tiny
            a0, a1 = _lower(a - half, low[0], width[0], size[0]), _upper(a + half, low[0], width[0], size[0])
            if a0 > a1:
                continue
            line = (cz * size[1] + cy) * size[0]
            first, last = _before(starts, keys, line + a0), _before(starts, keys, line + a1 + 1)
            if last > first:
                spans[2 * number], spans[2 * number + 1] = first, last
                number, total = number + 1, total + last - first
    return number, total


@kernel
def _fill(
    grid: Grid, query: Query, most: I64, spans: Array1[I64], near: Array1[I64], pairs: Found, k: I64, used: I64
) -> tuple[I64, I64, I64, I64]:
    """Go on with query k, with so many pairs found before it, until an array is too short.

    Gives the query come to, the pairs found, and how long `spans` and `near` must be to go on (-1: a query has more than `most`).
    """
    (sx, sy, sz), rows, names, keys, starts, low, width, size = grid
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
        number, total = _spans(
            float(fast[k]), float(middle[k]), float(slow[k]), float(reach), keys, starts, low, width, size, spans
        )
        if number < 0:
            return k, used, total, near.size
        if total > near.size:
            return k, used, spans.size, total
        beyond = reach * reach * _BEYOND + np.float32(1e-30)
        found = 0
        for s in range(number):
            # Written whatever it is, and written over where it was too far: no branch that is hard to foretell.
            for at in range(spans[2 * s], spans[2 * s + 1]):
                ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
                near[found] = at
                found += (ux * ux + uy * uy) + uz * uz <= beyond
        if found > most:
            count = 0
            for p in range(found):
                at = near[p]
                ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
                count += (np.sqrt((ux * ux + uy * uy) + uz * uz) <= reach) & (not own or names[at] != name)
            if count > most:
                return k, used, spans.size, -1
        if used + found > i.size:
            return k, used, spans.size, near.size
        for p in range(found):
            at = near[p]
            ux, uy, uz = sx[at] - x, sy[at] - y, sz[at] - z
            length = np.sqrt((ux * ux + uy * uy) + uz * uz)
            good = length <= reach
            if own:
                good &= names[at] != name
            if limited:
                good &= (ux * gx + uy * gy) + uz * gz >= least * length
            i[used], j[used] = k, rows[at]
            dx[used], dy[used], dz[used], distance[used] = ux, uy, uz, length
            used += good
        k += 1
    return k, used, spans.size, near.size


def find(grid: tuple[Any, ...], query: tuple[Any, ...], most: int) -> tuple[NDArray[Any], ...] | None:
    """Pairs of all queries [m] as `neighbours.Pairs` has them; None where one has more than `most` neighbours.

    `grid`: x, y, z, rows, ids and keys [n] of the agents sorted by cell; the table of starts, empty where there is none; axes,
    low, width and size of the cells (fast, middle, slow axis). `query`: x, y, z, ids (empty where they are not the grid's own),
    radius; heading x, y, z and cosine, empty where all round is asked about: else these give each query's field of view, and
    only pairs within it count.
    """
    x, y, z, rows, names, keys, starts, axes, low, width, size = grid
    places, (who, radius, hx, hy, hz, cosine) = query[:3], query[3:]
    ordered = ((x, y, z), rows, names, keys, starts, low, width, size)
    asking = (places, tuple(places[axis] for axis in axes), who, radius, (hx, hy, hz), cosine)
    m = radius.size
    spans, near = np.empty(64, np.int64), np.empty(1024, np.int64)
    kinds = (np.int64, np.int64, np.float32, np.float32, np.float32, np.float32)
    pairs = tuple(np.empty(max(16 * m, 1024), kind) for kind in kinds)  # what is not written takes no memory
    k, used, along, wide = _fill(ordered, asking, most, spans, near, pairs, 0, 0)
    while k < m:
        if wide < 0:
            return None
        if along > spans.size or wide > near.size:
            spans, near = np.empty(2 * along, np.int64), np.empty(2 * wide, np.int64)
        else:
            pairs = tuple(np.concatenate([a[:used], np.empty(a.size + near.size, a.dtype)]) for a in pairs)
        k, used, along, wide = _fill(ordered, asking, most, spans, near, pairs, k, used)
    return tuple(a[:used] for a in pairs)
