"""A substep of a crowd in two loops over all agents: `set_out` does all before obstacles and walls, and for each kind of ground
one loop walks agents and lets them arrive."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.face_table import WIDTH
from antdsl.ground.mesh.stretches import finish
from antdsl.ground.mesh.walk import (
    DONE,
    LEFT_OUT,
    ROWS_AHEAD,
    WAITS,
    Clearances,
    Placed,
    Surface,
    bring_near,
    counted,
    keep,
    walked,
)  # fmt: skip
from antdsl.ground.plane import straight
from antdsl.machine_code.kernels import (
    BOOL,
    F32,
    F64,
    I32,
    I64,
    U8,
    Array1,
    Array2,
    Strided2,
    fetch_ahead,
    independent,
    inlined,
    kernel,
    three,
)  # fmt: skip
from antdsl.numerics.kernel_vectors import Vec3, VectorColumns, dot, times
from antdsl.runtime.moving.headings import STANDS
from antdsl.runtime.moving.rises import WIDEST, half_of
from antdsl.runtime.moving.tilting import stood
from antdsl.runtime.moving.velocities import Bodies, Facing, Limits, Times, arrived, pushed

_F = np.float32
_ZERO = _F(0)


@kernel
def set_out(
    push: VectorColumns,
    velocity: VectorColumns,
    heading: VectorColumns,
    up: VectorColumns,
    normal: Array2[F32],
    limits: tuple[Array1[F32], Array1[F32], Array1[F32], Array1[F32], Array1[F32]],
    keeps: BOOL,
    min_speed: Array1[F32],
    size: Array1[F32],
    quarantined: Array1[BOOL],
    times_of: tuple[F32, F32, F32],
    to: VectorColumns,
    step: VectorColumns,
    looking: VectorColumns,
    lengths: tuple[Array1[F32], Array1[F32], Array1[F64]],
    state: Array1[I32],
    begin: I64,
    end: I64,
) -> tuple[F64, F64]:
    """What agents from `begin` to before `end` are about to do: velocities after the push `to` three arrays, the `step` (mm) that
    is their way in `dt`, and how bodies stand: their `state`, and of those who lean the heading along the ground, `looking`.

    `limits`: `max_speed`, `max_force`, `mass`, `response` and `max_turn`; `keeps`: whether `min_speed` counts. `times_of`: the
    longest response that takes its whole time in one substep, that time, and `dt`, that of others. Into `lengths`: how long the
    step is, by what angle (radians) a body tilts at most, and how far before it (mm) it looks
    out for walls. Gives the longest step that is finite and the greatest size, -inf where none is a number.
    """
    max_speed, max_turn, dt = limits[0], limits[4], times_of[2]
    long, most, reach = lengths
    for i in independent(begin, end):
        u = three(normal, i)
        v = pushed(push, velocity, u, heading, limits, keeps, min_speed, times_of, i)
        if quarantined[i]:
            v = (_ZERO, _ZERO, _ZERO)
        way = times(v, dt)
        for k in range(3):
            to[k][i], step[k][i] = v[k], way[k]
        long[i] = np.sqrt(dot(way, way))
        stood(i, up, heading, normal, max_speed, size, max_turn, dt, most, looking, state)
        reach[i] = WIDEST * half_of(size[i])
    longest, greatest = _ZERO, _F(-np.inf)
    for i in range(begin, end):
        longest = long[i] if long[i] > longest and np.isfinite(long[i]) else longest
        greatest = size[i] if size[i] > greatest else greatest
    return np.float64(longest), np.float64(greatest)


@inlined
def _ahead(heading: VectorColumns, looking: VectorColumns, state: Array1[I32], i: I64) -> Vec3:
    """The heading along the ground, in float64."""
    if state[i] == STANDS:
        return np.float64(heading[0][i]), np.float64(heading[1][i]), np.float64(heading[2][i])
    return np.float64(looking[0][i]), np.float64(looking[1][i]), np.float64(looking[2][i])


@kernel
def stride(
    surface: Surface,
    near: Clearances,
    at: Placed,
    size: Array1[F32],
    normal: Array2[F32],
    velocity: VectorColumns,
    step: VectorColumns,
    looking: VectorColumns,
    limits: Limits,
    bodies: Bodies,
    times_of: Times,
    facing: Facing,
    registers: tuple[VectorColumns, VectorColumns, VectorColumns, VectorColumns],
    reals: Array2[F64],
    wholes: Array2[I64],
    how: Array1[U8],
    placed: Placed,
    place: Array2[F64],
    old: Strided2[F64],
    normals: Array2[F32],
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """`walk_all` over triangles by steps and headings in float32, from footings `at` to `placed` and `place` (3, n); those
    who are there arrive as by `arrive`."""
    mesh, face, b1s, b2s, overs = at
    first = surface[3]
    heading, state = registers[2], bodies[1]
    to_mesh, to_face, to_b1, to_b2, to_over = placed
    for group in range(begin - 8 * ROWS_AHEAD, end, 8):
        # Columns are brought near, too: they are more than a processor by itself sees coming.
        k = group + 8 * ROWS_AHEAD
        for columns in (velocity, step, registers[0], registers[1], registers[2], registers[3], limits):
            for each in columns:
                fetch_ahead(each, k)
        for each in (bodies[0], size, state, b1s, b2s, overs, to_mesh, to_face, to_b1, to_b2, to_over):
            fetch_ahead(each, k)
        for axis in range(3):
            fetch_ahead(place, k + axis * to_b1.size)
        for each in (normal, normals):
            fetch_ahead(each, 3 * k)
            fetch_ahead(each, 3 * k + 16)
        for each in (mesh, face):
            fetch_ahead(each, k + 64)
        bring_near(surface, mesh, face, max(group + 8 * ROWS_AHEAD, begin), min(group + 8 * ROWS_AHEAD + 8, end))
        for i in independent(max(group, begin), min(group + 8, end)):
            how[i] = LEFT_OUT
            if mesh[i] < 0 or face[i] < 0:
                continue
            way = (np.float64(step[0][i]), np.float64(step[1][i]), np.float64(step[2][i]))
            if not np.isfinite(way[0] + way[1] + way[2]):
                continue
            x, y, z = three(normal, i)
            up = (np.float64(x), np.float64(y), np.float64(z))
            long, look = np.float64(size[i]), _ahead(heading, looking, state, i)
            high, over, f, b1, b2, side, c, s, heading_c, heading_s, left, gone, turn, event, edge, length, hops = walked(
                surface, near, True, first[mesh[i]] + face[i], b1s[i], b2s[i], overs[i], long, way, look, up
            )
            if event:
                how[i] = WAITS
                keep(
                    reals, wholes, i, i, high > 0, np.float64(size[i]), f, b1, b2, side, c, s, heading_c, heading_s, left, gone,
                    over, turn, event, edge, length, hops,
                )  # fmt: skip
                continue
            how[i] = DONE
            to_mesh[i], to_face[i] = mesh[i], f - first[mesh[i]]  # no edge leads to another mesh
            to_b1[i], to_b2[i], to_over[i] = b1, b2, over * side + 0.0
            found = finish(surface[0], WIDTH * f, b1, b2, side, c, s, heading_c, heading_s, over)
            for k in range(3):
                place[k, i] = found[0][k]
            arrived(i, found, hops > 0, old, step, velocity, limits, bodies, times_of, facing, registers, normals)
    waiting, left = counted(how, reals, wholes, begin, end)
    return begin, waiting, left


@kernel
def glide(
    plane: Array1[F64],
    at: Strided2[F64],
    velocity: VectorColumns,
    step: VectorColumns,
    looking: VectorColumns,
    limits: Limits,
    bodies: Bodies,
    times_of: Times,
    facing: Facing,
    registers: tuple[VectorColumns, VectorColumns, VectorColumns, VectorColumns],
    place: Array2[F64],
    normals: Array2[F32],
    begin: I64,
    end: I64,
) -> None:
    """Agents from `begin` to before `end` walk across the unit vector `plane` from points `at` to points `place`, (n, 3) both,
    and arrive there as by `arrive`."""
    heading, state = registers[2], bodies[1]
    up = (plane[0], plane[1], plane[2])
    for i in independent(begin, end):
        way = (np.float64(step[0][i]), np.float64(step[1][i]), np.float64(step[2][i]))
        look = _ahead(heading, looking, state, i)
        there, ahead, direction, _ = straight(up, (at[i, 0], at[i, 1], at[i, 2]), way, look)
        for k in range(3):
            place[i, k] = there[k]
        found = (there, up, ahead, direction)
        arrived(i, found, False, at, step, velocity, limits, bodies, times_of, facing, registers, normals)
