"""The walk of `walking` as one loop over agents: same operations, same order, same bits. Imported only where wanted."""

from __future__ import annotations

import numpy as np

from antdsl.ground.solid.projecting import FLAT, SETTLING
from antdsl.ground.solid.trilinear import LEAN
from antdsl.ground.solid.walk_rules import BACK, BISECTIONS, CROSSINGS, DONE, EDGE, FARTHER, LEAST, NEWTON, OFF, STRIDE, THIN
from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, Array3, called, inlined, kernel
from antdsl.numerics.vectors_compiled import cross, dot

Bricks = tuple[Array1[I32], Array1[F32], F64, F64, F64, F64, I64, I64, I64]  # table, values, origin, voxel and shape
Vectors = Array2[F64]

_AHEAD = 16  # agents whose cells are fetched from memory at once


@kernel
def walk_all(
    bricks: Bricks,
    points: Vectors,
    steps: Vectors,
    heading: Vectors,
    up: Vectors,
    close: Array1[F64],
    lean: Array1[F64],
    found: Array3[F64],
    gone: Array1[F64],
    blocked: Array1[BOOL],
    lost: Array1[BOOL],
) -> None:
    """Move all agents. (3, n) where they stand, their steps, headings and up, how near to stay and how far around their normals
    look; then where results go: place, up, heading and direction (4, 3, n), how far, and whether blocked or lost."""
    table, values = bricks[:2]
    grid = bricks[2:]
    for i in range(gone.size):
        if i % _AHEAD == 0:
            gone[i] = _touch(table, values, grid, points, i, min(i + _AHEAD, gone.size))
        start = (points[0, i], points[1, i], points[2, i])
        before = (up[0, i], up[1, i], up[2, i])
        head = (heading[0, i], heading[1, i], heading[2, i])
        wish = (steps[0, i], steps[1, i], steps[2, i])
        if not np.isfinite(wish[0] + wish[1] + wish[2]):
            wish = (0.0, 0.0, 0.0)
        normal = _unit(_smooth(table, values, grid, LEAN, start), before)
        wish = _turned(wish, before, normal, head)
        p, n, way, gone[i], blocked[i], lost[i] = _walk(table, values, grid, start, normal, wish, close[i])
        slope = _smooth(table, values, grid, lean[i], p)
        stood = _unit(slope, n) if dot(slope, slope) > THIN * THIN else n
        head, _ = _laid(_turned(head, before, stood, head), stood)
        way, _ = _laid(_turned(way, n, stood, way), stood)
        for k in range(3):
            found[0, k, i], found[1, k, i], found[2, k, i], found[3, k, i] = p[k], stood[k], head[k], way[k]


@called
def _touch(table, values, grid, points, first, last):  # type: ignore[no-untyped-def]
    """Read around the places of some agents, one read not waiting for the other; the sum says nothing."""
    total = 0.0
    for i in range(first, last):
        a, b, _ = _corners(table, values, grid, (points[0, i], points[1, i], points[2, i]))
        total += (a[0] + a[2]) + (b[0] + b[2])
    return total


@called
def _walk(table, values, grid, p, n, wish, close):  # type: ignore[no-untyped-def]
    """All steps of one agent: its place, normal and way, how far it went, and whether it is blocked or lost."""
    voxel = grid[3]
    way, flat = _laid(wish, n)
    left = min(np.sqrt(dot(wish, wish)), 2 * flat)
    stride, walked = STRIDE, 0.0
    settled, blocked = False, False
    if not left > 0:
        found, p, after = _settle(table, values, grid, p, n, close)
        if not found:
            return p, n, way, walked, False, True
        way = _turn(way, n, after)
        return p, after, way, walked, False, False
    for _ in range(CROSSINGS):
        if not left > 0:
            break
        length = min(left, stride * voxel)
        q, g, d = _onto(table, values, grid, p, n, way, length, close)
        after = _unit(g, n)
        middle = _distance(table, values, grid, ((p[0] + q[0]) * 0.5, (p[1] + q[1]) * 0.5, (p[2] + q[2]) * 0.5))
        went = (q[0] - p[0], q[1] - p[1], q[2] - p[2])
        far = FARTHER * length
        good = dot(went, went) <= far * far and abs(d) <= close and abs(middle) <= OFF * voxel
        if good and (length <= EDGE * voxel or dot(after, n) > BACK):
            way = _turn(way, n, after)
            p, n = q, after
            rest = left - length
            left = rest if rest > DONE * voxel else 0.0
            walked += length
            stride = min(stride * 2, STRIDE)
            settled, blocked = True, False
        elif not settled:
            found, p, after = _settle(table, values, grid, p, n, close)
            if not found:
                return p, n, way, walked, blocked, True
            way = _turn(way, n, after)
            n = after
            settled = True
        else:
            stride = length * (0.5 / voxel)
            if stride < LEAST:
                if blocked:
                    break
                beyond = 2 * LEAST * voxel
                _, g = _field(table, values, grid, (p[0] + way[0] * beyond, p[1] + way[1] * beyond, p[2] + way[2] * beyond))
                after = _unit(g, n)
                way = _turn(way, n, after)
                n = after
                stride, blocked = EDGE, True
    return p, n, way, walked, blocked, False


