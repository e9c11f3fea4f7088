"""`elementary` for one number at a time, in compiled loops: the same float64 operations in the same order, so the same bits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from antdsl.numerics.coefficients import (
    ATAN,
    COS,
    EXP,
    FAR,
    HALF_PI_HIGH,
    HALF_PI_LOW,
    LN2_HIGH,
    LN2_LOW,
    LOG,
    LOG2_E,
    PI,
    ROOT_HALF,
    SIN,
    TAN_EIGHTH,
    TWO_OVER_PI,
)
from antdsl.numerics.kernel_cache import njit

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
    turns = np.rint(wide * TWO_OVER_PI)
    rest = (wide - turns * HALF_PI_HIGH) - turns * HALF_PI_LOW
    quarter = turns - np.floor(turns * 0.25) * 4.0
    square = rest * rest
    sine, cosine = rest * _series(square, SIN), _series(square, COS)
    odd = quarter == 1.0 or quarter == 3.0
    c, s = (sine, cosine) if odd else (cosine, sine)
    return _F(-c if quarter == 1.0 or quarter == 2.0 else c), _F(-s if quarter >= 2.0 else s)


@njit()
def atan2(y, x):  # type: ignore[no-untyped-def]
    """Angle of (x, y), float32, of finite float32."""
    wide_y, wide_x = np.float64(y), np.float64(x)
    high, low = max(abs(wide_y), abs(wide_x)), min(abs(wide_y), abs(wide_x))
    ratio = low / (1.0 if high == 0.0 else high)
    steep = ratio > TAN_EIGHTH
    t = (ratio - 1.0) / (ratio + 1.0) if steep else ratio
    angle = t * _series(t * t, ATAN) + (PI / 4 if steep else 0.0)
    if abs(wide_y) > abs(wide_x):
        angle = PI / 2 - angle
    if wide_x < 0.0:
        angle = PI - angle
    return _F(-angle if wide_y < 0.0 else angle)


@njit(cache=True, nogil=True, error_model="numpy")
def sines(x, found):  # type: ignore[no-untyped-def]
    """Writes `elementary.sin` of all; False where an angle is not below 1e6."""
    for k in range(x.size):
        if not abs(x[k]) < FAR:
            return False
        found[k] = cos_sin(x[k])[1]
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def cosines(x, found):  # type: ignore[no-untyped-def]
    """Writes `elementary.cos` of all; False where an angle is not below 1e6."""
    for k in range(x.size):
        if not abs(x[k]) < FAR:
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
    """Writes `elementary.exp` of all; False where one is no number."""
    for k in range(x.size):
        wide = np.float64(x[k])
        if wide != wide:
            return False
        held = min(max(wide, -200.0), 200.0)
        power = np.rint(held * LOG2_E)
        rest = (held - power * LN2_HIGH) - power * LN2_LOW
        doublings: Any = np.int32(power)  # numba's ldexp takes no wider ones
        found[k] = _F(math.ldexp(_series(rest, EXP), doublings))
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def logarithms(x, found):  # type: ignore[no-untyped-def]
    """Writes `elementary.log` of all; False where one is not above 0, or not finite."""
    for k in range(x.size):
        wide = np.float64(x[k])
        if not (wide > 0.0 and wide < np.inf):
            return False
        mantissa, whole = math.frexp(wide)
        power = np.float64(whole)
        if mantissa < ROOT_HALF:
            mantissa, power = mantissa + mantissa, power - 1.0
        s = (mantissa - 1.0) / (mantissa + 1.0)
        found[k] = _F((s * _series(s * s, LOG) + power * LN2_LOW) + power * LN2_HIGH)
    return True
