"""The walk of `walk` and `ground` as one loop over agents: same operations in the same order and so the same bits. Who may meet
anything but the next face of its own surface waits for a second loop."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.around_compiled import beyond, landed, other_ahead, standing
from antdsl.ground.mesh.boxes_compiled import Tree
from antdsl.ground.mesh.crossings_compiled import crossed
from antdsl.ground.mesh.face_table import (
    AXIS1,
    CORNER,
    EDGE2,
    EDGE_C,
    EDGE_S,
    MESH,
    RATE1,
    SMOOTH,
    WIDTH,
)
from antdsl.ground.mesh.surroundings import LIFT
from antdsl.ground.mesh.topology import NO_LINK
from antdsl.ground.mesh.walk import CROSSINGS, GRAIN, HOPS, INWARD, STUCK
from antdsl.machine_code.kernels import (
    BOOL,
    F64,
    I32,
    I64,
    Array1,
    Array2,
    called,
    fetch_ahead,
    four,
    independent,
    inlined,
    kernel,
    whole,
)
from antdsl.numerics.vectors_compiled import inside as _inside

# `packed` faces, `link` and `forked` of the topology, the first face of each mesh.
Surface = tuple[Array1[F64], Array2[I32], BOOL, Array1[I64]]
# `first`, `count`, `least` and `reach` of `Parts`; an agent stays away from what is nearer than its way, LIFT of its body and a
# noise, which comes last.
Clearances = tuple[Array1[I64], Array1[I32], Array1[F64], F64, F64]
Placed = tuple[Array1[I32], Array1[I32], Array1[F64], Array1[F64], Array1[F64]]  # mesh, face, two weights, height over it
# Place, up, heading and direction (3, n), and the way gone.
Moved = tuple[Array2[F64], Array2[F64], Array2[F64], Array2[F64], Array1[F64]]
# What is kept of agents that wait: rows of an array of floats, and of one of whole numbers.
B1, B2, SIDE, C, S, HEADING_C, HEADING_S, LEFT, GONE, OVER, LENGTH, REALS = range(12)
AGENT, FACE, TURN, SPENT, BLOCKED, NEAR, EVENT, EDGE, WHOLES = range(9)
_FETCHED = 64  # agents whose rows are brought near at once: as many as a processor's nearest memory holds
AHEAD, BORDER, HANG = 1, 2, 3  # something may be in the way, or beyond the border; over one already


@kernel
def walk_all(
    surface: Surface,
    near: Clearances,
    mesh: Array1[I32],
    face: Array1[I32],
    b1s: Array1[F64],
    b2s: Array1[F64],
    overs: Array1[F64],
    body: Array1[F64],
    vectors: tuple[Array2[F64], Array2[F64], Array2[F64]],
    reals: Array2[F64],
    wholes: Array2[I64],
    done: Array1[BOOL],
    placed: Placed,
    moved: Moved,
    begin: I64,
    end: I64,
) -> I64:
    """One step of the agents from `begin` to before `end`; sets `done` for those that it moved and returns how many wait, in
    `reals` and `wholes` (.., end - begin).

    Then where agents stand, their body, wish, heading and up (3, n), and where the results go. Agents neither done nor waiting
    are left as they are.
    """
    table, link, forked, first = surface
    sub_first, sub_count, clear, reach, noise = near
    wish, heading, up = vectors
    to_mesh, to_face, to_b1, to_b2, to_over = placed
    place, above, ahead, direction, gone = moved
    for at in range(begin, end, _FETCHED):
        last = min(at + _FETCHED, end)
        for i in independent(at, last):
            if mesh[i] >= 0:
                row = WIDTH * (first[mesh[i]] + face[i])
                fetch_ahead(table, row)
                fetch_ahead(table, row + 8)
                fetch_ahead(table, row + 16)
                fetch_ahead(table, row + 24)
                fetch_ahead(table, row + 32)
        for i in independent(at, last):
            slot = i - begin
            done[i] = False
            wholes[EVENT, slot] = 0
            if mesh[i] < 0 or face[i] < 0:
                continue
            f = first[mesh[i]] + face[i]
            wish_x, wish_y, wish_z = wish[0, i], wish[1, i], wish[2, i]
            if not np.isfinite(wish_x + wish_y + wish_z):
                continue
            row = WIDTH * f
            axis1, axis2, normal, _ = _frame(table, row)
            along_up = up[0, i] * normal[0] + up[1, i] * normal[1] + up[2, i] * normal[2]
            side = -1.0 if along_up < 0 else 1.0
            over = overs[i] * side
            b1, b2 = _inside(b1s[i] + 0.0, b2s[i] + 0.0)
            c, s, left = _laid_down(axis1, axis2, wish_x, wish_y, wish_z, 1.0, 0.0)
            heading_c, heading_s, _ = _laid_down(axis1, axis2, heading[0, i], heading[1, i], heading[2, i], c, s)
            high = _margin(noise, body[i])
            if not _free(sub_first, sub_count, clear, reach, f, b1, b2) <= left + high:
                high = -np.inf  # has nothing to look out for on the whole way
            if over != 0 and left > 0:
                way, turn, event, edge, length = 0.0, 0, HANG, 0, 0.0
            else:
                f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn, event, edge, length = _walk(
                    table, link, forked, sub_first, sub_count, clear, reach, high, False,
                    f, b1, b2, side, c, s, heading_c, heading_s, left, 0.0, 0,
                )  # fmt: skip
            if not np.isfinite(b1 + b2 + c + s + heading_c + heading_s):
                continue
            if event:
                wholes[AGENT, slot], wholes[SPENT, slot], wholes[BLOCKED, slot] = i, 0, 0
                wholes[NEAR, slot] = high > 0
                _keep(
                    reals, wholes, slot, f, b1, b2, side, c, s, heading_c, heading_s, left, way, over, turn, event, edge, length
                )
                continue
            done[i] = True
            row = WIDTH * f
            on = whole(table[row + MESH])
            to_mesh[i], to_face[i] = on, f - first[on]
            to_b1[i], to_b2[i], to_over[i], gone[i] = b1, b2, over * side + 0.0, way
            _finish(table, row, b1, b2, side, c, s, heading_c, heading_s, over, i, place, above, ahead, direction)
    waiting = 0
    for k in range(0, end - begin):
        if wholes[EVENT, k] != 0:
            for row in range(0, REALS):
                reals[row, waiting] = reals[row, k]
            for row in range(0, WHOLES):
                wholes[row, waiting] = wholes[row, k]
            waiting += 1
    return waiting


@kernel
def walk_on(
    surface: Surface,
    near: Clearances,
    sides: tuple[Array1[I32], Array2[I32]],
    cuts: tuple[Array1[I64], Array1[I64]],
    boxes: Tree,
    scale: tuple[F64, F64, F64],
    touch: F64,
    straight: BOOL,
    found: Array1[I64],
    body: Array1[F64],
    reals: Array2[F64],
    wholes: Array2[I64],
    done: Array1[BOOL],
    placed: Placed,
    moved: Moved,
    blocked: Array1[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """The same for agents that wait, from `begin` to before `end`.

    `sides` are `piece` and `way` of the topology and `cuts` the arrays of its cuts, `boxes` those of `Boxes`, `scale` least, fine
    and under of `Scale`, and its `touch`; ways end at open borders if they are to be `straight`; `found` has room for all faces.
    """
    table, link, forked, first = surface
    sub_first, sub_count, clear, reach, noise = near
    first_cut, _ = cuts
    to_mesh, to_face, to_b1, to_b2, to_over = placed
    place, above, ahead, direction, gone = moved
    for k in range(begin, end):
        event = wholes[EVENT, k]
        i = wholes[AGENT, k]
        size = body[i]
        high = _margin(noise, size) if wholes[NEAR, k] != 0 else -np.inf
        f, b1, b2, side, c, s, heading_c, heading_s = (
            wholes[FACE, k],
            reals[B1, k],
            reals[B2, k],
            reals[SIDE, k],
            reals[C, k],
            reals[S, k],
            reals[HEADING_C, k],
            reals[HEADING_S, k],
        )
        left, way, over, turn, looked, edge, length = (
            reals[LEFT, k],
            reals[GONE, k],
            reals[OVER, k],
            wholes[TURN, k],
            False,
            wholes[EDGE, k],
            reals[LENGTH, k],
        )
        while event:
            to, one, two, side2, level, gap, shut = -1, 0.0, 0.0, side, 0.0, 0.0, False
            if event == AHEAD:
                looked = True
                if length > 0:
                    gap = length
                    if first_cut[f + 1] > first_cut[f]:
                        at_place, up, way_on = standing(table, f, b1, b2, side, c, s)
                        to, one, two, side2, gap, shut = crossed(
                            table, link, sides, cuts, touch, f, at_place, up, way_on, side, length
                        )  # fmt: skip
                    nearer, nearer1, nearer2, nearer_side, nearer_gap = other_ahead(
                        table, sides, boxes, scale, found, size, f, b1, b2, side, c, s, left, gap
                    )  # fmt: skip
                    if nearer >= 0:
                        to, one, two, side2, gap, shut = nearer, nearer1, nearer2, nearer_side, nearer_gap, False
                if to >= 0:
                    looked = False
                    turn += 1
            elif event == HANG:
                edge, outward = _hung(table, link, f, b1, b2, side, c, s)
                if outward:
                    event = BORDER
                    turn -= 1  # of a step, the loop counts the stretches
                else:
                    over, left, way = _rise(over, 0.0, left, way)
                    if over != 0:
                        left = 0.0
            if event == BORDER:
                turn += 1
                to, one, two, side2, gap, level = beyond(table, sides, boxes, scale, found, size, f, edge, b1, b2, side)
                over, left, way = _rise(over, level, left, way)
                if to < 0 and over == level:
                    c, s, left = _along(table[WIDTH * f + EDGE_C + edge], table[WIDTH * f + EDGE_S + edge], c, s, left)
                    wholes[BLOCKED, k] = 1
                    wholes[SPENT, k] += 1
                    if straight or wholes[SPENT, k] >= HOPS:
                        left = 0.0
                elif to < 0 or over != level or not left >= gap:
                    if way == 0:
                        wholes[BLOCKED, k] = 1
                    to, left = -1, 0.0
                else:
                    over = 0.0
                    wholes[NEAR, k] = 1
                    high = _margin(noise, size)
            if to >= 0:
                c, s, heading_c, heading_s = landed(table, f, side, c, s, heading_c, heading_s, to, side2)
                f, b1, b2, side = to, one, two, side2
                left = max(left - gap, 0.0)
                way += gap
                wholes[SPENT, k] += 1
                if shut or wholes[SPENT, k] >= HOPS:
                    left = 0.0
                    wholes[BLOCKED, k] = 1
            f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn, event, edge, length = _walk(
                table, link, forked, sub_first, sub_count, clear, reach, high, looked,
                f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn,
            )  # fmt: skip
            looked = False
        if not np.isfinite(b1 + b2 + c + s + heading_c + heading_s):
            continue
        done[i] = True
        row = WIDTH * f
        on = int(table[row + MESH])
        to_mesh[i], to_face[i] = on, f - first[on]
        to_b1[i], to_b2[i], to_over[i], gone[i], blocked[i] = b1, b2, over * side + 0.0, way, wholes[BLOCKED, k] != 0
        _finish(table, row, b1, b2, side, c, s, heading_c, heading_s, over, i, place, above, ahead, direction)


@inlined
def _margin(noise, body):  # type: ignore[no-untyped-def]
    """How near to its way (mm) a piece of surface must be to matter."""
    high = LIFT * body
    if not high > noise:
        high = noise
    return high + noise


@called
def _keep(  # type: ignore[no-untyped-def]
    reals, wholes, k, f, b1, b2, side, c, s, heading_c, heading_s, left, way, over, turn, event, edge, length
):
    reals[B1, k], reals[B2, k], reals[SIDE, k], reals[C, k], reals[S, k], reals[HEADING_C, k], reals[HEADING_S, k] = (
        b1,
        b2,
        side,
        c,
        s,
        heading_c,
        heading_s,
    )
    reals[LEFT, k], reals[GONE, k], reals[OVER, k], reals[LENGTH, k] = left, way, over, length
    wholes[FACE, k], wholes[TURN, k], wholes[EVENT, k], wholes[EDGE, k] = f, turn, event, edge


@inlined
def _rise(over, level, left, way):  # type: ignore[no-untyped-def]
    """As `walk.rise`: where it leads, and the way left and gone."""
    most = level - over
    climb = min(abs(most), left)
    to = level if climb >= abs(most) else over + (-climb if most < 0 else climb)
    return to, left - climb, way + climb


@inlined
def _hung(table, link, f, b1, b2, side, c, s):  # type: ignore[no-untyped-def]
    """As `walk.hung`."""
    weights, edge, least = (1.0 - b1 - b2, b1, b2), 0, np.inf
    for k in range(3):
        if link[1 if side < 0 else 0, 3 * f + k] == NO_LINK and weights[k] < least:
            edge, least = k, weights[k]
    row = WIDTH * f + edge
    return edge, c * table[row + EDGE_S] - s * table[row + EDGE_C] > 0


@inlined
def _frame(table, row):  # type: ignore[no-untyped-def]
    """Both axes of a face, its normal, and its rates and shear."""
    ax, ay, az, bx = four(table, row + AXIS1)
    by, bz, nx, ny = four(table, row + AXIS1 + 4)
    nz, rate1, rate2, shear = four(table, row + AXIS1 + 8)
    return (ax, ay, az), (bx, by, bz), (nx, ny, nz), (rate1, rate2, shear)


@inlined
def _edges(table, row):  # type: ignore[no-untyped-def]
    """Cosines, sines and links of a face's edges, and its mesh."""
    c0, c1, c2, mesh = four(table, row + EDGE_C)
    s0, s1, s2, link0 = four(table, row + EDGE_S)
    link1, link2, _, _ = four(table, row + EDGE_S + 4)
    return (c0, c1, c2), (s0, s1, s2), (link0, link1, link2), mesh


