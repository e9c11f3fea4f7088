"""Sums that do not depend on the order of their terms: decision 23 of the language reference.

Each term is rounded to a multiple of 2**quantum, as (x + M) - M in float64; multiples of one power of two add without rounding.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_BOUND = 44  # a term is at most 2**(quantum + 44), so that 512 of the greatest terms still add exactly in 53 bits


def rounded(terms: NDArray[np.float32], quantum: int) -> NDArray[np.float64]:
    """Terms as float64 multiples of 2**quantum, cut to +-2**(quantum + 44); NaN stays NaN."""
    bound = np.ldexp(1.0, quantum + _BOUND)
    magic = np.ldexp(1.5, quantum + 52)
    wide = np.clip(np.asarray(terms, np.float64), -bound, bound)
    wide += magic
    wide -= magic
    return wide


def sums(index: NDArray[np.integer[Any]], terms: NDArray[np.float32], quantum: int, length: int) -> NDArray[np.float32]:
    """Sum of the terms of each index 0 .. length-1, as float32."""
    if index.size == 0:
        return np.zeros(length, np.float32)
    return np.bincount(index, weights=rounded(terms, quantum), minlength=length).astype(np.float32)


def total(terms: NDArray[np.float32], quantum: int) -> np.float32:
    """Sum of all terms, as float32."""
    return np.float32(rounded(terms, quantum).sum()) if terms.size else np.float32(0)
