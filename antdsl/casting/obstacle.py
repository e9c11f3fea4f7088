"""What agents can sense before them, of whatever it is made."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import Ask, FeelerHits
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

    def felt(self, places: Arrays, asks: Sequence[Ask], threads: int = 1) -> list[tuple[int, NDArray[np.intp]]]:
        """What feelers touch of those of n agents who are asking, several times at once. `places`: x y z, and within how many mm
        there is no surface; ways (x y z) of any length and how far they reach; into whether, the distance and the normal (x y z),
        which say until then that nothing is touched. Gives back who has still to ask by `feelers`, with the number of what they
        ask."""

    def near(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """The nearest surface within `reach` (one or float[n]) of places: distance, and unit way to the asker."""
