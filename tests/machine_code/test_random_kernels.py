"""A sample of the random kernels: interpreted and compiled alike, and compiled for all targets of the package."""

from __future__ import annotations

import numpy as np
import pytest
from compilers import need_llvmlite
from random_kernels import compare, equal, inputs

from antdsl.machine_code import machine, shipped

pytestmark = pytest.mark.skipif(not machine.is_available(), reason="no machine code can be made here")


def test_random_kernels_give_the_same_bits_interpreted_and_compiled() -> None:
    need_llvmlite()
    assert compare(40, 11, show=False) == []


def test_errors_of_random_kernels_are_found_by_the_checked_build(monkeypatch: pytest.MonkeyPatch) -> None:
    import random_kernels

    monkeypatch.setattr(random_kernels, "DARING_EVERY", 1)
    assert compare(16, 12, show=False) == []


@pytest.mark.parametrize("target", list(shipped.TARGET_BY_NAME))
def test_random_kernels_compile_for_every_target(target: str) -> None:
    assert compare(4, 13, target, show=False) == []


def test_the_comparison_tells_signs_of_zero_and_types_apart() -> None:
    passed = inputs(1, 9)
    zeros = np.zeros(3)
    assert equal(zeros, zeros.copy()) and not equal(zeros, -zeros) and equal(zeros + np.nan, -(zeros + np.nan))
    assert not equal(passed["in_F64"], passed["in_F32"]) and not equal(passed["in_I64"], passed["in_I64"] + 1)
