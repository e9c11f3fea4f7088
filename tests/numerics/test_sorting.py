"""Orders of rows, against the plain way to find them."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.numerics import parallel
from antdsl.numerics.sorting import compute_morton_codes, sort_stably


@pytest.mark.parametrize("high", [1, 70, 1 << 20, 1 << 40, 1 << 60])
def test_numbers_are_sorted_as_numpy_does(high: int) -> None:
    keys = np.random.default_rng(1).integers(-high, high, 5000)
    assert np.array_equal(sort_stably(keys), np.argsort(keys, kind="stable"))
    assert sort_stably(keys[:0]).size == 0


def test_cells_are_numbered_bit_by_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 4)
    monkeypatch.setattr(parallel, "MIN_LIGHT_ITEMS_PER_THREAD", 50)
    cells = np.random.default_rng(3).integers(0, 1 << 21, (200, 3)).astype(np.uint64)
    plain = [sum(((int(cell[axis]) >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3)) for cell in cells]
    assert compute_morton_codes(cells).tolist() == plain and compute_morton_codes(np.asfortranarray(cells), 3).tolist() == plain
