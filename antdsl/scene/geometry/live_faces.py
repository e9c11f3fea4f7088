"""The rule for which triangles of a surface are ground. Scenes and the ground itself both use it.

A triangle is not ground if it has no area, if two of its corners coincide, or if another triangle has the same corners."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.near_pairs import find_pairs_within

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

_JOIN_DISTANCE_SHARE = 1e-6  # share of the extent of all surfaces; corners nearer than this are one corner
_FLAT_TRIANGLE_RATIO = 1e-7  # ratio of height to longest edge; below it, a triangle is a line
_ISOLATION_DISTANCE_GRAINS = 5.0  # grains; a corner this far from all others is not merged
_FACES_TRIED_FIRST = 8  # number of largest faces that are examined before all others


def has_nonzero_area(a: Floats, b: Floats, c: Floats) -> NDArray[np.bool_]:
    """Return whether each triangle has an area, bool[m]. `a`, `b`, `c` (m, 3): the corners."""
    area = _compute_lengths(np.cross(b - a, c - a))
    longest = np.maximum.reduce([_compute_lengths(edge) for edge in (b - a, c - a, c - b)])
    return np.asarray((area > _FLAT_TRIANGLE_RATIO * longest * longest) & (area > 0))


def find_faces_with_area(numbers: Ints, a: Floats, b: Floats, c: Floats) -> NDArray[np.bool_]:
    """Return whether each face is ground, bool[m]. `a`, `b`, `c` (m, 3): the corners of the faces.

    `numbers`: the result of `number_welded_corners` for these faces."""
    live = has_nonzero_area(a, b, c)
    key = np.sort(numbers, axis=1)
    live &= (key[:, 0] != key[:, 1]) & (key[:, 1] != key[:, 2])
    order = np.lexsort((np.arange(len(key)), ~live, key[:, 2], key[:, 1], key[:, 0]))
    again = (key[order][1:] == key[order][:-1]).all(axis=1)
    live[order[1:][again]] = False
    return live


def has_any_face_with_area(vertices: Floats, faces: Ints, extent: float) -> bool:
    """Return whether any face of a mesh is ground. `extent`: the width of all surfaces together.

    Usually, one of the largest faces has corners that are far from all other corners, which shows quickly that it is ground.
    Only if there is no such face, all corners are numbered to find those that coincide."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.where(has_nonzero_area(a, b, c), _compute_lengths(np.cross(b - a, c - a)), 0.0)
    clearance = _ISOLATION_DISTANCE_GRAINS * extent * _JOIN_DISTANCE_SHARE
    for face in np.argsort(-area, kind="stable")[:_FACES_TRIED_FIRST]:
        if not area[face]:
            break
        isolated_count = 0
        for corner in vertices[faces[face]]:
            away = np.abs(vertices - corner).max(axis=1)
            isolated_count += not ((away > 0) & (away <= clearance)).any()
        if isolated_count >= 2:
            return True
    return bool(
        find_faces_with_area(number_welded_corners(vertices, faces, np.zeros(len(faces), np.int32), extent), a, b, c).any()
    )


def _compute_lengths(v: Floats) -> Floats:
    length: Floats = np.sqrt((v * v).sum(axis=1))
    return length


def number_welded_corners(vertices: Floats, faces: Ints, mesh: Ints, extent: float) -> Ints:
    """Return numbers int32[m, 3] for the corners of faces. Corners of the same mesh at the same position have the same number.

    `vertices` float64[n, 3]; `faces` int32[m, 3].
    `mesh` int32[m]: the index of each face's mesh.
    `extent`: the width of all meshes together."""
    grain = max(extent * _JOIN_DISTANCE_SHARE, 1e-300)
    flat = faces.ravel()
    place = np.round((vertices[flat] - vertices[flat].min(axis=0, initial=np.inf)) / grain).astype(np.int64)
    owner = np.repeat(mesh, 3)
    order = np.lexsort((place[:, 2], place[:, 1], place[:, 0], owner))
    rows = np.column_stack([owner, place])[order]
    fresh = np.concatenate(([0], np.cumsum((rows[1:] != rows[:-1]).any(axis=1)))) if len(rows) else np.empty(0, np.int64)
    weld = np.empty(len(flat), np.int32)
    weld[order] = _merge_cells(vertices[flat[order]], owner[order], fresh, grain)
    return weld.reshape(-1, 3)


def number_connected_components(pairs: NDArray[np.int64], count: int) -> NDArray[np.int32]:
    """Return the index of the connected component of each node, int32[count]. `pairs` (k, 2): nodes that are connected directly.

    Components are numbered from 0, in the order of their first nodes."""
    parent = np.arange(count)
    one, two = pairs[:, 0], pairs[:, 1]
    while one.size:  # each pass removes at least half of the roots that are connected to others
        low, high = np.minimum(parent[one], parent[two]), np.maximum(parent[one], parent[two])
        joined = np.flatnonzero(low != high)
        one, two = one[joined], two[joined]
        np.minimum.at(parent, high[joined], low[joined])
        while not np.array_equal(above := parent[parent], parent):
            parent = above
    numbers: NDArray[np.int32] = (np.cumsum(parent == np.arange(count))[parent] - 1).astype(np.int32)
    return numbers


def _merge_cells(points: Floats, owner: Ints, cell: NDArray[np.int64], grain: float) -> NDArray[np.int64]:
    """Return merged cell numbers int64[n] for points in grid cells. `owner`: the index of each point's owner. `cell`: the cell
    of each point.

    Two cells with the same owner get the same number if points in them are nearer to each other than `grain`."""
    begin = np.unique(cell, return_index=True)[1]
    near = np.stack(find_pairs_within(points[begin], grain), axis=1)
    near = near[owner[begin][near[:, 0]] == owner[begin][near[:, 1]]]
    if not near.size:
        return cell
    joined: NDArray[np.int64] = number_connected_components(near, begin.size).astype(np.int64)[cell]
    return joined
