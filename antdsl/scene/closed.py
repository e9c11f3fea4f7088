"""Whether triangles close to a body: how often each edge is passed, and which way."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Index = NDArray[np.int64]


def grained(corners: Floats) -> tuple[Index, int]:
    """Corners float64[n,3,3] in voxels as whole numbers, and how many of these a voxel is: what lies nearer is one place."""
    extent = max(float(np.abs(corners).max()), 1.0)
    # Products of two sides stay below 2**62.
    grain = 1 << min(16, 29 - math.ceil(math.log2(extent)))
    return np.round(corners * grain).astype(np.int64), grain


def open_edges(corners: Index) -> tuple[int, bool]:
    """How many edges an odd number of triangles share, and whether each is passed as often one way as the other.

    `corners` (n, 3, 3): corners of triangles as whole numbers; those at one place are one."""
    points = corners.reshape(-1, 3)
    order = np.lexsort(points.T)
    ranked = points[order]
    new = np.concatenate(([False], (ranked[1:] != ranked[:-1]).any(axis=1)))
    name = np.empty(len(points), np.int64)
    name[order] = np.cumsum(new)
    a = name.reshape(-1, 3)
    b = a[:, [1, 2, 0]]
    real = a != b
    a, b = a[real], b[real]
    edge = np.minimum(a, b) * len(points) + np.maximum(a, b)
    order = np.argsort(edge, kind="stable")
    first = np.flatnonzero(np.concatenate(([True], np.diff(edge[order]) != 0)))
    count = np.diff(np.append(first, len(order)))
    way = np.add.reduceat(np.where(a < b, 1, -1)[order], first) if len(order) else np.zeros(0)
    return int((count % 2).sum()), not way.any()
