"""The walk of `walk` and `ground` as one loop over agents, for those who meet nothing on their way but the next face of their
own surface: same operations in the same order and so the same bits. Whoever else there is, it leaves alone."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from antdsl.runtime.senses.topology import NO_LINK, Topology
from antdsl.runtime.senses.walk import CROSSINGS, GRAIN, STUCK

Floats = NDArray[np.float64]

# Columns of the packed table: one face's numbers lie side by side, since agents stand on faces in no order.
_WIDTH = 40  # five whole lines of a cache
_AHEAD = 16  # agents whose rows are fetched at once
_CORNER, _EDGE1, _EDGE2, _NORMAL, _AXIS1, _AXIS2, _RATE1, _RATE2, _SHEAR, _EDGE_C, _EDGE_S, _SMOOTH, _LINK, _MESH = (
    0, 3, 6, 9, 12, 15, 18, 19, 20, 21, 24, 27, 36, 39,
)  # fmt: skip


def packed(table: Topology, mesh_of: NDArray[np.int32]) -> Floats:
    """All numbers of each face side by side, float64[40 m], with the links of the normal's side and the mesh it is of."""
    m = table.rate1.size
    space = np.empty(_WIDTH * m + 8)
    start = -space.ctypes.data % 64 // 8
    result = space[start : start + _WIDTH * m]
    pack(result, table, mesh_of, slice(0, m))
    return result


def pack(into: Floats, table: Topology, mesh_of: NDArray[np.int32], rows: slice) -> None:
    """Write the numbers of some faces into a packed table."""
    m = rows.stop - rows.start
    halves = slice(3 * rows.start, 3 * rows.stop)
    vectors = (table.corner, table.edge1, table.edge2, table.normal, table.axis1, table.axis2)
    parts: list[NDArray[Any]] = [v[:, rows].T for v in vectors]
    parts += [v[rows].reshape(m, 1) for v in (table.rate1, table.rate2, table.shear)]
    parts += [v[halves].reshape(m, 3) for v in (table.edge_c, table.edge_s)]
    parts += [table.smooth[:, rows].T, table.link[0, halves].reshape(m, 3), mesh_of[rows].reshape(m, 1)]
    np.concatenate(parts, axis=1, out=into.reshape(-1, _WIDTH)[rows])


@njit(cache=True, nogil=True, error_model="numpy")
def walk_all(  # type: ignore[no-untyped-def]  # numba takes the types from the call
    table, link, forked, first, sub_first, sub_count, clear, reach, slack, body, lift,
    mesh, face, b1s, b2s, wish, heading, up,
    done, to_mesh, to_face, to_b1, to_b2, place, above, ahead, direction, gone,
):  # fmt: skip
    """One step of all agents; sets `done` for those that it moved and leaves the others as they are.

    `table` is `packed`, `link` and `forked` of the topology and `first` the first face of each mesh.
    `sub_first`, `sub_count`, `clear` and `reach` are `first`, `count`, `least` and `reach` of
    `Parts`; an agent stays away from what is nearer than its way, `lift`
    of its `body` and `slack`. Then where agents stand, their wish, heading and up (3, n), and where the results go.
    """
    for i in range(done.size):
        if i % _AHEAD == 0:
            gone[i] = _touch(table, mesh, face, first, i, min(i + _AHEAD, done.size))
        done[i] = False
        if mesh[i] < 0 or face[i] < 0:
            continue
        f = first[mesh[i]] + face[i]
        wish_x, wish_y, wish_z = wish[0, i], wish[1, i], wish[2, i]
        if not np.isfinite(wish_x + wish_y + wish_z):
            continue
        row = _WIDTH * f
        along_up = up[0, i] * table[row + _NORMAL] + up[1, i] * table[row + _NORMAL + 1] + up[2, i] * table[row + _NORMAL + 2]
        side = -1.0 if along_up < 0 else 1.0
        b1, b2 = _inside(b1s[i] + 0.0, b2s[i] + 0.0)
        c, s, left = _laid_down(table, row, wish_x, wish_y, wish_z, 1.0, 0.0)
        heading_c, heading_s, _ = _laid_down(table, row, heading[0, i], heading[1, i], heading[2, i], c, s)
        high = lift * body[i]
        if not high > slack:
            high = slack
        high += slack
        if not _free(sub_first, sub_count, clear, reach, f, b1, b2) <= left + high:
            high = -np.inf  # has nothing to look out for on the whole way
        f, b1, b2, side, c, s, heading_c, heading_s, way, held_up = _walk(
            table, link, forked, sub_first, sub_count, clear, reach, high, f, b1, b2, side, c, s, heading_c, heading_s, left
        )
        if held_up or not np.isfinite(b1 + b2 + c + s + heading_c + heading_s):
            continue
        done[i] = True
        row = _WIDTH * f
        on = int(table[row + _MESH])
        to_mesh[i], to_face[i] = on, f - first[on]
        to_b1[i], to_b2[i], gone[i] = b1, b2, way
        _finish(table, row, b1, b2, side, c, s, heading_c, heading_s, i, place, above, ahead, direction)