@inlined
def _of(three, k):  # type: ignore[no-untyped-def]
    """One of three numbers."""
    return three[0] if k == 0 else (three[1] if k == 1 else three[2])


@inlined
def _laid_down(axis1, axis2, x, y, z, c0, s0):  # type: ignore[no-untyped-def]
    c = axis1[0] * x + axis1[1] * y + axis1[2] * z
    s = axis2[0] * x + axis2[1] * y + axis2[2] * z
    flat = np.sqrt(c * c + s * s)
    if not flat > 1e-150:
        return c0, s0, 0.0
    return c / flat, s / flat, min(np.sqrt(x * x + y * y + z * z), 2 * flat)


@inlined
def _free(sub_first, sub_count, clear, reach, f, b1, b2):  # type: ignore[no-untyped-def]
    """As `Parts.of`."""
    n = sub_count[f]
    if n == 0:
        return reach
    return clear[sub_first[f] + max(min(whole(np.floor(b1 * n)), n - 1), 0) * n + max(min(whole(np.floor(b2 * n)), n - 1), 0)]


@inlined
def _walk(  # type: ignore[no-untyped-def]
    table, link, forked, sub_first, sub_count, clear, reach, high, looked,
    f, b1, b2, side, c, s, heading_c, heading_s, left, gone, turn,
):  # fmt: skip
    """Across faces until the way is used up, or until an event: what the agent is then, the event, and the edge and length of
    its stretch. On stretches within whose length and `high` there may be another piece it stops, but not on the first if
    `looked`."""
    event, edge, length = 0, 0, 0.0
    while turn < CROSSINGS and left > 0:
        if turn >= STUCK:  # noqa: SIM102  # asked first: hardly anybody comes to it, and the rest of a division is dear
            if turn % STUCK == 0 and not looked:
                b1 = b1 * (1 - GRAIN) + GRAIN / 3
                b2 = b2 * (1 - GRAIN) + GRAIN / 3
        row = WIDTH * f
        _, along, across, shear = four(table, row + RATE1 - 1)
        rate1 = c * along - s * shear
        rate2 = s * across
        rate0 = -(rate1 + rate2)
        b0 = 1.0 - b1 - b2
        until, edge = np.inf, 0
        if rate0 < 0:
            until = max(b0, 0.0) / -rate0
        if rate1 < 0:
            way = max(b1, 0.0) / -rate1
            if way < until:
                until, edge = way, 1
        if rate2 < 0:
            way = max(b2, 0.0) / -rate2
            if way < until:
                until, edge = way, 2
        length = min(until, left)
        if high > 0 and not looked and _free(sub_first, sub_count, clear, reach, f, b1, b2) <= length + high:
            event = AHEAD
            break
        looked = False
        b1, b2 = _inside(b1 + rate1 * length, b2 + rate2 * length)
        gone += length
        if until >= left:
            break
        left = left - length
        cosines, sines, links, _ = _edges(table, row)
        beyond = link[1, 3 * f + edge] if forked and side < 0 else whole(_of(links, edge))
        if beyond == NO_LINK:
            event = BORDER
            break
        f, b1, b2, side, c, s, heading_c, heading_s = _cross(
            table, beyond, edge, _of(cosines, edge), _of(sines, edge), b1, b2, side, c, s, heading_c, heading_s
        )
        turn += 1
    return f, b1, b2, side, c, s, heading_c, heading_s, left, gone, turn, event, edge, length