@called
def _onto(table, values, grid, p, n, way, length, close):  # type: ignore[no-untyped-def]
    voxel = grid[3]
    far = (p[0] + way[0] * length, p[1] + way[1] * length, p[2] + way[2] * length)
    q = far
    d, g = _field(table, values, grid, q)
    beyond = d > 0
    limit = 0.5 * voxel
    for _ in range(NEWTON):
        if not abs(d) > close:
            return q, g, d
        square = max(dot(g, g), 1e-4)
        step = -d / square
        size = abs(step) * np.sqrt(square)
        if size > limit:
            step = step * (limit / max(size, limit))
        q = (q[0] + step * g[0], q[1] + step * g[1], q[2] + step * g[2])
        d, g = _field(table, values, grid, q)
    part = 0.5
    while abs(d) > close and part > 1e-4:
        depth = (-part if beyond else part) * length
        near = (p[0] + depth * n[0], p[1] + depth * n[1], p[2] + depth * n[2])
        if (_distance(table, values, grid, near) > 0) != beyond:
            for _ in range(BISECTIONS):
                q = ((near[0] + far[0]) * 0.5, (near[1] + far[1]) * 0.5, (near[2] + far[2]) * 0.5)
                d, g = _field(table, values, grid, q)
                if not abs(d) > close:
                    break
                if (d > 0) == beyond:
                    far = q
                else:
                    near = q
            break
        part = part * 0.2
    return q, g, d


@called
def _settle(table, values, grid, p, hint, close):  # type: ignore[no-untyped-def]
    """As `projecting.settle`: whether the surface was found, the place and the normal; those given where not."""
    voxel = grid[3]
    q = p
    if not np.isfinite(p[0] + p[1] + p[2]):
        return False, p, hint
    for turn in range(SETTLING):
        d, g = _field(table, values, grid, q)
        square = dot(g, g)
        if abs(d) <= close:
            if square > 0:
                size = np.sqrt(square)
                return True, q, (g[0] / size, g[1] / size, g[2] / size)
            return True, q, hint
        flat = square < FLAT or turn % 3 == 2
        step = -d if flat else -d / square
        length = abs(step) * np.sqrt(square)
        if not (flat or length <= voxel):
            step = step * (voxel / length)
        ahead = hint if flat else g
        q = (q[0] + step * ahead[0], q[1] + step * ahead[1], q[2] + step * ahead[2])
    return False, p, hint


@inlined
def _turn(way, before, after):  # type: ignore[no-untyped-def]
    way, _ = _laid(_turned(way, before, after, way), after)
    return way


@called
def _turned(v, before, after, way):  # type: ignore[no-untyped-def]
    cosine = dot(before, after)
    if cosine < -1 + 1e-9:
        hinge = cross(before, way)
        twice = 2 * dot(hinge, v)
        return (twice * hinge[0] - v[0], twice * hinge[1] - v[1], twice * hinge[2] - v[2])
    axis = cross(before, after)
    part = dot(axis, v) / (1.0 + cosine)
    swept = cross(axis, v)
    return (
        cosine * v[0] + swept[0] + part * axis[0],
        cosine * v[1] + swept[1] + part * axis[1],
        cosine * v[2] + swept[2] + part * axis[2],
    )


@called
def _laid(v, normal):  # type: ignore[no-untyped-def]
    along = dot(v, normal)
    flat = (v[0] - along * normal[0], v[1] - along * normal[1], v[2] - along * normal[2])
    size = np.sqrt(dot(flat, flat))
    if size > 1e-9:
        return (flat[0] / size, flat[1] / size, flat[2] / size), size
    axis = (0.0, 1.0, 0.0) if abs(normal[0]) > 0.9 else (1.0, 0.0, 0.0)
    off = dot(axis, normal)
    side = (axis[0] - off * normal[0], axis[1] - off * normal[1], axis[2] - off * normal[2])
    size = np.sqrt(dot(side, side))
    return (side[0] / size, side[1] / size, side[2] / size), 0.0


