"""Finds pairs of faces at which a mesh cuts itself. This is done once per mesh.

An agent on one face of a pair can get to the other side of the other face only at their cut."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.numerics.vector_rows import dot, length

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Index = NDArray[np.int64]

_PAIRS_PER_CHUNK = 2_000_000  # pairs of faces in a cell per chunk
_CELL_WIDTH_IN_FACES = 2.0  # width of a cell, in median face sizes
_MAX_FACE_CELLS = 8.0  # a face across more cells belongs to the larger faces
_COPLANAR_COSINE = 1 - 1e-12  # absolute cosine between normals; above it, faces count as parallel
_MAX_CELLS_PER_AXIS = 1 << 20  # along an axis


@dataclass(frozen=True, slots=True, eq=False)
class SelfIntersections:
    """Pairs of faces of the same piece that cut each other. Face f is cut by `cutting_faces[cut_starts[f]:cut_starts[f + 1]]`."""

    cut_starts: Index
    cutting_faces: Index

    @property
    def is_cut(self) -> NDArray[np.bool_]:
        """Return a mask of the faces that are cut."""
        return np.diff(self.cut_starts) > 0

    def list_cutting_faces(self, face: Index) -> tuple[Index, Index]:
        """Return all pairs of a face in `face` and a face that cuts it. The result is two arrays: indices into `face`, and
        numbers of the cutting faces."""
        count = np.diff(self.cut_starts).take(face)
        which = np.repeat(np.arange(face.size), count)
        step = np.arange(which.size) - np.repeat(np.cumsum(count) - count, count)
        return which, self.cutting_faces.take(np.repeat(self.cut_starts.take(face), count) + step)


def find_self_intersections(corners: Floats, weld: Ints, piece: Ints, coordinate_precision: float) -> SelfIntersections:
    """Return the cuts between faces of the same piece. `corners`: float64[m,3,3].

    - `weld` (m, 3): a number for each corner; corners at the same position have the same number
    - `piece` int32[m]: the piece of each face, -1 for none
    - `coordinate_precision`: faces within this distance (mm) of each other touch; this counts as a cut"""
    flat = weld.ravel()
    one_place = np.zeros((int(flat.max(initial=-1)) + 1, 3))
    one_place[flat[::-1]] = corners.reshape(-1, 3)[::-1]  # nearly equal corners get one position, so they cut nothing
    one, two = _find_intersecting_pairs(one_place[weld], weld, piece, coordinate_precision)
    face, other = np.concatenate([one, two]), np.concatenate([two, one])
    order = np.lexsort((other, face))
    return SelfIntersections(np.concatenate([[0], np.cumsum(np.bincount(face, minlength=len(piece)))]), other[order])


def _find_intersecting_pairs(corners: Floats, weld: Ints, piece: Ints, grain: float) -> tuple[Index, Index]:
    """Return pairs of faces that cut or touch each other and belong to the same piece of the ground."""
    cut_pairs = [np.empty((2, 0), np.int64)]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(length(normal), 1e-300)[:, None]
    weld_columns = np.ascontiguousarray(weld.T)  # one array per corner is faster than an axis of three
    for one, two in _iterate_overlapping_pairs(corners, np.flatnonzero(piece >= 0)):
        own = np.flatnonzero(piece.take(one) == piece.take(two))
        one, two = one[own], two[own]
        same = [[own_corner.take(one) == other_corner.take(two) for other_corner in weld_columns] for own_corner in weld_columns]
        # Faces with a common edge cannot cut each other; faces with one common corner can.
        count = sum(each.view(np.int8) for row in same for each in row)
        pair_rows = np.flatnonzero(count < 2)
        pair_rows = pair_rows[np.abs(dot(normal[one[pair_rows]], normal[two[pair_rows]])) < _COPLANAR_COSINE]
        one, two = one[pair_rows], two[pair_rows]
        same = [[each[pair_rows] for each in row] for row in same]
        shared = [[a | b | c for a, b, c in rows] for rows in (same, zip(*same, strict=True))]
        for _ in range(2):  # corners of each face are on both sides of the other face's plane, or on it
            ground, up = corners[two, 0], normal[two]
            height = [dot(corners[one, k] - ground, up) for k in range(3)]
            low = np.minimum.reduce([np.where(own, np.inf, h) for own, h in zip(shared[0], height, strict=True)])
            high = np.maximum.reduce([np.where(own, -np.inf, h) for own, h in zip(shared[0], height, strict=True)])
            across = np.flatnonzero((low <= grain) & (high >= -grain))
            one, two, shared = two[across], one[across], [[v[across] for v in row] for row in shared[::-1]]
        cuts = np.zeros(one.size, bool)
        for f, g, meets in ((one, two, shared[0]), (two, one, shared[1])):
            for k in range(3):
                free = np.flatnonzero(~(meets[k] | meets[(k + 1) % 3] | cuts))
                ends = corners[f[free], k], corners[f[free], (k + 1) % 3]
                cuts[free] = _find_piercing_edges(*ends, corners[g[free]], grain)
        cut_pairs.append(np.stack([one[cuts], two[cuts]]))
    pairs = np.unique(np.concatenate(cut_pairs, axis=1), axis=1)
    return pairs[0], pairs[1]


def _iterate_overlapping_pairs(corners: Floats, live_faces: Index) -> Iterator[tuple[Index, Index]]:
    """Yield pairs of faces in `live_faces` with overlapping boxes, as two arrays with the lower number first. A pair may be
    yielded more than once."""
    a, b, c = (np.ascontiguousarray(corners[:, k].T) for k in range(3))
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    size = (high - low).max(axis=0)
    smaller, left = live_faces[:0], live_faces
    while left.size:
        width = _CELL_WIDTH_IN_FACES * float(np.median(size[left]))
        fits = size[left] <= _MAX_FACE_CELLS * width
        now, left = left[fits], left[~fits]
        for one, two in _iterate_pairs_in_cells(corners, now, smaller, width):
            for least, most in zip(low, high, strict=True):  # one axis after another, so that fewer pairs remain each time
                beside = np.flatnonzero((least.take(one) <= most.take(two)) & (least.take(two) <= most.take(one)))
                one, two = one[beside], two[beside]
            yield np.minimum(one, two), np.maximum(one, two)
        smaller = np.concatenate([now, smaller])


def _iterate_pairs_in_cells(corners: Floats, faces: Index, smaller_faces: Index, width: float) -> Iterator[tuple[Index, Index]]:
    """Yield the pairs of faces that share a cell of a grid. They are pairs of two `faces`, and pairs of one of `faces` and one of
    `smaller_faces`. `width`: the width of a cell."""
    listed = np.concatenate([faces, smaller_faces])
    if listed.size < 2:
        return
    listed_corners = corners[listed]
    begin = listed_corners.min(axis=(0, 1))
    width = max(width, float((listed_corners.max(axis=(0, 1)) - begin).max()) / _MAX_CELLS_PER_AXIS, 1e-300)
    keys, names = [], []
    for cell, which in iterate_triangle_cells((listed_corners - begin) / width, exact=False):
        keys.append((cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2])
        names.append(which)
    key, name = np.concatenate(keys), np.concatenate(names)
    order = np.lexsort((name, key))
    key, name = key[order], name[order]
    keep = np.concatenate([[True], (key[1:] != key[:-1]) | (name[1:] != name[:-1])])
    key, name = key[keep], name[keep]
    # Each face is paired with later faces of its cell. Smaller faces come last and are not paired with each other.
    count = np.where(name < faces.size, np.searchsorted(key, key, "right") - np.arange(key.size) - 1, 0)
    stop = np.cumsum(count)
    start = 0
    while start < key.size:
        end = max(int(np.searchsorted(stop, (stop[start - 1] if start else 0) + _PAIRS_PER_CHUNK, "right")), start + 1)
        counts = count[start:end]
        one = np.repeat(np.arange(start, end), counts)
        two = one + 1 + np.arange(one.size) - np.repeat(np.cumsum(counts) - counts, counts)
        yield listed[name[one]], listed[name[two]]
        start = end


def _find_piercing_edges(start: Floats, end: Floats, triangle: Floats, grain: float) -> NDArray[np.bool_]:
    """Return whether each edge passes through its triangle, or touches it within `grain` mm (Möller, Trumbore, Fast, Minimum
    Storage Ray/Triangle Intersection, 1997, p. 22-24).

    If an edge is in the plane of the triangle, only its start is tested, because its end is the start of another edge. If the
    edge also crosses an edge of the triangle, the test of that other edge finds the crossing."""
    a, e1, e2 = triangle[:, 0], triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    normal = np.cross(e1, e2)
    size = length(normal)
    above, below = (dot(v - a, normal) / size for v in (start, end))
    result = np.zeros(len(start), bool)
    rows = np.flatnonzero((above * below < 0) | (np.minimum(np.abs(above), np.abs(below)) <= grain))
    above, below = above[rows], below[rows]
    level = np.abs(above) <= grain
    part = np.where(level, 0.0, np.clip(above / np.where(level, 1.0, above - below), 0.0, 1.0))
    place = start[rows] + part[:, None] * (end[rows] - start[rows]) - a[rows]
    e1, e2, normal, square = e1[rows], e2[rows], normal[rows], size[rows] ** 2
    b1, b2 = dot(np.cross(place, e2), normal) / square, dot(np.cross(e1, place), normal) / square
    over = grain * np.sqrt(np.maximum(dot(e1, e1), dot(e2, e2))) / size[rows]
    result[rows] = (b1 >= -over) & (b2 >= -over) & (b1 + b2 <= 1 + 2 * over)
    return result
