"""The passes of obstacles over all agents as loops: the same operations in the same order, and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.casting.grid_rays import AHEAD, Grid, feel
from antdsl.casting.nearest_faces import fetch_around, fetch_lists, way_out
from antdsl.casting.tolerances import FURTHER
from antdsl.machine_code.kernels import BOOL, F32, I64, Array1, Array2, Strided2, independent, inlined, kernel, scratch
from antdsl.numerics.vectors_compiled import dot, minus, plus, times

Three = tuple[Array1[F32], Array1[F32], Array1[F32]]
_F = np.float32
_ZERO, _HALF, _ONE, _FAR = _F(0), _F(0.5), _F(1), _F(np.inf)
_LEAST, _MARGIN = _F(1e-9), _F(0.5)  # as `obstacles`
_TINY = _F(1e-12)  # as `vectors.unit`
_SLACK = _F(1e-4)  # as `obstacle_clearance`
_WIDER = _F(1) + _SLACK
_LOOKS = 1 + 1e-6  # more than rounding makes of a distance
_LONGER = _F(1) + _F(1e-6)  # as `obstacles`


@kernel
def same(one: Three, other: Three, begin: I64, end: I64) -> BOOL:
    """Whether vectors from `begin` to before `end` are all equal, none of them NaN."""
    found = True
    for i in range(begin, end):
        found = found and one[0][i] == other[0][i] and one[1][i] == other[1][i] and one[2][i] == other[2][i]
    return found


@inlined
def _asked(step, radius, clear, i):  # type: ignore[no-untyped-def]
    """How long a step is, its margin, and whether it may touch an obstacle."""
    way = (step[0][i], step[1][i], step[2][i])
    size = np.sqrt(dot(way, way))
    margin = (_ZERO if radius[i] <= 0 else radius[i]) * _MARGIN
    return size, margin, size > _LEAST and clear[i] <= (size + margin) * _WIDER + _SLACK


@inlined
def _kept(step, up, size, margin, clear, gap, out):  # type: ignore[no-untyped-def]
    """A step that keeps the margin from the nearest face, so far along `out`; its length, and whether it may meet a face."""
    wall = minus(out, times(up, dot(out, up)))
    long = np.sqrt(dot(wall, wall))
    if long > _TINY and np.isfinite(long):
        wall = times(wall, _ONE / long)
    else:
        wall = (_ZERO, _ZERO, _ZERO)
    least, half = margin - gap, size * _HALF
    least = (half if half < least else least) - dot(step, wall)
    if not least <= 0:
        step = plus(step, times(wall, least))
    long = np.sqrt(dot(step, step))
    if long > size:
        step = times(step, size / long)
    if gap < 0:
        clear = _FAR  # nothing holds who is inside
    elif not gap <= clear:
        clear = gap
    size = np.sqrt(dot(step, step))
    return step, size, size > _LEAST and clear <= (size + margin) * _WIDER + _SLACK


@kernel
def along(
    grid: Grid,
    place: Three,
    step: Three,
    up: Strided2[F32],
    radius: Array1[F32],
    clear: Array1[F32],
    rows: Array1[I64],
    found: Array2[F32],
    met: Array1[I64],
    hits: Array2[F32],
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64, I64]:
    """`begin`; how many agents from there to before `end` may touch an obstacle on their step, which is `clear` of them, without
    those who are outside and whose nearest face is farther than they look: their steps stay; how many of these meet it on the
    step that keeps the margin; and of how many the grid cannot tell. From number `begin` on: their `rows` with place, that step,
    the `up` of the ground (3, n) and the margin, `found` [10, n]; who of them has `met` a face, how much of the step (mm) is
    free, and the normal, `hits` [4, n]."""
    asking = begin
    for i in range(begin, end):
        _, _, asked = _asked(step, radius, clear, i)
        if asked:
            rows[asking] = i
            asking += 1
    count, hit, left = 0, 0, 0
    cubes = scratch(9 * AHEAD, I64)
    for low in range(begin, asking, AHEAD):
        high = min(low + AHEAD, asking)
        for n in range(low, high):
            i = rows[n]
            fetch_around(grid, (place[0][i], place[1][i], place[2][i]), cubes, n - low)
        fetch_lists(grid, cubes, 9 * (high - low))
        for n in range(low, high):
            i = rows[n]
            size, margin, _ = _asked(step, radius, clear, i)
            at, above = (place[0][i], place[1][i], place[2][i]), (up[0, i], up[1, i], up[2, i])
            gap, out = way_out(grid, at, np.float64((size + margin) * _WIDER + _SLACK) * _LOOKS)
            if gap == _FAR:
                continue
            left += 1 if gap != gap else 0
            bent, size, asked = _kept((step[0][i], step[1][i], step[2][i]), above, size, margin, clear[i], gap, out)
            k = begin + count
            rows[k], found[9, k] = i, margin
            for axis in range(3):
                found[axis, k], found[3 + axis, k], found[6 + axis, k] = at[axis], bent[axis], above[axis]
            if asked:
                normal, face = feel(grid, at, times(bent, _ONE / size), size + margin)
                left += 1 if face == FURTHER else 0
                if face >= 0:
                    h = begin + hit
                    free = _F(normal[3]) - margin
                    free = _ZERO if free < _ZERO else size if free > size else free
                    met[h], hits[0, h], hits[1, h], hits[2, h], hits[3, h] = (
                        count,
                        free,
                        _F(normal[0]),
                        _F(normal[1]),
                        _F(normal[2]),
                    )
                    hit += 1
            count += 1
    return begin, count, hit, left


@kernel
def put(step: Three, rows: Array1[I64], own: Strided2[F32], to: Array2[F32]) -> None:
    """Steps `to` (3, n), of some rows their `own` (3, k)."""
    for i in independent(0, step[0].size):
        to[0, i], to[1, i], to[2, i] = step[0][i], step[1][i], step[2][i]
    for k in range(rows.size):
        to[0, rows[k]], to[1, rows[k]], to[2, rows[k]] = own[0, k], own[1, k], own[2, k]


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
        size, margin, asked = _asked(step, radius, clear, i)
        if asked:
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
        margin, up, away = near[1, i], (above[0][i], above[1][i], above[2][i]), (out[0, i], out[1, i], out[2, i])
        step, size, asked = _kept((near[6, i], near[7, i], near[8, i]), up, near[0, i], margin, near[2, i], gaps[i], away)
        bent[0, i], bent[1, i], bent[2, i] = step
        if asked:
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
