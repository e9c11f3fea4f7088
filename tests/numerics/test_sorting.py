"""Orders of rows, against the plain way to find them."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.numerics.sorting import interleaved, places_among, stable_order


@pytest.mark.parametrize("high", [1, 70, 1 << 20, 1 << 40, 1 << 60])
def test_numbers_are_sorted_as_numpy_does(high: int) -> None:
    keys = np.random.default_rng(1).integers(-high, high, 5000)
    assert np.array_equal(stable_order(keys), np.argsort(keys, kind="stable"))
    assert stable_order(keys[:0]).size == 0


@pytest.mark.parametrize("high", [900, 1 << 40])
def test_numbers_are_found_among_others(high: int) -> None:
    draw = np.random.default_rng(2)
    known = draw.permutation(np.unique(draw.integers(0, high, 600)))
    wanted = np.concatenate([draw.permutation(known)[:300], draw.integers(0, high, 100), [high + 5]])
    where = {int(number): place for place, number in enumerate(known)}
    assert places_among(known, wanted).tolist() == [where.get(int(number), -1) for number in wanted]
    assert places_among(known[:0], wanted).tolist() == [-1] * len(wanted)
    assert places_among(known, wanted[:0]).size == 0


def test_cells_are_numbered_bit_by_bit() -> None:
    cells = np.random.default_rng(3).integers(0, 1 << 21, (200, 3)).astype(np.uint64)
    plain = [sum(((int(cell[axis]) >> bit) & 1) << (3 * bit + axis) for bit in range(21) for axis in range(3)) for cell in cells]
    assert interleaved(cells).tolist() == plain
