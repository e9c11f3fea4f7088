"""Where a mesh cuts through itself: the pairs of faces that do are found once; who walks on one of them crosses it where the
other one cuts it and nowhere else, which is worked out exactly."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.rasterise import triangle_cells

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Index = NDArray[np.int64]

_PAIRS = 2_000_000  # of faces in one cell, looked at together
_CELL = 2.0  # mean sizes of faces: width of a cell
_MOST_CELLS = 1 << 20  # along an axis


@dataclass(frozen=True, slots=True, eq=False)
class Cuts:
    """Face f is cut by the faces `other[first[f]:first[f + 1]]` of its own piece, and cuts these."""

    first: Index
    other: Index

    @property
    def cut(self) -> NDArray[np.bool_]:
        """Which faces are cut."""
        return np.diff(self.first) > 0

    def of(self, face: Index) -> tuple[Index, Index]:
        """All faces that cut some faces: which of those asked each cuts, and its number."""
        count = np.diff(self.first).take(face)
        which = np.repeat(np.arange(face.size), count)
        step = np.arange(which.size) - np.repeat(np.cumsum(count) - count, count)
        return which, self.other.take(np.repeat(self.first.take(face), count) + step)


def cuts(corners: Floats, weld: Ints, piece: Ints, grain: float) -> Cuts:
    """Of faces with corners float64[m,3,3] whose places are numbered by `weld` (m, 3), of the pieces int32[m] (-1 for none). What
    goes less than `grain` (mm) through a face touches it and does not cut it."""
    flat = weld.ravel()
    one_place = np.zeros((int(flat.max(initial=-1)) + 1, 3))
    one_place[flat[::-1]] = corners.reshape(-1, 3)[::-1]  # corners that are nearly at one place do not cut what they belong to
    one, two = _pairs(one_place[weld], weld, piece, grain)
    face, other = np.concatenate([one, two]), np.concatenate([two, one])
    order = np.lexsort((other, face))
    return Cuts(np.concatenate([[0], np.cumsum(np.bincount(face, minlength=len(piece)))]), other[order])


def _pairs(corners: Floats, weld: Ints, piece: Ints, grain: float) -> tuple[Index, Index]:
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
        # Who share an edge fold along it and cannot cut each other. Who share a corner can.
        apart &= shared < 2
        one, two = one[apart], two[apart]
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
