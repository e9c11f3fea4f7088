"""The passes of `cutting` over pairs as loops: the same operations, and sums that are exact in any order, so the same bits."""

from __future__ import annotations

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, independent, inlined, kernel
from antdsl.numerics.sorting_compiled import listed
from antdsl.numerics.vectors_compiled import dot, minus, of, put, times

_BENDS, _GOES = 3, 0.5  # as `cutting`


@inlined
def add(sums, i, v, magic):  # type: ignore[no-untyped-def]
    """Add to a sum of terms that are rounded to the quantum of `magic`."""
    for axis in range(3):
        sums[axis, i] += (v[axis] + magic) - magic


@inlined
def negative(v):  # type: ignore[no-untyped-def]
    return -v[0], -v[1], -v[2]


@kernel
def bent(
    i: Array1[I64],
    j: Array1[I64],
    gap: Array1[F64],
    way: Array2[F64],
    came: Array2[F64],
    mass: Array1[F64],
    walked: Array2[F64],
    magic: F64,
    free: Array2[F64],
    sums: Array2[F64],
    part: Array1[F64],
    met: Array1[I64],
    some: Array1[I64],
    pairs: Array1[I64],
    cut: Array2[F64],
    stopped: Array1[I64],
    changed: Array1[BOOL],
) -> I64:
    """As `cutting._bent` with what `cutting._free` says: by what steps are `cut` (3, k), who has `changed` (k), and how many are
    stopped, which are the first of `stopped`. `free` (2, m), `sums` (3, k), `part`, `met` and `some` (k) and `pairs` (m) are room
    for work. Once all pairs have been looked at, only those count of which a row has been bent: no other goes elsewhere."""
    for pair in independent(0, i.size):
        ways, over = of(way, pair), 0
        for side in range(2):
            own, other = (j[pair], i[pair]) if side else (i[pair], j[pair])
            towards = -dot(ways, of(walked, own))
            far = max(gap[pair], 0.0) * 0.5 + max(-dot(ways, of(came, other)), 0.0)
            heavier = 1 - min(2 * mass[other] / (mass[own] + mass[other]), 1.0)
            far += heavier * max(towards - far, 0.0)
            free[side, pair] = far
            over = 1 if towards - far > 0 else over
            ways = negative(ways)
        pairs[pair] = over
    count, rows = listed(pairs, i.size), 0
    met[:] = 0
    part[:] = 1.0
    for k in independent(0, part.size):
        put(cut, k, of(walked, k))
    for bend in range(_BENDS):
        found = False
        for n in range(count):
            pair = pairs[n]
            ways = of(way, pair)
            for side in range(2):
                k = j[pair] if side else i[pair]
                over = -dot(ways, of(cut, k)) - free[side, pair]
                if over > 0:
                    if met[k] == 0:
                        sums[0, k], sums[1, k], sums[2, k] = 0.0, 0.0, 0.0
                        if bend == 0:
                            some[rows] = k
                            rows += 1
                    add(sums, k, times(ways, over), magic)
                    met[k] += 1
                    found = True
                ways = negative(ways)
        if not found:
            break
        for n in range(rows):
            k = some[n]
            if met[k]:
                for axis in range(3):
                    cut[axis, k] += sums[axis, k] / met[k]
        if bend == 0:
            for pair in independent(0, i.size):
                pairs[pair] = 1 if (met[i[pair]] != 0) | (met[j[pair]] != 0) else 0
            count = listed(pairs, i.size)
        for n in range(rows):
            met[some[n]] = 0
    for n in range(count):
        pair = pairs[n]
        ways = of(way, pair)
        for side in range(2):
            k = j[pair] if side else i[pair]
            towards = -dot(ways, of(cut, k))
            if towards > free[side, pair]:
                part[k] = min(part[k], free[side, pair] / max(towards, 1e-300))
            ways = negative(ways)
    for k in independent(0, part.size):
        way_on = of(walked, k)
        step = times(of(cut, k), part[k])
        short = minus(step, way_on)
        put(cut, k, short)
        held = dot(step, step) < _GOES * _GOES * dot(way_on, way_on)
        stopped[k] = 1 if held else 0
        changed[k] = held | (short[0] != 0) | (short[1] != 0) | (short[2] != 0)
    return listed(stopped, part.size)
