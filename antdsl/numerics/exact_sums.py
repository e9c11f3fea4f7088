"""Sums that do not depend on the order of their terms (decision 23 of the language reference).

Each term x is first rounded to a multiple of 2**quantum, by computing (x + M) - M in float64 with a large constant M.
Multiples of the same power of two can be added without rounding."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_TERM_EXPONENT = 44  # a term is at most 2**(quantum + 44)
_FLOAT64_BITS = 53  # bits of float64: sums are exact below 2**(quantum + 53)
LOW_WORD_BITS = 22  # bits of the lower of two words, for larger sums; both words suffice for any number of terms


def quantise_terms(terms: NDArray[np.float32], quantum: int) -> NDArray[np.float64]:
    """Return terms rounded to float64 multiples of 2**quantum and clamped to ±2**(quantum + 44); NaN stays NaN."""
    bound = np.ldexp(1.0, quantum + MAX_TERM_EXPONENT)
    magic = np.ldexp(1.5, quantum + 52)
    wide = np.clip(np.asarray(terms, np.float64), -bound, bound)
    wide += magic
    wide -= magic
    return wide


def sum_by_index(index: NDArray[np.integer[Any]], terms: NDArray[np.float32], quantum: int, length: int) -> NDArray[np.float32]:
    """Return the sum of the terms with each index from 0 to `length` - 1, float32 [length]. Terms are rounded to multiples of
    2**quantum and added exactly; then the sums are rounded to float64 and float32."""
    if index.size == 0:
        return np.zeros(length, np.float32)
    wide = quantise_terms(terms, quantum)
    largest = max(float(wide.max()), -float(wide.min()))
    if not largest * index.size <= np.ldexp(1.0, quantum + _FLOAT64_BITS):  # also for NaN
        return _sum_in_two_words(index, wide, quantum, length)
    return np.bincount(index, weights=wide, minlength=length).astype(np.float32)


def _sum_in_two_words(
    index: NDArray[np.integer[Any]], terms: NDArray[np.float64], quantum: int, length: int
) -> NDArray[np.float32]:
    """Return the result of `sum_by_index` for totals that one float64 cannot hold exactly. Each term is split into a multiple
    of 2**(quantum + 22) and a remainder. Both are summed exactly, and the total is rounded once."""
    magic = np.ldexp(1.5, quantum + LOW_WORD_BITS + 52)
    high = (terms + magic) - magic
    low = np.bincount(index, weights=terms - high, minlength=length)
    return (np.bincount(index, weights=high, minlength=length) + low).astype(np.float32)
