"""The passes of `corrections` over those that are led, and how a crowd stands for `contacts`, as loops: the same operations in
the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, Array2, Strided2, independent, inlined, kernel
from antdsl.numerics.vectors_compiled import dot, minus, plus, put, times

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]
_LONGER = 1.005  # as `corrections`
_ZERO, _ONE, _TINY, _LIGHTEST = np.float32(0), np.float32(1), np.float32(1e-12), 1e-30


@inlined
def _row(table, i):  # type: ignore[no-untyped-def]
    """One of vectors (n, 3)."""
    return table[i, 0], table[i, 1], table[i, 2]


@inlined
def _single(v):  # type: ignore[no-untyped-def]
    return np.float32(v[0]), np.float32(v[1]), np.float32(v[2])


@kernel
def stands(
    rows: Array1[I64],
    first: I64,
    began: Strided2[F64],
    place: Strided2[F64],
    feet: Strided2[F32],
    max_speed: Array1[F32],
    weight: Array1[F32],
    dt: F64,
    start: Array2[F64],
    walked: Array2[F64],
    normal: Array2[F64],
    reach: Array1[F64],
    mass: Array1[F64],
) -> None:
    """How some rows of a species stand after a substep of `dt` s, from the number `first` on among all rows: as
    `contacts._Agents`, and by how much they have `walked` (3, k) mm."""
    for n in independent(0, rows.size):
        row, k = rows[n], first + n
        before = _row(began, row)
        put(start, k, before)
        put(walked, k, minus(_row(place, row), before))
        normal[0, k], normal[1, k], normal[2, k] = feet[row, 0], feet[row, 1], feet[row, 2]
        reach[k] = np.float64(_ZERO if max_speed[row] <= 0 else max_speed[row]) * dt
        mass[k] = max(np.float64(weight[row]), _LIGHTEST)


@kernel
def came(rows: Array1[I64], first: I64, velocity: Three, dt: F32, way: Array2[F64]) -> None:
    """As `contacts._came`, of some rows of a species, from the number `first` on among all rows."""
    for n in independent(0, rows.size):
        for axis in range(3):
            way[axis, first + n] = velocity[axis][rows[n]] * dt


@kernel
def asked(
    rows: Array1[I64],
    gone: Strided2[F64],
    feet: Strided2[F32],
    facing: Three,
    long: Array1[F32],
    way: Array2[F32],
    normal: Array2[F32],
    up: Array2[F64],
    heading: Array2[F64],
    size: Array1[F64],
) -> None:
    """What a walk by (3, k) mm is told of some rows of a species: the way and the normal of the ground, float32, the same normal,
    headings and sizes, float64."""
    for k in independent(0, rows.size):
        row = rows[k]
        size[k] = long[row]
        for axis in range(3):
            way[axis, k], heading[axis, k] = gone[axis, k], facing[axis][row]
            normal[axis, k] = feet[row, axis]
            up[axis, k] = feet[row, axis]


@kernel
def too_far(
    rows: Array1[I64],
    to: Strided2[F64],
    began: Strided2[F64],
    place: Strided2[F64],
    max_speed: Array1[F32],
    dt: F64,
    far: Array1[F64],
    most: Array1[F64],
) -> BOOL:
    """Whether any of some rows of a species gets farther than it may by ending at places `to` (k, 3), or that is not known: how
    far (mm) from where it `began` (n, 3), and how far it may."""
    found = False
    for k in range(rows.size):
        row = rows[k]
        start = _row(began, row)
        way, walked = minus(_row(to, k), start), minus(_row(place, row), start)
        far[k] = np.sqrt(dot(way, way))
        most[k] = max(np.float64(max_speed[row]) * dt, np.sqrt(dot(walked, walked)))
        found |= not far[k] <= most[k] * _LONGER
    return found


@kernel
def arrived(
    rows: Array1[I64],
    to: Strided2[F64],
    above: Strided2[F64],
    dt: F32,
    at: Three,
    velocity: Three,
    place: Strided2[F64],
    feet: Strided2[F32],
    got: Array2[F64],
) -> None:
    """As `corrections.Corrections._put`, of all but footings: agents end at places `to` with ways up `above` (k, 3), and have
    come on by what they `got` (3, k) mm."""
    for k in independent(0, rows.size):
        row = rows[k]
        end, up = _row(to, k), _single(_row(above, k))
        way = minus(end, _row(place, row))
        put(got, k, way)
        pushed = _single(way)
        size = np.sqrt(dot(pushed, pushed))
        good = size > _TINY and np.isfinite(size)
        factor = _ONE / (size if good else _ONE)
        against = times(pushed, factor)
        if not good:
            against = (size * _ZERO, size * _ZERO, size * _ZERO)
        v = (velocity[0][row], velocity[1][row], velocity[2][row])
        back, most = -dot(v, against), size / dt
        back = _ZERO if back <= 0 else back  # never -0
        v = plus(v, times(against, most if most < back else back))
        v = minus(v, times(up, dot(v, up)))
        for axis in range(3):
            at[axis][row], velocity[axis][row] = end[axis], v[axis]
            place[row, axis], feet[row, axis] = end[axis], up[axis]
