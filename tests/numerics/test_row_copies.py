"""Rows of many arrays are copied and picked as NumPy does, by machine code in any number of threads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.numerics import parallel, row_copies
from antdsl.numerics.row_copies import RowCopier, copy_rows

COUNT = 9_001


@pytest.fixture(params=[1, 3])
def threads(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> int:
    """By so many threads."""
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 4)
    return int(request.param)


def arrays(count: int) -> list[NDArray[Any]]:
    """With rows of 4, 8, 1, 8 and 12 bytes."""
    rng = np.random.default_rng(count)
    reals, wholes = rng.random(count), rng.integers(0, 1 << 40, count)
    return [reals.astype(np.float32), reals, reals > 0.5, wholes, rng.random((count, 3)).astype(np.float32)]


@pytest.mark.parametrize("count", [0, 1, COUNT])
def test_selected_rows_are_copied(threads: int, count: int) -> None:
    of = arrays(COUNT)
    rows = np.repeat(np.random.default_rng(1).permutation(COUNT), 2)[::2][:count]  # not in one piece
    to = [np.zeros((count + 1, *each.shape[1:]), each.dtype) for each in of]
    copy_rows([(target[:count], each) for target, each in zip(to, of, strict=True)], rows, threads)
    for target, each in zip(to, of, strict=True):
        assert np.array_equal(target[:count], each[rows]) and not target[count].any()


def test_repeated_copies_use_the_current_arrays(threads: int) -> None:
    copies, of = RowCopier(), arrays(COUNT)
    for turn in range(3):
        if turn < 2:
            to = [np.zeros_like(each) for each in of]
        for each in of:
            each[:] = each[::-1].copy()
        copies.copy(to, of, threads)
        assert all(np.array_equal(*pair) for pair in zip(to, of, strict=True))
    few = np.zeros(3)
    copies.copy([few], [np.arange(3.0)], threads)
    assert few.tolist() == [0, 1, 2]
    copies.copy([few, few], [few, np.full(3, 4.0)], threads)
    assert few.tolist() == [4, 4, 4]
    copies.copy([few], [few], threads)
    copies.copy([], [], threads)
    assert few.tolist() == [4, 4, 4]


def test_addresses_are_looked_up_once(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    looked = []
    monkeypatch.setattr(
        row_copies,
        "_build_copy_table",
        lambda *arguments, table=row_copies._build_copy_table: looked.append(arguments) or table(*arguments),
    )
    copies, of = RowCopier(), arrays(COUNT)
    to = [np.zeros_like(each) for each in of]
    for _ in range(3):
        copies.copy(list(to), list(of), threads)
    assert len(looked) == 1
