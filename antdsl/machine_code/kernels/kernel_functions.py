"""The built-in and NumPy functions that a kernel may call, each with the function that emits its instructions."""

from __future__ import annotations

import ast
import math
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, TRUTH, UNSIGNED
from antdsl.machine_code.kernels.values import Number, make_literal_number

if TYPE_CHECKING:
    from antdsl.machine_code.kernels.statements import StatementWriter


_ROUNDING_MAGIC = 1.5 * 2.0**52  # a sum with it has the rounded integer in its lowest bits


def simd_range(begin: int, end: int) -> Iterator[int]:
    """Return the numbers from `begin` to `end - 1`, for a loop with independent iterations: none reads what another one
    writes."""
    return iter(range(begin, end))


def allocate_scratch(count: int, dtype: Any) -> Any:
    """Return a private buffer of `count` numbers for a kernel. The count must be a literal."""
    return np.empty(count, dtype)


def load_consecutive(array: Any, at: int, count: int) -> tuple[Any, ...]:
    """Return `count` consecutive elements of a one-dimensional array, read at once. `count` is a multiple of four."""
    return tuple(array[at + k] for k in range(count))


def load3(array: Any, row: int) -> tuple[Any, Any, Any]:
    """Return a row of an array (n, 3) as three numbers; consecutive rows are read at once."""
    return array[row, 0], array[row, 1], array[row, 2]


def store3(array: Any, row: int, items: tuple[Any, Any, Any]) -> None:
    """Store three numbers as a row of an array (n, 3)."""
    array[row, 0], array[row, 1], array[row, 2] = items


def prefetch(array: Any, at: int) -> None:
    """Prefetch the cache line of an element. Indices outside the array are allowed."""


def round_to_int(value: float) -> int:
    """Return the integer nearest to a float64 of magnitude below 2**51. The result for other inputs is unspecified."""
    return round(value) if abs(value) < 2.0**51 else 0


def float_to_bits(value: Any) -> Any:
    """Return the 64 bits of a float64 as an integer."""
    return int(np.float64(value).view(np.int64))


def bits_to_float(bits: Any) -> Any:
    """Return the float64 with these bits."""
    return float(np.int64(bits).view(np.float64))


def _make_intrinsic(stem: str) -> Callable[..., Number]:
    """Return a function that emits a call of the LLVM function `stem` for one number, such as `llvm.sqrt`."""

    def write_call(w: StatementWriter, a: Number) -> Number:
        a = w.to_float(a)
        return w.op(stem, a.kind, a)

    return write_call


def _emit_absolute(w: StatementWriter, a: Number) -> Number:
    if a.kind in (DOUBLE, FLOAT):
        return w.op("fabs", a.kind, a)
    return w.select(w.compare("lt", a, make_literal_number(0)), w.negate(a), a)


def _emit_minimum(w: StatementWriter, *values: Number) -> Number:
    """Emit the minimum as Python defines it, and return it: the first value, unless a later value is less."""
    best = values[0]
    for each in values[1:]:
        a, b = w.match_kinds(each, best)
        best = w.select(w.compare("lt", a, b), a, b)
    return best


def _emit_maximum(w: StatementWriter, *values: Number) -> Number:
    best = values[0]
    for each in values[1:]:
        a, b = w.match_kinds(each, best)
        best = w.select(w.compare("gt", a, b), a, b)
    return best


def _emit_is_finite(w: StatementWriter, a: Number) -> Number:
    a = w.to_float(a)
    return w.compare("lt", w.op("fabs", a.kind, a), w.convert(make_literal_number(math.inf), a.kind))


def _emit_is_nan(w: StatementWriter, a: Number) -> Number:
    a = w.to_float(a)
    return w.op("fno", TRUTH, a, a)


def _make_conversion(kind: str) -> Callable[..., Number]:
    """Return a function that emits a conversion of a number to `kind`."""
    return lambda w, a: w.convert(a, kind)


def _emit_floor(w: StatementWriter, a: Number) -> Number:
    return w.convert(_make_intrinsic("floor")(w, a), INT)


def _emit_float_bits(w: StatementWriter, a: Number) -> Number:
    return w.op("bitcast", INT, w.convert(a, DOUBLE))


def _emit_nearest_integer(w: StatementWriter, a: Number) -> Number:
    bits = _emit_float_bits(w, w.apply_operator(ast.Pass(), ast.Add(), a, make_literal_number(_ROUNDING_MAGIC)))
    return w.apply_operator(ast.Pass(), ast.Sub(), bits, make_literal_number(float_to_bits(_ROUNDING_MAGIC)))


def _emit_float_from_bits(w: StatementWriter, a: Number) -> Number:
    return w.op("bitcast", DOUBLE, w.convert(a, INT))


def _make_narrowing(bits: int, is_signed: bool) -> Callable[..., Number]:
    """Return a function that emits a cast to an integer of `bits` bits, extended to 64 bits again."""

    def write_conversion(w: StatementWriter, a: Number) -> Number:
        return w.op("sext" if is_signed else "zext", INT, w.op("trunc", f"i{bits}", w.convert(a, INT)))

    return write_conversion


EMITTER_BY_FUNCTION: Mapping[Any, Callable[..., Number]] = {
    np.sqrt: _make_intrinsic("sqrt"), math.sqrt: _make_intrinsic("sqrt"), np.floor: _make_intrinsic("floor"), 
    math.floor: _emit_floor, np.ceil: _make_intrinsic("ceil"), np.rint: _make_intrinsic("rint"),
    abs: _emit_absolute, np.abs: _emit_absolute, min: _emit_minimum, max: _emit_maximum,
    np.isfinite: _emit_is_finite, math.isfinite: _emit_is_finite, np.isnan: _emit_is_nan, math.isnan: _emit_is_nan,
    int: _make_conversion(INT), np.int64: _make_conversion(INT),
    np.intp: _make_conversion(INT), np.uint64: _make_conversion(UNSIGNED), float: _make_conversion(DOUBLE),
    np.float64: _make_conversion(DOUBLE), np.float32: _make_conversion(FLOAT),
    bool: _make_conversion(TRUTH), np.bool_: _make_conversion(TRUTH), np.int32: _make_narrowing(32, True),
    np.uint32: _make_narrowing(32, False),
    float_to_bits: _emit_float_bits, bits_to_float: _emit_float_from_bits, round_to_int: _emit_nearest_integer,
}  # fmt: skip
