"""A sample of the random kernels: the same bits interpreted and compiled, with and without lanes, for all targets of the package.

Code for aarch64 runs under qemu."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest
from compilers import need_llvmlite
from emulated_kernels import EmulatedCode, missing_program
from random_kernel_source import module_of
from random_kernels import can_run, compare, equal, inputs, load, outcome

from antdsl.machine_code import llvm_compiler, shipped_objects
from antdsl.machine_code.kernels.kernel import render_kernels

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="no machine code can be made here")


def test_random_kernels_give_the_same_bits_interpreted_and_compiled() -> None:
    need_llvmlite()
    assert compare(40, 11, show=False) == []


def test_errors_of_random_kernels_are_found_by_the_checked_build(monkeypatch: pytest.MonkeyPatch) -> None:
    import random_kernels

    monkeypatch.setattr(random_kernels, "DARING_EVERY", 1)
    assert compare(16, 12, show=False) == []


def test_random_kernels_without_lanes_give_the_same_bits() -> None:
    need_llvmlite()
    assert compare(12, 14, show=False, lanes=1) == []


@pytest.mark.parametrize("target", list(shipped_objects.TARGET_BY_NAME))
def test_random_kernels_compile_for_every_target_and_run_where_possible(target: str) -> None:
    assert compare(12 if can_run(shipped_objects.TARGET_BY_NAME[target]) else 4, 13, target, show=False) == []


@pytest.mark.skipif(bool(missing_program()), reason=f"{missing_program()} is not installed")
def test_emulated_code_is_what_runs(tmp_path: Path) -> None:
    """Code with one other operation gives other results, so the comparison is with that code; other arrays stay as they are."""
    need_llvmlite()
    target = shipped_objects.TARGET_BY_NAME["aarch64"]
    kernels = load(module_of(Random("21"), 6, False), tmp_path)
    text = render_kernels(kernels, target)
    outcomes = []
    for each in (text, text.replace(" fadd ", " fsub ").replace(" fmul ", " fdiv ")):
        with EmulatedCode(kernels, each, llvm_compiler.compile_object(each, target), tmp_path) as code:
            outcomes.append([outcome(code.caller(kernel), inputs(31, 17)) for kernel in kernels])
    pairs = [(a, b) for (_, one), (_, other) in zip(*outcomes, strict=True) for a, b in zip(one, other, strict=True)]
    same = [equal(a, b) for a, b in pairs]
    assert any(same) and not all(same)


def test_the_comparison_tells_signs_of_zero_and_types_apart() -> None:
    passed = inputs(1, 9)
    zeros = np.zeros(3)
    assert equal(zeros, zeros.copy()) and not equal(zeros, -zeros) and equal(zeros + np.nan, -(zeros + np.nan))
    assert not equal(passed["in_F64"], passed["in_F32"]) and not equal(passed["in_I64"], passed["in_I64"] + 1)
