"""Ground for a scene without surfaces: the plane through the origin, across the scene's up. Endless and flat.

The doors are those of `senses.ground.Ground`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFooting:
    """Where agents stand: `point` float64 (n, 3) on the plane; `mesh` is 0, as if the plane were the only surface."""

    point: Vectors
    mesh: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class PlaneMove:
    """What `senses.ground.MoveResult` says, for the plane: nobody is lost or blocked."""

    footing: PlaneFooting
    position: Vectors
    up: Vectors
    heading: Vectors
    direction: Vectors
    travelled: NDArray[np.float64]
    lost: NDArray[np.bool_]
    blocked: NDArray[np.bool_]


class Plane:
    """The plane through the origin; `up` is its unit normal."""

    def __init__(self, up: Vectors) -> None:
        self._up = np.asarray(up, np.float64)

    @property
    def meshes(self) -> None:
        """The part of the ground that is made of meshes: none."""
        return None

    def _flat(self, vectors: Vectors) -> Vectors:
        along = (vectors[:, 0] * self._up[0] + vectors[:, 1] * self._up[1]) + vectors[:, 2] * self._up[2]
        flat: Vectors = vectors - along[:, None] * self._up
        return flat

    def _footing(self, points: Vectors) -> PlaneFooting:
        return PlaneFooting(points, np.zeros(len(points), np.int32))

    def place(self, points: Vectors, up: Vectors, on: object = None) -> tuple[PlaneFooting, NDArray[np.bool_]]:
        """Drop points (n, 3) along `up`; every point is found."""
        return self._footing(self._flat(np.asarray(points, np.float64).reshape(-1, 3))), np.ones(len(points), np.bool_)

    def position(self, footing: PlaneFooting) -> Vectors:
        return footing.point

    def normal(self, footing: PlaneFooting) -> Vectors:
        return np.broadcast_to(self._up, footing.point.shape)

    def upright(self, footing: PlaneFooting, up: Vectors) -> Vectors:
        return self.normal(footing)

    def move(
        self, footing: PlaneFooting, displacement: Vectors, heading: Vectors, up: Vectors, body: NDArray[np.float64], threads: int
    ) -> PlaneMove:
        """Walk straight on."""
        step = self._flat(displacement)
        travelled = np.sqrt((step[:, 0] * step[:, 0] + step[:, 1] * step[:, 1]) + step[:, 2] * step[:, 2])
        heading = self._flat(heading)
        going = travelled > 0
        direction = np.where(going[:, None], step / np.where(going, travelled, 1.0)[:, None], heading)
        footing = self._footing(footing.point + step)
        none = np.zeros(len(body), np.bool_)
        return PlaneMove(footing, footing.point, np.broadcast_to(self._up, up.shape), heading, direction, travelled, none, none)
