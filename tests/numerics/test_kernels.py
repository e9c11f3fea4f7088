"""Kernels in a subset of Python: the same as the function run plainly, and code outside the subset is reported."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from compilers import need_llvmlite

from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I16,
    I32,
    I64,
    U8,
    U64,
    Array1,
    Array2,
    Strided2,
    allocate_scratch,
    bits_to_float,
    float_to_bits,
    inlined,
    kernel,
    kernel_helper,
    simd_range,
)
from antdsl.machine_code.kernels.ir import NotInSubsetError

SERIES = (0.5, -1.25, 3.0, 7.5)
ODD = np.uint64(0x9E3779B97F4A7C15)
Pair = tuple[Array1[F64], Array1[F64]]
Nested = tuple[Pair, I64]


@pytest.fixture(autouse=True)
def compilers() -> None:
    need_llvmlite()


@inlined
def series(x, factors):  # type: ignore[no-untyped-def]
    value = factors[-1]
    for c in factors[-2::-1]:
        value = value * x + c
    return value


@kernel_helper
def first_above(x, least):  # type: ignore[no-untyped-def]
    """Leaves early, from within two loops."""
    for k in range(x.size):
        while True:
            if x[k] > least:
                return k, x[k]
            break
    return -1, 0.0


@kernel
def loops(x: Array1[F64], k: I64, out: Array1[F64]) -> tuple[I64, F64]:
    count = 0
    for i in range(x.size - 1, -1, -1):
        if i % 3 == 1:
            continue
        v = series(x[i], SERIES)
        for side in range(2):
            if side == 1 and v < 0:
                break
            v = v + side
        for side in range(k):
            v = v - side * 0.5
        out[i] = v if i % 2 else -v
        count += v > 0
    return count, first_above(x, 1.5)[1]


@kernel
def integers(a: Array1[I64], b: Array1[I64], small: Array1[I16], tiny: Array1[U8], out: Array2[I64]) -> None:
    for i in range(a.size):
        out[i, 0], out[i, 1] = a[i] // b[i], a[i] % b[i]
        out[i, 2] = (a[i] >> 3) ^ (b[i] & 255) | 4
        out[i, 3] = small[i] + tiny[i]


@kernel
def unsigned(a: Array1[U64], out: Array1[U64]) -> U64:
    total = np.uint64(0)
    for i in range(a.size):
        word = (a[i] ^ (a[i] >> np.uint64(31))) * ODD
        out[i] = word >> np.uint64(60)
        total += word
    return total


@kernel
def floats(x: Array1[F32], y: Strided2[F64], good: Array1[BOOL], out: Array1[F32]) -> BOOL:
    any_good = False
    for i in range(x.size):
        good[i] = (np.isfinite(x[i]) and np.float64(x[i]) > y[0, i]) or y[1, i] < 0
        any_good |= good[i]
        out[i] = np.sqrt(abs(x[i])) * np.float32(0.1) + np.floor(x[i])
    return any_good


@kernel
def nested(both: Nested, at: Array1[I32]) -> F64:
    (one, other), count = both
    buffer = allocate_scratch(8, F64)
    for i in range(count):
        buffer[i] = one[at[i]] + other[i]
    total = 0.0
    for i in range(count):
        total += min(max(buffer[i], -1.0), 1.0)
    return bits_to_float(float_to_bits(total))


@kernel
def beside(x: Array1[F64], out: Array1[F64]) -> None:
    for i in simd_range(0, x.size):
        v = x[i]
        turns = 0
        while v > 1.0:
            v = v * 0.5
            turns += 1
            if turns > 20:
                break
        if turns % 2 == 0:
            v = -v
        out[i] = v + series(v, SERIES)


def both(tested_kernel: Any, *arguments: Any) -> tuple[list[Any], Any, list[Any], Any]:
    """What is left of the arguments, and what is given back, compiled and plainly."""
    results = []
    for run in (tested_kernel, tested_kernel.part.function):
        own = [each.copy() if isinstance(each, np.ndarray) else each for each in arguments]
        with np.errstate(all="ignore"):
            results += [own, run(*own)]
    return results[0], results[1], results[2], results[3]


def same(tested_kernel: Any, *arguments: Any) -> None:
    left, result, plain, plain_result = both(tested_kernel, *arguments)
    for a, b in zip(left, plain, strict=True):
        if isinstance(a, np.ndarray):
            assert np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    assert result == plain_result


@pytest.mark.parametrize("size", [0, 1, 7, 8, 9, 100])
def test_kernels_equal_their_python_function(size: int) -> None:
    draw = np.random.default_rng(size)
    x = draw.normal(size=size) * 4
    same(loops, x, 3, np.zeros(size))
    same(beside, np.abs(x) * 100, np.zeros(size))
    a, b = draw.integers(-(1 << 40), 1 << 40, (2, size))
    small, tiny = draw.integers(-300, 300, size).astype(np.int16), draw.integers(0, 255, size).astype(np.uint8)
    same(integers, a, np.where(b == 0, 1, b >> 20 | 1), small, tiny, np.zeros((size, 4), np.int64))
    same(unsigned, draw.integers(0, 1 << 63, size).astype(np.uint64) * np.uint64(2), np.zeros(size, np.uint64))
    odd = x.astype(np.float32)
    odd[::5] = np.nan
    same(floats, odd, draw.normal(size=(2, size)), np.zeros(size, bool), np.zeros(size, np.float32))
    count = min(size, 8)
    same(nested, ((x, -x[::-1].copy()), count), draw.permutation(size).astype(np.int32))


def test_arrays_of_other_kinds_are_refused() -> None:
    x = np.zeros(16)
    x.flags.writeable = False
    for wrong, message in (
        ((x[::2], 1, np.zeros(8)), "contiguous"),
        ((x.astype(np.float32), 1, np.zeros(16)), "float64"),
        ((x.reshape(4, 4), 1, np.zeros(16)), "axes"),
        ((np.zeros(16), 1, x), "read-only"),
    ):
        with pytest.raises(ValueError, match=message):
            loops(*wrong)
    with pytest.raises(TypeError, match="arguments"):
        loops(x)


@kernel
def lists(x: Array1[F64]) -> F64:
    return [x[0]][0]


@kernel
def behind(x: Array1[F64]) -> F64:
    return x[-1]


@kernel
def other_type(x: Array1[F64]) -> I64:
    count = 0
    count = x[0]  # type: ignore[assignment]
    return count


@kernel
def unknown(x: Array1[F64]) -> F64:
    return float(np.hypot(x[0], x[0]))


@kernel
def turns_of_a_tuple(k: I64) -> F64:
    return SERIES[k]


@kernel
def mixed_types(x: Array1[F32], y: Array1[F64]) -> None:
    y[0] = x[0] * y[0]


@kernel
def mixed_counts(x: Array1[F32], k: I64) -> None:
    x[0] = x[0] * k


@kernel
def inexact_literal(x: Array1[F32]) -> None:
    x[0] = x[0] * 0.1


@kernel
def widened_variable(x: Array1[F32]) -> F64:
    total = 0.0
    for k in range(x.size):
        total = x[k]
    return total


NOT_IN_SUBSET = (
    lists, behind, other_type, unknown, turns_of_a_tuple, mixed_types, mixed_counts, inexact_literal, widened_variable,
)  # fmt: skip


@kernel
def literals(x: Array1[F32], y: Array1[F32]) -> None:
    for k in range(x.size):
        y[k] = (1 - x[k] * 0.5) / 3 if x[k] > 0 else 2.0


def test_literals_take_the_type_of_the_other_number() -> None:
    """As in NumPy: the products are those of float32."""
    x = np.random.default_rng(3).normal(size=400).astype(np.float32)
    y = np.empty_like(x)
    literals(x, y)
    assert np.array_equal(y, np.where(x > 0, (1 - x * np.float32(0.5)) / np.float32(3), np.float32(2)))


@pytest.mark.parametrize("function", NOT_IN_SUBSET, ids=lambda each: str(each.__name__))
def test_code_outside_the_subset_is_reported_with_its_line(function: Any) -> None:
    with pytest.raises(NotInSubsetError, match=f"line [0-9]+, `{function.__name__}`"):
        function.text()


def test_code_in_use_is_not_freed() -> None:
    import gc

    from antdsl.machine_code import code_cache

    assert beside(np.ones(9), np.zeros(9)) is None
    code_cache.release_unused_code()
    gc.collect()
    same(beside, np.arange(9.0), np.zeros(9))
