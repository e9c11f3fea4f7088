"""Finds items near agents. The result is a list of pairs: a requesting row and an item, with the offset and the distance (mm,
float32).

If there are few items, all are measured from all rows. If there are many, items too far away along two axes are excluded first.
Both methods give the same bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, Array1, kernel
from antdsl.numerics.kernel_vectors import VectorColumns
from antdsl.numerics.parallel import make_contiguous
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.world import AXES, Items

Floats = NDArray[np.float32]
ItemPairColumns = tuple[NDArray[Any], ...]  # row, item, x, y, z, distance
PairColumns = tuple[Array1[I64], Array1[I64], Array1[F32], Array1[F32], Array1[F32], Array1[F32]]

_PAIRS_PER_CHUNK = 1 << 16  # pairs of an agent and an item at once
_MIN_ITEMS_TO_FILTER = 128  # with more items, those too far away along an axis are not measured
# Factor on a radius, and mm: they exceed the rounding of float32 and of its squares
_RADIUS_SLACK_FACTOR, _MIN_DISTANCE_MM = 1 + 1e-5, 1e-15


def find_items_within(items: Items, own_positions: tuple[Floats, ...], radius: Any) -> ItemPairColumns:
    """Return the pairs of agents and items within a radius (mm, one number or float[n]) of the agents' positions.

    The columns are: agent, item, offset x, y, z, and distance. They are sorted by agent, then by item."""
    reach = np.full(len(own_positions[0]), radius, np.float32) if np.ndim(radius) == 0 else np.asarray(radius, np.float32)
    if len(items) > _MIN_ITEMS_TO_FILTER:
        return find_pairs_among_near_items(items, own_positions, reach)
    return find_pairs_among_all_items(items, own_positions, reach)


def _get_visible_positions(items: Items) -> VectorArrays:
    """Return the positions of items as agents sense them, x, y and z as float32 arrays."""
    x, y, z = (np.asarray(items.visible_values[axis], np.float32) for axis in AXES)
    return x, y, z


def find_pairs_among_all_items(items: Items, own_positions: tuple[Floats, ...], reach: Floats) -> ItemPairColumns:
    """Return the pairs within `reach` (mm), by measuring the distance of every item from every agent."""
    item_points, agent_points, (reach,) = (
        make_contiguous(*_get_visible_positions(items)),
        make_contiguous(*own_positions),
        make_contiguous(reach),
    )
    pairs = tuple(np.empty(max(2 * reach.size, 64), kind) for kind in (np.int64, np.int64, *(np.float32,) * 4))
    row, used = _fill_pairs(item_points, agent_points, reach, pairs, 0, 0)
    while row < reach.size:
        pairs = tuple(np.concatenate([a, np.empty(a.size + len(items), a.dtype)]) for a in pairs)
        row, used = _fill_pairs(item_points, agent_points, reach, pairs, row, used)
    return tuple(a[:used] for a in pairs)


def find_pairs_among_near_items(items: Items, own_positions: tuple[Floats, ...], reach: Floats) -> ItemPairColumns:
    """Return the pairs within `reach` (mm), by measuring only items that are within reach along two axes.

    These are the two axes along which the items are spread most widely."""
    n, item_points = len(own_positions[0]), _get_visible_positions(items)
    with np.errstate(invalid="ignore"):
        one, two = sorted(range(3), key=lambda k: -float(np.nan_to_num(np.ptp(item_points[k]))))[:2]
        order = np.argsort(item_points[one], kind="stable")
        far = reach.astype(np.float64) * _RADIUS_SLACK_FACTOR + _MIN_DISTANCE_MM
        far[~np.isfinite(far)] = np.inf
        place = np.where(far < np.inf, own_positions[one], np.float32(0)).astype(np.float64)
        first_axis, second_axis = (item_points[axis].astype(np.float64)[order] for axis in (one, two))
        first, last = first_axis.searchsorted(place - far, "left"), first_axis.searchsorted(place + far, "right")
    count = np.maximum(last - first, 0)
    ends = np.cumsum(count)
    parts: list[ItemPairColumns] = []
    a = 0
    while a < n:
        previous_end = int(ends[a - 1]) if a else 0
        b = max(a + 1, int(ends.searchsorted(previous_end + _PAIRS_PER_CHUNK, "right")))
        counts = count[a:b]
        at = np.arange(int(counts.sum())) + np.repeat(first[a:b] - (np.cumsum(counts) - counts), counts)
        offsets = second_axis.take(at) - np.repeat(own_positions[two][a:b].astype(np.float64), counts)
        near = np.flatnonzero(~(np.abs(offsets) > np.repeat(far[a:b], counts)))
        i, j = np.repeat(np.arange(a, b), counts).take(near), order.take(at.take(near))
        dx, dy, dz = (t.take(j) - place.take(i) for t, place in zip(item_points, own_positions, strict=True))
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        keep = np.flatnonzero(distance <= reach.take(i))
        keep = keep[np.lexsort((j[keep], i[keep]))]
        parts.append(tuple(column.take(keep) for column in (i, j, dx, dy, dz, distance)))
        a = b
    return _join_columns(parts)


def _join_columns(parts: list[ItemPairColumns]) -> ItemPairColumns:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return np.empty(0, np.intp), np.empty(0, np.intp), *np.empty((4, 0), np.float32)
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))


@kernel
def _fill_pairs(
    items: VectorColumns, agent_points: VectorColumns, reach: Array1[F32], pairs: PairColumns, row: I64, used_count: I64
) -> tuple[I64, I64]:
    """Write the pairs of agents from `row` on, after the first `used_count` pairs, until no agent remains or the arrays are full.

    Return the next row, and the number of pairs."""
    ix, iy, iz = items
    x, y, z = agent_points
    i, j, dx, dy, dz, distance = pairs
    while row < x.size:
        if used_count + ix.size > i.size:
            return row, used_count
        for k in range(ix.size):
            ux, uy, uz = ix[k] - x[row], iy[k] - y[row], iz[k] - z[row]
            length = np.sqrt((ux * ux + uy * uy) + uz * uz)
            if length <= reach[row]:
                i[used_count], j[used_count] = row, k
                dx[used_count], dy[used_count], dz[used_count], distance[used_count] = ux, uy, uz, length
                used_count += 1
        row += 1
    return row, used_count
