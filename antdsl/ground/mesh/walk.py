"""Walking over triangles: straight lines that unfold across edges, climb what stands in the way and stop at open borders. Exact
in float64: the point never leaves its triangle, and the way walked is as long as asked.

One loop goes over all agents. Who may meet anything but the next face of its own surface waits for a second loop."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.boxes import Tree
from antdsl.ground.mesh.crossings import crossed
from antdsl.ground.mesh.face_table import (
    EDGE_C,
    EDGE_S,
    EDGES,
    MESH,
    WIDTH,
)
from antdsl.ground.mesh.stretches import AHEAD, BORDER, HANG, HOPS, along_border, finish, frame, free, go, laid_down
from antdsl.ground.mesh.surroundings import LIFT, beyond, landed, other_ahead, standing
from antdsl.ground.mesh.topology import NO_LINK
from antdsl.machine_code.kernels import (
    BOOL,
    F64,
    I32,
    I64,
    U8,
    Array1,
    Array2,
    Strided2,
    called,
    fetch_ahead,
    independent,
    inlined,
    kernel,
)
from antdsl.numerics.kernel_vectors import Vec3, of, put
from antdsl.numerics.kernel_vectors import inside as _inside
from antdsl.numerics.parallel import own

# `packed` faces, `link` and `forked` of the topology, the first face of each mesh.
Surface = tuple[Array1[F64], Array2[I32], BOOL, Array1[I64]]
# `first`, `count`, `least` and `reach` of `Parts`; an agent stays away from what is nearer than its way, LIFT of its body and a
# noise, which comes last.
Clearances = tuple[Array1[I64], Array1[I32], Array1[F64], F64, F64]
Placed = tuple[Array1[I32], Array1[I32], Array1[F64], Array1[F64], Array1[F64]]  # mesh, face, two weights, height over it
# Place, up, heading and direction (3, n), and the way gone.
Moved = tuple[Array2[F64], Array2[F64], Array2[F64], Array2[F64], Array1[F64]]
# What is kept of agents that wait: rows of an array of floats, and of one of whole numbers.
B1, B2, SIDE, C, S, HEADING_C, HEADING_S, LEFT, GONE, OVER, LENGTH, BODY, REALS = range(13)
AGENT, FACE, TURN, SPENT, BLOCKED, NEAR, EVENT, EDGE, WHOLES = range(9)
LEFT_OUT, DONE, WAITS = range(3)  # how it is with an agent after the first loop; `stride` leaves some out, for `walk_all`
ROWS_AHEAD = 2  # eights of agents whose rows are brought near before theirs are read
FETCHED = 64  # agents whose rows are brought near at once: as many as a processor's nearest memory holds


@inlined
def bring_near(surface: Surface, mesh: Array1[I32], face: Array1[I32], begin: I64, end: I64) -> None:
    """Have the rows of the faces brought near that agents from `begin` to before `end` stand on."""
    table, _, _, first = surface
    for i in independent(begin, end):
        if mesh[i] >= 0:
            row = WIDTH * (first[mesh[i]] + face[i])
            fetch_ahead(table, row)
            fetch_ahead(table, row + 8)
            fetch_ahead(table, row + 16)
            fetch_ahead(table, row + 24)
            fetch_ahead(table, row + 32)


@inlined
def walked(
    surface: Surface,
    near: Clearances,
    along_open: BOOL,
    f: I64,
    b1: F64,
    b2: F64,
    over: F64,
    size: F64,
    wish: Vec3,
    heading: Vec3,
    up: Vec3,
) -> tuple[F64, F64, I64, F64, F64, F64, F64, F64, F64, F64, F64, F64, I64, I64, I64, F64, I64]:
    """An agent's way over face `f` and those beyond its edges, from weights and so far `over` it, with its `size`, wish, heading
    and up: where `go` leads to, `along_open` borders or not, and before that how near it looks out for other surfaces, and how
    far over its face it is, both on its side."""
    table, link, forked, _ = surface
    sub_first, sub_count, clear, reach, noise = near
    axis1, axis2, normal = frame(table, WIDTH * f)
    along_up = up[0] * normal[0] + up[1] * normal[1] + up[2] * normal[2]
    side = -1.0 if along_up < 0 else 1.0
    over = over * side
    b1, b2 = _inside(b1 + 0.0, b2 + 0.0)
    c, s, left = laid_down(axis1, axis2, wish[0], wish[1], wish[2], 1.0, 0.0)
    heading_c, heading_s, _ = laid_down(axis1, axis2, heading[0], heading[1], heading[2], c, s)
    high = _margin(noise, size)
    if not free(sub_first, sub_count, clear, reach, f, b1, b2) <= left + high:
        high = -np.inf  # has nothing to look out for on the whole way
    if over != 0 and left > 0:
        way, turn, event, edge, length, hops = 0.0, 0, HANG, 0, 0.0, 0
    else:
        f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn, event, edge, length, hops = go(
            table, link, forked, sub_first, sub_count, clear, reach, high, False, along_open,
            f, b1, b2, side, c, s, heading_c, heading_s, left, 0.0, 0,
        )  # fmt: skip
        if hops > 0:
            over = 0.0
    return high, over, f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn, event, edge, length, hops


@inlined
def counted(how: Array1[U8], reals: Array2[F64], wholes: Array2[I64], begin: I64, end: I64) -> tuple[I64, I64]:
    """How many of the agents from `begin` to before `end` wait, whose columns of `reals` and `wholes` are brought together from
    `begin` on, and how many are left."""
    waiting, left = 0, 0
    for k in range(begin, end):
        if how[k] == WAITS:
            for row in range(0, REALS):
                reals[row, begin + waiting] = reals[row, k]
            for row in range(0, WHOLES):
                wholes[row, begin + waiting] = wholes[row, k]
            waiting += 1
        elif how[k] == LEFT_OUT:
            left += 1
    return waiting, left


@kernel
def walk_all(
    surface: Surface,
    near: Clearances,
    at: Placed,
    body: Array1[F64],
    vectors: tuple[Array2[F64], Array2[F64], Array2[F64]],
    reals: Array2[F64],
    wholes: Array2[I64],
    how: Array1[U8],
    placed: Placed,
    moved: Moved,
    begin: I64,
    end: I64,
) -> tuple[I64, I64, I64]:
    """One step of the agents from `begin` to before `end`: says in `how` whether one was moved (DONE), or WAITS, in `reals` and
    `wholes` (.., n) from `begin` on, and returns `begin`, how many wait, and 0 for those that are left out.

    `at`: where agents stand; then their body, wish, heading and up (3, n), and where the results go. A wish that is not finite
    counts as none. Who is nowhere, or has weights that are not finite, is nowhere afterwards.
    """
    mesh, face, b1s, b2s, overs = at
    first = surface[3]
    wish, heading, up = vectors
    to_mesh, to_face, to_b1, to_b2, to_over = placed
    place, above, ahead, direction, gone = moved
    for some in range(begin, end, FETCHED):
        last = min(some + FETCHED, end)
        bring_near(surface, mesh, face, some, last)
        for i in independent(some, last):
            how[i] = DONE
            step, look, above_it = of(wish, i), of(heading, i), of(up, i)
            if mesh[i] < 0 or face[i] < 0 or not np.isfinite(b1s[i] + b2s[i] + overs[i]):
                to_mesh[i], to_face[i], to_b1[i], to_b2[i], to_over[i], gone[i] = -1, -1, 0.0, 0.0, 0.0, 0.0
                _put(i, ((0.0, 0.0, 0.0), above_it, look, look), place, above, ahead, direction)
                continue
            high, over, f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn, event, edge, length, _ = walked(
                surface, near, False, first[mesh[i]] + face[i], b1s[i], b2s[i], overs[i], body[i], step, look, above_it
            )
            if event:
                how[i] = WAITS
                keep(
                    reals, wholes, i, i, high > 0, body[i], f, b1, b2, side, c, s, heading_c, heading_s, left, way, over, turn,
                    event, edge, length, 0,
                )  # fmt: skip
                continue
            to_mesh[i], to_face[i] = mesh[i], f - first[mesh[i]]  # no edge leads to another mesh
            to_b1[i], to_b2[i], to_over[i], gone[i] = b1, b2, over * side + 0.0, way
            _put(i, finish(surface[0], WIDTH * f, b1, b2, side, c, s, heading_c, heading_s, over), place, above, ahead, direction)
    waiting, left = counted(how, reals, wholes, begin, end)
    return begin, waiting, left


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
    rooms: tuple[Array1[I64], I64, I64],
    reals: Strided2[F64],
    wholes: Strided2[I64],
    how: Array1[U8],
    placed: Placed,
    moved: Moved,
    blocked: Array1[BOOL],
    begin: I64,
    end: I64,
) -> None:
    """The same for agents that wait, from `begin` to before `end`.

    `sides` are `piece` and `way` of the topology and `cuts` the arrays of its cuts, `boxes` those of `Boxes`, `scale` least, fine
    and under of `Scale`, and its `touch`; ways end at open borders if they are to be `straight`; `rooms` has
    room for all faces in each of so many, and says how many agents wait.
    """
    table, link, forked, first = surface
    sub_first, sub_count, clear, reach, noise = near
    first_cut, _ = cuts
    to_mesh, to_face, to_b1, to_b2, to_over = placed
    place, above, ahead, direction, gone = moved
    places, count, several = rooms
    found = places, own(begin, several, count) * boxes[0].size
    for k in range(begin, end):
        event = wholes[EVENT, k]
        i = wholes[AGENT, k]
        size = reals[BODY, k]
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
                    along = WIDTH * f + EDGES + 4 * edge
                    c, s, left = along_border(table[along + EDGE_C], table[along + EDGE_S], c, s, left)
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
            f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn, event, edge, length, _ = go(
                table, link, forked, sub_first, sub_count, clear, reach, high, looked, False,
                f, b1, b2, side, c, s, heading_c, heading_s, left, way, turn,
            )  # fmt: skip
            looked = False
        how[i] = DONE
        row = WIDTH * f
        on = int(table[row + MESH])
        to_mesh[i], to_face[i] = on, f - first[on]
        to_b1[i], to_b2[i], to_over[i], gone[i], blocked[i] = b1, b2, over * side + 0.0, way, wholes[BLOCKED, k] != 0
        _put(i, finish(table, row, b1, b2, side, c, s, heading_c, heading_s, over), place, above, ahead, direction)


@inlined
def _put(
    i: I64,
    found: tuple[Vec3, Vec3, Vec3, Vec3],
    place: Array2[F64],
    above: Array2[F64],
    ahead: Array2[F64],
    direction: Array2[F64],
) -> None:
    put(place, i, found[0])
    put(above, i, found[1])
    put(ahead, i, found[2])
    put(direction, i, found[3])


@inlined
def _margin(noise: F64, body: F64) -> F64:
    """How near to its way (mm) a piece of surface must be to matter."""
    high = LIFT * body
    if not high > noise:
        high = noise
    return high + noise


@called
def keep(
    reals: Array2[F64],
    wholes: Array2[I64],
    k: I64,
    i: I64,
    near: BOOL,
    body: F64,
    f: I64,
    b1: F64,
    b2: F64,
    side: F64,
    c: F64,
    s: F64,
    heading_c: F64,
    heading_s: F64,
    left: F64,
    way: F64,
    over: F64,
    turn: I64,
    event: I64,
    edge: I64,
    length: F64,
    hops: I64,
) -> None:
    """Write down an agent that waits, who has followed so many borders: of its HOPS they are SPENT, and it is BLOCKED by any."""
    wholes[AGENT, k], wholes[SPENT, k], wholes[BLOCKED, k], wholes[NEAR, k], reals[BODY, k] = i, hops, hops > 0, near, body
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
def _rise(over: F64, level: F64, left: F64, way: F64) -> tuple[F64, F64, F64]:
    """Up or down over a border to a level (mm above the own face), as far as the way left lasts: where it leads, and the way left
    and gone."""
    most = level - over
    climb = min(abs(most), left)
    to = level if climb >= abs(most) else over + (-climb if most < 0 else climb)
    return to, left - climb, way + climb


@inlined
def _hung(table: Array1[F64], link: Array2[I32], f: I64, b1: F64, b2: F64, side: F64, c: F64, s: F64) -> tuple[I64, BOOL]:
    """The open border over which an agent steps, and whether it heads out over it."""
    weights, edge, least = (1.0 - b1 - b2, b1, b2), 0, np.inf
    for k in range(3):
        if link[1 if side < 0 else 0, 3 * f + k] == NO_LINK and weights[k] < least:
            edge, least = k, weights[k]
    row = WIDTH * f + EDGES + 4 * edge
    return edge, c * table[row + EDGE_S] - s * table[row + EDGE_C] > 0