@inlined
def _unit(v, otherwise):  # type: ignore[no-untyped-def]
    size = np.sqrt(dot(v, v))
    if not size > 1e-6:
        return otherwise
    over = 1.0 / size
    return (v[0] * over, v[1] * over, v[2] * over)


@called
def _smooth(table, values, grid, lean, p):  # type: ignore[no-untyped-def]
    a = lean * grid[3]
    scale = 0.5 / a
    x, y, z = p
    return (
        (_distance(table, values, grid, (x + a, y, z)) - _distance(table, values, grid, (x - a, y, z))) * scale,
        (_distance(table, values, grid, (x, y + a, z)) - _distance(table, values, grid, (x, y - a, z))) * scale,
        (_distance(table, values, grid, (x, y, z + a)) - _distance(table, values, grid, (x, y, z - a))) * scale,
    )


@inlined
def _rim(place, low, over, nodes):  # type: ignore[no-untyped-def]
    """The node below a place along one axis, and how far it is beyond."""
    at = (place - low) * over
    at = at if at >= 0.0 else 0.0
    at = min(at, nodes - 1.0)
    node = min(np.int64(at), nodes - 2)
    return node, at - node


@inlined
def _corners(table, values, grid, p):  # type: ignore[no-untyped-def]
    over = 1.0 / grid[3]
    i, fx = _rim(p[0], grid[0], over, grid[4] * 16)
    j, fy = _rim(p[1], grid[1], over, grid[5] * 16)
    k, fz = _rim(p[2], grid[2], over, grid[6] * 16)
    i1, j1, k1 = i + 1, j + 1, k + 1
    bx0, bx1 = (i >> 4) * grid[5] * grid[6], (i1 >> 4) * grid[5] * grid[6]
    by0, by1 = (j >> 4) * grid[6], (j1 >> 4) * grid[6]
    bz0, bz1 = k >> 4, k1 >> 4
    x0, x1, y0, y1, z0, z1 = (i & 15) << 8, (i1 & 15) << 8, (j & 15) << 4, (j1 & 15) << 4, k & 15, k1 & 15
    return (
        (
            _node(table, values, bx0 + by0 + bz0, x0 + y0 + z0), _node(table, values, bx0 + by0 + bz1, x0 + y0 + z1),
            _node(table, values, bx0 + by1 + bz0, x0 + y1 + z0), _node(table, values, bx0 + by1 + bz1, x0 + y1 + z1),
        ),
        (
            _node(table, values, bx1 + by0 + bz0, x1 + y0 + z0), _node(table, values, bx1 + by0 + bz1, x1 + y0 + z1),
            _node(table, values, bx1 + by1 + bz0, x1 + y1 + z0), _node(table, values, bx1 + by1 + bz1, x1 + y1 + z1),
        ),
        (fx, fy, fz),
    )  # fmt: skip


@inlined
def _node(table, values, brick, place):  # type: ignore[no-untyped-def]
    return np.float64(values[(table[brick] << 12) + place])


@inlined
def _distance(table, values, grid, p):  # type: ignore[no-untyped-def]
    a, b, f = _corners(table, values, grid, p)
    v00, v01 = a[0] + (a[1] - a[0]) * f[2], a[2] + (a[3] - a[2]) * f[2]
    v10, v11 = b[0] + (b[1] - b[0]) * f[2], b[2] + (b[3] - b[2]) * f[2]
    v0, v1 = v00 + (v01 - v00) * f[1], v10 + (v11 - v10) * f[1]
    return v0 + (v1 - v0) * f[0]


@called
def _field(table, values, grid, p):  # type: ignore[no-untyped-def]
    a, b, f = _corners(table, values, grid, p)
    d00, d01, d10, d11 = a[1] - a[0], a[3] - a[2], b[1] - b[0], b[3] - b[2]
    v00, v01, v10, v11 = a[0] + d00 * f[2], a[2] + d01 * f[2], b[0] + d10 * f[2], b[2] + d11 * f[2]
    e0, e1 = v01 - v00, v11 - v10
    v0, v1 = v00 + e0 * f[1], v10 + e1 * f[1]
    gx = v1 - v0
    scale = 1.0 / grid[3]
    z0, z1 = d00 + (d01 - d00) * f[1], d10 + (d11 - d10) * f[1]
    return v0 + gx * f[0], (gx * scale, (e0 + (e1 - e0) * f[0]) * scale, (z0 + (z1 - z0) * f[0]) * scale)
