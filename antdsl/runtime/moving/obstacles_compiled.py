"""The passes of obstacles over all agents as loops: the same operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, I64, Array1, Array2, independent, kernel
from antdsl.numerics.vectors_compiled import dot, minus, plus, times

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]
_F = np.float32
_ZERO, _HALF, _ONE, _FAR = _F(0), _F(0.5), _F(1), _F(np.inf)
_LEAST, _MARGIN = _F(1e-9), _F(0.5)  # as `obstacles`
_TINY = _F(1e-12)  # as `vectors.unit`
_SLACK = _F(1e-4)  # as `obstacle_clearance`
_WIDER = _F(1) + _SLACK
_LONGER = _F(1) + _F(1e-6)  # as `obstacles`


@kernel
def same(one: Three, other: Three, begin: I64, end: I64) -> BOOL:
    """Whether vectors from `begin` to before `end` are all equal, none of them NaN."""
    found = True
    for i in range(begin, end):
        found = found and one[0][i] == other[0][i] and one[1][i] == other[1][i] and one[2][i] == other[2][i]
    return found


@kernel
def touching(
    place: Three,
    step: Three,
    radius: Array1[F32],
    clear: Array1[F32],
    rows: Array1[I64],
    found: Array2[F32],
    begin: I64,
    end: I64,
) -> tuple[I64, I64]:
    """Gives `begin` and how many from there to before `end` may touch an obstacle on their step, which is `clear` of them: from
    `begin` on their rows, and of each `found` [9, ..]: how long its step is, its margin (mm) and `clear`, then both vectors."""
    count = begin
    for i in range(begin, end):
        way = (step[0][i], step[1][i], step[2][i])
        size = np.sqrt(dot(way, way))
        margin = (_ZERO if radius[i] <= 0 else radius[i]) * _MARGIN
        if size > _LEAST and clear[i] <= (size + margin) * _WIDER + _SLACK:
            rows[count], found[0, count], found[1, count], found[2, count] = i, size, margin, clear[i]
            for k in range(3):
                found[3 + k, count], found[6 + k, count] = place[k][i], step[k][i]
            count += 1
    return begin, count - begin


@kernel
def kept_off(
    near: Array2[F32],
    above: Three,
    gaps: Array1[F32],
    out: Array2[F32],
    bent: Array2[F32],
    going: Array1[I64],
    rays: Array2[F32],
) -> I64:
    """Steps of those whom `touching` has found, on ground whose up is `above`, `bent` [3, n] such that they keep the margin from
    the nearest face, which lies so far (`gaps`) along `out` [3, n]; and how many may meet a face on them: which ones they are,
    and their `rays` [9, n]: place, direction, how far they look, the length of the step and the margin."""
    count = 0
    for i in range(gaps.size):
        size, margin, clear, gap = near[0, i], near[1, i], near[2, i], gaps[i]
        step, up = (near[6, i], near[7, i], near[8, i]), (above[0][i], above[1][i], above[2][i])
        away = (out[0, i], out[1, i], out[2, i])
        wall = minus(away, times(up, dot(away, up)))
        long = np.sqrt(dot(wall, wall))
        if long > _TINY and np.isfinite(long):
            wall = times(wall, _ONE / long)
        else:
            wall = (_ZERO, _ZERO, _ZERO)
        least, half = margin - gap, size * _HALF
        least = (half if half < least else least) - dot(step, wall)
        step = plus(step, times(wall, _ZERO if least <= 0 else least))
        long = np.sqrt(dot(step, step))
        if long > size:
            step = times(step, size / long)
        bent[0, i], bent[1, i], bent[2, i] = step
        if gap < 0:
            clear = _FAR  # nothing holds who is inside
        elif not gap <= clear:
            clear = gap
        size = np.sqrt(dot(step, step))
        if size > _LEAST and clear <= (size + margin) * _WIDER + _SLACK:
            going[count] = i
            inverse = _ONE / size
            for k in range(3):
                rays[k, count], rays[3 + k, count] = near[3 + k, i], step[k] * inverse
            rays[6, count], rays[7, count], rays[8, count] = size + margin, size, margin
            count += 1
    return count


@kernel
def slowed(wanted: Three, step: Three, velocity: Three, rate: F32, begin: I64, end: I64) -> None:
    """Changes velocities of agents from `begin` to before `end`, of those whose steps are not as `wanted`, to `rate` times their
    steps."""
    for i in independent(begin, end):
        if step[0][i] != wanted[0][i] or step[1][i] != wanted[1][i] or step[2][i] != wanted[2][i]:
            for k in range(3):
                velocity[k][i] = step[k][i] * rate


@kernel
def strayed(
    rows: Array1[I64], place: Three, start: Three, wide: Array1[F32], at: Array2[F32], radius: Array1[F32], gone: Array1[F32]
) -> None:
    """Of some rows where they are, `at` (3, k), their radii, and how far from where the step began, with a bit more."""
    for k in independent(0, rows.size):
        row = rows[k]
        to = (place[0][row], place[1][row], place[2][row])
        way = minus(to, (start[0][row], start[1][row], start[2][row]))
        at[0, k], at[1, k], at[2, k] = to
        radius[k], gone[k] = wide[row], np.sqrt(dot(way, way)) * _LONGER
