"""Where a mesh cuts through itself: found once, so that only there rays look out for what is of one's own piece.

Faces that cut each other get different numbers of a patch; all others have the number of their piece."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from antdsl.runtime.senses.rasterise import triangle_cells

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]
Index = NDArray[np.int64]

_PAIRS = 2_000_000  # of faces in one cell, looked at together
_CELL = 2.0  # mean sizes of faces: width of a cell
_FOLDED = 0.5  # cosine between the normals of faces that share a corner, above which they are not folded over each other
_RINGS = 2  # of faces around those that are cut that belong to their patch: an agent's eye is ahead of its feet
_MOST_CELLS = 1 << 20  # along an axis


def patches(corners: Floats, weld: Ints, piece: Ints, grain: float) -> Ints:
    """Patch int32[m] of each face, -1 for those without a piece: corners float64[m,3,3] whose places are numbered by `weld`
    (m, 3). What goes less than `grain` (mm) through a face touches it and does not cut it."""
    one, two = _cuts(corners, weld, piece, grain)
    if not one.size:
        return piece
    cut = np.unique(np.concatenate([one, two]))
    colour = _coloured(cut, np.searchsorted(cut, one), np.searchsorted(cut, two), weld)
    whole = np.zeros(len(piece), np.int64)
    whole[cut] = colour
    for _ in range(_RINGS):
        whole = _spread(whole, weld, cut)
    first = int(piece.max(initial=-1)) + 1
    pair = np.stack([piece.astype(np.int64), whole], axis=1)[whole > 0]
    _, number = np.unique(pair, axis=0, return_inverse=True)
    patch = piece.copy()
    patch[whole > 0] = first + number.ravel()
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


def _coloured(cut: Index, one: Index, two: Index, weld: Ints) -> Index:
    """Numbers from 0 for `cut` faces, different for each pair of numbers in `cut`, as few as come of taking them as they hang
    together: strips along a cut have one number mostly."""
    size = cut.size
    near = _touching(weld[cut])
    _, strip = connected_components(near, directed=False)
    order = np.concatenate([_in_turn(near, int(np.flatnonzero(strip == k)[0])) for k in range(int(strip.max()) + 1)])
    enemies: list[list[int]] = [[] for _ in range(size)]
    for a, b in zip(one.tolist(), two.tolist(), strict=True):
        enemies[a].append(b)
        enemies[b].append(a)
    colour = np.full(size, -1, np.int64)
    for face in order.tolist():
        taken = {int(colour[other]) for other in enemies[face]}
        friends = near.indices[near.indptr[face] : near.indptr[face + 1]]
        wanted = [int(c) for c in colour[friends] if c >= 0]
        free = [c for c in wanted if c not in taken]
        colour[face] = free[0] if free else next(c for c in range(size) if c not in taken)
    return colour


def _in_turn(near: coo_array, start: int) -> Index:
    order: Index = breadth_first_order(near, start, directed=False, return_predecessors=False)
    return order


def _touching(weld: Ints) -> coo_array:
    """Which faces share a corner, as a sparse table."""
    count = len(weld)
    places, number = np.unique(weld, return_inverse=True)
    table = coo_array((np.ones(3 * count, np.int32), (np.repeat(np.arange(count), 3), number.ravel())), (count, len(places)))
    return (table @ table.T).tocsr()


def _spread(colour: Index, weld: Ints, cut: Index) -> Index:
    """Faces beside those with a number above 0 get it too; those that are cut keep theirs."""
    at = np.zeros(int(weld.max()) + 1, np.int64)
    some = np.flatnonzero(colour > 0)
    np.maximum.at(at, weld[some].ravel(), np.repeat(colour[some], 3))
    wide = np.where(colour > 0, colour, at[weld].max(axis=1))
    wide[cut] = colour[cut]
    return wide
