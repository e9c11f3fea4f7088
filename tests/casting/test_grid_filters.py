"""Filters of grids against those of SciPy, to the bit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from antdsl.casting.grid_filters import compute_blocked_distances, filter_maximum, filter_minimum

SHAPES = [(1, 1, 1), (5, 1, 7), (30, 4, 50), (2, 90, 3), (40, 40, 40)]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("rings", [0, 1, 2, 5, 31, 200])
def test_filters_equal_a_search_of_the_neighbourhood(shape: tuple[int, ...], rings: int) -> None:
    random = np.random.default_rng(rings)
    for grid in (random.random(shape) < 0.02, random.integers(-9, 50, shape).astype(np.int32)):
        original = grid.copy()
        most, least = filter_maximum(grid, rings), filter_minimum(grid, rings)
        assert most.dtype == least.dtype == grid.dtype and (grid == original).all()
        assert np.array_equal(most, maximum_filter(grid, 2 * rings + 1, mode="nearest"))
        assert np.array_equal(least, minimum_filter(grid, 2 * rings + 1, mode="nearest"))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.0, 0.001, 0.05, 0.7])
def test_distances_to_blocked_cells_equal_scipy(shape: tuple[int, ...], share: float) -> None:
    taken = np.random.default_rng(5).random(shape) < share
    taken.flat[taken.size // 3] = True
    assert np.array_equal(compute_blocked_distances(~taken), distance_transform_edt(~taken))
