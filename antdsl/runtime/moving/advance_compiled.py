"""The passes of `moving` over all agents as two loops, before and after the walk: the same float32 operations in the same order,
and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, Array2, Strided2, called, independent, inlined, kernel
from antdsl.numerics.elementary_compiled import atan2, cos_sin
from antdsl.numerics.vectors_compiled import cross, dot, minus, plus, times

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]
_F = np.float32
_ZERO, _HALF, _ONE = _F(0), _F(0.5), _F(1)
_TINY, _STEEP = _F(1e-12), _F(0.9)  # as `vectors.unit` and `vectors.across`
_PI = _F(np.pi)
_LEVEL = _F(1e-3)
_SURELY = _F(1e-3)
_TWELFTH, _NINETIETH = _F(1 / 12), _F(1 / 90)  # as `moving`


@kernel
def velocities(
    push: Three,
    velocity: Three,
    up: Three,
    max_speed: Array1[F32],
    max_force: Array1[F32],
    mass: Array1[F32],
    response: Array1[F32],
    max_turn: Array1[F32],
    keeps: BOOL,
    min_speed: Array1[F32],
    heading: Three,
    at_once: F32,
    first: F32,
    dt: F32,
    to: Array2[F32],
    begin: I64,
    end: I64,
) -> None:
    """Velocities of agents from `begin` to before `end` after the push, within the limits of speed and turn, into `to` (3, n).
    `at_once` is the longest response that takes its whole time, `first`, in one substep; `dt` the time of others. `keeps`:
    whether `min_speed` and `heading` count. All float32, vectors three arrays."""
    for i in independent(begin, end):
        u = (up[0][i], up[1][i], up[2][i])
        wish = _flat((push[0][i], push[1][i], push[2][i]), u)
        wish = times(wish, _ONE / _maximum(_length(wish), _ONE))
        before = _flat((velocity[0][i], velocity[1][i], velocity[2][i]), u)
        time = first if response[i] <= at_once else dt
        gain = max_force[i] / mass[i]
        gain = (gain if np.isfinite(gain) else _ZERO) * time
        v = plus(before, times(wish, gain))
        speed, most = _length(v), _maximum(max_speed[i], _ZERO)
        if speed > most:
            v = times(v, most / (speed if speed > 0 else _ONE))
        v = (v[0] if np.isfinite(v[0]) else _ZERO, v[1] if np.isfinite(v[1]) else _ZERO, v[2] if np.isfinite(v[2]) else _ZERO)
        if keeps:
            least = _minimum(_maximum(min_speed[i], _ZERO), _maximum(max_speed[i], _ZERO))
            v = _quickened(v, before, _flat((heading[0][i], heading[1][i], heading[2][i]), u), least)
        if np.isfinite(max_turn[i]):
            most = _maximum(max_turn[i], _ZERO) * time
            turn = min(most, _PI)
            both = _length(v) * _length(before)
            if not (dot(v, before) > (cos_sin(turn)[0] + _SURELY) * both and both > _TINY):
                v = _turned(v, before, u, most)
        to[0, i], to[1, i], to[2, i] = v


@inlined
def _quickened(velocity, before, heading, least):  # type: ignore[no-untyped-def]
    """As `moving._quickened`, for one."""
    square = dot(velocity, velocity)
    if not square < least * least:
        return velocity
    ahead, good = _unit(before)
    if not good:
        ahead, good = _unit(heading)
        if not good:
            ahead = (_ZERO * least, _ZERO * least, _ZERO * least)
    along = dot(velocity, ahead)
    more = np.sqrt(_maximum((least * least - square) + along * along, _ZERO)) - along
    return plus(velocity, times(ahead, more))


@called
def _turned(velocity, before, up, most):  # type: ignore[no-untyped-def]
    """As `moving._limit_turn`, for one."""
    if not _length(before) > 0:
        most = _F(4.0)
    ahead, good = _unit(before)
    if not good:
        ahead, good = _unit(velocity)
        if not good:
            ahead = _across(up)
    direction, good = _unit(velocity)
    if not good:
        direction = ahead
    left = cross(up, ahead)
    side, good = _unit(_flat(direction, ahead))
    if not good:
        side = left
    sine, cosine = _length(cross(ahead, direction)), dot(ahead, direction)
    if not (np.isfinite(sine) and np.isfinite(cosine)) or not atan2(sine, cosine) > most:
        return velocity
    c, s = cos_sin(most)
    return times(plus(times(ahead, c), times(side, s)), _length(velocity))


@kernel
def arrive(
    velocity: Three,
    step: Three,
    old: Strided2[F64],
    walked: tuple[Strided2[F64], Strided2[F64], Strided2[F64], Strided2[F64], Array1[BOOL]],
    max_speed: Array1[F32],
    max_turn: Array1[F32],
    response: Array1[F32],
    at_once: F32,
    most: Array1[F32],
    dt: F32,
    share: F32,
    slow: F32,
    bounce: F32,
    beyond: F32,
    faces: BOOL,
    face: Three,
    position: Three,
    to: Three,
    heading: Three,
    up: Three,
    hasty: Array1[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """Velocity and heading of agents from `begin` to before `end` where the walk has led, with place and up, into three arrays
    each: `position`, `to`, `heading`, `up`; and in `hasty` whose up turns by more than `most` (radians), or whose body by more
    than `max_turn` allows and `beyond` that.

    `velocity`, `step`: before the walk, float32; `old` the place before it, (n, 3); `walked`: place, up, heading and direction of
    the walk, (3, n), and who is blocked. `faces`: whether `face` has ways to face. `at_once` is the longest
    response of who faces at once where it goes.
    """
    place, above, ahead, direction, blocked = walked
    rate = _ONE / dt
    for i in independent(begin, end):
        u = (_F(above[0, i]), _F(above[1, i]), _F(above[2, i]))
        v = (velocity[0][i], velocity[1][i], velocity[2][i])
        v = times((_F(direction[0, i]), _F(direction[1, i]), _F(direction[2, i])), _length(v))
        if blocked[i]:
            gone = (_F(place[0, i] - old[i, 0]), _F(place[1, i] - old[i, 1]), _F(place[2, i] - old[i, 2]))
            gone = times(gone, rate)
            lost = minus(times((step[0][i], step[1][i], step[2][i]), rate), gone)
            v = minus(gone, times(lost, bounce))
        v = _flat(v, u)
        h = (_F(ahead[0, i]), _F(ahead[1, i]), _F(ahead[2, i]))
        chord = minus(u, (up[0][i], up[1][i], up[2][i]))
        square, limit = dot(chord, chord), most[i] * most[i]
        tilt = square * (_ONE + square * (_TWELFTH + square * _NINETIETH))
        hasty[i] = tilt > limit
        wish = (face[0][i], face[1][i], face[2][i])
        h = _faced(
            h, v, u, faces, wish, max_speed[i], max_turn[i], response[i] <= at_once, _minimum(tilt, limit), dt, share, slow
        )
        before, was = (heading[0][i], heading[1][i], heading[2][i]), (up[0][i], up[1][i], up[2][i])
        bent, aside = minus(h, before), minus(cross(u, h), cross(was, before))
        square = (dot(bent, bent) + dot(chord, chord) + dot(aside, aside)) * _HALF
        limit = _maximum(max_turn[i], _ZERO) * dt * beyond
        hasty[i] |= square * (_ONE + square * (_TWELFTH + square * _NINETIETH)) > limit * limit + _F(1e-12)
        to[0][i], to[1][i], to[2][i] = v
        heading[0][i], heading[1][i], heading[2][i] = h
        up[0][i], up[1][i], up[2][i] = u
        position[0][i], position[1][i], position[2][i] = _F(place[0, i]), _F(place[1, i]), _F(place[2, i])


@inlined
def _faced(heading, velocity, up, faces, wish, max_speed, max_turn, at_once, tilt, dt, share, slow):  # type: ignore[no-untyped-def]
    """As `moving._face`, for one."""
    heading, good = _unit(_flat(heading, up))
    if not good:
        heading = _across(up)
    direction, good = _unit(velocity)
    if not good:
        direction = heading
    faced = False
    if faces:
        way, good = _unit(wish)
        along = _flat(way if good else up, up)
        faced = _length(along) > _LEVEL
        way, good = _unit(along)
        if faced and good:
            direction = way
    if dot(heading, direction) < 0 and not (at_once and not np.isfinite(max_turn)):
        left = cross(up, heading)
        side, good = _unit(_flat(direction, heading))
        if not good:
            side = left
        direction, good = _unit(_flat(side, up))
        if not good:
            direction = left
    eager = _minimum(_length(velocity) / _maximum(max_speed * slow, _F(1e-6)), _ONE)
    if faced:
        eager = _ONE
    change = times(minus(direction, heading), _ONE if at_once else share * eager)
    if np.isfinite(max_turn):
        size, most = _length(change), _maximum(max_turn, _ZERO) * dt
        most = np.sqrt(_maximum(most * most - tilt, _ZERO))
        if size > most:
            change = times(change, most / (size if size > 0 else _ONE))
    turned, good = _unit(_flat(plus(heading, change), up))
    if not good:
        return heading
    return turned


@inlined
def _maximum(a, b):  # type: ignore[no-untyped-def]
    """The first number's NaN is kept, as NumPy does."""
    return b if a <= b else a


@inlined
def _minimum(a, b):  # type: ignore[no-untyped-def]
    return b if a >= b else a


@inlined
def _length(a):  # type: ignore[no-untyped-def]
    return np.sqrt(dot(a, a))


@inlined
def _flat(a, up):  # type: ignore[no-untyped-def]
    return minus(a, times(up, dot(a, up)))


@inlined
def _unit(a):  # type: ignore[no-untyped-def]
    """Length 1, and whether there is a direction."""
    size = _length(a)
    good = size > _TINY and np.isfinite(size)
    return times(a, _ONE / (size if good else _ONE)), good


@inlined
def _across(up):  # type: ignore[no-untyped-def]
    steep = abs(up[0]) > _STEEP
    side = _flat((_ZERO if steep else _ONE, _ONE if steep else _ZERO, _ZERO), up)
    return times(side, _ONE / _length(side))
