"""Onto the zero level: Newton steps along the gradient, bounded, and never over to a wall that faces the other way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.solids.bricks import Bricks
from antdsl.runtime.solids.trilinear import sample_and_gradient

Floats = NDArray[np.float64]

_STEPS = 8
_CLOSE = 1e-5  # voxels


@dataclass(frozen=True, slots=True)
class Projected:
    """Places on the surface float64[n,3], unit normals out of the solid float64[n,3], and whether one was found in reach."""

    points: Floats
    normals: Floats
    found: NDArray[np.bool_]


def project(bricks: Bricks, points: Floats, hints: Floats, reach: float | None = None) -> Projected:
    """As `Volume.project`; where nothing is found the point stays, with its hint."""
    start = np.array(points, np.float64).reshape(-1, 3)
    hint = np.asarray(hints, np.float64).reshape(-1, 3)
    far = 2 * bricks.voxel if reach is None else float(reach)
    place = start.copy()
    for _ in range(_STEPS):
        distance, gradient = sample_and_gradient(bricks, place)
        slope = gradient.astype(np.float64)
        size = (slope * slope).sum(axis=1)
        slope = np.where((size < 0.01)[:, None], hint, slope)
        step = -distance / np.maximum((slope * slope).sum(axis=1), 1e-3)
        length = np.abs(step) * np.sqrt((slope * slope).sum(axis=1))
        step *= np.minimum(1.0, 0.5 * bricks.voxel / np.maximum(length, 1e-30))
        place += slope * step[:, None]
    distance, gradient = sample_and_gradient(bricks, place)
    normal = gradient.astype(np.float64)
    size = np.sqrt((normal * normal).sum(axis=1))
    normal = np.where((size > 1e-6)[:, None], normal / np.maximum(size, 1e-30)[:, None], hint)
    moved = np.sqrt(((place - start) ** 2).sum(axis=1))
    found = (np.abs(distance) <= _CLOSE * bricks.voxel) & (moved <= far) & ((normal * hint).sum(axis=1) > -0.5)
    return Projected(np.where(found[:, None], place, start), np.where(found[:, None], normal, hint), found)
