"""sin, cos, exp, log, pow and atan2 of float32 numbers, computed with basic float64 operations only.

Addition, multiplication, division and rounding give the same bits on every machine, for scalars and for arrays. Transcendental
functions of libraries may differ between machines. Errors stay below one unit in the last place of float32
(tests/numerics/test_runtime_kernels.py). Reductions and series: W. J. Cody and W. Waite, Software Manual for the Elementary
Functions, 1980, chapters 5 to 8 and 11."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np

from antdsl.numerics import elementary_loops, parallel
from antdsl.numerics.elementary_loops import (
    ATAN_COEFFICIENTS,
    COS_COEFFICIENTS,
    EXP_COEFFICIENTS,
    HALF_PI_HIGH,
    HALF_PI_LOW,
    LARGE_ANGLE,
    LN2_HIGH,
    LN2_LOW,
    LOG2_E,
    LOG_COEFFICIENTS,
    PI,
    SIN_COEFFICIENTS,
    SQRT_HALF,
    TAN_EIGHTH_TURN,
    TWO_OVER_PI,
)

FloatValue = Any  # a float32 array, or one np.float32


def _evaluate_series(x: FloatValue, coefficients: tuple[float, ...]) -> FloatValue:
    """Return the value of a polynomial at `x` (Horner's method). `coefficients` begin with the constant term."""
    value = x * 0.0 + coefficients[-1]
    for c in coefficients[-2::-1]:  # in place for arrays
        value *= x
        value += c
    return value


def _split_quarter_turns(x: FloatValue) -> tuple[FloatValue, FloatValue]:
    """Split an angle (rad) into a remainder between -pi/4 and pi/4, and the number of quarter turns, 0 .. 3."""
    wide_x = _to_float64(x)
    usual = np.abs(wide_x) < LARGE_ANGLE
    wide: FloatValue = wide_x if np.all(usual) else np.where(usual, wide_x, np.fmod(wide_x, 2.0 * PI))
    turns = np.rint(wide * TWO_OVER_PI)
    rest = (wide - turns * HALF_PI_HIGH) - turns * HALF_PI_LOW
    return rest, turns - np.floor(turns * 0.25) * 4.0


def _compute_sine_and_cosine(x: FloatValue) -> tuple[FloatValue, FloatValue, FloatValue]:
    """Reduce an angle by quarter turns. Return the sine and cosine of the remainder, and the number of quarter turns, 0 .. 3."""
    rest, quarter = _split_quarter_turns(x)
    square = rest * rest
    return rest * _evaluate_series(square, SIN_COEFFICIENTS), _evaluate_series(square, COS_COEFFICIENTS), quarter


def sin(x: FloatValue) -> FloatValue:
    """Return the sine of an angle (rad); NaN if the angle is not finite. Angles above 1e6 are reduced modulo the float64 value
    of 2 pi."""
    if np.ndim(x) == 0:
        return _get_cached_value(sin_float64, np.float64(x).tobytes())
    values = _run_kernel("write_sines", x)
    return _to_float32(sin_float64(x)) if values is None else values


def cos(x: FloatValue) -> FloatValue:
    """Return the cosine of an angle (rad). NaN and large angles are treated as in `sin`."""
    if np.ndim(x) == 0:
        return _get_cached_value(cos_float64, np.float64(x).tobytes())
    values = _run_kernel("write_cosines", x)
    return _to_float32(cos_float64(x)) if values is None else values


def sin_float64(x: FloatValue) -> FloatValue:
    """Return the sine of an angle (rad) as float64, with an error of about 1e-13."""
    sine, cosine, quarter = _compute_sine_and_cosine(x)
    value: FloatValue = np.where((quarter == 1.0) | (quarter == 3.0), cosine, sine)
    return np.where(quarter >= 2.0, -value, value)


def cos_float64(x: FloatValue) -> FloatValue:
    """Return the cosine of an angle (rad) as float64, with an error of about 1e-13."""
    sine, cosine, quarter = _compute_sine_and_cosine(x)
    value: FloatValue = np.where((quarter == 1.0) | (quarter == 3.0), sine, cosine)
    return np.where((quarter == 1.0) | (quarter == 2.0), -value, value)


def _exp_float64(value: FloatValue) -> FloatValue:
    """Return e raised to the power `value`, a float64."""
    value = np.minimum(np.maximum(value, -200.0), 200.0)  # both propagate NaN; beyond these limits float32 is 0 or infinite
    power = np.rint(value * LOG2_E)
    rest = (value - power * LN2_HIGH) - power * LN2_LOW
    exponent = np.where(power == power, power, 0.0).astype(np.int32)
    return np.ldexp(_evaluate_series(rest, EXP_COEFFICIENTS), exponent)


def _log_float64(number: FloatValue) -> FloatValue:
    """Return the natural logarithm of a float64; -inf for 0, NaN for negative numbers."""
    usual = (number > 0.0) & (number < np.inf)
    mantissa, power = np.frexp(np.where(usual, number, 1.0))
    low = mantissa < SQRT_HALF
    mantissa = np.where(low, mantissa + mantissa, mantissa)
    power = power - low * 1.0
    s = (mantissa - 1.0) / (mantissa + 1.0)
    value = (s * _evaluate_series(s * s, LOG_COEFFICIENTS) + power * LN2_LOW) + power * LN2_HIGH
    special = np.where(number == 0.0, -np.inf, np.where(number == np.inf, np.inf, np.nan))
    return np.where(usual, value, special)


def exp(x: FloatValue) -> FloatValue:
    """Return e raised to the power `x`."""
    if np.ndim(x) == 0:
        return _get_cached_value(_exp_float64, np.float64(x).tobytes())
    values = _run_kernel("write_exponentials", x)
    return _to_float32(_exp_float64(_to_float64(x))) if values is None else values


def log(x: FloatValue) -> FloatValue:
    """Return the natural logarithm; -inf for 0, NaN for negative numbers."""
    values = _run_kernel("write_logarithms", x)
    return _to_float32(_log_float64(_to_float64(x))) if values is None else values


def power(a: FloatValue, b: FloatValue) -> FloatValue:
    """Return `a` raised to the power `b`. The result is NaN for a negative `a` unless `b` is an integer. `a**0` and `1**b` are
    1 for any `a` and `b`, also NaN."""
    wide_a, wide_b = _to_float64(a), _to_float64(b)
    value = _exp_float64(wide_b * _log_float64(np.abs(wide_a)))
    is_integer = np.floor(wide_b) == wide_b
    is_odd = is_integer & (np.floor(wide_b * 0.5) * 2.0 != wide_b)
    value = np.where(wide_a < 0.0, np.where(is_integer, np.where(is_odd, -value, value), np.nan), value)
    return _to_float32(np.where((wide_b == 0.0) | (wide_a == 1.0), 1.0, value))


def atan2(y: FloatValue, x: FloatValue) -> FloatValue:
    """Return the angle (rad) between the x axis and the direction (x, y), from -pi to pi; 0 for (0, 0)."""
    values = _run_kernel("write_angles", y, x)
    return _to_float32(atan2_float64(y, x)) if values is None else values


def atan2_float64(y: FloatValue, x: FloatValue) -> FloatValue:
    """Return the same angle as `atan2`, but as float64 with an error of about 1e-13."""
    wide_y, wide_x = _to_float64(y), _to_float64(x)
    high, low = np.maximum(np.abs(wide_y), np.abs(wide_x)), np.minimum(np.abs(wide_y), np.abs(wide_x))
    ratio = low / np.where(high == 0.0, 1.0, high)
    ratio = np.where((low == np.inf) & (high == np.inf), 1.0, ratio)
    steep = ratio > TAN_EIGHTH_TURN
    t = np.where(steep, (ratio - 1.0) / (ratio + 1.0), ratio)
    angle = t * _evaluate_series(t * t, ATAN_COEFFICIENTS) + np.where(steep, PI / 4, 0.0)
    angle = np.where(np.abs(wide_y) > np.abs(wide_x), PI / 2 - angle, angle)
    angle = np.where(wide_x < 0.0, PI - angle, angle)
    return np.where(wide_y < 0.0, -angle, angle)


def _to_float64(x: FloatValue) -> FloatValue:
    return np.float64(x) if np.ndim(x) == 0 else x.astype(np.float64)


def _to_float32(x: FloatValue) -> FloatValue:
    return np.float32(x) if np.ndim(x) == 0 else x.astype(np.float32)


@lru_cache(1024)
def _get_cached_value(function: Callable[[FloatValue], FloatValue], number: bytes) -> FloatValue:
    """Return the cached value of a function of one float64. The cache's key consists of the bytes of the number, which
    distinguish -0 from 0. Caching pays because most of these numbers are the same in every step."""
    return _to_float32(function(np.frombuffer(number)[0]))


def _run_kernel(kernel_name: str, *values: FloatValue) -> FloatValue | None:
    """Run the kernel `kernel_name` of `elementary_loops` on arrays, and return the result. Return None if the kernel cannot
    process these arrays, for example because of a NaN."""
    one = values[0]
    if not all(isinstance(v, np.ndarray) and v.dtype == np.float32 and v.ndim == 1 and v.size == one.size for v in values):
        return None
    output = np.empty(one.size, np.float32)
    return output if getattr(elementary_loops, kernel_name)(*parallel.make_contiguous(*values), output) else None
