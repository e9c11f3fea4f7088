"""Curves drawn by artists. They are resampled at equal spacing, and queried for the nearest point and its tangent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import Vectors
from antdsl.numerics.vector_rows import normalise

_MAX_SAMPLES = 4096
_NEAREST_SAMPLE_COUNT = 6  # samples of the first query; sufficient except for agents far from a bend


@dataclass(frozen=True, slots=True)
class ClosestCurvePoints:
    """The curve point nearest to each query point: its distance (mm), its position (mm) and the unit tangent there, all
    float32[n]."""

    distance: NDArray[np.float32]
    px: NDArray[np.float32]
    py: NDArray[np.float32]
    pz: NDArray[np.float32]
    tx: NDArray[np.float32]
    ty: NDArray[np.float32]
    tz: NDArray[np.float32]


class SampledCurve:
    """A polyline float64[n,3] (mm), n >= 1, resampled into pieces of equal length, at most `spacing` mm.

    The spacing is larger if the curve would have too many samples. Tangents point from the first point to the last, or with
    `reverse` from the last to the first. The tangent of a curve with one point is 0. Raises ValueError if there is no point, or a
    point is not finite."""

    def __init__(self, points: Vectors, spacing: float, reverse: bool = False) -> None:
        points = np.asarray(points, np.float64).reshape(-1, 3)
        if not len(points) or not np.isfinite(points).all():
            raise ValueError("a curve needs at least one point, and all of its coordinates must be finite numbers")
        if not spacing > 0:
            raise ValueError("the spacing of a curve must be more than 0")
        self.samples = resample_curve(points[::-1] if reverse else points, spacing)
        self._segment_vectors = np.diff(self.samples, axis=0)
        self._segment_lengths = np.sqrt((self._segment_vectors * self._segment_vectors).sum(axis=1))
        self.length = float(self._segment_lengths.sum())
        directions = normalise(self._segment_vectors)
        self._tangent = normalise(np.concatenate([directions[:1], directions[:-1] + directions[1:], directions[-1:]]))
        self._sample_tree: Any = None

    def find_closest(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any]) -> ClosestCurvePoints:
        """Return the nearest point of the curve to each position (1-D arrays, mm). Of equally near points, the first along the
        curve is returned.

        The result is exact for the resampled curve. The nearest sample gives an upper bound of the distance. Only segments within
        this bound, plus the length of one piece, can contain the nearest point. Positions that are not finite get an infinite
        distance."""
        from scipy.spatial import cKDTree

        if self._sample_tree is None:
            self._sample_tree = cKDTree(self.samples)
        place = np.stack([np.asarray(a, np.float64) for a in (x, y, z)], axis=1)
        finite = np.isfinite(place).all(axis=1)
        place[~finite] = 0.0
        if len(self.samples) == 1:
            point, tangent = np.broadcast_to(self.samples[0], place.shape), np.zeros_like(place)
        else:
            point, tangent = self._find_nearest_points(place)
        offset = point - place
        distance = np.where(finite, np.sqrt((offset[:, 0] ** 2 + offset[:, 1] ** 2) + offset[:, 2] ** 2), np.inf)
        columns = (distance, *point.T, *tangent.T)
        return ClosestCurvePoints(*(np.ascontiguousarray(c, np.float32) for c in columns))

    def _find_nearest_points(self, positions: Vectors) -> tuple[Vectors, Vectors]:
        """Return the nearest points [n,3] of the curve to positions [n,3], and the tangents [n,3] there."""
        neighbour_count = min(_NEAREST_SAMPLE_COUNT, len(self.samples))
        gap, sample = self._sample_tree.query(positions, k=list(range(1, neighbour_count + 1)))
        best = self._find_nearest_segment(positions, sample)
        # A segment nearer than the nearest sample has an end within that distance plus half a piece.
        reach = np.sqrt(gap[:, 0] ** 2 + (self._segment_lengths.max() / 2) ** 2) * (1 + 1e-9) + 1e-12
        for row in np.flatnonzero((gap[:, -1] <= reach) & (neighbour_count < len(self.samples))):
            near = self._sample_tree.query_ball_point(positions[row], reach[row])
            best[row] = self._find_nearest_segment(positions[row : row + 1], np.asarray(near, np.int64)[None])[0]
        part = self._project_on_segment(positions, best)[0][:, None]
        # The tangent rotates evenly along each piece, so that agents that follow the curve do not jerk.
        tangent = self._tangent[best] * (1 - part) + self._tangent[best + 1] * part
        return self.samples[best] + part * self._segment_vectors[best], normalise(tangent)

    def _find_nearest_segment(self, positions: Vectors, sample: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of the segment nearest to each position. `sample`: int[n,k], the samples next to which segments are
        searched. Of equally near segments, the first is returned."""
        segment = np.sort(np.clip(np.concatenate([sample - 1, sample], axis=1), 0, len(self._segment_vectors) - 1), axis=1)
        gaps = np.stack([self._project_on_segment(positions, column)[1] for column in segment.T], axis=1)
        best: NDArray[np.int64] = segment[np.arange(len(positions)), gaps.argmin(axis=1)]
        return best

    def _project_on_segment(
        self, positions: Vectors, segment: NDArray[np.int64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Project each position onto its segment. Return the fraction (0 to 1) along the segment, and the squared distance."""
        offset, step = positions - self.samples[segment], self._segment_vectors[segment]
        square = self._segment_lengths[segment] ** 2
        projection = (offset[:, 0] * step[:, 0] + offset[:, 1] * step[:, 1]) + offset[:, 2] * step[:, 2]
        part = np.clip(projection / np.where(square > 0, square, 1.0), 0.0, 1.0)
        offset = offset - part[:, None] * step
        return part, (offset[:, 0] ** 2 + offset[:, 1] ** 2) + offset[:, 2] ** 2


def resample_curve(points: Vectors, spacing: float) -> Vectors:
    """Return points [k,3] at equal spacing along a polyline [n,3], including both ends. The spacing is at most `spacing`, unless
    this would give too many points."""
    step = np.sqrt((np.diff(points, axis=0) ** 2).sum(axis=1))
    has_length = np.concatenate(([True], step > 0))
    points, arc_lengths = points[has_length], np.concatenate(([0.0], np.cumsum(step[step > 0])))
    if len(points) == 1:
        return points
    pieces = int(min(max(np.ceil(arc_lengths[-1] / spacing - 1e-9), 1), _MAX_SAMPLES))
    sample_lengths = np.linspace(0.0, arc_lengths[-1], pieces + 1)
    samples = np.stack([np.interp(sample_lengths, arc_lengths, points[:, axis]) for axis in range(3)], axis=1)
    samples[0], samples[-1] = points[0], points[-1]
    return samples
