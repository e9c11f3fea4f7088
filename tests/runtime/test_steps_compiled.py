"""Kernels of the phases of a step give the bits of the NumPy version that stands beside them."""

from itertools import product

import numpy as np
import pytest

from antdsl.fields import cells as cell_tables
from antdsl.fields.cells import SurfaceCells
from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.numerics import compiled
from tests.compilers import need_llvmlite

SLOPE = (np.array([[0, 0, 0], [60, 0, 0], [60, 60, 12], [0, 60, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))


@pytest.fixture
def by_kernels(monkeypatch):
    """Chooses whether kernels run."""
    need_llvmlite()
    return lambda fast: monkeypatch.setattr(compiled, "wanted", lambda count: fast and count > 0)


def bits(array):
    return array.view({4: np.int32, 8: np.int64}[array.dtype.itemsize])


@pytest.mark.parametrize("combine, limit", [*product(("add", "max"), (np.inf, 3.0))])
def test_a_step_of_a_field_is_the_same(by_kernels, combine, limit):
    cells = SurfaceCells([SLOPE], 2.0)
    for stencil, first, diffusion, keep in product((4, 8), (False, True), (0.0, 2.0), (1.0, 0.97)):
        found = []
        for fast in (False, True):
            by_kernels(fast)
            field, rng = PheromoneField(cells, combine, limit, stencil, first), np.random.default_rng(3)
            for number in range(12):
                if number % 3 == 0:
                    field.deposit(rng.integers(0, len(cells), 50).astype(np.int32), 2 * rng.random(50, np.float32))
                if number == 7:
                    field.leave(np.arange(5), np.full(5, 0.25))
                field.step(keep, diffusion, 1 / 24)
            found.append(field.values.copy())
        assert np.array_equal(*map(bits, found)) and found[0].any()


@pytest.mark.parametrize("first", (False, True))
def test_a_field_that_is_full_everywhere_spreads_the_same(by_kernels, first):
    cells, found = SurfaceCells([SLOPE], 2.0), []
    for fast in (False, True):
        by_kernels(fast)
        field = PheromoneField(cells, "add", 3.0, 8, first)
        for _ in range(6):
            field.deposit(np.arange(len(cells), dtype=np.int32), np.full(len(cells), 7, np.float32))
            field.step(1.0, 16.0, 1 / 24)
        found.append(field.values.copy())
    assert np.array_equal(*map(bits, found))


@pytest.mark.parametrize("kind, dense", [*product((SurfaceCells, GrowingCells), (8_000_000, 0))])
def test_cells_of_agents_are_the_same(by_kernels, monkeypatch, kind, dense):
    monkeypatch.setattr(cell_tables, "_DENSE", dense)
    cells, rng, known, room = kind([SLOPE], 2.0), np.random.default_rng(1), None, None
    points = rng.random((3, 1500)).T * [60, 60, 12]
    points[:, 2] = points[:, 0] * points[:, 1] / 300
    for number in range(6):
        points = np.asarray(points + rng.normal(0, 0.4, points.shape), order="FC"[number % 2])
        points[3], points[4] = np.nan, 1e9
        side = np.where(rng.random(1500) < 0.1, rng.integers(0, 6, 1500), 4).astype(np.int8)
        by_kernels(True)
        room, known = cells.follow(points, side, known, room)
        by_kernels(False)
        assert np.array_equal(room, cells.follow(points, side, None)[0])
    assert 0.5 < (room >= 0).mean() < 1
