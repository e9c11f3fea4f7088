"""`randomness.uniform` for one id at a time, in a compiled loop: the same whole numbers, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, I64, U64, Array1, independent, inlined, kernel
from antdsl.numerics.philox import HALF, LOW, M0, M1, ROUNDS, SPREAD, UNIT, W0, W1

Shared = tuple[U64, U64, U64, U64, U64]  # first, third and last word of the counters, and the two of the key


@kernel
def uniforms(ids: Array1[I64], shared: Shared, which: I64, found: Array1[F32]) -> None:
    """Writes a draw of each id, `which` of the four of its counter."""
    for n in independent(0, ids.size):
        found[n] = np.float32(_word(ids[n], shared, which) >> 8) * UNIT


@kernel
def words(ids: Array1[I64], shared: Shared, which: I64, found: Array1[U64]) -> None:
    """As `uniforms`, the whole word."""
    for n in independent(0, ids.size):
        found[n] = _word(ids[n], shared, which)


@inlined
def _word(number, shared, which):  # type: ignore[no-untyped-def]
    wide = np.uint64(number)
    c0, low, c3, first, second = shared
    a, b, c, d = c0, wide & LOW, (((wide >> HALF) * SPREAD) & LOW) ^ low, c3
    for _ in range(ROUNDS):
        p0, p1 = a * M0, c * M1
        a, b, c, d = (p1 >> HALF) ^ b ^ first, p1 & LOW, (p0 >> HALF) ^ d ^ second, p0 & LOW
        first, second = (first + W0) & LOW, (second + W1) & LOW
    return a if which == 0 else b if which == 1 else c if which == 2 else d
