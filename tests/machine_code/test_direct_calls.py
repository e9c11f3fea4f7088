"""Kernels that machine code calls: what they read of each kind of argument, and what is left to Python."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels import BOOL, F32, F64, I64, U64, Array1, Array2, Strided2, direct, kernel, kernel_calls

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="no llvmlite")


@kernel
def read(
    real: F64, single: F32, integer: I64, unsigned: U64, truth: BOOL, pair: tuple[Array1[F32], tuple[F64, I64]]
) -> tuple[F64, F32, I64, U64, BOOL, F32, F64, I64]:
    first, (second, third) = pair
    return real, single, integer, unsigned, truth, first[0], second, third


@kernel
def written(x: Array1[F64], out: Array2[F64], any_way: Strided2[F32]) -> None:
    for i in range(out.shape[0]):
        for k in range(out.shape[1]):
            out[i, k] = x[i] + np.float64(any_way[i, k])


@kernel
def last(x: Array1[I64]) -> I64:
    return x[x.size - 1]


@pytest.fixture
def otherwise(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of kernels that Python has called, from now on."""
    calls: list[str] = []
    plain = kernel_calls._make_python_caller

    def counted(name: str, *rest: Any) -> Any:
        run = plain(name, *rest)

        def noted(*arguments: Any) -> Any:
            calls.append(name)
            return run(*arguments)

        return noted

    monkeypatch.setattr(kernel_calls, "_make_python_caller", counted)
    for each in (read, written, last):
        monkeypatch.setattr(each, "_loaded_call", None)
        monkeypatch.setattr(each, "__call__", each._first_call)
    return calls


_ONE = np.array([7.5], np.float32)
_GOOD: list[tuple[Any, ...]] = [
    (1.5, 2.5, 3, 4, True, (_ONE, (8.5, 9))),
    (np.float64(1.5), np.float32(2.5), np.int64(3), np.uint64(4), np.bool_(True), (_ONE, (np.float32(8.5), np.int64(9)))),
    (1.5, np.float64(2.5), -(2**63), 2**63, False, (_ONE[:1], (8.5, True))),
    (1.5, 2.5, 2**63 - 1, 2**64 - 2, np.bool_(False), (_ONE, (float("inf"), 0))),
]
_OTHERWISE: list[tuple[Any, ...]] = [
    (1, 2.5, 3, 4, True, (_ONE, (8.5, 9))),
    (1.5, 2.5, 3, 2**64 - 1, True, (_ONE, (8.5, 9))),
    (1.5, 2.5, np.int32(3), 4, True, (_ONE, (8.5, 9))),
    (1.5, 2.5, 3, 4, 1.0, [_ONE, (8.5, 9)]),
]


@pytest.mark.skipif(not direct.is_supported(), reason="objects lie otherwise here")
@pytest.mark.parametrize(("cases", "calls"), [(_GOOD, 0), (_OTHERWISE, len(_OTHERWISE))])
def test_numbers_and_tuples_are_read(otherwise: list[str], cases: list[tuple[Any, ...]], calls: int) -> None:
    for real, single, integer, unsigned, truth, pair in cases:
        result = read(real, single, integer, unsigned, truth, pair)
        first, (second, third) = pair
        assert result == (real, single, integer, unsigned, bool(truth), first[0], second, third)
        assert [type(each) for each in result] == [float, float, int, int, bool, float, float, int]
    assert otherwise == ["read"] * calls


@pytest.mark.skipif(not direct.is_supported(), reason="objects lie otherwise here")
def test_arrays_are_read_as_they_lie(otherwise: list[str]) -> None:
    rng = np.random.default_rng(1)
    x, base = rng.random(4), rng.random((8, 9)).astype(np.float32)
    for any_way in (base[:4, :3], base.T[:4, :3], base[::2, ::3], base[::-2, ::-3], np.ascontiguousarray(base[:4, :3])):
        out = np.zeros((4, 3))
        written(x, out, any_way)
        assert np.array_equal(out, x[:, None] + any_way)
    assert not otherwise


def test_wrong_arguments_are_reported() -> None:
    x, out, any_way = np.zeros(4), np.zeros((4, 3)), np.zeros((4, 3), np.float32)
    still = out.copy()
    still.flags.writeable = False
    turned = np.zeros((3, 4)).T
    for bad in ((x, still, any_way), (x, turned, any_way), (x[::2], out, any_way), (x, out, out), (x, x, any_way)):
        with pytest.raises(ValueError, match=r"written|contiguous"):
            written(*bad)
    for few in ((), (x,), (x, out, any_way, x)):
        with pytest.raises(TypeError, match="takes 3 arguments"):
            written(*few)
    with pytest.raises(ValueError, match="takes 2 values"):
        read(1.5, 2.5, 3, 4, True, (_ONE, (8.5, 9), 1))
    with pytest.raises((OverflowError, ValueError)):
        read(1.5, 2.5, 2**63, 4, True, (_ONE, (8.5, 9)))
    with pytest.raises((OverflowError, ValueError)):
        read(1.5, 2.5, 3, -4, True, (_ONE, (8.5, 9)))


def test_without_it_python_calls_with_the_same_results(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(direct, "is_supported", lambda: False)
    for each in (read, last):
        monkeypatch.setattr(each, "_loaded_call", None)
        monkeypatch.setattr(each, "__call__", each._first_call)
    assert read(*_GOOD[0]) == (1.5, 2.5, 3, 4, True, 7.5, 8.5, 9)
    assert last(np.arange(5)) == 4


def test_nothing_is_held_or_let_go_by_a_call() -> None:
    array, big = np.arange(100_000, 100_005), 123_456.789
    pair = (_ONE, (big, 9))
    last(array), read(big, 2.5, 3, 4, True, pair)
    initial_counts = [sys.getrefcount(each) for each in (array, big, pair, _ONE, np.dtype(np.int64), None, True)]
    for _ in range(1_000):
        last(array)
        read(big, 2.5, 3, 4, True, pair)
        written(np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3), np.float32))
    final_counts = [sys.getrefcount(each) for each in (array, big, pair, _ONE, np.dtype(np.int64), None, True)]
    assert all(abs(a - b) < 50 for a, b in zip(initial_counts, final_counts, strict=True))


def test_threads_call_at_once() -> None:
    def work(k: int) -> bool:
        array = np.arange(k, k + 100)
        return all(last(array) == k + 99 for _ in range(500))

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(16)))
