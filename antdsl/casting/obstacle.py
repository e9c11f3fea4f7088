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

    Positions and directions are 1-D arrays of one length n; lengths are in mm."""

    def measure_clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """Return a distance (float32[n]) from each position within which there is no surface; 0 near a surface."""

    def cast_feelers(
        self, positions: VectorComponents, directions: VectorComponents, reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the first hits of feelers from positions (x y z) along unit directions (x y z), within `reach` (one or
        float[n])."""

    def cast_feeler_batch(
        self, positions: Arrays, queries: Sequence[FeelerQuery], threads: int = 1
    ) -> list[tuple[int, NDArray[np.intp]]]:
        """Write the hits of feelers for several queries together, each for some of n agents.

        - `positions`: x y z, and a distance (mm) within which there is no surface
        - `queries`: for each query, which agents request it; directions (x y z) of any length and their reach; and its result
          arrays
        - result arrays: hit, distance and normal (x y z), initialised to no hit

        Returns, for each query, its number and the rows that still need `cast_feelers`."""

    def find_nearest_within(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the nearest surface within `reach` (one or float[n]) of positions.

        The normal of a hit is the unit direction from the surface to the position."""
