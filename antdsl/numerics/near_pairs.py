"""Finds pairs of points within a given distance, with a grid of cells. The functions are meant for point sets with few such
pairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
CellOffset = tuple[int, int, int]

_CELL_WIDTH_FACTOR = 1.001  # factor of the cell width, so that in spite of rounding no pair is more than one cell apart
_CELLS_PER_CHUNK = 1 << 20  # cells per chunk
_NEIGHBOUR_OFFSETS: list[CellOffset] = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
_FORWARD_OFFSETS = _NEIGHBOUR_OFFSETS[len(_NEIGHBOUR_OFFSETS) // 2 :]  # each pair of cells once


def find_pairs_within(points: Floats, reach: float) -> tuple[Index, Index]:
    """Return all pairs of points [n,3] that are at most `reach` apart, as two arrays of indices. The first array has the lower
    index of each pair."""
    one, other = _find_pairs(points, points, reach, _FORWARD_OFFSETS)
    return np.minimum(one, other), np.maximum(one, other)


def find_pairs_between(points: Floats, others: Floats, reach: float) -> tuple[Index, Index]:
    """Return the pairs of a point of `points` [n,3] and a point of `others` [k,3] that are at most `reach` apart. The results are
    two arrays: the indices into `points`, and the indices into `others`."""
    return _find_pairs(points, others, reach, _NEIGHBOUR_OFFSETS)


def _find_pairs(points: Floats, others: Floats, reach: float, cells: list[CellOffset]) -> tuple[Index, Index]:
    """Return all pairs of points with a distance of at most `reach`, as indices into `points` and into `others`. `cells`: the
    grid cells to search, as offsets from each point's cell."""
    empty = np.empty(0, np.int64)
    if not (len(points) and len(others)):
        return empty, empty
    low = np.minimum(points.min(axis=0), others.min(axis=0))
    point_cells, other_cells = (
        np.floor((each - low) / (_CELL_WIDTH_FACTOR * reach)).astype(np.int64) for each in (points, others)
    )
    _, ny, nz = np.maximum(point_cells.max(axis=0), other_cells.max(axis=0)) + 3
    pairs = [(empty, empty)]
    with np.errstate(over="ignore"):  # distant cells may share a number, so distances are measured
        point_keys, key = ((each[:, 0] * ny + each[:, 1]) * nz + each[:, 2] for each in (point_cells, other_cells))
        point_order, order = np.argsort(point_keys, kind="stable"), np.argsort(key, kind="stable")
        point_keys, key = point_keys[point_order], key[order]
        shift = np.array([(x * ny + y) * nz + z for x, y, z in cells])
    for first in range(0, len(shift), size := 1 + _CELLS_PER_CHUNK // len(points)):
        with np.errstate(over="ignore"):
            target_keys = (point_keys + shift[first : first + size, None]).ravel()
        begin = np.searchsorted(key, target_keys)
        hit = np.flatnonzero(key[np.minimum(begin, len(key) - 1)] == target_keys)
        begin = begin[hit]
        count = np.searchsorted(key, target_keys[hit], "right") - begin
        step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        one, other = point_order[np.repeat(hit % len(points), count)], order[np.repeat(begin, count) + step]
        offset = points[one] - others[other]
        square = (offset[:, 0] * offset[:, 0] + offset[:, 1] * offset[:, 1]) + offset[:, 2] * offset[:, 2]
        near = square <= reach * reach
        if cells is _FORWARD_OFFSETS:  # pairs within a cell occur in both orders
            near &= (one < other) | (np.repeat(first + hit // len(points), count) > 0)
        pairs.append((one[near], other[near]))
    ones, all_others = zip(*pairs, strict=True)
    return np.concatenate(ones), np.concatenate(all_others)
