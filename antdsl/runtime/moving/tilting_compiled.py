"""The passes of `tilting` over few agents as loops: the same operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import F32, F64, I64, Array1, Array2, Strided2, called, inlined, kernel
from antdsl.numerics.elementary_compiled import atan2, cos_sin
from antdsl.numerics.vectors_compiled import cross, dot, minus, plus, times

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]
# Of walls: normal and way ahead (3, k), angle, how far, over how much.
Walls = tuple[Strided2[F64], Strided2[F64], Array1[F64], Array1[F64], Array1[F64]]
_F = np.float32
_OPPOSITE, _STEEP = 0.05, 0.9  # as `tilting` and `vectors`


@inlined
def _over(a, s):  # type: ignore[no-untyped-def]
    return a[0] / s, a[1] / s, a[2] / s


@inlined
def _unit(v):  # type: ignore[no-untyped-def]
    return _over(v, max(np.sqrt(dot(v, v)), 1e-300))


@inlined
def _of(vectors, i):  # type: ignore[no-untyped-def]
    """One of vectors (3, n), in float64."""
    return np.float64(vectors[0][i]), np.float64(vectors[1][i]), np.float64(vectors[2][i])


@inlined
def _across(v, up):  # type: ignore[no-untyped-def]
    flat = minus(v, times(up, dot(v, up)))
    size = np.sqrt(dot(flat, flat))
    if size > 1e-6:
        return _over(flat, size)
    axis = (0.0, 1.0, 0.0) if abs(up[0]) > _STEEP else (1.0, 0.0, 0.0)
    side = minus(axis, times(up, dot(axis, up)))
    return times(side, 1 / np.sqrt(dot(side, side)))


@called
def _axis(one, other, ahead):  # type: ignore[no-untyped-def]
    axis, cosine = cross(one, other), min(max(dot(one, other), -1.0), 1.0)
    sine = np.sqrt(dot(axis, axis))
    if sine > _OPPOSITE or cosine > 0:
        return _over(axis, max(sine, 1e-300)), cosine, sine
    return _unit(cross(one, ahead)), cosine, sine


@inlined
def _rotated(v, axis, c, s):  # type: ignore[no-untyped-def]
    return plus(plus(times(v, c), times(cross(axis, v), s)), times(axis, dot(axis, v) * (1.0 - c)))


@called
def _laid(heading, one, other):  # type: ignore[no-untyped-def]
    axis, cosine, sine = _axis(one, other, heading)
    return _across(_rotated(heading, axis, cosine, sine), other)


@inlined
def _nearer(gone, wall, ahead):  # type: ignore[no-untyped-def]
    return dot(gone, wall) / min(dot(ahead, wall), -1e-3)


@called
def _tilted(n, wall, ahead, angle, far, over, gone):  # type: ignore[no-untyped-def]
    part = min(max(1.0 - (far - _nearer(gone, wall, ahead)) / over, 0.0), 1.0) * angle
    axis, cosine = cross(n, wall), dot(n, wall)
    sine = np.sqrt(dot(axis, axis))
    left = np.float64(atan2(_F(sine), _F(cosine)))
    least = _F(min(part, left))
    if not (least > 0 and sine > 1e-6):
        return n
    side = cross(_over(axis, max(sine, 1e-300)), n)
    c, s = cos_sin(least)
    turned = plus(times(n, np.float64(c)), times(side, np.float64(s)))
    return _over(turned, np.sqrt(dot(turned, turned)))


@kernel
def laid(rows: Array1[I64], heading: Array2[F32], up: Array2[F32], normal: Array2[F32], to: Array2[F32]) -> None:
    """Headings of some rows of (3, n) float32, laid from across `up` to across `normal` (n, 3), into `to` (3, k)."""
    for k in range(rows.size):
        i = rows[k]
        found = _laid(_of(heading, i), _of(up, i), (np.float64(normal[i, 0]), np.float64(normal[i, 1]), np.float64(normal[i, 2])))
        to[0, k], to[1, k], to[2, k] = _F(found[0]), _F(found[1]), _F(found[2])


@kernel
def shares(
    rows: Array1[I64],
    at: Array1[I64],
    step: Three,
    up: Array2[F32],
    normal: Array2[F32],
    most: Array1[F32],
    walls: Walls,
    to: Array1[F32],
) -> None:
    """Into `to` [n] which part of its step each of `rows` can make; `at[k]` is the number of its wall, -1 for none."""
    wall, ahead, angle, far, over = walls
    zero = (0.0, 0.0, 0.0)
    for k in range(rows.size):
        i, j = rows[k], at[k]
        way, stood = _of(step, i), _of(up, i)
        size = np.sqrt(dot(way, way))
        wanted = np.float64(normal[i, 0]), np.float64(normal[i, 1]), np.float64(normal[i, 2])
        room = np.inf
        if j >= 0:
            w, a = _of(wall, j), _of(ahead, j)
            wanted = _tilted(wanted, w, a, angle[j], far[j], over[j], zero)
            towards = _nearer(_over(way, max(size, 1e-300)), w, a)
            across = cross(stood, w)
            left = np.float64(atan2(_F(np.sqrt(dot(across, across))), _F(dot(stood, w))))
            tilt = angle[j] - left + np.float64(most[i])
            free = max(over[j] * (tilt / angle[j] - 1.0) + far[j], 0.0)
            room = free / max(towards, 0.05) if towards > 0.05 else np.inf
        lag = min(1.0, 2.0 * max(dot(stood, wanted), 0.0))
        to[i] = _F(min(lag, min(max(room / max(size, 1e-300), 0.0), 1.0)))


@kernel
def follow(
    rows: Array1[I64],
    at: Array1[I64],
    before_up: Array2[F32],
    before_heading: Array2[F32],
    went: Strided2[F64],
    most: Array1[F32],
    max_turn: Array1[F32],
    dt: F32,
    walls: Walls,
    half: Array1[F64],
    raised: F64,
    now_up: Three,
    now_heading: Three,
) -> None:
    """As `Bodies.follow` for `rows`, whose walls are `at`; changes `now_up` and `now_heading`."""
    wall, ahead, angle, far, over = walls
    for k in range(rows.size):
        i, j = rows[k], at[k]
        before = _of(before_up, i)
        look = _across(_of(before_heading, i), before)
        normal, looking = _of(now_up, i), _of(now_heading, i)
        gone = (went[i, 0], went[i, 1], went[i, 2])
        wanted = normal
        if j >= 0:
            wanted = _tilted(normal, _of(wall, j), _of(ahead, j), angle[j], far[j], over[j], gone)
        axis, cosine, sine = _axis(before, wanted, look)
        whole = atan2(_F(sine), _F(cosine))
        if whole <= most[i]:
            tilt, c, s, up = whole, cosine, sine, wanted
        else:
            part = cos_sin(most[i])
            tilt, c, s = most[i], np.float64(part[0]), np.float64(part[1])
            up = _unit(_rotated(before, axis, c, s))
        one = _across(_rotated(look, axis, c, s), up)
        other = _laid(_laid(looking, normal, wanted), wanted, up)
        room = 4.0
        if np.isfinite(max_turn[i]):
            turn = np.float64(max(max_turn[i], _F(0)) * dt)
            room = np.sqrt(max(turn * turn - np.float64(tilt) * np.float64(tilt), 0.0))
        most_yaw = _F(min(room, 4.0))
        left = cross(up, one)
        yaw = atan2(_F(dot(left, other)), _F(dot(one, other)))
        facing = other
        if not abs(yaw) <= most_yaw:
            c32, s32 = cos_sin(most_yaw if yaw > 0 else -most_yaw)
            facing = _unit(plus(times(one, np.float64(c32)), times(left, np.float64(s32))))
        if j >= 0:
            w, a = _of(wall, j), _of(ahead, j)
            middle = plus(times(up, 2 * raised * half[j]), times(a, _nearer(gone, w, a) - far[j]))
            with_turn = dot(plus(middle, times(facing, half[j])), w)
            without = dot(plus(middle, times(one, half[j])), w)
            if with_turn < min(without, 0.0):
                facing = one
        now_up[0][i], now_up[1][i], now_up[2][i] = _F(up[0]), _F(up[1]), _F(up[2])
        now_heading[0][i], now_heading[1][i], now_heading[2][i] = _F(facing[0]), _F(facing[1]), _F(facing[2])
