"""The compiled half of `row_hash`: the same bits. All in int64, whose products wrap as those of uint64 do.

Imported only where `compiled.wanted` says so."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.kernel_cache import njit

_HALF = 0xFFFFFFFF
_REST = 0x7FFFFFFF  # what a logical shift by 33 leaves
_BY, _THEN = 0xFF51AFD7ED558CCD - 2**64, 0xC4CEB9FE1A85EC53 - 2**64

Longs = NDArray[np.int64]


@njit(cache=True, nogil=True, error_model="numpy")
def fold_whole(word: Longs, a0: int, b0: int, a1: int, b1: int, first: Longs, second: Longs) -> None:
    """Add the products of the halves of each word [n] to both lanes."""
    for i in range(word.size):
        a, b = word[i] & _HALF, (word[i] >> 32) & _HALF
        first[i] += ((a + a0) & _HALF) * ((b + b0) & _HALF)
        second[i] += ((a + a1) & _HALF) * ((b + b1) & _HALF)


@njit(cache=True, nogil=True, error_model="numpy")
def fold_halves(
    low: NDArray[np.int32], high: NDArray[np.int32], a0: int, b0: int, a1: int, b1: int, first: Longs, second: Longs
) -> None:
    """The same of words whose halves lie in two arrays [n]."""
    for i in range(low.size):
        a, b = np.int64(low[i]), np.int64(high[i])
        first[i] += ((a + a0) & _HALF) * ((b + b0) & _HALF)
        second[i] += ((a + a1) & _HALF) * ((b + b1) & _HALF)


@njit(cache=True, nogil=True, error_model="numpy")
def finish(first: Longs, second: Longs) -> tuple[int, int]:
    """The sums of both lanes, each row mixed."""
    s, t = np.int64(0), np.int64(0)
    for i in range(first.size):
        g, h = first[i], second[i]
        g, h = (g ^ ((g >> 33) & _REST)) * _BY, (h ^ ((h >> 33) & _REST)) * _BY
        g, h = (g ^ ((g >> 33) & _REST)) * _THEN, (h ^ ((h >> 33) & _REST)) * _THEN
        s += g ^ ((g >> 33) & _REST)
        t += h ^ ((h >> 33) & _REST)
    return s, t
