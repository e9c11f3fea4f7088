"""Which cells of a regular lattice do triangles touch: the exact test, in pieces that stay small in memory."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

_PIECE = 1 << 15  # triangles handled at once
_LARGEST = 2.0  # extent in cells above which a triangle is cut in four


def triangle_cells(corners: NDArray[np.float64], exact: bool = True) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield (cells int64[k,3], triangle int64[k]) until all touched cells of all triangles are named.

    `corners` is float64[n,3,3] (triangle, corner, axis) in units of cells: cell (i,j,k) is [i,i+1)×[j,j+1)×[k,k+1). A cell
    may come more than once for a large triangle. With `exact` false, all cells of a small box around each part come.
    Triangle against box: Akenine-Möller, Fast 3D Triangle-Box Overlap Testing, 2001, p. 2-4.
    """
    todo = [(corners[a : a + _PIECE], np.arange(a, min(a + _PIECE, len(corners)))) for a in range(0, len(corners), _PIECE)]
    todo.reverse()
    while todo:
        tri, name = todo.pop()
        large = (tri.max(axis=1) - tri.min(axis=1)).max(axis=1) > _LARGEST
        small = ~large
        if small.any():
            yield _box_cells(tri[small], name[small], exact)
        if large.any():
            quarters, names = _quarter(tri[large]), np.tile(name[large], 4)
            for a in range(0, len(quarters), _PIECE):
                todo.append((quarters[a : a + _PIECE], names[a : a + _PIECE]))


def _quarter(tri: NDArray[np.float64]) -> NDArray[np.float64]:
    a, b, c = tri[:, 0], tri[:, 1], tri[:, 2]
    ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
    parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
    return np.concatenate([np.stack(part, axis=1) for part in parts])


def _box_cells(tri: NDArray[np.float64], name: NDArray[np.int64], exact: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    low = np.floor(tri.min(axis=1)).astype(np.int64)
    size = np.floor(tri.max(axis=1)).astype(np.int64) - low + 1
    count = size.prod(axis=1)
    which = np.repeat(np.arange(len(tri)), count)
    step = np.arange(which.size) - np.repeat(np.cumsum(count) - count, count)
    nx, ny = size[which, 0], size[which, 1]
    cells = low[which] + np.stack([step % nx, step // nx % ny, step // (nx * ny)], axis=1)
    if exact:
        touched = _touch(tri[which] - (cells + 0.5)[:, None, :])
        cells, which = cells[touched], which[touched]
    return cells, name[which]


def _touch(tri: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether triangles float64[k,3,3] meet the unit box around 0, given that their bounding boxes do."""
    v = [tri[:, i].T for i in range(3)]
    edges = [v[1] - v[0], v[2] - v[1], v[0] - v[2]]
    normal = np.cross(edges[0], edges[1], axis=0)
    slack = 1e-9
    touch: NDArray[np.bool_] = np.abs((normal * v[0]).sum(axis=0)) <= 0.5 * np.abs(normal).sum(axis=0) + slack
    for edge in edges:
        for axis in range(3):
            p, q = (axis + 1) % 3, (axis + 2) % 3
            reach = 0.5 * (np.abs(edge[p]) + np.abs(edge[q])) + slack
            at = [edge[p] * w[q] - edge[q] * w[p] for w in v]
            touch &= (np.minimum(np.minimum(*at[:2]), at[2]) <= reach) & (np.maximum(np.maximum(*at[:2]), at[2]) >= -reach)
    return touch
