"""Neighbours: the cell grid against SciPy's tree, whatever the order of rows, with crowds on one spot and odd input."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from antdsl import limits
from antdsl.numerics import parallel
from antdsl.senses.neighbours import CellGrid, NeighbourPairs


def crowd(n: int, extent: tuple[float, float, float], seed: int = 1) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return tuple(rng.uniform(-0.5 * e, 0.5 * e, n).astype(np.float32) for e in extent)


def by_brute_force(x, y, z, ids, qx, qy, qz, qid, radius) -> set[tuple[int, int]]:
    dx, dy, dz = (a[None, :] - q[:, None] for a, q in ((x, qx), (y, qy), (z, qz)))
    distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
    near = distance <= np.broadcast_to(np.asarray(radius, np.float32), qx.shape)[:, None]
    if qid is not None:
        near &= ids[None, :] != qid[:, None]
    return set(zip(*(a.tolist() for a in np.nonzero(near)), strict=True))


def as_ids(pairs: NeighbourPairs, ids: np.ndarray, seeker_ids: np.ndarray) -> list[tuple]:
    rows = zip(seeker_ids[pairs.i], ids[pairs.j], pairs.dx, pairs.dy, pairs.dz, pairs.distance, strict=True)
    return [tuple(v.item() for v in row) for row in rows]


@pytest.mark.parametrize("extent", [(300, 300, 300), (800, 0, 800), (900, 20, 900), (5000, 0, 0), (0, 0, 4000)])
@pytest.mark.parametrize("cell", [3.0, 20.0, 500.0])
def test_same_pairs_as_brute_force(extent, cell):
    x, y, z = crowd(900, extent)
    ids = np.arange(900, dtype=np.int64)
    pairs = CellGrid(x, y, z, ids, cell).find_pairs(None, 21.5)
    expected = by_brute_force(x, y, z, ids, x, y, z, ids, 21.5)
    assert len(expected) > 100
    assert set(zip(pairs.i.tolist(), pairs.j.tolist(), strict=True)) == expected
    assert pairs.i.size == len(expected)
    assert np.all(np.diff(pairs.i) >= 0)
    dx, dy, dz = (a[pairs.j] - a[pairs.i] for a in (x, y, z))
    assert np.array_equal(dx, pairs.dx) and np.array_equal(dz, pairs.dz)
    assert np.array_equal(np.sqrt((dx * dx + dy * dy) + dz * dz), pairs.distance)


def test_same_pairs_as_the_tree_of_scipy():
    x, y, z = crowd(15_000, (480, 30, 480))
    pairs = CellGrid(x, y, z, np.arange(15_000, dtype=np.int64), 7.0).find_pairs(None, 6.3)
    tree = cKDTree(np.stack([x, y, z], axis=1).astype(np.float64))
    mine = set(zip(pairs.i.tolist(), pairs.j.tolist(), strict=True))
    theirs = tree.query_pairs(6.3, output_type="ndarray")
    theirs = set(map(tuple, np.concatenate([theirs, theirs[:, ::-1]]).tolist()))
    borderline = mine ^ theirs  # float32 and float64 may part within rounding of the radius
    assert len(mine) > 30_000
    assert all(abs(np.hypot(np.hypot(x[i] - x[j], y[i] - y[j]), z[i] - z[j]) - 6.3) < 1e-5 for i, j in borderline)


def test_queries_have_separate_radii():
    x, y, z = crowd(700, (200, 10, 200))
    qx, qy, qz = crowd(300, (260, 30, 260), seed=2)
    radius = np.random.default_rng(3).uniform(0, 60, 300).astype(np.float32)
    radius[:3] = (0, np.nan, -1)
    grid = CellGrid(x, y, z, np.arange(700, dtype=np.int64), 10.0)
    pairs = grid.find_pairs(None, radius, qx=qx, qy=qy, qz=qz)
    assert set(zip(pairs.i.tolist(), pairs.j.tolist(), strict=True)) == by_brute_force(x, y, z, None, qx, qy, qz, None, radius)
    rows = np.array([200, 7, 7, 40], np.int32)
    row_pairs = grid.find_pairs(rows, radius[rows], qx=qx, qy=qy, qz=qz)
    for k, row in enumerate(rows):
        assert np.array_equal(row_pairs.j[row_pairs.i == k], pairs.j[pairs.i == row])


def test_the_order_of_rows_is_not_observable(monkeypatch):
    n = 2500
    x, y, z = crowd(n, (300, 20, 300))
    ids = np.arange(n, dtype=np.int64) * 3
    expected = as_ids(CellGrid(x, y, z, ids, 15.0).find_pairs(None, 14.0), ids, ids)
    order = np.random.default_rng(5).permutation(n)
    monkeypatch.setattr(parallel, "MIN_AGENTS_PER_THREAD", 37)
    grid = CellGrid(x[order], y[order], z[order], ids[order], 15.0)
    back = np.argsort(order).astype(np.int32)
    for threads in (1, 3):
        assert as_ids(grid.find_pairs(back, 14.0, threads=threads), ids[order], ids) == expected


def test_an_agent_far_away_changes_nothing_for_others():
    x, y, z = crowd(500, (100, 5, 100))
    ids = np.arange(501, dtype=np.int64)
    expected = sorted(as_ids(CellGrid(x, y, z, ids[:500], 9.0).find_pairs(None, 9.0), ids, ids))
    far = [np.append(a, np.float32(v)) for a, v in zip((x, y, z), (-70_000.0, 3e4, 1e5), strict=True)]
    assert sorted(as_ids(CellGrid(*far, ids, 9.0).find_pairs(None, 9.0), ids, ids)) == expected


def test_a_crowd_at_one_position_uses_the_lowest_ids():
    import tracemalloc

    n = 4000
    x = np.full(n, 12.5, np.float32)
    ids = np.random.default_rng(0).permutation(n).astype(np.int64)
    tracemalloc.start()
    pairs = CellGrid(x, x, x, ids, 5.0).find_pairs(None, 5.0)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 120e6  # all 16 million pairs at once would take more than three times this
    assert np.array_equal(np.bincount(pairs.i), np.full(n, limits.MAX_QUERY_NEIGHBOURS))
    last = ids[pairs.j[pairs.i == int(np.argmax(ids))]]
    assert sorted(last.tolist()) == list(range(limits.MAX_QUERY_NEIGHBOURS))


def test_empty_crowds_and_invalid_positions_are_accepted():
    none = np.empty(0, np.float32)
    assert CellGrid(none, none, none, np.empty(0, np.int64), 5.0).find_pairs(None, 5.0).i.size == 0
    x = np.array([0, 1, np.nan, np.inf, 1e30, 2], np.float32)
    zero = np.zeros(6, np.float32)
    pairs = CellGrid(x, zero, zero, np.arange(6, dtype=np.int64), 5.0).find_pairs(None, np.float32(np.inf))
    assert {(0, 1), (1, 0), (0, 5), (5, 4)} <= set(zip(pairs.i.tolist(), pairs.j.tolist(), strict=True))
    assert not np.isin([2, 3], pairs.j).any() and not np.isin([2, 3], pairs.i).any()


def test_the_field_of_view_selects_neighbours() -> None:
    n = 600
    x, y, z = crowd(n, (90, 10, 90))
    ids = np.arange(n, dtype=np.int64)
    angle = np.random.default_rng(4).uniform(0, 2 * np.pi, n)
    view = (
        np.cos(angle).astype(np.float32),
        np.zeros(n, np.float32),
        np.sin(angle).astype(np.float32),
        np.full(n, 0.5, np.float32),
    )
    grid = CellGrid(x, y, z, ids, 12.0)
    every, visible = grid.find_pairs(None, 12.0), grid.find_pairs(None, 12.0, view=view)
    turned = np.abs(np.arctan2(every.dz, every.dx) - np.float32(angle[every.i]))
    inside = np.cos(turned) * np.hypot(every.dx, every.dz) >= 0.5 * every.distance  # a sixth of the way round to either side
    assert 0.2 < inside.mean() < 0.5
    assert set(zip(visible.i.tolist(), visible.j.tolist(), strict=True)) == set(
        zip(every.i[inside].tolist(), every.j[inside].tolist(), strict=True)
    )


def test_the_neighbour_limit_applies_before_the_field_of_view() -> None:
    n = 1000
    x = np.linspace(-20, 20, n).astype(np.float32)
    zero, one = np.zeros(n, np.float32), np.ones(n, np.float32)
    pairs = CellGrid(x, zero, zero, np.arange(n, dtype=np.int64), 50.0).find_pairs(None, 50.0, view=(one, zero, zero, zero))
    assert np.bincount(pairs.i)[n // 2] == limits.MAX_QUERY_NEIGHBOURS // 2  # the nearest, half of which are in front
    assert np.bincount(pairs.i)[0] == limits.MAX_QUERY_NEIGHBOURS
