"""Float32 arithmetic of constants, to the bit as the backends do it: a float64 result rounded once more.

Double rounding is harmless for + - * / and the square root, since 53 >= 2 * 24 + 2
(Figueroa, "When is double rounding innocuous?", 1995).
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

_PACK = struct.Struct("<f")


def f32(x: float) -> float:
    """The nearest float32, ties to even; beyond the range it is infinite."""
    try:
        return float(_PACK.unpack(_PACK.pack(x))[0])
    except OverflowError:
        return math.copysign(math.inf, x)


def _divide(a: float, b: float) -> float:
    if b != 0:
        return a / b
    if a == 0 or math.isnan(a):
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def _sqrt(a: float) -> float:
    return math.sqrt(a) if a >= 0 else math.nan


def _floor(a: float) -> float:
    return float(math.floor(a)) if math.isfinite(a) and a != 0 else a


ARITHMETIC: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _divide,
    "neg": lambda a: -a,
    "abs": abs,
    "floor": _floor,
    "sqrt": _sqrt,
    "finite": lambda a: a if math.isfinite(a) else 0.0,
}

COMPARISONS: dict[str, Callable[..., bool]] = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
}


def least(a: float, b: float) -> float | None:
    """min as the backends take it; None where the sign of a zero would depend on the order."""
    if a == b == 0:
        return None
    if math.isnan(a) or math.isnan(b):
        return b if math.isnan(a) else a
    return min(a, b)


def greatest(a: float, b: float) -> float | None:
    """max, with the same care as `least`."""
    if a == b == 0:
        return None
    if math.isnan(a) or math.isnan(b):
        return b if math.isnan(a) else a
    return max(a, b)
