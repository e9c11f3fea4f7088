"""`randomness.uniform` for one id at a time, in a compiled loop: the same whole numbers, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.kernel_cache import njit
from antdsl.numerics.philox import HALF, LOW, M0, M1, ROUNDS, SPREAD, UNIT, W0, W1

_W0, _W1 = np.uint64(W0), np.uint64(W1)  # as whole numbers of Python they would make floats here
_8 = np.uint64(8)


@njit(cache=True, nogil=True, error_model="numpy")
def uniforms(ids, c0, low, c3, k0, k1, which, found):  # type: ignore[no-untyped-def]
    """Writes a draw of each id, `which` of the four of its counter."""
    for n in range(ids.size):
        found[n] = np.float32(_word(ids[n], c0, low, c3, k0, k1, which) >> _8) * UNIT


@njit(cache=True, nogil=True, error_model="numpy")
def words(ids, c0, low, c3, k0, k1, which, found):  # type: ignore[no-untyped-def]
    """As `uniforms`, the whole word."""
    for n in range(ids.size):
        found[n] = _word(ids[n], c0, low, c3, k0, k1, which)


@njit(inline="always")
def _word(number, c0, low, c3, k0, k1, which):  # type: ignore[no-untyped-def]
    wide = np.uint64(number)
    a, b, c, d = c0, wide & LOW, (((wide >> HALF) * SPREAD) & LOW) ^ low, c3
    first, second = k0, k1
    for _ in range(ROUNDS):
        p0, p1 = a * M0, c * M1
        a, b, c, d = (p1 >> HALF) ^ b ^ first, p1 & LOW, (p0 >> HALF) ^ d ^ second, p0 & LOW
        first, second = (first + _W0) & LOW, (second + _W1) & LOW
    return a if which == 0 else b if which == 1 else c if which == 2 else d
