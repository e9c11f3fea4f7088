"""Loops that run eight turns at a time give what each turn gives alone."""

from __future__ import annotations

import numpy as np
import pytest
from kernel_interpreter import KernelInterpreter

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I32,
    I64,
    Array1,
    Array2,
    NotInSubsetError,
    inlined,
    kernel,
    kernel_helper,
    load3,
    load_consecutive,
    round_to_int,
    simd_range,
    store3,
)
from antdsl.machine_code.kernels.kernel import render_kernels

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="no machine code can be made here")
COUNTS = (0, 1, 7, 8, 9, 64, 203)


@inlined
def _halved(x, most):
    """How often a number is halved until it is at most 1, in turns of a loop that some leave early."""
    turns = 0
    while x > 1.0:
        turns += 1
        if turns > most:
            break
        if turns % 3 == 0:
            continue
        x = x * 0.5
    return turns, x


@kernel_helper
def _kind(x):
    if x < 0:
        return -1, x
    if x < 1:
        x = x + 1.0
        if x < 1.25:
            return 5, x
    return 2, x * 2.0


@kernel
def questions(x: Array1[F64], to: Array1[F64], kinds: Array1[I32], flags: Array1[BOOL], begin: I64, end: I64) -> None:
    for i in simd_range(begin, end):
        flags[i] = False
        if not np.isfinite(x[i]):
            continue
        turns, rest = _halved(abs(x[i]), 9)
        kind, value = _kind(x[i])
        total = 0.0
        for k in range(turns):
            if k == 5:
                break
            total += value if k % 2 == 0 else -rest
        near = 0 if x[i] > 3 else 1
        if kind == 2 and (value > 4 or rest < 0.6):
            total = max(total, 1.0)
        elif kind < 0:
            near = 2
        for k in range(3):
            if k > near:
                break
            total += k
        to[i], kinds[i] = total, kind + turns
        flags[i] = kind == 2 and total > 1


@kernel
def tables(
    rows: Array1[I64], table: Array1[F64], shift: Array2[F32], to: Array2[F64], integers: Array1[I64], begin: I64, end: I64
) -> None:
    for i in simd_range(begin, end):
        at = rows[i]
        if at >= 0:
            a, b, c, d = load_consecutive(table, 4 * at, 4)
            to[0, i], to[1, i] = a + b * np.float64(shift[0, i]), c - d / np.float64(shift[1, i])
            integers[4 * i + round_to_int(a)] = round_to_int(b)


@kernel
def rows(
    which: Array1[I64], table: Array1[F32], vectors: Array2[F32], wide: Array2[F64], to: Array2[F64], begin: I64, end: I64
) -> None:
    """Rows that follow each other, of those that ask, and parts of a table's rows that lie anywhere."""
    for i in simd_range(begin, end):
        x, y, z = load3(vectors, i)
        store3(to, i, (np.float64(x), np.float64(y) * 2.0, np.float64(z)))
        if which[i] < 0:
            continue
        values = load_consecutive(table, 20 * which[i] + 4, 12)
        a, b, c = load3(wide, i)
        store3(to, i, (np.float64(values[0]) + a, np.float64(values[7]) * b, c - np.float64(values[10])))
        if values[11] > 0:
            p, q, r = load3(vectors, which[i])
            store3(wide, i, (np.float64(r), np.float64(p), np.float64(q)))


def numbers(count: int) -> np.ndarray:
    rng = np.random.default_rng(count)
    x = rng.normal(size=count) * 10 ** rng.uniform(-2, 3, count)
    x[::11], x[3::17], x[5::19] = np.nan, np.inf, 0.0
    return x


@pytest.mark.parametrize("count", COUNTS)
def test_turns_that_ask_leave_and_return_at_different_places(count: int) -> None:
    x = numbers(count)
    kernel_results, plain = ((np.full(count, -7.0), np.full(count, -7, np.int32), np.ones(count, bool)) for _ in range(2))
    questions(x, *kernel_results, 0, count)
    questions.part.function(x, *plain, 0, count)
    for one, other in zip(kernel_results, plain, strict=True):
        assert np.array_equal(one, other, equal_nan=True)
    if count > 20:
        assert len(np.unique(kernel_results[1])) > 5 and kernel_results[2].any() and not kernel_results[2].all()


@pytest.mark.parametrize("count", COUNTS)
def test_elements_anywhere_are_read_and_stored_for_those_that_ask(count: int) -> None:
    rng = np.random.default_rng(count)
    rows = rng.integers(-1, 40, count)
    table = np.stack([rng.integers(0, 4, 40), rng.integers(-9, 9, 40), *rng.normal(size=(2, 40))], axis=1).ravel()
    shift = rng.normal(size=(2, count)).astype(np.float32)
    kernel_results, plain = ((np.zeros((2, count)), np.zeros(4 * count + 4, np.int64)) for _ in range(2))
    tables(rows, table, shift, *kernel_results, 0, count)
    tables.part.function(rows, table, shift.astype(np.float64), *plain, 0, count)
    assert all(np.array_equal(one, other) for one, other in zip(kernel_results, plain, strict=True))


