"""What agents can sense before them, of whatever it is made."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import FeelerHits
from antdsl.casting.triangle_grid import Arrays


class Obstacle(Protocol):
    """What agents can sense before them: a mesh (`RayScene`) or a solid (`SolidFeelers`). Places and directions are 1-D arrays of
    one length n, lengths mm."""

    def clearance(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """A distance (float32[n]) within which places have no surface; 0 when near."""

    def feelers(
        self,
        x: NDArray[Any],
        y: NDArray[Any],
        z: NDArray[Any],
        dx: NDArray[Any],
        dy: NDArray[Any],
        dz: NDArray[Any],
        reach: NDArray[Any] | float,
        threads: int = 1,
    ) -> FeelerHits:
        """What lies within `reach` (one or float[n]) of places along unit directions."""

    def felt(
        self, place: Arrays, asking: NDArray[np.bool_], ways: Arrays, clear: NDArray[np.float32], found: Arrays
    ) -> NDArray[np.intp]:
        """What feelers touch of those who are `asking`, bool[n], and have no surface within `clear`, along `ways` (x y z) of any
        length, as far as the last of these says: whether, the distance and the normal (x y z), into `found`, which says that
        nothing is touched. Gives back the numbers of those who have still to ask by `feelers`."""

    def near(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """The nearest surface within `reach` (one or float[n]) of places: distance, and unit way to the asker."""
