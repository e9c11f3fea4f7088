"""Where a mesh cuts through itself: found once, so that only there rays look out for what is of one's own piece.

There each face is a patch of its own; all others have the number of their piece."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.rasterise import triangle_cells

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Index = NDArray[np.int64]

_PAIRS = 2_000_000  # of faces in one cell, looked at together
_CELL = 2.0  # mean sizes of faces: width of a cell
_FOLDED = 0.5  # cosine between the normals of faces that share a corner, above which they are not folded over each other
_RINGS = 2  # of faces around those that are cut that look out as well: an agent's eye is ahead of its feet
_MOST_CELLS = 1 << 20  # along an axis


def patches(corners: Floats, weld: Ints, piece: Ints, grain: float) -> Ints:
    """Patch int32[m] of each face, -1 for those without a piece: corners float64[m,3,3] whose places are numbered by `weld`
    (m, 3). What goes less than `grain` (mm) through a face touches it and does not cut it."""
    one, two = _cuts(corners, weld, piece, grain)
    patch = piece.copy()
    if one.size:
        alone = np.zeros(len(piece), bool)
        alone[one] = alone[two] = True
        for _ in range(_RINGS):
            near = np.zeros(int(weld.max()) + 1, bool)
            near[weld[alone].ravel()] = True
            alone = near[weld].any(axis=1) & (piece >= 0)
        patch[alone] = int(piece.max()) + 1 + np.arange(int(alone.sum()))
    return patch


def _cuts(corners: Floats, weld: Ints, piece: Ints, grain: float) -> tuple[Index, Index]:
    """Pairs of faces of one piece, one of which has an edge that goes through the other."""
    found = [np.empty((2, 0), np.int64)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.sqrt((normal * normal).sum(axis=1)), 1e-300)[:, None]
    for one, two in _near(corners, np.flatnonzero(piece >= 0)):
        apart = piece[one] == piece[two]
        shared = np.zeros(one.size, np.int8)
        for j in range(3):
            for k in range(3):
                shared += weld[one, j] == weld[two, k]
        # Who share an edge fold along it and cannot cut each other. Who share a corner can where they are folded over there.
        apart &= shared < 2
        one, two, shared = one[apart], two[apart], shared[apart]
        folded = np.flatnonzero((shared == 0) | ((normal[one] * normal[two]).sum(axis=1) < _FOLDED))
        one, two = one[folded], two[folded]
        for _ in range(2):  # each has corners on both sides of the other
            height = ((corners[one] - corners[two, :1]) * normal[two][:, None]).sum(axis=2)
            across = (height.min(axis=1) < -grain) & (height.max(axis=1) > grain)
            one, two = two[across], one[across]
        cuts = np.zeros(one.size, bool)
        for f, g in ((one, two), (two, one)):
            for k in range(3):
                cuts |= _pierces(corners[f, k], corners[f, (k + 1) % 3], corners[g], grain)
        found.append(np.stack([one[cuts], two[cuts]]))
    pairs = np.unique(np.concatenate(found, axis=1), axis=1)
    return pairs[0], pairs[1]


def _near(corners: Floats, live: Index) -> Iterator[tuple[Index, Index]]:
    """Pairs of `live` faces whose boxes overlap, the lower number first; a pair may come more than once."""
    if live.size < 2:
        return
    low, high = corners[live].min(axis=1), corners[live].max(axis=1)
    begin = low.min(axis=0)
    width = max(_CELL * float((high - low).max(axis=1).mean()), float((high.max(axis=0) - begin).max()) / _MOST_CELLS, 1e-300)
    keys, names = [], []
    for cell, which in triangle_cells((corners[live] - begin) / width, exact=False):
        keys.append((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2])
        names.append(which)
    key, name = np.concatenate(keys), np.concatenate(names)
    order = np.argsort(key, kind="stable")
    key, name = key[order], name[order]
    keep = np.concatenate([[True], (key[1:] != key[:-1]) | (name[1:] != name[:-1])])
    key, name = key[keep], name[keep]
    # Each with those after it in its cell; what comes twice there is looked at twice.
    ends = np.searchsorted(key, key, "right")
    count = ends - np.arange(key.size) - 1
    stop = np.cumsum(count)
    start = 0
    while start < key.size:
        end = max(int(np.searchsorted(stop, (stop[start - 1] if start else 0) + _PAIRS, "right")), start + 1)
        here = count[start:end]
        one = np.repeat(np.arange(start, end), here)
        two = one + 1 + np.arange(one.size) - np.repeat(np.cumsum(here) - here, here)
        one, two = name[one], name[two]
        beside = ((low[one] <= high[two]) & (low[two] <= high[one])).all(axis=1)
        one, two = live[one[beside]], live[two[beside]]
        yield np.minimum(one, two), np.maximum(one, two)
        start = end


def _pierces(start: Floats, end: Floats, triangle: Floats, grain: float) -> NDArray[np.bool_]:
    """Whether edges go through triangles, more than `grain` on both sides of the plane and inside its edges (Möller, Trumbore,
    Fast, Minimum Storage Ray/Triangle Intersection, 1997, p. 22-24)."""
    a, e1, e2 = triangle[:, 0], triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    normal = np.cross(e1, e2)
    size = np.sqrt((normal * normal).sum(axis=1))
    above, below = (((v - a) * normal).sum(axis=1) for v in (start, end))
    across = (above * below < 0) & (np.minimum(np.abs(above), np.abs(below)) > grain * size)
    result = np.zeros(len(start), bool)
    rows = np.flatnonzero(across)
    if not rows.size:
        return result
    part = above[rows] / (above[rows] - below[rows])
    place = start[rows] + part[:, None] * (end[rows] - start[rows]) - a[rows]
    square = size[rows] ** 2
    b1 = (np.cross(place, e2[rows]) * normal[rows]).sum(axis=1) / square
    b2 = (np.cross(e1[rows], place) * normal[rows]).sum(axis=1) / square
    result[rows] = (b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1)
    return result
