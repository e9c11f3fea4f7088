"""Queries of one solid for walks: where a path enters it, which point is below a position, and which direction leads out of
it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid import Volume
from antdsl.ground.solid_feelers import SolidProximityQueries
from antdsl.numerics.vector_rows import length

Floats = NDArray[np.float64]

_SAMPLES_PER_STEP = 8  # samples of a step that are tested for an entry into a solid
_ENTRY_REFINEMENTS = 5  # number of refinements: the interval with the entry is sampled again


def find_entry_fraction(volume: Volume, start: Floats, end: Floats) -> Floats:
    """Return the fraction of each path from `start` to `end` before it first enters the solid. `end` must be in the solid.

    The result is the fraction at the last sample in air, or 0 if `start` is not in air."""
    free, long = np.zeros(len(start)), 1.0
    for _ in range(_ENTRY_REFINEMENTS):
        parts = free + long * (np.arange(_SAMPLES_PER_STEP) / _SAMPLES_PER_STEP)[:, None]
        positions = start + parts[:, :, None] * (end - start)
        solid = (volume.sample_distances(positions.reshape(-1, 3)) < 0).reshape(parts.shape)
        first = np.where(solid.any(axis=0), solid.argmax(axis=0), _SAMPLES_PER_STEP)
        long /= _SAMPLES_PER_STEP
        free += np.maximum(first - 1, 0) * long
    return free


def compute_solid_normals(volume: Volume, place: Floats) -> Floats:
    """Return unit normals float64[n,3] that point out of a solid. They are zero where the distance field is flat."""
    slope = volume.sample_gradients(place).astype(np.float64)
    normal: Floats = slope / np.maximum(length(slope), 1e-12)[:, None]
    return normal


def find_top_points(volume: Volume, points: Floats, up: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the first point of a solid that a ray from far above each point along -`up` hits, and whether the ray hits."""
    height = float(length((volume.high - volume.low)[None, :])[0])
    middle = (volume.low + volume.high) / 2
    start = points + up * (((middle - points) * up).sum(axis=1) + height)[:, None]
    return find_points_below(volume, start, up, 2 * height)


def find_points_below(volume: Volume, start: Floats, up: Floats, reach: Floats | float) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the first point of a solid that a ray from `start` along -`up` hits within `reach` (mm), and whether the ray
    hits."""
    hits = SolidProximityQueries(volume).cast_feelers(start.T, -up.T, reach)
    place = start - up * np.where(hits.hit, hits.t, 0.0)[:, None]
    landed = volume.project_to_surface(place, up, 2 * volume.voxel)
    return landed.points, hits.hit & landed.is_in_reach