@njit(cache=True, nogil=True, error_model="numpy")
def _touch(table, mesh, face, first, start, stop):  # type: ignore[no-untyped-def]
    """Reads what the next agents will need of the table. These reads wait for memory all at once, and not one after another."""
    total = 0.0
    for i in range(start, stop):
        if mesh[i] >= 0 and face[i] >= 0:
            row = _WIDTH * (first[mesh[i]] + face[i])
            for k in range(0, _WIDTH, 8):
                total += table[row + k]
    return total


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _inside(b1, b2):  # type: ignore[no-untyped-def]
    b1, b2 = min(max(b1, 0.0), 1.0), min(max(b2, 0.0), 1.0)
    total = b1 + b2
    if total > 1.0:
        return b1 / total, b2 / total
    return b1, b2


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _laid_down(table, row, x, y, z, c0, s0):  # type: ignore[no-untyped-def]
    c = table[row + _AXIS1] * x + table[row + _AXIS1 + 1] * y + table[row + _AXIS1 + 2] * z
    s = table[row + _AXIS2] * x + table[row + _AXIS2 + 1] * y + table[row + _AXIS2 + 2] * z
    flat = np.sqrt(c * c + s * s)
    if not flat > 1e-150:
        return c0, s0, 0.0
    return c / flat, s / flat, min(np.sqrt(x * x + y * y + z * z), 2 * flat)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _free(sub_first, sub_count, clear, reach, f, b1, b2):  # type: ignore[no-untyped-def]
    """As `Parts.of`."""
    n = sub_count[f]
    if n == 0:
        return reach
    return clear[sub_first[f] + min(int(b1 * n), n - 1) * n + min(int(b2 * n), n - 1)]


