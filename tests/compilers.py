"""What a test needs that compiles: it is skipped where that is missing, or there and of no use. Packages that are installed and
do not load raise other errors than those that are not, so that `pytest.importorskip` does not do."""

from __future__ import annotations

import pytest

from antdsl.machine_code import llvm_compiler


def need_numba() -> None:
    """Skip the test where what benchmarks compare with cannot be compiled."""
    try:
        import numba  # noqa: F401
    except Exception as problem:  # made for another NumPy: it says so in different ways
        pytest.skip(f"needs numba: {problem}")


def need_llvmlite() -> None:
    """Skip the test where machine code cannot be made."""
    if why := llvm_compiler.find_unavailability_reason():
        pytest.skip(why)
