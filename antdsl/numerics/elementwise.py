"""The elementwise operations that plans use, for float32 arrays and single float32 numbers. All backends use this table. It
contains only functions of antdsl, and operations for which IEEE 754 defines the result exactly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from antdsl.numerics import elementary

NumPyValue = Any  # an array, or one NumPy scalar
FLOAT32_ZERO = np.float32(0)


def take_minimum(a: NumPyValue, b: NumPyValue) -> NumPyValue:
    """Return the lesser of two numbers. If one is NaN, return the other. A result of -0 becomes 0, because `fmin` of -0 and 0
    may return either."""
    return np.fmin(a, b) + FLOAT32_ZERO


def take_maximum(a: NumPyValue, b: NumPyValue) -> NumPyValue:
    """Return the greater of two numbers. NaN and -0 are treated as in `take_minimum`."""
    return np.fmax(a, b) + FLOAT32_ZERO


def select_by_condition(condition: NumPyValue, true_value: NumPyValue, false_value: NumPyValue) -> NumPyValue:
    """Return `true_value` where the condition is true, else `false_value`."""
    if np.ndim(condition) == 0 and np.ndim(true_value) == 0 and np.ndim(false_value) == 0:
        return true_value if condition else false_value
    return np.where(condition, true_value, false_value)


def to_float32(a: NumPyValue) -> NumPyValue:
    """Convert a bool, a state number or a row number to float32."""
    return np.float32(a) if np.ndim(a) == 0 else a.astype(np.float32)


def replace_non_finite(a: NumPyValue) -> NumPyValue:
    """Return the numbers with each NaN and infinity replaced by 0."""
    return select_by_condition(np.isfinite(a), a, FLOAT32_ZERO)


# Functions with `out=`: the array of a value that is no longer needed can be reused.
UFUNC_BY_NAME: Mapping[str, np.ufunc] = {
    "add": np.add,
    "sub": np.subtract,
    "mul": np.multiply,
    "div": np.divide,
    "neg": np.negative,
    "abs": np.absolute,
    "floor": np.floor,
    "sqrt": np.sqrt,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
    "eq": np.equal,
    "ne": np.not_equal,
    "and": np.logical_and,
    "or": np.logical_or,
    "not": np.logical_not,
}

FUNCTION_BY_NAME: Mapping[str, Callable[..., NumPyValue]] = {
    **UFUNC_BY_NAME,
    "min": take_minimum,
    "max": take_maximum,
    "sin": elementary.sin,
    "cos": elementary.cos,
    "exp": elementary.exp,
    "log": elementary.log,
    "pow": elementary.power,
    "atan2": elementary.atan2,
    "where": select_by_condition,
    "number": to_float32,
    "finite": replace_non_finite,
}