@inlined
def _along(edge_c, edge_s, c, s, left):  # type: ignore[no-untyped-def]
    """Along an open border, and the way that is left there."""
    along = c * edge_c + s * edge_s
    turn = -1.0 if along < 0 else 1.0
    return turn * edge_c - INWARD * edge_s, turn * edge_s + INWARD * edge_c, left * abs(along)


@inlined
def _cross(table, beyond, edge, c1, s1, b1, b2, side, c, s, heading_c, heading_s):  # type: ignore[no-untyped-def]
    """Into the face beyond an edge."""
    f, k2, flip = np.int64(beyond >> 3), (beyond >> 1) & 3, (beyond & 1) == 1
    b0 = 1.0 - b1 - b2
    first = b1 if edge == 0 else (b2 if edge == 1 else b0)
    second = b2 if edge == 0 else (b0 if edge == 1 else b1)
    if not flip:
        first, second = second, first
    there = WIDTH * f
    cosines, sines, _, _ = _edges(table, there)
    c2, s2 = _of(cosines, k2), _of(sines, k2)
    turn = 1.0 if flip else -1.0
    along, out = turn * (c * c1 + s * s1), c * s1 - s * c1
    c, s = along * c2 - out * s2, along * s2 + out * c2
    along, out = turn * (heading_c * c1 + heading_s * s1), heading_c * s1 - heading_s * c1
    heading_c, heading_s = along * c2 - out * s2, along * s2 + out * c2
    b1 = max(first if k2 == 0 else (0.0 if k2 == 1 else second), 0.0)
    b2 = max(second if k2 == 0 else (first if k2 == 1 else 0.0), 0.0)
    return f, b1, b2, -side if flip else side, c, s, heading_c, heading_s


