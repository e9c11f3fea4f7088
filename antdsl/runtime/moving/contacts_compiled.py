"""The passes of `contacts` over pairs as loops: the same operations in the same order, sums exact in any, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.kernel_cache import njit
from antdsl.numerics.vectors_compiled import dot, minus, plus, times

_FINE, _SHARES, _SPREADS, _BENDS = 40, 1 << 20, 3, 3  # as `contacts`
_OUTWARD, _PRESSED, _LEAST, _EAGER, _STEEPEST = 10.0, 1.0, 1 / 64, 1.5, 0.1
_MAGIC = 1.5 * 2.0 ** (52 - _FINE)


@njit(inline="always")
def _of(vectors, i):  # type: ignore[no-untyped-def]
    """One of vectors (3, k)."""
    return vectors[0, i], vectors[1, i], vectors[2, i]


@njit(inline="always")
def _put(vectors, i, v):  # type: ignore[no-untyped-def]
    vectors[0, i], vectors[1, i], vectors[2, i] = v


@njit(inline="always")
def _add(sums, i, v, magic):  # type: ignore[no-untyped-def]
    """Add to a sum of terms that are rounded to the quantum of `magic`."""
    for axis in range(3):
        sums[axis, i] += (v[axis] + magic) - magic


@njit(inline="always")
def _rounded(term):  # type: ignore[no-untyped-def]
    return (term + _MAGIC) - _MAGIC


@njit(inline="always")
def _negative(v):  # type: ignore[no-untyped-def]
    return -v[0], -v[1], -v[2]


@njit(cache=True, nogil=True, error_model="numpy")
def bent(i, j, way, free, walked, magic, step):  # type: ignore[no-untyped-def]
    """Steps (3, k) bent along half-planes of pairs, and then cut, from those `walked` into `step`. `free` (2 m): how far the first
    and then the second of each pair may go towards the other."""
    count, m = walked.shape[1], i.size
    sums, met, part = np.empty((3, count)), np.empty(count, np.int64), np.ones(count)
    step[:] = walked
    for _ in range(_BENDS):
        sums[:], met[:] = 0.0, 0
        found = False
        for pair in range(m):
            ways = _of(way, pair)
            for side in range(2):
                k = j[pair] if side else i[pair]
                over = -dot(ways, _of(step, k)) - free[pair + side * m]
                if over > 0:
                    _add(sums, k, times(ways, over), magic)
                    met[k] += 1
                    found = True
                ways = _negative(ways)
        if not found:
            break
        for k in range(count):
            if met[k]:
                for axis in range(3):
                    step[axis, k] += sums[axis, k] / met[k]
    for pair in range(m):
        ways = _of(way, pair)
        for side in range(2):
            k = j[pair] if side else i[pair]
            towards = -dot(ways, _of(step, k))
            if towards > free[pair + side * m]:
                part[k] = min(part[k], free[pair + side * m] / max(towards, 1e-300))
            ways = _negative(ways)
    for k in range(count):
        _put(step, k, times(_of(step, k), part[k]))


@njit(error_model="numpy")
def _share(i, j, pairs, gap, least, light, heap, level, share):  # type: ignore[no-untyped-def]
    """As `contacts._shares`, into `share` (2, m)."""
    count = light.size
    locked, spread, deepest = np.zeros(count), np.empty(count), 0.0
    for pair in pairs:
        if gap[pair] < -least[pair]:
            deepest = max(deepest, -gap[pair])
    for pair in pairs:
        if gap[pair] < -least[pair]:
            deep = _rounded(-gap[pair] / deepest)
            locked[i[pair]] += deep
            locked[j[pair]] += deep
    for _ in range(_SPREADS):
        spread[:] = locked
        for pair in pairs:
            if gap[pair] < -least[pair]:
                spread[i[pair]] += locked[j[pair]]
                spread[j[pair]] += locked[i[pair]]
        highest = spread.max()
        for k in range(count):
            locked[k] = _rounded(spread[k] / highest)
    for n in range(pairs.size):
        p, q = i[pairs[n]], j[pairs[n]]
        first, second = locked[p], locked[q]
        outward = _PRESSED + (_OUTWARD - _PRESSED) * max(heap[p], heap[q])
        outer = 0.5 + outward * (second - first) / max(first + second, 1e-300)
        outer = min(max(outer, _LEAST), 1 - _LEAST)
        one, other = light[p] * outer * level[0, n], light[q] * (1 - outer) * level[1, n]
        total = one + other
        share[0, n] = np.rint(one / max(total, 1e-300) * _SHARES) / _SHARES
        share[1, n] = 1 - share[0, n] if total > 0 else 0.0


@njit(error_model="numpy", inline="always")
def _within(gone, middle, room):  # type: ignore[no-untyped-def]
    """As `contacts._within`, for one."""
    way = plus(middle, gone)
    size = np.sqrt(dot(way, way))
    if size > room:
        return minus(times(way, room / size), middle)
    return gone


@njit(cache=True, nogil=True, error_model="numpy")
def look(  # type: ignore[no-untyped-def]  # numba takes the types from the call
    i, j, which, gap, way, least, light, heap, normal, walked, most, room, cut, gone, magic, sweeps, slow
):  # fmt: skip
    """As `contacts._look`, where two part by `slow` of their overlap."""
    count = light.size
    met, there = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    touching = False
    for pair in range(i.size):
        if which[pair] and gap[pair] < -least[pair]:
            met[i[pair]] = met[j[pair]] = touching = True
    if not touching:
        return False
    pairs, m = np.empty(i.size, np.intp), 0
    for pair in range(i.size):
        if which[pair] and (met[i[pair]] or met[j[pair]]):
            there[i[pair]] = there[j[pair]] = True
            pairs[m] = pair
            m += 1
    pairs = pairs[:m]
    level, share, ways = np.empty((2, m)), np.empty((2, m)), np.empty((2, m, 3))
    for n in range(m):
        pair = pairs[n]
        v = _of(way, pair)
        for side in range(2):
            up = _of(normal, j[pair] if side else i[pair])
            along = minus(v, times(up, dot(v, up)))
            ways[side, n, 0], ways[side, n, 1], ways[side, n, 2] = along
            level[side, n] = dot(along, along)
            v = _negative(v)
    _share(i, j, pairs, gap, least, light, heap, level, share)
    for side in range(2):
        for n in range(m):
            factor = share[side, n] / max(level[side, n], _STEEPEST)
            for axis in range(3):
                ways[side, n, axis] *= factor
    led, sums, weight, contacts = gone.copy(), np.empty((3, count)), np.empty(count), np.empty(count, np.int64)
    for _ in range(sweeps):
        sums[:], weight[:], contacts[:] = 0.0, 0.0, 0
        touching = False
        for n in range(m):
            pair = pairs[n]
            p, q = i[pair], j[pair]
            one, other = minus(_of(led, p), _of(gone, p)), minus(_of(led, q), _of(gone, q))
            left = gap[pair] + dot(_of(way, pair), minus(one, other))
            if left < -least[pair]:
                touching = True
                for side in range(2):
                    k = q if side else p
                    _add(sums, k, times((ways[side, n, 0], ways[side, n, 1], ways[side, n, 2]), left * -slow), magic)
                    weight[k] += share[side, n]
                    contacts[k] += 1
        if not touching:
            break
        for k in range(count):
            if there[k]:
                part = (1 + (_EAGER - 1) * heap[k] if contacts[k] > 1 else 1.0) / max(weight[k], 1.0)
                asked = plus(_of(led, k), times(_of(sums, k), part))
                asked = _within(asked, _negative(_of(cut, k)), room[k])
                _put(led, k, _within(asked, _of(walked, k), most[k]))
    gone[:] = led
    return True
