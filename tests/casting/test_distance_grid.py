"""Lower bounds of distances: those of the cells, by their own arithmetic, and never more than the distance."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.casting.distance_grid import DistanceGrid
from antdsl.casting.faces import find_nearest_on_triangle


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("threads", [1, 2])
def test_lower_bounds_equal_those_of_the_nearest_cell(kind: type, threads: int) -> None:
    rng = np.random.default_rng(3)
    corners = rng.normal(0, 100, (60, 1, 3)) * [1, 0.5, 0.3] + rng.normal(0, 3, (60, 3, 3))
    grid, points = DistanceGrid(corners, 20_000), (rng.normal(0, 110, (9000, 3)) * [1.3, 0.6, 0.4]).astype(kind)
    points[:4] = [[np.nan] * 3, [np.inf, 0, 0], [0, -np.inf, 0], [1e30, 0, np.nan]]
    low, high, size, width = grid._cell_layout
    at = points.astype(np.float64)
    inside = np.fmin(np.fmax(at, low), high)
    cell = np.minimum(np.floor((inside - low) * (1.0 / width)).astype(int), size - 1)
    least = grid._cell_bounds[(cell[:, 0] * size[1] + cell[:, 1]) * size[2] + cell[:, 2]]
    with np.errstate(all="ignore"):
        gap = at - inside
        outside = (gap[:, 0] * gap[:, 0] + gap[:, 1] * gap[:, 1]) + gap[:, 2] * gap[:, 2]
        away = np.sqrt((least * least).astype(np.float64) + outside) * (1 - 1e-5)
    bounds = grid.compute_lower_bounds(*np.ascontiguousarray(points.T), threads)
    assert bounds.dtype == np.float32
    assert np.array_equal(bounds, np.where(outside > 0, away, least).astype(np.float32))
    assert (bounds[4:] == 0).sum() > 50 and ((bounds > 0) & (outside == 0)).sum() > 1000 and (outside > 0).sum() > 1000
    for k in range(4, 9000, 60):
        point = np.broadcast_to(at[k], (len(corners), 3))
        distance = np.sqrt(((find_nearest_on_triangle(point, corners) - point) ** 2).sum(axis=1)).min()
        assert bounds[k] <= distance * (1 + 1e-6)
    assert not len(grid.compute_lower_bounds(*np.empty((3, 0), kind)))
