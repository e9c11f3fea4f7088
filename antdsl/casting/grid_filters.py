"""Filters of grids: the minimum or maximum of surrounding cells, and the distance to the nearest cell that is not free. Results
are bit-identical to those of SciPy's `ndimage`. SciPy is not used, because its import takes longer than all filters of a
scene."""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

GridValue = TypeVar("GridValue", np.bool_, np.int32)

_MAX_SQUARED_DISTANCE = 1 << 29  # exceeds the squared length of any grid; the sum of two fits into int32


def filter_maximum(grid: NDArray[GridValue], rings: int) -> NDArray[GridValue]:
    """Return a grid in which each cell has the maximum of the cells at most `rings` cells away along every axis."""
    return _filter_neighbourhood(grid, rings, np.maximum)


def filter_minimum(grid: NDArray[GridValue], rings: int) -> NDArray[GridValue]:
    """Return a grid in which each cell has the minimum of the cells at most `rings` cells away along every axis."""
    return _filter_neighbourhood(grid, rings, np.minimum)


def _filter_neighbourhood(grid: NDArray[GridValue], rings: int, combine: Any) -> NDArray[GridValue]:
    """Combine each cell with the cells at most `rings` cells away along every axis. `combine`: a function of two arrays, such as
    `np.maximum`."""
    for axis in range(grid.ndim):
        for flip in (False, True):  # first the following cells, then the preceding ones
            line = np.moveaxis(grid, axis, 0)
            line = line[::-1] if flip else line
            width, window = 1, min(rings + 1, len(line))
            while width < window:
                step = min(width, window - width)
                ahead = line.copy()
                combine(line[:-step], line[step:], out=ahead[:-step])
                line, width = ahead, width + step
            grid = np.moveaxis(line[::-1] if flip else line, 0, axis)
    return np.ascontiguousarray(grid)


def compute_blocked_distances(is_free: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return, for each cell, the distance to the nearest cell that is not free. It is in cells, from centre to centre.

    At least one cell must not be free. The axes are processed one after another. In each pass, the new squared distance of a cell
    is a minimum over all cells on its line: their previous squared distance plus the square of the offset along the line."""
    square = np.where(is_free, np.int32(_MAX_SQUARED_DISTANCE), np.int32(0))
    for axis in np.argsort(is_free.shape, kind="stable"):  # after the shortest axis, few cells are far from all blocked cells
        line = np.moveaxis(square, axis, 0)
        nearest = line.copy()
        for step in range(1, len(line)):
            if step * step >= int(nearest.max()):
                break
            np.minimum(nearest[step:], line[:-step] + np.int32(step * step), out=nearest[step:])
            np.minimum(nearest[:-step], line[step:] + np.int32(step * step), out=nearest[:-step])
        square = np.moveaxis(nearest, 0, axis)
    return np.sqrt(np.ascontiguousarray(square).astype(np.float64))
