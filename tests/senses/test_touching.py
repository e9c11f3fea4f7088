"""Who is near enough to touch: all pairs by brute force, and in dense clusters the pairs that plain loops over cells choose."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from antdsl.senses.touching import find_touching_pairs

MOST = 48  # agents of three cells in a row that one is paired with
SIZES = [(150, 150, 0), (90, 90, 90), (150, 150, 4), (0, 900, 0), (1e6, 1e6, 3), (1e5, 1e5, 1e5), (0, 0, 3000)]
REACHES = [(1, 1.2), (1, 8), (0.002, 20), (0.1, 0.1)]


def as_set(result) -> set[tuple[int, int]]:
    pairs = {(min(i, j), max(i, j)) for i, j in zip(result.i.tolist(), result.j.tolist(), strict=True)}
    assert len(pairs) == len(result.i)
    return pairs


def near(place: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """Whether agents of places [3, n] are in reach of each other [n, n]."""
    x, y, z = (each[None] - each[:, None] for each in place)
    limit = reach[None] + reach[:, None]
    return (x * x + y * y) + z * z <= limit * limit


def all_pairs(place: np.ndarray, reach: np.ndarray) -> set[tuple[int, int]]:
    with np.errstate(invalid="ignore"):
        good = np.isfinite(place).all(axis=0) & np.isfinite(reach) & (reach > 0)
        result = near(place, reach) & good[None] & good[:, None]
    return {(i, j) for i, j in zip(*(k.tolist() for k in np.nonzero(result)), strict=True) if i < j}


@pytest.mark.parametrize("reach", REACHES, ids=str)
@pytest.mark.parametrize("size", SIZES, ids=str)
def test_every_pair_in_reach_is_found_once(size: tuple[float, ...], reach: tuple[float, float]) -> None:
    for count in (0, 1, 2, 5, 30, 250, 700):
        random = np.random.default_rng(count)
        place = (random.random((3, count)) - 0.4) * np.array(size)[:, None]
        wide = np.exp(random.uniform(*np.log(reach), count))
        if count == 250:
            place[0, 5], place[1, 6], place[2, 7], wide[[8, 9, 10, 11]] = np.nan, np.inf, -np.inf, (np.nan, np.inf, 0, -1)
        if count > 200:
            place[:, 12:30] = place[:, 12:13] + random.uniform(-0.1, 0.1, (3, 18))
        expected, bounds = all_pairs(place, wide), None
        if count == 700:
            bounds = [(float(each.min()), float(each.max())) for each in (*place, wide)]
        result = find_touching_pairs(tuple(place), wide, np.arange(count), bounds)
        assert result.is_complete and as_set(result) == expected
        rows = random.permutation(count)
        result = find_touching_pairs(tuple(place[:, rows]), wide[rows], rows, bounds)
        assert result.is_complete and {tuple(sorted((rows[i], rows[j]))) for i, j in as_set(result)} == expected
    assert len(expected) > 100


def test_agents_next_to_the_cells_of_larger_ones_are_found() -> None:
    large = np.array([[0.0, 40, 0], [0, 0, 30], [0, 0, 0]])
    random = np.random.default_rng(5)
    for tall in (0, 40):
        small = random.uniform(-30, 70, (3, 1997)) * np.array([[1], [1], [tall / 40]])
        place, reach = np.concatenate([large, small], axis=1), np.repeat([10.0, 0.1], [3, 1997])
        result = find_touching_pairs(tuple(place), reach, np.arange(2000))
        assert result.is_complete and as_set(result) == all_pairs(place, reach) and len(result.i) > 10


class Loops:
    """Agents of one size in cells, by plain loops: rows are given in the order in which they count."""

    def __init__(self, place: np.ndarray, reach: np.ndarray, rows: np.ndarray) -> None:
        own, self.place = place[:, rows], place
        extent = np.ptp(own, axis=1)
        self.axes = sorted(range(3), key=lambda axis: -extent[axis])
        self.width, self.low = max(2 * reach[rows].max(), extent.max() / 2**20, 1e-9), own.min(axis=1)
        self.flat = self.left_out = False
        cells = [self.cell(row) for row in rows]
        columns = {column: sum(cell[1:] == column for cell in cells) for column in {cell[1:] for cell in cells}}
        self.flat = extent.min() < self.width or sum(n * n for n in columns.values()) <= 8 * len(rows)
        self.rows = sorted(rows.tolist(), key=lambda row: (self.cell(row), rows.tolist().index(row)))
        self.cells = [self.cell(row) for row in self.rows]

    def cell(self, row: int) -> tuple[int, ...]:
        fast, middle, slow = (int(np.floor((self.place[axis, row] - self.low[axis]) * (1 / self.width))) for axis in self.axes)
        return (0 if self.flat else slow, middle, fast)

    def three(self, layer: int, line: int, first: int) -> list[int]:
        return [k for k, cell in enumerate(self.cells) if cell[:2] == (layer, line) and first <= cell[2] <= first + 2]

    def among(self) -> Iterator[tuple[int, int]]:
        for at, (layer, line, along) in enumerate(self.cells):
            spans = [[k for k in self.three(layer, line, along - 1) if k > at], self.three(layer, line + 1, along - 1)]
            if not self.flat:
                spans += [self.three(layer + 1, line + aside, along - 1) for aside in (-1, 0, 1)]
            yield from self.chosen(at, self.rows[at], spans)

    def queried_by(self, rows: list[int]) -> Iterator[tuple[int, int]]:
        known = [row for row in rows if self.reaches(row)]
        for at, row in enumerate(known):
            layer, line, along = self.cell(row)
            depths = (0,) if self.flat else (-1, 0, 1)
            yield from self.chosen(at, row, [self.three(layer + d, line + a, along - 1) for d in depths for a in (-1, 0, 1)])

    def reaches(self, row: int) -> bool:
        extent = np.ptp(self.place[:, self.rows], axis=1)
        for axis in self.axes[: 2 if self.flat else 3]:
            at = np.floor((self.place[axis, row] - self.low[axis]) * (1 / self.width))
            if not -1 <= at <= int(extent[axis] / self.width) + 1:
                return False
        return True

    def chosen(self, at: int, row: int, spans: list[list[int]]) -> Iterator[tuple[int, int]]:
        for span in spans:
            if len(span) > MOST:
                self.left_out = True
                span = [span[(k + at * MOST) % len(span)] for k in range(MOST)]
            yield from ((row, self.rows[k]) for k in span)


@pytest.mark.parametrize("size", [(0, 0, 0), (4, 4, 0.1), (40, 3, 0), (4, 4, 9), (5, 5, 5), (0, 40, 6)], ids=str)
@pytest.mark.parametrize("large", [0, 12, 80])
def test_in_a_dense_cluster_pairs_are_those_that_loops_over_cells_choose(size: tuple[float, ...], large: int) -> None:
    random = np.random.default_rng(3)
    count = 420
    place, reach = random.random((3, count)) * np.array(size)[:, None], np.where(np.arange(count) < large, 4.0, 1.0)
    place[:2, -5:] += 30
    ids, complete = random.permutation(count), True
    order, expected = np.argsort(ids), set()
    for width in (1.0, 4.0) if large else (1.0,):
        loops = Loops(place, reach, order[reach[order] == width])
        expected |= {*loops.among(), *loops.queried_by([row for row in order.tolist() if reach[row] < width])}
        complete &= not loops.left_out
    inside = near(place, reach)
    expected = {(min(pair), max(pair)) for pair in expected if inside[pair]}
    for rows in (np.arange(count), random.permutation(count)):
        result = find_touching_pairs(tuple(place[:, rows]), reach[rows], ids[rows])
        assert result.is_complete == complete
        assert {tuple(sorted((rows[i], rows[j]))) for i, j in as_set(result)} == expected


def test_thousands_in_one_place_are_paired_with_a_bounded_number_each() -> None:
    n = 7500
    place = np.zeros(n)
    result = find_touching_pairs((place, place, place), np.ones(n), np.arange(n))
    each = np.bincount(np.concatenate([result.i, result.j]), minlength=n)
    assert not result.is_complete and each.min() >= 40 and len(result.i) < 60 * n
    result = find_touching_pairs((place, place, place), np.repeat([1.0, 9.0], [n - 1, 1]), np.arange(n))
    assert np.count_nonzero((result.i == n - 1) | (result.j == n - 1)) == n - 1 and len(result.i) < 60 * n
