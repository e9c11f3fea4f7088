"""Steps that would lead agents into others are deflected along them, then cut: no agent goes farther than half of the free
gap."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, independent, inlined, kernel
from antdsl.numerics.kernel_vectors import Vec3, dot, minus, of, put, times
from antdsl.numerics.sorting import listed
from antdsl.runtime.moving.capsules import Near

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_FINE = 40  # digits of a term in a sum, below the widest overlap
_GOES = 0.5  # of its way: who goes less is stopped
_BENDS = 3  # times that a step is bent along those in its way, before it is cut


def cut(near: Near, came: Floats, mass: Floats, walked: Floats, gap: Floats, way: Floats) -> tuple[Floats, Rows, Flags]:
    """Cut and deflect steps of rows that `walked` (3, k) mm, so that no agent enters another. Returns the displacements (3, k) mm
    of that correction, the stopped rows, and flags (k) of rows that are cut or stopped. An agent that goes less than half of its
    step is stopped. `came` (3, k) mm: the displacements in a period of equal length before this one. `gap` (m) and `way` (3, m)
    of pairs are those before the steps.

    As in J. van den Berg et al., Reciprocal n-Body Collision Avoidance, 2011, each agent respects half-planes independently.
    Towards each neighbour it goes no farther than half of the gap, and than the neighbour's withdrawal if that continues its
    previous displacement. The shared limits thus need no iteration between agents, and a pressing crowd stands still. Of two
    masses, the heavier is cut less."""
    most = max(walked.max(), -walked.min(), 1e-30)
    magic = np.ldexp(1.5, int(np.frexp(most)[1]) + 2 - _FINE + 52)
    rows, pairs = len(near.rows), len(gap)
    (short, sums), part, changed = np.empty((2, 3, rows)), np.empty(rows), np.empty(rows, np.bool_)
    met, some, stopped = np.empty((3, rows), np.intp)
    room = Room(np.empty((2, pairs)), sums, part, met, some, np.empty(pairs, np.intp))
    count = _bent(near.i, near.j, gap, way, came, mass, walked, magic, room, short, stopped, changed)
    return short, stopped[:count], changed


@inlined
def add(sums: Array2[F64], i: I64, v: Vec3, magic: F64) -> None:
    """Add a term, rounded to the quantum of `magic`, to a sum."""
    for axis in range(3):
        sums[axis, i] += (v[axis] + magic) - magic


@inlined
def negative(v: Vec3) -> Vec3:
    return -v[0], -v[1], -v[2]


class Room(NamedTuple):
    """Work buffers: `free` (2, m), `sums` (3, k), `part`, `met` and `some` (k) and `pairs` (m)."""

    free: Array2[F64]
    sums: Array2[F64]
    part: Array1[F64]
    met: Array1[I64]
    some: Array1[I64]
    pairs: Array1[I64]


@kernel
def _bent(
    i: Array1[I64],
    j: Array1[I64],
    gap: Array1[F64],
    way: Array2[F64],
    came: Array2[F64],
    mass: Array1[F64],
    walked: Array2[F64],
    magic: F64,
    room: Room,
    cut: Array2[F64],
    stopped: Array1[I64],
    changed: Array1[BOOL],
) -> I64:
    """Bend and cut steps as `cut` describes. Writes by what steps are `cut` (3, k), which rows have `changed` (k), and the
    `stopped` rows first in `stopped`. Returns their number.

    After a pass over all pairs, only pairs with a bent row are visited again, because no other step has changed."""
    free, sums, part, met, some, pairs = room
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