@njit(cache=True, nogil=True, error_model="numpy")
def _walk(  # type: ignore[no-untyped-def]
    table, link, forked, sub_first, sub_count, clear, reach, high, f, b1, b2, side, c, s, heading_c, heading_s, left
):
    """Across faces until the way is used up; the last value says that an open border was met instead, or a stretch within
    whose length and `high` there may be another piece."""
    gone = 0.0
    for turn in range(CROSSINGS):
        if not left > 0:
            break
        if turn >= STUCK and turn % STUCK == 0:
            b1 = b1 * (1 - GRAIN) + GRAIN / 3
            b2 = b2 * (1 - GRAIN) + GRAIN / 3
        row = _WIDTH * f
        rate1 = c * table[row + _RATE1] - s * table[row + _SHEAR]
        rate2 = s * table[row + _RATE2]
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
        if high > 0 and _free(sub_first, sub_count, clear, reach, f, b1, b2) <= length + high:
            return f, b1, b2, side, c, s, heading_c, heading_s, gone, True
        b1, b2 = _inside(b1 + rate1 * length, b2 + rate2 * length)
        gone += length
        if until >= left:
            break
        left = left - length
        beyond = link[1, 3 * f + edge] if forked and side < 0 else int(table[row + _LINK + edge])
        if beyond == NO_LINK:
            return f, b1, b2, side, c, s, heading_c, heading_s, gone, True
        f, b1, b2, side, c, s, heading_c, heading_s = _cross(table, row, beyond, edge, b1, b2, side, c, s, heading_c, heading_s)
    return f, b1, b2, side, c, s, heading_c, heading_s, gone, False


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cross(table, row, beyond, edge, b1, b2, side, c, s, heading_c, heading_s):  # type: ignore[no-untyped-def]
    """Into the face beyond an edge."""
    f, k2, flip = np.int64(beyond >> 3), (beyond >> 1) & 3, (beyond & 1) == 1
    b0 = 1.0 - b1 - b2
    first = b1 if edge == 0 else (b2 if edge == 1 else b0)
    second = b2 if edge == 0 else (b0 if edge == 1 else b1)
    if not flip:
        first, second = second, first
    there = _WIDTH * f
    c1, s1 = table[row + _EDGE_C + edge], table[row + _EDGE_S + edge]
    c2, s2 = table[there + _EDGE_C + k2], table[there + _EDGE_S + k2]
    turn = 1.0 if flip else -1.0
    along, out = turn * (c * c1 + s * s1), c * s1 - s * c1
    c, s = along * c2 - out * s2, along * s2 + out * c2
    along, out = turn * (heading_c * c1 + heading_s * s1), heading_c * s1 - heading_s * c1
    heading_c, heading_s = along * c2 - out * s2, along * s2 + out * c2
    b1 = max(first if k2 == 0 else (0.0 if k2 == 1 else second), 0.0)
    b2 = max(second if k2 == 0 else (first if k2 == 1 else 0.0), 0.0)
    return f, b1, b2, -side if flip else side, c, s, heading_c, heading_s


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _finish(table, row, b1, b2, side, c, s, heading_c, heading_s, i, place, above, ahead, direction):  # type: ignore[no-untyped-def]
    """Place, smooth normal, transported heading and direction of travel in space."""
    b0 = 1.0 - b1 - b2
    sx = table[row + _SMOOTH] * b0 + table[row + _SMOOTH + 3] * b1 + table[row + _SMOOTH + 6] * b2
    sy = table[row + _SMOOTH + 1] * b0 + table[row + _SMOOTH + 4] * b1 + table[row + _SMOOTH + 7] * b2
    sz = table[row + _SMOOTH + 2] * b0 + table[row + _SMOOTH + 5] * b1 + table[row + _SMOOTH + 8] * b2
    size = np.sqrt(max(sx * sx + sy * sy + sz * sz, 1e-300))
    sx, sy, sz = sx / size * side, sy / size * side, sz / size * side
    nx, ny, nz = table[row + _NORMAL] * side, table[row + _NORMAL + 1] * side, table[row + _NORMAL + 2] * side
    hx = table[row + _AXIS1] * heading_c + table[row + _AXIS2] * heading_s
    hy = table[row + _AXIS1 + 1] * heading_c + table[row + _AXIS2 + 1] * heading_s
    hz = table[row + _AXIS1 + 2] * heading_c + table[row + _AXIS2 + 2] * heading_s
    hx, hy, hz = _turned(hx, hy, hz, nx, ny, nz, sx, sy, sz)
    off = hx * sx + hy * sy + hz * sz
    hx, hy, hz = hx - off * sx, hy - off * sy, hz - off * sz
    size = np.sqrt(hx * hx + hy * hy + hz * hz)
    ahead[0, i], ahead[1, i], ahead[2, i] = hx / size, hy / size, hz / size
    above[0, i], above[1, i], above[2, i] = sx, sy, sz
    for k in range(3):
        place[k, i] = table[row + _CORNER + k] + b1 * table[row + _EDGE1 + k] + b2 * table[row + _EDGE2 + k]
        direction[k, i] = table[row + _AXIS1 + k] * c + table[row + _AXIS2 + k] * s


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
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
