"""What agents can sense ahead of them, meshes and solids alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import FeelerHits, FeelerQuery
from antdsl.casting.triangle_grid import Arrays
from antdsl.numerics.vectors import VectorComponents


class Obstacle(Protocol):
    """A surface that agents can sense ahead: a mesh (`RayScene`) or a solid (`SolidFeelers`). Positions and directions are 1-D
    arrays of one length n, lengths mm."""

    def clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """Return a distance (float32[n]) within which positions have no surface; 0 when near."""

    def cast_feelers(
        self, positions: VectorComponents, directions: VectorComponents, reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return what lies within `reach` (one or float[n]) of positions (x y z) along unit directions (x y z)."""

    def feel_batch(self, positions: Arrays, asks: Sequence[FeelerQuery], threads: int = 1) -> list[tuple[int, NDArray[np.intp]]]:
        """Write what feelers touch, for several requests together, each by some of n agents. `positions`: x y z, and the distance
        (mm) free of surface. Each request has ways (x y z) of any length and their reach, and result arrays: hit, distance and
        normal (x y z), initialised to no hit. Returns, with the number of each request, the rows that still need `feelers`."""

    def nearest_within(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """Return the nearest surface within `reach` (one or float[n]) of positions: distance, and unit direction towards the
        position."""
