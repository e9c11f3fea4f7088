"""Pairs of places that are near each other, and what hangs together by pairs, against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from antdsl.numerics import near_pairs
from antdsl.numerics.near_pairs import find_pairs_between, find_pairs_within
from antdsl.scene.geometry.live_faces import number_connected_components


def random_points(count: int, size: float, seed: int = 0) -> np.ndarray:
    """Random places, a third of them on a lattice, where some are at one place."""
    points = np.random.default_rng(seed).uniform(-size, size, (count, 3))
    points[::3] = np.round(points[::3], 1)
    return points


@pytest.mark.parametrize("count", [0, 1, 2, 700])
@pytest.mark.parametrize("reach", [0.01, 0.1, 0.35])
def test_pairs_equal_those_of_a_tree(count: int, reach: float, monkeypatch: pytest.MonkeyPatch) -> None:
    own, others = random_points(count, 1.0), random_points(count // 2, 1.1, 1)
    expected = cKDTree(own).query_pairs(reach) if count else set()
    between = (
        {(i, j) for i, row in enumerate(cKDTree(own).query_ball_tree(cKDTree(others), reach)) for j in row}
        if count > 1
        else set()
    )
    for at_once in (1 << 20, 50):
        monkeypatch.setattr(near_pairs, "_CELLS_PER_CHUNK", at_once)
        one, two = find_pairs_within(own, reach)
        assert sorted(zip(one.tolist(), two.tolist(), strict=True)) == sorted(expected)
        one, two = find_pairs_between(own, others, reach)
        assert sorted(zip(one.tolist(), two.tolist(), strict=True)) == sorted(between)


def test_pairs_at_the_maximum_distance_count() -> None:
    lattice = np.stack(np.meshgrid(*[np.arange(5.0)] * 3), axis=-1).reshape(-1, 3)
    assert len(find_pairs_within(lattice, 1.0)[0]) == 3 * 4 * 25


def test_many_cells_give_equal_pairs() -> None:
    far = np.concatenate([random_points(50, 1.0), random_points(50, 1.0) + 1e13])
    one, two = find_pairs_within(far, 1e-3)
    assert sorted(zip(one.tolist(), two.tolist(), strict=True)) == sorted(cKDTree(far).query_pairs(1e-3))


@pytest.mark.parametrize(("count", "pairs"), [(0, 0), (5, 0), (10, 6), (2000, 900), (2000, 1900), (2000, 9000)])
def test_components_are_numbered_by_their_first_member(count: int, pairs: int) -> None:
    joined = np.random.default_rng(pairs).integers(0, max(count, 1), (pairs, 2))
    expected = (
        connected_components(coo_array((np.ones(pairs), joined.T), shape=(count, count)), directed=False)[1] if count else []
    )
    assert number_connected_components(joined, count).tolist() == list(expected)


def test_a_long_chain_is_one_component() -> None:
    order = np.random.default_rng(3).permutation(20_000)
    assert number_connected_components(np.stack([order[:-1], order[1:]], axis=1), len(order)).max() == 0
