"""Kernels of fields and their cells, against matrices, dictionaries and sorted lists over all cells."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from antdsl.fields import growing, threshold_cells
from antdsl.fields.cell_lookup import VoxelCellIndex, update_cell_lookups
from antdsl.fields.pheromone import advance_cells, compute_cell_inflow, find_strongest_nearby_cells

SIZE = 6, 5, 7  # voxels of a box
VOXEL = 2.5  # mm


def test_flow_between_cells_equals_a_matrix_product() -> None:
    rng = np.random.default_rng(1)
    n = 90
    links = (rng.random((n, n)) < 0.06) * rng.uniform(0, 0.1, (n, n))
    rows, columns = np.nonzero(links)
    start = np.searchsorted(rows, np.arange(n + 1))
    held, out, change = rng.uniform(0, 5, n), links.sum(axis=0), np.full(n, 9.0)
    for part in ((0, 40), (40, n)):
        compute_cell_inflow(held, links[rows, columns], columns.astype(np.int32), start, out, change, *part)
    np.testing.assert_allclose(change, links @ held - out * held, rtol=1e-12, atol=1e-13)
    assert abs(change.sum()) < 1e-12


@pytest.mark.parametrize("spreads", [True, False])
@pytest.mark.parametrize("lands", [0, 1, 2])
def test_cells_spread_fade_and_receive_deposits(spreads: bool, lands: int) -> None:
    rng = np.random.default_rng(2)
    n, unit, spread, keep, limit, least = 300, 0.125, 0.3, 0.9, 4.0, 0.05
    held = np.where(rng.random(n) < 0.3, rng.uniform(0, 0.06, n), rng.uniform(0, 5, n))
    pending = np.where(rng.random(n) < 0.5, 0, rng.integers(1, 40, n))
    change = rng.normal(0, 0.5, n) if spreads else np.empty(0)
    amount = (held + (spread * change if spreads else 0)) * keep
    deposit = pending * unit
    amount = np.minimum([amount, amount + deposit, np.maximum(amount, deposit)][lands], limit)
    expected, left = np.where(amount < least, 0, amount), pending.copy() if lands == 0 else 0 * pending
    for part in ((0, 101), (101, n)):
        advance_cells(held, change, pending, spread, keep, unit, limit, -np.inf, least, lands, *part)
    np.testing.assert_allclose(held, expected, rtol=1e-14, atol=1e-15)
    assert np.array_equal(pending, left) and (held == limit).any() and (held == 0).any()


def test_signed_cells_keep_negative_amounts_but_the_smallest() -> None:
    held = np.array([-3.0, -0.04, -0.06, 0.04, 0.06, 7.0])
    pending = np.array([8, 0, 0, 0, 0, -8], np.int64)
    advance_cells(held, np.empty(0), pending, 0.0, 1.0, 0.125, np.inf, -0.05, 0.05, 1, 0, 6)
    np.testing.assert_array_equal(held, [-2.0, 0, -0.06, 0, 0.06, 6.0])
    assert not pending.any()


def test_the_strongest_cell_of_a_block_is_its_first_greatest() -> None:
    rng = np.random.default_rng(3)
    cells, count = 50, 200
    block = rng.integers(0, cells + 1, (cells, 9)).astype(np.int32)
    held = np.append(rng.integers(0, 4, cells).astype(float), 0.0)
    held[block[:7]] = 0.0  # blocks without anything
    own = rng.integers(-1, cells, count).astype(np.int32)
    own[:3] = -1
    best, value = np.full(count, 77), np.full(count, 77.0)
    find_strongest_nearby_cells(own, block, held, best, value)
    for n in range(count):
        amounts = [] if own[n] < 0 else [float(held[cell]) for cell in block[own[n]]]
        most = max(amounts, default=0.0)
        empty = cells if own[n] < 0 else own[n]
        assert value[n] == most and best[n] == (block[own[n]][amounts.index(most)] if most > 0 else empty)


class Box:
    """Cells in some voxels and sides of a box, by key, in random order."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.size = np.array(SIZE)
        self.keys = rng.permutation(np.flatnonzero(rng.random(6 * self.size.prod()) < 0.3))
        self.direct = np.full(6 * self.size.prod(), -1, np.int32)
        self.direct[self.keys] = np.arange(len(self.keys))
        self.voxels, self.sides = self.keys // 6, self.keys % 6
        self.at = np.stack(np.unravel_index(self.voxels, SIZE), axis=1)
        self.position = np.round((self.at + rng.uniform(0, 1, self.at.shape)) * 4) / 4 * VOXEL  # some equally far

    def candidates(self, voxel: np.ndarray, side: int, point: np.ndarray) -> list[tuple[float, int]]:
        """Distances and numbers of cells near a voxel that do not face the other way, from the nearest on."""
        near = (np.abs(self.at - voxel) <= 1).all(axis=1) & (self.sides != side + 1 - 2 * (side % 2))
        gaps = ((self.position - point) ** 2).sum(axis=1)
        return sorted((float(gaps[cell]), int(cell)) for cell in np.flatnonzero(near))