@inlined
def _finish(  # type: ignore[no-untyped-def]
    table, row, b1, b2, side, c, s, heading_c, heading_s, over, i, place, above, ahead, direction
):
    """Place, smooth normal, transported heading and direction of travel in space."""
    b0 = 1.0 - b1 - b2
    axis1, axis2, (nx, ny, nz), _ = _frame(table, row)
    _, _, corner_x, corner_y = four(table, row + CORNER - 2)
    corner_z, one_x, one_y, one_z = four(table, row + CORNER + 2)
    two_x, two_y, two_z, s0 = four(table, row + EDGE2)
    s1, s2, s3, s4 = four(table, row + SMOOTH + 1)
    s5, s6, s7, s8 = four(table, row + SMOOTH + 5)
    sx, sy, sz = s0 * b0 + s3 * b1 + s6 * b2, s1 * b0 + s4 * b1 + s7 * b2, s2 * b0 + s5 * b1 + s8 * b2
    size = np.sqrt(max(sx * sx + sy * sy + sz * sz, 1e-300))
    sx, sy, sz = sx / size * side, sy / size * side, sz / size * side
    nx, ny, nz = nx * side, ny * side, nz * side
    hx = axis1[0] * heading_c + axis2[0] * heading_s
    hy = axis1[1] * heading_c + axis2[1] * heading_s
    hz = axis1[2] * heading_c + axis2[2] * heading_s
    hx, hy, hz = _turned(hx, hy, hz, nx, ny, nz, sx, sy, sz)
    off = hx * sx + hy * sy + hz * sz
    hx, hy, hz = hx - off * sx, hy - off * sy, hz - off * sz
    size = np.sqrt(hx * hx + hy * hy + hz * hz)
    ahead[0, i], ahead[1, i], ahead[2, i] = hx / size, hy / size, hz / size
    above[0, i], above[1, i], above[2, i] = sx, sy, sz
    place[0, i] = corner_x + b1 * one_x + b2 * two_x + over * nx
    place[1, i] = corner_y + b1 * one_y + b2 * two_y + over * ny
    place[2, i] = corner_z + b1 * one_z + b2 * two_z + over * nz
    direction[0, i] = axis1[0] * c + axis2[0] * s
    direction[1, i] = axis1[1] * c + axis2[1] * s
    direction[2, i] = axis1[2] * c + axis2[2] * s


@inlined
def _turned(vx, vy, vz, bx, by, bz, ax, ay, az):  # type: ignore[no-untyped-def]
    """A vector turned as the unit normal b turns into a; half a turn goes over the vector itself."""
    cosine = bx * ax + by * ay + bz * az
    if cosine < -1 + 1e-9:
        hx, hy, hz = by * vz - bz * vy, bz * vx - bx * vz, bx * vy - by * vx
        twice = 2 * (hx * vx + hy * vy + hz * vz)
        return twice * hx - vx, twice * hy - vy, twice * hz - vz
    x, y, z = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
    part = (x * vx + y * vy + z * vz) / (1 + cosine)
    return (
        cosine * vx + (y * vz - z * vy) + part * x,
        cosine * vy + (z * vx - x * vz) + part * y,
        cosine * vz + (x * vy - y * vx) + part * z,
    )
