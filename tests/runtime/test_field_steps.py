"""Kernels of the phases of a step give the bits of the NumPy version that stands beside them."""

from itertools import product

import numpy as np
import pytest
from scipy.sparse import csr_array

from antdsl.fields import cells as cell_tables
from antdsl.fields.cells import SurfaceCells
from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import DEPOSIT_QUANTUM, MAX_DEPOSIT, ZERO_FLUSH_THRESHOLD, PheromoneField

SLOPE = (np.array([[0, 0, 0], [60, 0, 0], [60, 60, 12], [0, 60, 0]], float), np.array([[0, 1, 2], [0, 2, 3]]))


class Plainly:
    """A field as arrays: what is there, and a step of it by its definition."""

    def __init__(self, field: PheromoneField) -> None:
        self.field, self.values, self.pending = field, np.zeros(len(field.cells)), np.zeros(len(field.cells))

    def deposit(self, cells: np.ndarray, amounts: np.ndarray) -> None:
        rounded_amounts = np.rint(np.minimum(amounts.astype(np.float64), MAX_DEPOSIT) / DEPOSIT_QUANTUM) * DEPOSIT_QUANTUM
        (np.add if self.field.combine == "add" else np.maximum).at(self.pending, cells, rounded_amounts)

    def land(self) -> None:
        landed = self.values + self.pending if self.field.combine == "add" else np.maximum(self.values, self.pending)
        self.values, self.pending = np.minimum(landed, self.field.limit), np.zeros(len(self.values))

    def step(self, keep: float, diffusion: float, dt: float) -> None:
        if self.field.deposits_first:
            self.land()
        if diffusion:
            flow = self.field._laplacian
            data, columns, starts = flow._inflow_matrix
            change = csr_array((data, columns, starts), 2 * self.values.shape) @ self.values - flow._outflow_shares * self.values
            self.values = self.values + diffusion * dt / self.field.cells.cell**2 * change
        self.values = self.values * float(np.float32(keep))
        if not self.field.deposits_first:
            self.land()
        self.values[self.values < ZERO_FLUSH_THRESHOLD] = 0.0


def bits(array):
    return array.view({4: np.int32, 8: np.int64}[array.dtype.itemsize])


@pytest.mark.parametrize("combine, limit", [*product(("add", "max"), (np.inf, 3.0))])
def test_a_step_of_a_field_is_that_of_arrays(combine, limit):
    cells = SurfaceCells([SLOPE], 2.0)
    for stencil, first, diffusion, keep in product((4, 8), (False, True), (0.0, 2.0), (1.0, 0.97)):
        field, rng = PheromoneField(cells, combine, limit, stencil, first), np.random.default_rng(3)
        plainly = Plainly(field)
        for number in range(12):
            if number % 3 == 0:
                put = rng.integers(0, len(cells), 50).astype(np.int32), 2 * rng.random(50, np.float32)
                field.deposit(*put)
                plainly.deposit(*put)
            if number == 7:
                field.set_remaining_amounts(np.arange(5), np.full(5, 0.25))
                plainly.values[:5] = 0.25
            field.advance(keep, diffusion, 1 / 24, 2)
            plainly.step(keep, diffusion, 1 / 24)
        assert np.array_equal(bits(plainly.values), bits(field.amounts)) and field.amounts.any()


@pytest.mark.parametrize("first", (False, True))
def test_a_field_that_is_full_everywhere_spreads_as_arrays_do(first):
    cells = SurfaceCells([SLOPE], 2.0)
    field = PheromoneField(cells, "add", 3.0, 8, first)
    plainly = Plainly(field)
    for _ in range(6):
        full = np.arange(len(cells), dtype=np.int32), np.full(len(cells), 7, np.float32)
        field.deposit(*full)
        plainly.deposit(*full)
        field.advance(1.0, 16.0, 1 / 24)
        plainly.step(1.0, 16.0, 1 / 24)
    assert np.array_equal(bits(plainly.values), bits(field.amounts))


@pytest.mark.parametrize("kind, dense", [*product((SurfaceCells, GrowingCells), (8_000_000, 0))])
def test_cells_of_agents_are_those_of_their_voxel_and_side(monkeypatch, kind, dense):
    monkeypatch.setattr(cell_tables, "_MAX_DENSE_VOXELS", dense)
    cells, rng, known, buffer = kind([SLOPE], 2.0), np.random.default_rng(1), None, None
    points = rng.random((3, 1500)).T * [60, 60, 12]
    points[:, 2] = points[:, 0] * points[:, 1] / 300
    numbers = {int(key): n for n, key in enumerate(cells._keys)}
    for number in range(6):
        points = np.asarray(points + rng.normal(0, 0.4, points.shape), order="FC"[number % 2])
        points[3], points[4] = np.nan, 1e9
        side = np.where(rng.random(1500) < 0.1, rng.integers(0, 6, 1500), 4).astype(np.int8)
        buffer, known = cells.update_cells(points, side, known, buffer)
        with np.errstate(invalid="ignore"):
            voxel = np.floor(points / cells.cell + 0.5) - cells._low
        for n in range(1500):
            own = -1
            if ((voxel[n] >= 0) & (voxel[n] < cells._size)).all():
                x, y, z = voxel[n].astype(int)
                own = numbers.get(int(((x * cells._size[1] + y) * cells._size[2] + z) * 6 + side[n]), -1)
            assert own < 0 or buffer[n] == own  # who has none gets one near by
        assert np.array_equal(buffer, cells.update_cells(points, side, None)[0])
    assert 0.5 < (buffer >= 0).mean() < 1
