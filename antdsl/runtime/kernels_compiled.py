"""`kernels` for one number at a time, in compiled loops: the same float64 operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.runtime import kernels
from antdsl.runtime.compiling import njit

_SIN, _COS, _ATAN = kernels._SIN, kernels._COS, kernels._ATAN
_TWO_OVER_PI, _HIGH, _LOW = kernels._TWO_OVER_PI, kernels._HALF_PI_HIGH, kernels._HALF_PI_LOW
_PI, _TAN_EIGHTH = kernels._PI, kernels._TAN_EIGHTH
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
