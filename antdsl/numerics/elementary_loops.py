"""The functions of `elementary` as compiled loops over single numbers. They use the same float64 operations in the same order,
so results have the same bits."""

from __future__ import annotations

from math import factorial
from typing import Any

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, Array1, bits_to_float, float_to_bits, inlined, kernel, simd_range

PI = 3.141592653589793
TWO_OVER_PI = 0.6366197723675814
HALF_PI_HIGH = 1.5707963267341256  # the first 33 bits of pi/2: its product with a whole number below 2**20 is exact
HALF_PI_LOW = 6.077100506506192e-11
LARGE_ANGLE = 1e6  # larger angles are first reduced to the exact remainder of 2 pi
LOG2_E = 1.4426950408889634
LN2_HIGH = 0.693147180369123816490
LN2_LOW = 1.90821492927058770002e-10
SQRT_HALF = 0.7071067811865476
TAN_EIGHTH_TURN = 0.41421356237309503

SIN_COEFFICIENTS = tuple((-1.0) ** k / factorial(2 * k + 1) for k in range(7))
COS_COEFFICIENTS = tuple((-1.0) ** k / factorial(2 * k) for k in range(8))
EXP_COEFFICIENTS = tuple(1.0 / factorial(k) for k in range(12))
LOG_COEFFICIENTS = tuple(2.0 / (2 * k + 1) for k in range(10))
ATAN_COEFFICIENTS = tuple((-1.0) ** k / (2 * k + 1) for k in range(15))
_F = np.float32
# Of float64: fraction bits, exponent bits, and exponent offset
_FRACTION_BITS, _EXPONENT_MASK, _EXPONENT_BIAS = 52, 0x7FF, 1023


@inlined
def _evaluate_series(x: F64, coefficients: Any) -> F64:
    """Return the value of a polynomial at `x` (Horner's method). `coefficients` begin with the constant term."""
    value = x * 0.0 + coefficients[-1]
    for c in coefficients[-2::-1]:
        value *= x
        value += c
    return value


@inlined
def compute_cos_and_sin(x: F32) -> tuple[F32, F32]:
    """Return the cosine and the sine, as float32, of an angle below 1e6 rad."""
    wide = np.float64(x)
    turns = np.rint(wide * TWO_OVER_PI)
    rest = (wide - turns * HALF_PI_HIGH) - turns * HALF_PI_LOW
    quarter = turns - np.floor(turns * 0.25) * 4.0
    square = rest * rest
    sine, cosine = rest * _evaluate_series(square, SIN_COEFFICIENTS), _evaluate_series(square, COS_COEFFICIENTS)
    is_odd = quarter == 1.0 or quarter == 3.0
    c, s = (sine, cosine) if is_odd else (cosine, sine)
    return _F(-c if quarter == 1.0 or quarter == 2.0 else c), _F(-s if quarter >= 2.0 else s)


@inlined
def atan2(y: F32, x: F32) -> F32:
    """Return the angle (rad, float32) between the x axis and the direction (x, y). Both numbers must be finite float32."""
    wide_y, wide_x = np.float64(y), np.float64(x)
    high, low = max(abs(wide_y), abs(wide_x)), min(abs(wide_y), abs(wide_x))
    ratio = low / (1.0 if high == 0.0 else high)
    steep = ratio > TAN_EIGHTH_TURN
    t = (ratio - 1.0) / (ratio + 1.0) if steep else ratio
    angle = t * _evaluate_series(t * t, ATAN_COEFFICIENTS) + (PI / 4 if steep else 0.0)
    if abs(wide_y) > abs(wide_x):
        angle = PI / 2 - angle
    if wide_x < 0.0:
        angle = PI - angle
    return _F(-angle if wide_y < 0.0 else angle)


@inlined
def _are_all_between(x: Array1[F32], lower: F64, upper: F64) -> BOOL:
    """Return whether all numbers lie between `lower` and `upper`."""
    is_between = True
    for k in range(x.size):
        is_between &= np.float64(x[k]) > lower and np.float64(x[k]) < upper
    return is_between


@kernel
def write_sines(x: Array1[F32], output: Array1[F32]) -> BOOL:
    """Write `elementary.sin` of all numbers to `output`, and return True. Return False if an angle is not below 1e6 rad."""
    if not _are_all_between(x, -LARGE_ANGLE, LARGE_ANGLE):
        return False
    for k in simd_range(0, x.size):
        output[k] = compute_cos_and_sin(x[k])[1]
    return True


@kernel
def write_cosines(x: Array1[F32], output: Array1[F32]) -> BOOL:
    """Write `elementary.cos` of all numbers to `output`, and return True. Return False if an angle is not below 1e6 rad."""
    if not _are_all_between(x, -LARGE_ANGLE, LARGE_ANGLE):
        return False
    for k in simd_range(0, x.size):
        output[k] = compute_cos_and_sin(x[k])[0]
    return True


@kernel
def write_angles(y: Array1[F32], x: Array1[F32], output: Array1[F32]) -> BOOL:
    """Write `elementary.atan2` of all pairs of numbers to `output`, and return True. Return False if a number is not finite."""
    if not (_are_all_between(y, -np.inf, np.inf) and _are_all_between(x, -np.inf, np.inf)):
        return False
    for k in simd_range(0, x.size):
        output[k] = atan2(y[k], x[k])
    return True


@kernel
def write_exponentials(x: Array1[F32], output: Array1[F32]) -> BOOL:
    """Write `elementary.exp` of all numbers to `output`, and return True. Return False if a number is NaN."""
    for k in range(x.size):
        if x[k] != x[k]:
            return False
    for k in simd_range(0, x.size):
        clamped = min(max(np.float64(x[k]), -200.0), 200.0)
        power = np.rint(clamped * LOG2_E)
        rest = (clamped - power * LN2_HIGH) - power * LN2_LOW
        output[k] = _F(
            _evaluate_series(rest, EXP_COEFFICIENTS) * bits_to_float((np.int64(power) + _EXPONENT_BIAS) << _FRACTION_BITS)
        )
    return True


@kernel
def write_logarithms(x: Array1[F32], output: Array1[F32]) -> BOOL:
    """Write `elementary.log` of all numbers to `output`, and return True. Return False if a number is not positive and finite."""
    if not _are_all_between(x, 0.0, np.inf):
        return False
    for k in simd_range(0, x.size):
        bits = float_to_bits(np.float64(x[k]))  # of a positive float32; as float64 it is never denormal
        power = np.float64(((bits >> _FRACTION_BITS) & _EXPONENT_MASK) - (_EXPONENT_BIAS - 1))
        mantissa = bits_to_float((bits & ((1 << _FRACTION_BITS) - 1)) | ((_EXPONENT_BIAS - 1) << _FRACTION_BITS))
        if mantissa < SQRT_HALF:
            mantissa, power = mantissa + mantissa, power - 1.0
        s = (mantissa - 1.0) / (mantissa + 1.0)
        output[k] = _F((s * _evaluate_series(s * s, LOG_COEFFICIENTS) + power * LN2_LOW) + power * LN2_HIGH)
    return True
