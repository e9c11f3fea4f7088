"""Pairs of points within a distance, found by the cells of a grid. For sets with few such pairs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Cell = tuple[int, int, int]

_ROOMY = 1.001  # widths of a cell, in distances that are looked for: rounding puts none farther than a cell away
_AT_ONCE = 1 << 20  # cells that are looked up
_AROUND: list[Cell] = [(x, y, z) for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1)]
_FORWARD = _AROUND[len(_AROUND) // 2 :]  # each pair of cells once


def pairs_within(places: Floats, reach: float) -> tuple[Index, Index]:
    """Return the pairs of points [n,3] at most `reach` apart: their indices, the lower one first."""
    one, other = _pairs(places, places, reach, _FORWARD)
    return np.minimum(one, other), np.maximum(one, other)


def pairs_between(places: Floats, others: Floats, reach: float) -> tuple[Index, Index]:
    """Return the pairs of points [n,3] and others [k,3] at most `reach` apart: the indices of both."""
    return _pairs(places, others, reach, _AROUND)


def _pairs(places: Floats, others: Floats, reach: float, cells: list[Cell]) -> tuple[Index, Index]:
    empty = np.empty(0, np.int64)
    if not (len(places) and len(others)):
        return empty, empty
    low = np.minimum(places.min(axis=0), others.min(axis=0))
    here, there = (np.floor((each - low) / (_ROOMY * reach)).astype(np.int64) for each in (places, others))
    _, ny, nz = np.maximum(here.max(axis=0), there.max(axis=0)) + 3
    found = [(empty, empty)]
    with np.errstate(over="ignore"):  # cells that are far from each other may share a number: distances are measured
        asked, key = ((each[:, 0] * ny + each[:, 1]) * nz + each[:, 2] for each in (here, there))
        own, order = np.argsort(asked, kind="stable"), np.argsort(key, kind="stable")
        asked, key = asked[own], key[order]
        shift = np.array([(x * ny + y) * nz + z for x, y, z in cells])
    for first in range(0, len(shift), size := 1 + _AT_ONCE // len(places)):
        with np.errstate(over="ignore"):
            wanted = (asked + shift[first : first + size, None]).ravel()
        begin = np.searchsorted(key, wanted)
        hit = np.flatnonzero(key[np.minimum(begin, len(key) - 1)] == wanted)
        begin = begin[hit]
        count = np.searchsorted(key, wanted[hit], "right") - begin
        step = np.arange(int(count.sum())) - np.repeat(np.cumsum(count) - count, count)
        one, other = own[np.repeat(hit % len(places), count)], order[np.repeat(begin, count) + step]
        away = places[one] - others[other]
        square = (away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]) + away[:, 2] * away[:, 2]
        near = square <= reach * reach
        if cells is _FORWARD:  # pairs in one cell come both ways
            near &= (one < other) | (np.repeat(first + hit // len(places), count) > 0)
        found.append((one[near], other[near]))
    ones, all_others = zip(*found, strict=True)
    return np.concatenate(ones), np.concatenate(all_others)
