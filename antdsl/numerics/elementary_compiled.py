"""`kernels` for one number at a time, in compiled loops: the same float64 operations in the same order, and so the same bits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from antdsl.numerics import elementary
from antdsl.numerics.kernel_cache import njit

_SIN, _COS, _ATAN, _EXP, _LOG = elementary._SIN, elementary._COS, elementary._ATAN, elementary._EXP, elementary._LOG
_FAR, _ROOT_HALF, _LOG2_E = elementary._FAR, elementary._ROOT_HALF, elementary._LOG2_E
_LN2_HIGH, _LN2_LOW = elementary._LN2_HIGH, elementary._LN2_LOW
_TWO_OVER_PI, _HIGH, _LOW = elementary._TWO_OVER_PI, elementary._HALF_PI_HIGH, elementary._HALF_PI_LOW
_PI, _TAN_EIGHTH = elementary._PI, elementary._TAN_EIGHTH
_F = np.float32


@njit(inline="always")
def _series(x, coefficients):  # type: ignore[no-untyped-def]
    value = x * 0.0 + coefficients[len(coefficients) - 1]
    for k in range(len(coefficients) - 2, -1, -1):
        value *= x
        value += coefficients[k]
    return value


@njit()
def cos_sin(x):  # type: ignore[no-untyped-def]
    """Cosine and sine, float32, of an angle below 1e6."""
    wide = np.float64(x)
    turns = np.rint(wide * _TWO_OVER_PI)
    rest = (wide - turns * _HIGH) - turns * _LOW
    quarter = turns - np.floor(turns * 0.25) * 4.0
    square = rest * rest
    sine, cosine = rest * _series(square, _SIN), _series(square, _COS)
    odd = quarter == 1.0 or quarter == 3.0
    c, s = (sine, cosine) if odd else (cosine, sine)
    return _F(-c if quarter == 1.0 or quarter == 2.0 else c), _F(-s if quarter >= 2.0 else s)


@njit()
def atan2(y, x):  # type: ignore[no-untyped-def]
    """Angle of (x, y), float32, of finite float32."""
    wide_y, wide_x = np.float64(y), np.float64(x)
    high, low = max(abs(wide_y), abs(wide_x)), min(abs(wide_y), abs(wide_x))
    ratio = low / (1.0 if high == 0.0 else high)
    steep = ratio > _TAN_EIGHTH
    t = (ratio - 1.0) / (ratio + 1.0) if steep else ratio
    angle = t * _series(t * t, _ATAN) + (_PI / 4 if steep else 0.0)
    if abs(wide_y) > abs(wide_x):
        angle = _PI / 2 - angle
    if wide_x < 0.0:
        angle = _PI - angle
    return _F(-angle if wide_y < 0.0 else angle)


@njit(cache=True, nogil=True, error_model="numpy")
def sines(x, found):  # type: ignore[no-untyped-def]
    """Writes `kernels.sin` of all; False where an angle is not below 1e6."""
    for k in range(x.size):
        if not abs(x[k]) < _FAR:
            return False
        found[k] = cos_sin(x[k])[1]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def cosines(x, found):  # type: ignore[no-untyped-def]
    """Writes `kernels.cos` of all; False where an angle is not below 1e6."""
    for k in range(x.size):
        if not abs(x[k]) < _FAR:
            return False
        found[k] = cos_sin(x[k])[0]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def angles(y, x, found):  # type: ignore[no-untyped-def]
    """Writes `kernels.atan2` of all; False where a number is not finite."""
    for k in range(x.size):
        if not (abs(y[k]) < np.inf and abs(x[k]) < np.inf):
            return False
        found[k] = atan2(y[k], x[k])
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def exponentials(x, found):  # type: ignore[no-untyped-def]
    """Writes `kernels.exp` of all; False where one is no number."""
    for k in range(x.size):
        wide = np.float64(x[k])
        if wide != wide:
            return False
        held = min(max(wide, -200.0), 200.0)
        power = np.rint(held * _LOG2_E)
        rest = (held - power * _LN2_HIGH) - power * _LN2_LOW
        doublings: Any = np.int32(power)  # numba's ldexp takes no wider ones
        found[k] = _F(math.ldexp(_series(rest, _EXP), doublings))
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def logarithms(x, found):  # type: ignore[no-untyped-def]
    """Writes `kernels.log` of all; False where one is not above 0, or not finite."""
    for k in range(x.size):
        wide = np.float64(x[k])
        if not (wide > 0.0 and wide < np.inf):
            return False
        mantissa, whole = math.frexp(wide)
        power = np.float64(whole)
        if mantissa < _ROOT_HALF:
            mantissa, power = mantissa + mantissa, power - 1.0
        s = (mantissa - 1.0) / (mantissa + 1.0)
        found[k] = _F((s * _series(s * s, _LOG) + power * _LN2_LOW) + power * _LN2_HIGH)
    return True
