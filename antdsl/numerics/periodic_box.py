"""The box of a periodic world. Anything that leaves it on one side re-enters on the opposite side.

The box has width 0 along an axis that does not wrap. Each position has images, one box width apart along each wrapped axis.
The offset between two positions is measured to the nearest image."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
_REACH_SLACK_SHARE = 1e-4  # share of the greatest width; exceeds the rounding of positions


@dataclass(frozen=True, slots=True)
class PeriodicBox:
    """The low corner and the widths (mm) of a periodic world; each has three values, for x, y and z."""

    low: tuple[float, float, float]
    widths: tuple[float, float, float]

    @property
    def axes(self) -> tuple[int, ...]:
        """Return the axes that wrap: 0 for x, 1 for y, 2 for z."""
        return tuple(axis for axis in range(3) if self.widths[axis])

    @property
    def least_width(self) -> float:
        """Return the width (mm) along the narrowest axis that wraps."""
        return min(self.widths[axis] for axis in self.axes)

    @property
    def inverse_table(self) -> Floats:
        """Return the three widths (mm), then their inverses, float64[6]. Both are 0 for axes that do not wrap."""
        return np.array([*self.widths, *(1 / width if width else 0.0 for width in self.widths)])

    def shift(self, offset: Floats) -> PeriodicBox:
        """Return the box for positions relative to the origin `offset` (3,) mm, that is, moved by -`offset`."""
        x, y, z = (float(low - by) for low, by in zip(self.low, offset, strict=True))
        return PeriodicBox((x, y, z), self.widths)

    def count_widths(self, points: Floats) -> NDArray[np.int64]:
        """Return by how many box widths each of `points` (n, 3) mm is outside the box along each axis, int64[n, 3]. The number
        is 0 inside the box and on its sides."""
        counts = np.zeros(points.shape, np.int64)
        for axis in self.axes:
            low, width = self.low[axis], self.widths[axis]
            values = points[:, axis]
            outside = np.isfinite(values) & ~((values >= low) & (values <= low + width))
            if outside.any():
                counts[outside, axis] = np.floor((values[outside] - low) / width)
        return counts

    def wrap_points(self, points: Floats) -> Floats:
        """Return `points` (n, 3) mm moved into the box by whole box widths."""
        return self.move_points(points, -self.count_widths(points))

    def move_points(self, points: Floats, counts: NDArray[np.int64]) -> Floats:
        """Return `points` (n, 3) mm moved by `counts` (n, 3) box widths along the axes."""
        return points + counts * np.array(self.widths) if counts.any() else points

    def find_nearest_images(self, offsets: NDArray[Any]) -> NDArray[Any]:
        """Return how many box widths to add to each of `offsets` (n, 3) mm to make it shortest, int64[n, 3].

        The number is 0 for components of exactly half a width."""
        counts = np.zeros(offsets.shape, np.int64)
        for axis in self.axes:
            half = offsets.dtype.type(self.widths[axis] / 2)
            counts[:, axis] = (offsets[:, axis] < -half).astype(np.int64) - (offsets[:, axis] > half)
        return counts

    def list_images(self) -> list[NDArray[np.int64]]:
        """Return all periodic images of the box that touch the box, each as its offset in box widths, int64[3]. The first one is
        the box itself."""
        return [np.array(step, np.int64) for step in product(*((0, -1, 1) if width else (0,) for width in self.widths))]

    def find_image_rows(self, position: tuple[NDArray[Any], ...], reach: float) -> tuple[NDArray[np.intp], tuple[Any, ...]]:
        """Return all positions, and all their periodic images that are within `reach` (mm) of the box. `position`: x, y and z
        (mm). The results are rows, and coordinates (x, y, z) of the same length. The original positions come first."""
        reach += _REACH_SLACK_SHARE * max(self.widths)
        rows, positions = [np.arange(len(position[0]))], [position]
        for image in self.list_images()[1:]:
            moved, near = [], np.ones(len(position[0]), np.bool_)
            for own, low, width, count in zip(position, self.low, self.widths, image.tolist(), strict=True):
                coordinate = own + own.dtype.type(count * width) if count else own
                near &= (coordinate >= low - reach) & (coordinate <= low + width + reach) if width else True
                moved.append(coordinate)
            chosen = np.flatnonzero(near)
            rows.append(chosen)
            positions.append(tuple(each.take(chosen) for each in moved))
        return np.concatenate(rows), tuple(np.concatenate(each) for each in zip(*positions, strict=True))


def measure_offset(first: NDArray[Any], second: NDArray[Any], width: float) -> NDArray[Any]:
    """Return the offset from `second` to the nearest image of `first` along one axis, mm, float32. `width`: the box width
    (mm); 0 if the axis does not wrap. The plain difference decides which image is nearest. The result is then computed from
    the coordinate of this image. So a grid that stores images of all agents gives the same bits."""
    offset: NDArray[Any] = first - second
    if not width:
        return offset
    half, step = np.float32(width / 2), np.float32(width)
    offset = np.where(offset > half, (first - step) - second, offset)
    return np.where(first - second < -half, (first + step) - second, offset)
