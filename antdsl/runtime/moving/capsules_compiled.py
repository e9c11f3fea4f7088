"""How near capsules are to each other by one loop: the same operations in the same order as `capsules`, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, Strided2, called, inlined, kernel
from antdsl.numerics.vectors_compiled import dot, minus, plus, times

_OPPOSITE, _NOWHERE = -0.5, 1e-6  # as `capsules`


@inlined
def _of(vectors, i):  # type: ignore[no-untyped-def]
    """One of vectors (3, k)."""
    return vectors[0, i], vectors[1, i], vectors[2, i]


@called
def _gap(away, a, b, one, other, reach, length, wide):  # type: ignore[no-untyped-def]
    """As `capsules._gaps`, of one pair: gap and way; and whether it has no way of its own."""
    between = plus(one, other)
    factor = 0.0 if dot(one, other) < _OPPOSITE else 1 / np.sqrt(max(dot(between, between), 1e-12))
    between = times(between, factor)
    flat = minus(away, times(between, dot(away, between)))
    one, other = minus(a, times(between, dot(a, between))), minus(b, times(between, dot(b, between)))
    aa, bb, ab = max(dot(one, one), 1e-9), max(dot(other, other), 1e-9), dot(one, other)
    c, f = dot(one, flat), dot(other, flat)
    skew = aa * bb - ab * ab
    s = (ab * f - c * bb) / skew if skew > 1e-9 else 0.0
    s = min(max(s, -reach), reach)
    t = min(max((ab * s + f) / bb, -length), length)
    s = min(max((ab * t - c) / aa, -reach), reach)
    apart = minus(plus(away, times(a, s)), times(b, t))
    over = dot(apart, between)
    apart = minus(apart, times(between, over))
    distance = np.sqrt(dot(apart, apart))
    room = wide * wide - over * over
    gap = distance - np.sqrt(room) if room > 0 else np.inf
    size = max(distance, 1e-300)
    return gap, (apart[0] / size, apart[1] / size, apart[2] / size), distance <= wide * _NOWHERE


@kernel
def measured(
    middle: Strided2[F64],
    gone: Strided2[F64],
    ahead: Strided2[F64],
    up: Strided2[F64],
    half: Array1[F64],
    radius: Array1[F64],
    i: Array1[I64],
    j: Array1[I64],
    changed: Array1[BOOL],
    gap: Array1[F64],
    way: Array2[F64],
    lost: Array1[I64],
) -> I64:
    """As `capsules.Near.measure`, into `gap` and `way`; gives how many pairs have no way of their own, which are the first of
    `lost`."""
    count = 0
    for pair in range(i.size):
        p, q = i[pair], j[pair]
        if not (changed[p] or changed[q]):
            continue
        away = minus(plus(_of(middle, p), _of(gone, p)), plus(_of(middle, q), _of(gone, q)))
        found = _gap(
            away, _of(ahead, p), _of(ahead, q), _of(up, p), _of(up, q), half[p], half[q], radius[p] + radius[q]
        )  # fmt: skip
        gap[pair], (way[0, pair], way[1, pair], way[2, pair]) = found[0], found[1]
        lost[count] = pair
        count += found[2]
    return count
