"""A coarse grid with lower bounds of the distance to the nearest triangle. With it, a few array operations exclude all agents
that are far from triangles."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.grid_filters import compute_blocked_distances
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.machine_code.kernels import F32, F64, I64, Array1, inlined, kernel, round_to_int, simd_range
from antdsl.numerics import parallel, stored_tables
from antdsl.numerics.vector_rows import dot

_TARGET_CELL_COUNT = 250_000  # a table of this size stays in the processor's cache together with all other data of a step
_MAX_LISTED_CELLS = 4_000_000  # maximum number of pairs of a triangle and a touched cell
_MAX_REFINED_CELLS = 150_000  # each takes about 2 microseconds

PointColumns = tuple[Array1[F32], Array1[F32], Array1[F32]]
PointColumns64 = tuple[Array1[F64], Array1[F64], Array1[F64]]
CellLayout = tuple[Array1[F64], Array1[F64], Array1[I64], F64]  # lowest and highest corner, cells along each axis, cell width


class DistanceGrid:
    """Lower bounds of the distance from positions to a set of triangles, with corners float64[m,3,3] (mm).

    `store_tables`: whether to store the bounds for later runs."""

    def __init__(self, corners: NDArray[np.float64], target_cells: int = _TARGET_CELL_COUNT, store_tables: bool = True) -> None:
        self._low = corners.min(axis=(0, 1)) if len(corners) else np.zeros(3)
        extent = (corners.max(axis=(0, 1)) if len(corners) else np.zeros(3)) - self._low
        self._width = limit_cell_width(corners, choose_cell_width(extent, target_cells))
        self._size = np.floor(extent / self._width).astype(np.int64) + 1
        self._high = self._low + extent
        self._cell_layout = (self._low, self._high, self._size, self._width)
        work = partial(self._compute_cell_bounds, corners)
        size = int(np.prod(self._size)) if store_tables else 0
        self._cell_bounds = stored_tables.get_or_compute("distance grid", size, (corners, float(target_cells)), work, "cells")[
            "least"
        ]

    def _compute_cell_bounds(self, corners: NDArray[np.float64]) -> stored_tables.Tables:
        """Return the table of lower bounds (mm). For every point of a cell, all triangles are at least as far away as the cell's
        bound."""
        free = np.ones(tuple(self._size), bool)
        for cell, _ in iterate_triangle_cells((corners - self._low) / self._width, exact=False):
            cell = np.minimum(cell, self._size - 1)
            free[cell[:, 0], cell[:, 1], cell[:, 2]] = False
        cell_distances = compute_blocked_distances(free) if len(corners) else np.full(tuple(self._size), np.inf)
        # The query point and the triangle may be anywhere in their cells: add two half diagonals.
        bounds = np.maximum((cell_distances - np.sqrt(3.0)) * self._width * (1 - 1e-6), 0.0).astype(np.float32).ravel()
        return {"least": bounds}

    def refine_near_cells(self, distance: Callable[[NDArray[np.float64]], NDArray[np.float64]]) -> None:
        """Measure cells near triangles, which raises their lower bounds. `distance`: a function that returns the distances (mm)
        of points [n,3] from the nearest triangle.

        Measured bounds are too low by at most half the diagonal of a cell, others by at most twice as much. Nothing is measured
        if this would take longer than a crowd can save by it in a few hundred steps."""
        near = np.flatnonzero(self._cell_bounds < 2 * self._width)
        if near.size > _MAX_REFINED_CELLS:
            return
        cells = np.stack(np.unravel_index(near, tuple(self._size)), axis=1)
        measured_distances = distance(self._low + (cells + 0.5) * self._width)
        error = 2e-3 + 2e-6 * float((self._high - self._low).max())  # mm: rounding error of float32
        refined_bounds = measured_distances - np.sqrt(0.75) * self._width * (1 + 1e-6) - error
        self._cell_bounds[near] = np.maximum(self._cell_bounds[near], refined_bounds.astype(np.float32))

    def compute_lower_bounds(self, x: NDArray[Any], y: NDArray[Any], z: NDArray[Any], threads: int = 1) -> NDArray[np.float32]:
        """Return a lower bound (mm, float32[n]) of the distance from each position to the nearest triangle. It is 0 near
        triangles."""
        least_distances, columns = np.empty(len(x), np.float32), (x, y, z)
        single = all(each.dtype == np.float32 for each in columns)
        if not single:
            columns = (x.astype(np.float64), y.astype(np.float64), z.astype(np.float64))
        work = partial(
            write_lower_bounds if single else write_lower_bounds64,
            parallel.make_contiguous(*columns),
            self._cell_layout,
            self._cell_bounds,
            least_distances,
        )
        parallel.run_in_parts(work, len(x), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)
        return least_distances


@inlined
def _compute_lower_bound(cells: CellLayout, cell_bounds: Array1[F32], px: F64, py: F64, pz: F64) -> F32:
    """Return a lower bound (mm) of the distance from a position to the nearest triangle."""
    low, high, size, width = cells
    part = 1.0 / width
    ix, iy, iz = (
        _clamp_coordinate(px, low[0], high[0]),
        _clamp_coordinate(py, low[1], high[1]),
        _clamp_coordinate(pz, low[2], high[2]),
    )
    gx, gy, gz = px - ix, py - iy, pz - iz
    outside = (gx * gx + gy * gy) + gz * gz
    cell = min(_to_cell_number((ix - low[0]) * part), size[0] - 1) * size[1] + min(
        _to_cell_number((iy - low[1]) * part), size[1] - 1
    )
    cell = cell * size[2] + min(_to_cell_number((iz - low[2]) * part), size[2] - 1)
    cell_bound = cell_bounds[cell]
    # The position in the box is a projection, so the angle between both distances is at least a right angle.
    bound = np.float32(np.sqrt(np.float64(cell_bound * cell_bound) + outside) * (1 - 1e-5))
    return bound if outside > 0 else cell_bound


@kernel
def write_lower_bounds(
    positions: PointColumns, cells: CellLayout, cell_bounds: Array1[F32], bounds: Array1[F32], begin: I64, end: I64
) -> None:
    """Write a lower bound (mm) of the distance to the nearest triangle into `bounds`, for the positions `begin` to `end`
    (exclusive)."""
    x, y, z = positions
    for n in simd_range(begin, end):
        bounds[n] = _compute_lower_bound(cells, cell_bounds, np.float64(x[n]), np.float64(y[n]), np.float64(z[n]))


@kernel
def write_lower_bounds64(
    positions: PointColumns64, cells: CellLayout, cell_bounds: Array1[F32], bounds: Array1[F32], begin: I64, end: I64
) -> None:
    """Write lower bounds for positions in float64. Otherwise the same as `write_lower_bounds`."""
    x, y, z = positions
    for n in simd_range(begin, end):
        bounds[n] = _compute_lower_bound(cells, cell_bounds, x[n], y[n], z[n])


@inlined
def _to_cell_number(place: F64) -> I64:
    """Return the cell number along one axis for the coordinate `place` (in cells), which must not be negative."""
    return round_to_int(np.floor(place))


@inlined
def _clamp_coordinate(place: F64, low: F64, high: F64) -> F64:
    """Return the coordinate `place`, clamped to the range from `low` to `high`. NaN becomes `low`."""
    inside = place if place > low else low
    return inside if inside < high else high


def choose_cell_width(extent: NDArray[np.float64], cells: int) -> float:
    """Return the edge length of cubes of which about `cells` fill a box with the sides `extent`. A short side counts as one
    cube."""
    longest = float(extent.max())
    if not longest > 0:
        return 1.0
    low, high = longest / cells, longest
    for _ in range(60):
        middle = (low * high) ** 0.5
        if float(np.prod(np.floor(extent / middle) + 1)) > cells:
            low = middle
        else:
            high = middle
    return high


def limit_cell_width(corners: NDArray[np.float64], width: float) -> float:
    """Return an edge length of cubes, at least `width`, with which listing the cubes that triangles touch takes a few seconds at
    most. `corners`: float64[m,3,3], those of the triangles."""
    lengths, area = measure_sides_and_area(corners)
    perimeter = float(lengths.sum())
    while 3 * area / width**2 + 2 * perimeter / width > _MAX_LISTED_CELLS + 8.0 * len(corners):
        width *= 1.25
    return width


def measure_sides_and_area(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Return the side lengths (3, m) of triangles (m, 3, 3), and their total area."""
    sides = [corners[:, (k + 1) % 3] - corners[:, k] for k in range(3)]
    normal = np.cross(sides[0], sides[1])
    lengths: NDArray[np.float64] = np.sqrt(np.stack([dot(side, side) for side in sides]))
    return lengths, float(np.sqrt(dot(normal, normal)).sum() / 2)