@pytest.mark.parametrize("k", [1, 6, 100])
def test_nearest_cells_are_those_of_a_sorted_list(k: int) -> None:
    box = Box(4)
    cells, none = np.arange(0, len(box.keys), 3), len(box.keys)
    table = np.full((len(box.keys), k), -7, np.int32)
    growing.fill_nearest_cells(box.direct, (box.voxels, box.keys), box.size, box.position, cells, k, none, table)
    for cell in cells:
        listed = sorted(at for _, at in box.candidates(box.at[cell], box.sides[cell], box.position[cell])[:k])
        assert table[cell].tolist() == listed + [none] * (k - len(listed))
    assert (np.delete(table, cells, axis=0) == -7).all()


def test_points_get_the_nearest_cell_around_them() -> None:
    box, rng = Box(5), np.random.default_rng(6)
    count = 400
    voxel = rng.integers(-2, box.size + 2, (count, 3))
    points, side = (voxel + rng.uniform(0, 1, (count, 3))) * VOXEL, rng.integers(0, 6, count)
    best = np.full(count, -7)
    growing.fill_nearby_cells(box.direct, box.size, box.position, points, voxel, side, best)
    for n in range(count):
        listed = box.candidates(voxel[n], side[n], points[n])
        assert best[n] in [at for gap, at in listed if gap == listed[0][0]] if listed else best[n] == -1
    assert (best < 0).any()


@pytest.mark.parametrize("listed", [True, False])
def test_points_are_located_by_voxel_and_side(listed: bool) -> None:
    """With a table of all keys and with sorted keys in blocks; known keys are not looked up again."""
    box, rng = Box(7), np.random.default_rng(8)
    low, shift, count = np.array([-3, 2, 0]), 4, 500
    keys = np.sort(box.keys)
    start = np.searchsorted(keys, np.arange((len(box.direct) >> shift) + 2) << shift).astype(np.int32)
    empty = np.empty(0, np.int32)
    tables = (box.direct, keys[:0], 0, empty) if listed else (empty, keys, shift, start)
    cell_by_key = {int(key): cell for cell, key in enumerate(box.keys if listed else keys)}
    index = VoxelCellIndex(VOXEL, low, box.size, *tables)
    known, known_cells = np.full(count, -1), np.full(count, -1, np.int32)
    voxel = rng.integers(-1, box.size + 1, (count, 3))
    for turn in range(2):
        if turn:
            voxel[::3] = rng.integers(-1, box.size + 1, (len(voxel[::3]), 3))
        points = tuple((voxel + low + rng.uniform(-0.49, 0.49, (count, 3))).T * VOXEL)
        points = tuple(np.ascontiguousarray(each) for each in points)
        side, cells = rng.integers(0, 6, count).astype(np.int8), np.full(count, -7, np.int32)
        missed = [update_cell_lookups(points, side, index, known, known_cells, cells, *part) for part in ((0, 203), (203, count))]
        inside = ((voxel >= 0) & (voxel < box.size)).all(axis=1)
        key = np.where(inside, np.ravel_multi_index(np.clip(voxel, 0, box.size - 1).T, SIZE) * 6 + side, -1)
        expected = [cell_by_key.get(int(each), -1) for each in key]
        assert cells.tolist() == expected and np.array_equal(known, key) and known_cells.tolist() == expected
        assert sum(missed) == expected.count(-1) and 50 < sum(missed) < count
    known_cells[expected.index(max(expected))] = 3  # an answer that is stored is used
    update_cell_lookups(points, side, index, known, known_cells, cells, 0, count)
    assert cells[expected.index(max(expected))] == 3


def test_cells_that_cross_the_threshold_change_the_counts_around_them() -> None:
    rng = np.random.default_rng(9)
    n, least = 1300, np.float32(0.3)
    blocks = [rng.choice(n, rng.integers(0, 9), replace=False) for _ in range(n)]
    start = np.concatenate([[0], np.cumsum([len(each) for each in blocks])])
    cell = np.concatenate(blocks).astype(np.int32)
    holds, count, changed = np.zeros(n, np.bool_), np.zeros(n, np.uint8), np.full(n, -1)
    for _ in range(3):
        held = rng.uniform(0, 0.6, n)
        held[:5] = 0.3, np.nextafter(0.3, 0), np.float32(0.3), np.nextafter(np.float32(0.3), np.float32(0)), 0.0
        listed = []
        for part in ((0, 600), (600, n)):
            first, many = threshold_cells.write_changed_cells(held, least, holds, changed, *part)
            assert first == part[0]
            listed += changed[first : first + many].tolist()
        strong = held.astype(np.float32) >= least
        assert listed == np.flatnonzero(strong != holds).tolist()
        threshold_cells.update_counts(np.array(listed), start, cell, holds, count)
        assert np.array_equal(holds, strong)
        around = list(itertools.chain.from_iterable(blocks[each] for each in np.flatnonzero(strong)))
        assert np.array_equal(count, np.bincount(around, minlength=n))
