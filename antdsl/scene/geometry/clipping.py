"""Cuts triangle meshes at the sides of a box."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
MeshArrays = tuple[Floats, NDArray[np.int32]]


def clip_mesh(vertices: Floats, faces: NDArray[np.int32], low: Floats, high: Floats) -> MeshArrays:
    """Return the part of a mesh inside a box with the corners `low` and `high` (3,).

    Faces inside the box are unchanged and remain in order. Faces that cross a side are cut (I. Sutherland, G. Hodgman, Reentrant
    polygon clipping, 1974), and their parts come after the other faces. An infinite bound does not cut. `vertices` (n, 3),
    `faces` (m, 3)."""
    for axis in range(3):
        for side, bound in ((1.0, low[axis]), (-1.0, -high[axis])):
            if np.isfinite(bound):
                vertices, faces = _clip_at_plane(vertices, faces, axis, side, bound)
    return vertices, faces


def _clip_at_plane(vertices: Floats, faces: NDArray[np.int32], axis: int, side: float, bound: float) -> MeshArrays:
    """Return the part of a mesh in which `side` times the coordinate along `axis` is at least `bound`. New vertices lie exactly
    on the plane."""
    height = side * vertices[:, axis] - bound
    inside, outside = (height >= 0)[faces], (height <= 0)[faces]
    crossing = np.flatnonzero(~inside.all(axis=1) & ~outside.all(axis=1))
    inner = faces[inside.all(axis=1) & ~outside.all(axis=1)]
    added: list[Floats] = []
    cut: list[tuple[int, int, int]] = []
    number_of: dict[tuple[int, int], int] = {}
    for face in faces[crossing].tolist():
        polygon: list[int] = []
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            if height[a] >= 0:
                polygon.append(a)
            if height[a] * height[b] < 0:
                edge = (min(a, b), max(a, b))
                if edge not in number_of:
                    number_of[edge] = len(vertices) + len(added)
                    added.append(_find_point(vertices, height, axis, side * bound, *edge))
                polygon.append(number_of[edge])
        cut += [(polygon[0], polygon[k], polygon[k + 1]) for k in range(1, len(polygon) - 1)]
    if not len(crossing):
        return vertices, inner
    return np.concatenate([vertices, np.array(added).reshape(-1, 3)]), np.concatenate([inner, np.array(cut, np.int32)])


def _find_point(vertices: Floats, height: Floats, axis: int, bound: float, a: int, b: int) -> Floats:
    """Return the point at which the edge from vertex `a` to vertex `b` meets the plane."""
    share = height[a] / (height[a] - height[b])
    point: Floats = vertices[a] + share * (vertices[b] - vertices[a])
    point[axis] = bound
    return point