@pytest.mark.parametrize("count", COUNTS)
def test_rows_of_three_and_of_many_are_read_and_stored_for_those_that_ask(count: int) -> None:
    rng = np.random.default_rng(count)
    which = rng.integers(-1, max(count, 1), count)
    table = rng.normal(size=20 * max(count, 1) + 4).astype(np.float32)
    vectors, wide = rng.normal(size=(count, 3)).astype(np.float32), rng.normal(size=(count, 3))
    begin = min(count, 1)
    kernel_results, plain = ((wide.copy(), np.full((count, 3), -7.0)) for _ in range(2))
    rows(which, table, vectors, *kernel_results, begin, count)
    rows.part.function(which, table.astype(np.float64), vectors, *plain, begin, count)
    for one, other in zip(kernel_results, plain, strict=True):
        assert np.array_equal(one, other)
    if count > 20:
        assert (kernel_results[0] != wide).any() and (kernel_results[0] == wide).any() and (kernel_results[1][:begin] == -7).all()


@pytest.mark.parametrize("begin", [0, 3, 8])
def test_a_part_of_the_turns_is_left_to_others(begin: int) -> None:
    x, end = numbers(64), 41
    to, kinds, flags = np.full(64, -7.0), np.full(64, -7, np.int32), np.ones(64, bool)
    questions(x, to, kinds, flags, begin, end)
    assert (to[:begin] == -7).all() and (to[end:] == -7).all() and flags[end:].all()
    questions(x, to, kinds, flags, 9, 2)


@kernel
def several(x: Array1[F64], to: Array1[F64]) -> None:
    total = 0.0
    for i in simd_range(0, x.size):
        total += x[i]
    to[0] = total


def test_what_turns_would_change_together_is_refused() -> None:
    with pytest.raises(NotInSubsetError, match="several iterations of the loop"):
        several(np.ones(9), np.zeros(1))


TARGETS = [
    llvm_compiler.PORTABLE_TARGET,
    llvm_compiler.Target(
        llvm_compiler.PORTABLE_TARGET.triple,
        "znver4",
        llvm_compiler.format_features({"avx2": True, "fma": True, "avx512f": True, "avx512vbmi2": True}),
    ),
    llvm_compiler.Target("aarch64-unknown-linux-gnu", "generic", ""),
]


@pytest.mark.parametrize("target", TARGETS)
def test_no_operation_is_fused(target: llvm_compiler.Target) -> None:
    text = "".join(llvm_compiler.compile_assembly(each.text(target), target) for each in (questions, tables, rows))
    assert "mul" in text
    assert not any(word in text for word in ("fmadd", "fmsub", "fnmadd", "fmla", "fmls"))


@kernel
def reads_one_place(table: Array1[F64], at: I64, count: I64, to: Array1[F64]) -> None:
    """Read an element that does not depend on the turn where it exists: by a statement, in an expression, and behind `and`."""
    for i in simd_range(0, to.size):
        to[i] = 1.0
        if to[i] > 0.0 and at < count and table[at] > 0.0:
            to[i] += table[at]
        to[i] += table[at] if to[i] > 0.0 and at < count else 0.0
        if at >= count:
            continue
        to[i] += table[at] / np.float64(count // (count - at))


@pytest.mark.parametrize("size", COUNTS)
@pytest.mark.parametrize("at", [-3, -1, 0, 2, 5, 1 << 40])
def test_one_place_is_read_for_all_turns_only_where_a_turn_asks(size: int, at: int) -> None:
    table = np.array([2.0, -1.0, 4.0])
    for rows in (table, table[:0]):
        inside = 0 <= at < len(rows)
        count = len(rows) if at >= 0 else at
        code = llvm_compiler.load_object(
            llvm_compiler.compile_object(
                render_kernels([reads_one_place], llvm_compiler.find_host_target(), checked=True),
                llvm_compiler.find_host_target(),
            )
        )
        outputs = [np.zeros(size) for _ in range(3)]
        for run, to in zip(
            (reads_one_place, reads_one_place.make_caller(code, checked=True), KernelInterpreter(reads_one_place)),
            outputs,
            strict=True,
        ):
            run(rows, at, count, to)
        first = rows[at] if inside else 0.0
        expected = 1.0 + (first if first > 0 else 0.0) + first + (first / (count // (count - at)) if inside else 0.0)
        for to in outputs:
            np.testing.assert_array_equal(to, expected)
