"""What the NumPy functions do to lanes that the project's kernels are written with: the same bits, NaN and signs of zero too."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from antdsl.machine_code.lanes import F64, I32, I64, PTR, WIDTH, Lanes


def _minimum(e: Any, a: Any, b: Any) -> Any:
    """The lesser; NaN where one is."""
    left, right = e.paired(a, b)
    found = e.where(left > right, right, left)
    return found if right.constant else e.where(e.unordered(right), right, found)


def _maximum(e: Any, a: Any, b: Any) -> Any:
    left, right = e.paired(a, b)
    found = e.where(left < right, right, left)
    return found if right.constant else e.where(e.unordered(right), right, found)


def _fmin(e: Any, a: Any, b: Any) -> Any:
    """The lesser; the other one where one is NaN."""
    left, right = e.paired(a, b)
    return e.where(e.unordered(right), left, e.where(left < right, left, right))


def _fmax(e: Any, a: Any, b: Any) -> Any:
    left, right = e.paired(a, b)
    return e.where(e.unordered(right), left, e.where(left > right, left, right))


def _isfinite(e: Any, a: Lanes) -> Any:
    return e.intrinsic("fabs", a) < np.inf


def _frexp(e: Any, a: Lanes) -> tuple[Lanes, Lanes]:
    """Of a normal number of float64: its fraction in [0.5, 1), and its power of 2 as i32."""
    bits = e.bits(a, I64)
    power = e.convert((bits >> 52) & 0x7FF, I32) - 1022
    return e.bits((bits & ~(0x7FF << 52)) | (1022 << 52), F64), power


def _ldexp(e: Any, a: Lanes, power: Lanes) -> Any:
    """a times a power of 2 between -1022 and 1023."""
    wide = e.convert(power, I64)
    return a * e.bits((wide + 1023) << 52, F64)


def _fmod(e: Any, a: Any, b: Any) -> Any:
    """The exact remainder, with the sign of a. Most are less than b already, and what is not is found lane by lane."""
    left, right = e.paired(a, b)
    result = e.slot(left.kind)
    e.do(f"store {left.typed}, ptr {result}")
    rest = e.intrinsic("fabs", left) < e.intrinsic("fabs", right)
    with e.inside(e.some(~rest)):
        for lane in range(WIDTH):
            x, y = (e.op(f"extractelement {v.typed}, i64 {lane}", v.kind, one=True) for v in (left, right))
            one = e.op(f"frem {x.typed}, {y.name}", x.kind, one=True)
            place = e.op(f"getelementptr {x.kind}, ptr {result}, i64 {lane}", PTR, one=True)
            e.do(f"store {one.typed}, ptr {place.name}")
    return e.op(f"load {left.type}, ptr {result}", left.kind)


def _logical(word: str) -> Callable[..., Lanes]:
    return lambda e, a, b: e.bitwise(word, a, b)


MEANINGS: Mapping[Any, Callable[..., Any]] = {
    np.add: lambda e, a, b: e.arithmetic("add", a, b),
    np.subtract: lambda e, a, b: e.arithmetic("sub", a, b),
    np.multiply: lambda e, a, b: e.arithmetic("mul", a, b),
    np.true_divide: lambda e, a, b: e.arithmetic("div", a, b),
    np.negative: lambda e, a: -a,
    np.absolute: lambda e, a: e.intrinsic("fabs", a),
    np.floor: lambda e, a: e.intrinsic("floor", a),
    np.rint: lambda e, a: e.intrinsic("rint", a),
    np.sqrt: lambda e, a: e.intrinsic("sqrt", a),
    np.less: lambda e, a, b: e.compare("lt", a, b),
    np.less_equal: lambda e, a, b: e.compare("le", a, b),
    np.greater: lambda e, a, b: e.compare("gt", a, b),
    np.greater_equal: lambda e, a, b: e.compare("ge", a, b),
    np.equal: lambda e, a, b: e.compare("eq", a, b),
    np.not_equal: lambda e, a, b: e.compare("ne", a, b),
    np.logical_and: _logical("and"),
    np.logical_or: _logical("or"),
    np.logical_not: lambda e, a: ~a,
    np.bitwise_and: _logical("and"),
    np.bitwise_or: _logical("or"),
    np.bitwise_xor: _logical("xor"),
    np.right_shift: lambda e, a, b: e.bitwise("lshr", a, b),
    np.left_shift: lambda e, a, b: e.bitwise("shl", a, b),
    np.minimum: _minimum,
    np.maximum: _maximum,
    np.fmin: _fmin,
    np.fmax: _fmax,
    np.isfinite: _isfinite,
    np.frexp: _frexp,
    np.ldexp: _ldexp,
    np.fmod: _fmod,
    np.where: lambda e, condition, then, other: e.where(condition, then, other),
    np.ndim: lambda e, a: 1,
    np.all: lambda e, a: False,  # of lanes it is not known while their text is written
    np.clip: lambda e, a, low, high: _minimum(e, _maximum(e, a, low), high),
}
