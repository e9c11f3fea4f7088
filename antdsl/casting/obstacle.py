"""What agents can sense before them, of whatever it is made."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import Columns, FeelerHits


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
        self,
        place: Columns,
        rows: NDArray[np.intp],
        way: Columns,
        reach: NDArray[Any],
        clear: NDArray[np.float32],
        found: tuple[NDArray[np.bool_], NDArray[np.float32], NDArray[np.float32]],
    ) -> NDArray[np.intp]:
        """What feelers touch of `rows` of all places [n], who have no surface within `clear` [n], along ways [k] of any length,
        as far as `reach` [k]: whether, the distance and the normal [3,k], into `found`, which says that nothing is touched.
        Gives back who of the k has still to ask by `feelers`."""

    def near(
        self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], reach: NDArray[Any] | float, threads: int = 1
    ) -> FeelerHits:
        """The nearest surface within `reach` (one or float[n]) of places: distance, and unit way to the asker."""
