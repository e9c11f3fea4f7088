"""`randomness.uniform` for one id at a time, in a compiled loop: the same whole numbers, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.numerics import randomness
from antdsl.numerics.kernel_cache import njit

_M0, _M1, _LOW, _32, _SPREAD = randomness._M0, randomness._M1, randomness._LOW, randomness._32, randomness._SPREAD
_W0, _W1 = np.uint64(randomness._W0), np.uint64(randomness._W1)
_ROUNDS, _UNIT = randomness._ROUNDS, randomness._UNIT
_8 = np.uint64(8)


@njit(cache=True, nogil=True, error_model="numpy")
def uniforms(ids, c0, low, c3, k0, k1, which, found):  # type: ignore[no-untyped-def]
    """Writes a draw of each id, `which` of the four of its counter."""
    for n in range(ids.size):
        wide = np.uint64(ids[n])
        a, b, c, d = c0, wide & _LOW, (((wide >> _32) * _SPREAD) & _LOW) ^ low, c3
        first, second = k0, k1
        for _ in range(_ROUNDS):
            p0, p1 = a * _M0, c * _M1
            a, b, c, d = (p1 >> _32) ^ b ^ first, p1 & _LOW, (p0 >> _32) ^ d ^ second, p0 & _LOW
            first, second = (first + _W0) & _LOW, (second + _W1) & _LOW
        word = a if which == 0 else b if which == 1 else c if which == 2 else d
        found[n] = np.float32(word >> _8) * _UNIT
