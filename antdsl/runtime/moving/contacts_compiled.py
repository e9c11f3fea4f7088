"""The passes of `contacts` over pairs as loops: the same operations, and sums that are exact in any order, so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.kernel_cache import njit
from antdsl.numerics.vectors_compiled import dot, minus, plus, times
from antdsl.runtime.moving.capsules_compiled import measured

_FINE, _SHARES, _SPREADS, _BENDS = 40, 1 << 20, 3, 3  # as `contacts` and `cutting`
_OUTWARD, _PRESSED, _LEAST, _EAGER, _STEEPEST, _DEAD = 10.0, 1.0, 1 / 64, 1.5, 0.1, 5e-4
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
    """As `cutting._bent`, into `step` (3, k)."""
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
def _share(i, j, deep, light, heap, level, share):  # type: ignore[no-untyped-def]
    """As `contacts._shares`, into `share` (2, m)."""
    locked, spread = np.zeros(light.size), np.empty(light.size)
    deepest = deep.max()
    for n in range(i.size):
        if deep[n] > 0:
            part = _rounded(deep[n] / deepest)
            locked[i[n]] += part
            locked[j[n]] += part
    for _ in range(_SPREADS):
        spread[:] = locked
        for n in range(i.size):
            if deep[n] > 0:
                spread[i[n]] += locked[j[n]]
                spread[j[n]] += locked[i[n]]
        highest = spread.max()
        for k in range(locked.size):
            locked[k] = _rounded(spread[k] / highest)
    for n in range(i.size):
        p, q = i[n], j[n]
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
def parted(  # type: ignore[no-untyped-def]  # numba takes the types from the call
    middle, ahead, up, half, radius, i, j, gap, way, which, light, heap, normal, walked, most, room, cut, gone, magic, looks,
    sweeps, slow, lost,
):  # fmt: skip
    """As the looks of `contacts._apart`, where two part by `slow` of their overlap; changes `gap`, `way`, `which` and `gone`.
    Where pairs have no way of their own it gives how many looks are left, and how many these are, the first of `lost`."""
    least, changed = np.empty(i.size), np.empty(light.size, np.bool_)
    for pair in range(i.size):
        least[pair] = (radius[i[pair]] + radius[j[pair]]) * _DEAD
    for left in range(looks - 1, -1, -1):
        changed[:] = False
        if not _look(
            i, j, which, gap, way, least, light, heap, normal, walked, most, room, cut, gone, magic, sweeps, slow, changed
        ):
            break
        count = measured(middle, gone, ahead, up, half, radius, i, j, changed, gap, way, lost)
        for pair in range(i.size):
            which[pair] |= changed[i[pair]] or changed[j[pair]]
        if count:
            return left, count
    return 0, 0


@njit(error_model="numpy")
def _look(  # type: ignore[no-untyped-def]
    i, j, which, gap, way, least, light, heap, normal, walked, most, room, cut, gone, magic, sweeps, slow, changed
):  # fmt: skip
    """As `contacts._look`; says who has `changed`, and whether anybody has."""
    number, m, count = np.zeros(light.size, np.intp), 0, 0  # of who touches 1, then of who is in a pair with one of these
    for pair in range(i.size):
        if which[pair] and gap[pair] < -least[pair]:
            number[i[pair]] = number[j[pair]] = 1
            m += 1
    if not m:
        return False
    m = 0
    for pair in range(i.size):
        m += which[pair] and (number[i[pair]] == 1 or number[j[pair]] == 1)
    pairs, first, second = np.empty(m, np.intp), np.empty(m, np.intp), np.empty(m, np.intp)
    m = 0
    for pair in range(i.size):
        if which[pair] and (number[i[pair]] == 1 or number[j[pair]] == 1):
            pairs[m] = pair
            m += 1
    some = np.empty(min(light.size, 2 * m), np.intp)
    number[:] = -1
    for n in range(m):
        for side in range(2):
            k = j[pairs[n]] if side else i[pairs[n]]
            if number[k] < 0:
                number[k], some[count] = count, k
                count += 1
        first[n], second[n] = number[i[pairs[n]]], number[j[pairs[n]]]
    some = some[:count]
    deep, level, share, ways = np.empty(m), np.empty((2, m)), np.empty((2, m)), np.empty((2, m, 3))
    for n in range(m):
        pair = pairs[n]
        deep[n] = -gap[pair] if gap[pair] < -least[pair] else 0.0
        v = _of(way, pair)
        for side in range(2):
            up = _of(normal, j[pair] if side else i[pair])
            along = minus(v, times(up, dot(v, up)))
            ways[side, n, 0], ways[side, n, 1], ways[side, n, 2] = along
            level[side, n] = dot(along, along)
            v = _negative(v)
    _share(first, second, deep, light[some], heap[some], level, share)
    for side in range(2):
        for n in range(m):
            factor = share[side, n] / max(level[side, n], _STEEPEST)
            for axis in range(3):
                ways[side, n, axis] *= factor
    led, sums, weight, contacts = np.zeros((3, count)), np.empty((3, count)), np.empty(count), np.empty(count, np.int64)
    for k in range(count):
        _put(led, k, _of(gone, some[k]))
    for _ in range(sweeps):
        sums[:], weight[:], contacts[:] = 0.0, 0.0, 0
        touching = False
        for n in range(m):
            pair, p, q = pairs[n], first[n], second[n]
            one, other = minus(_of(led, p), _of(gone, i[pair])), minus(_of(led, q), _of(gone, j[pair]))
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
            at = some[k]
            part = (1 + (_EAGER - 1) * heap[at] if contacts[k] > 1 else 1.0) / max(weight[k], 1.0)
            asked = plus(_of(led, k), times(_of(sums, k), part))
            asked = _within(asked, _negative(_of(cut, at)), room[at])
            _put(led, k, _within(asked, _of(walked, at), most[at]))
    moved = False
    for k in range(count):
        for axis in range(3):
            changed[some[k]] |= led[axis, k] != gone[axis, some[k]]
        moved |= changed[some[k]]
        _put(gone, some[k], _of(led, k))
    return moved
