"""What every reader of a mesh file gives: points and polygons as the file has them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class PolygonMesh:
    """`points` float64[n, 3] in the file's units; `counts` int64[p]: corners of each polygon; `indices` int64[counts.sum()]: the
    point of each corner, which a reader need not have checked."""

    points: NDArray[np.float64]
    counts: NDArray[np.int64]
    indices: NDArray[np.int64]

    @staticmethod
    def of_triangles(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> PolygonMesh:
        """A mesh of triangles (m, 3)."""
        return PolygonMesh(points, np.full(len(triangles), 3), triangles.reshape(-1))
