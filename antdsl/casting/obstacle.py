"""The interface of surfaces that agents sense ahead of them: meshes and solids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import FeelerHits, FeelerQuery
from antdsl.casting.triangle_grid import Arrays
from antdsl.numerics.vectors import VectorComponents


class Obstacle(Protocol):
    """A surface that agents can sense ahead: a mesh (`RayScene`) or a solid (`SolidProximityQueries`).

    Positions and directions are given as three arrays [n], x, y and z. Lengths are in mm."""

    def measure_clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """Return a distance, float32[n], around each position within which there is no surface. It is 0 near a surface."""

    def cast_feelers(
        self, positions: VectorComponents, directions: VectorComponents, reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the first hits of feelers from `positions` along the unit vectors `directions`, within `reach` (one or
        float[n])."""

    def cast_feeler_batch(
        self, positions: Arrays, queries: Sequence[FeelerQuery], threads: int = 1
    ) -> list[tuple[int, NDArray[np.intp]]]:
        """Answer several queries of feelers at once, each for some of n agents. Write the results to the arrays of the queries.

        - `positions`: four arrays [n]: x, y, z, and a distance within which there is no surface
        - `queries`: for each query, a mask of the agents, the directions (x, y, z, of any length), the reach, and the result
          arrays
        - result arrays: five arrays [n], hit, distance and normal (x, y, z), which the caller has initialised to no hit

        Returns the number of each query and the rows for which `cast_feelers` must still be called."""

    def find_nearest_within(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the nearest surface within `reach` (one or float[n]) of positions.

        The normal of a hit is the unit direction from the surface to the position."""
