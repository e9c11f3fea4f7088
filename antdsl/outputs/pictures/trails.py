"""Colours the ground by what is laid on it: the cells of a field, smoothed from cell to cell along the surface."""

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.light import decoded
from antdsl.outputs.pictures.model import Trail
from antdsl.outputs.pictures.vectors import Floats

Array = NDArray[np.float64]

_MOST_VOXELS = 40_000_000


class TrailCloth:
    """Where the samples of a stage lie among a trail's cells: made once a camera, then coloured each frame.

    `points` (n, 3): the places of the samples that lie on ground."""

    def __init__(self, points: Floats, cell: float) -> None:
        low, high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
        self.cell = cell
        while np.prod(np.ceil((high - low) / self.cell) + 4) > _MOST_VOXELS:
            self.cell *= 1.26
        self.low = low - 1.5 * self.cell
        self.shape = tuple(int(v) for v in np.ceil((high - low) / self.cell) + 4)
        scaled = (points - self.low.astype(np.float32)) * np.float32(1 / self.cell) - np.float32(0.5)
        whole = np.maximum(np.floor(scaled), 0)
        self.part = scaled - whole
        first = whole.astype(np.int32)
        _, b, c = self.shape
        self.first = (first[:, 0] * b + first[:, 1]) * c + first[:, 2]
        own = np.floor(scaled + np.float32(0.5)).astype(np.int32)
        taken = np.zeros(int(np.prod(self.shape)), np.float32)
        taken[(own[:, 0] * b + own[:, 1]) * c + own[:, 2]] = 1
        self.taken = taken
        self.weight = np.maximum(self._between(taken), np.float32(1e-6))

    def _between(self, voxels: Floats) -> Floats:
        """Trilinear values at the samples."""
        _, b, c = self.shape
        x, y, z = self.part.T
        rows = []
        for step in (0, c, b * c, b * c + c):
            low = voxels.take(self.first + np.int32(step))
            rows.append(low + (voxels.take(self.first + np.int32(step + 1)) - low) * z)
        between: Floats = (rows[0] + (rows[1] - rows[0]) * y) * (1 - x) + (rows[2] + (rows[3] - rows[2]) * y) * x
        return between

    def share(self, trail: Trail) -> Floats:
        """How much of the ground (n,) the trail covers at the samples, 0..1: cells where no sample lies do not thin out those
        beside them."""
        inside = (trail.position >= self.low) & (trail.position < self.low + self.cell * np.asarray(self.shape))
        kept = np.flatnonzero(inside.all(axis=1) & (trail.strength > 0))
        at = ((trail.position[kept] - self.low) / self.cell).astype(np.int64)
        _, b, c = self.shape
        voxels = np.zeros(len(self.taken), np.float32)
        np.maximum.at(voxels, (at[:, 0] * b + at[:, 1]) * c + at[:, 2], cover(trail)[kept])
        return self._between(voxels * self.taken) / self.weight


def robust_full(strength: Array) -> float:
    """The strength to be drawn strongest: what a twentieth of the cells that hold any lie above; 0 when none does."""
    held = strength[strength > 0]
    return float(np.quantile(held, 0.95)) if len(held) else 0.0


def cover(trail: Trail) -> Floats:
    """Share of the ground (n,) that each cell's scent covers. Scent spans many powers of ten, of which the faint ones lead
    the way too: the 0.4th power shows a thousandth of the strongest as a sixteenth."""
    full = trail.full if trail.full is not None else robust_full(trail.strength)
    share = np.clip(np.asarray(trail.strength, np.float64) / max(full, 1e-30), 0.0, 1.0) ** 0.4
    return np.asarray(share, np.float32)


def dyed(albedo: Floats, share: Floats, trail: Trail) -> Floats:
    """Ground colours (n, 3) with the trail on them; its strongest covers most of the ground's own colour."""
    return albedo + (decoded(trail.colour) - albedo) * (0.85 * share)[:, None]
