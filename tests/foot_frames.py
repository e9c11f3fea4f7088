"""Bodies and feet by NumPy's own products, independent of the kernels that move them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.runtime.world import Population

Points = NDArray[np.float64]


@dataclass(frozen=True)
class BodyFrames:
    """n bodies: places [n, 3] (mm), axes [n, 3, 3] (ahead, up and aside as rows), sizes [n]."""

    place: Points
    axes: Points
    size: Points

    @staticmethod
    def of(population: Population) -> BodyFrames:
        """The bodies of a population by id."""
        rows = population.get_rows_by_id()
        heading, up = (
            np.stack(vec.get_vector_registers(population.now, name), axis=1)[rows].astype(float) for name in ("heading", "up")
        )
        ahead = heading / np.linalg.norm(heading, axis=1, keepdims=True)
        above = up - ahead * (up * ahead).sum(axis=1, keepdims=True)
        above /= np.linalg.norm(above, axis=1, keepdims=True)
        axes = np.stack([ahead, above, np.cross(ahead, above)], axis=1)
        return BodyFrames(population.position[rows], axes, population.now["size"][rows].astype(float))

    def to_bodies(self, points: Points) -> Points:
        """Where places [3, n, L] are from bodies, ahead, above and aside in their lengths, [3, n, L]."""
        away = (np.moveaxis(points, 0, -1) - self.place[:, None]) / self.size[:, None, None]
        return np.moveaxis(np.einsum("nak,nlk->nla", self.axes, away), -1, 0)

    def to_world(self, points: Points) -> Points:
        """Places [3, n, L] of points [L, 3] of each body."""
        away = np.einsum("lk,nka->nla", points, self.axes) * self.size[:, None, None]
        return np.moveaxis(self.place[:, None] + away, -1, 0)


def lean(points: Points, slope: NDArray[np.floating]) -> Points:
    """Points [L, 3] of trunks with their up turned to the normal of planes with slopes [2, n]: [3, n, L], by Rodrigues'
    formula."""
    normal = np.stack([-slope[0], np.ones(slope.shape[1]), -slope[1]], axis=1).astype(float)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    axis, cosine = np.cross([0.0, 1.0, 0.0], normal), normal[:, 1]
    across = np.cross(axis[:, None], points[None])
    along = (axis @ points.T)[..., None] * axis[:, None] / (1 + cosine)[:, None, None]
    return np.moveaxis(points[None] * cosine[:, None, None] + across + along, -1, 0)
