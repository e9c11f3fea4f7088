"""`boxes.first_met` for compiled walks, in two parts: triangles near to where a walker looks, and of these the first on a way.
Same operations in the same order and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.ground.mesh.boxes import EDGE, FARTHEST, LEVEL, WIDE
from antdsl.ground.mesh.face_table import CORNER, EDGE1, EDGE2, WIDTH
from antdsl.machine_code.kernels import F64, I64, Array1, Array2, called, fetch_ahead, inlined, scratch
from antdsl.numerics.vectors_compiled import at, cross, dot, minus

Tree = tuple[Array1[I64], Array1[I64], Array2[F64]]  # order, first and bounds of `Boxes`
_DEEP = 128  # boxes that wait to be opened: more than trees of 2**40 triangles ever need


@called
def gather(pieces, boxes, one, two, size, face, piece, found):  # type: ignore[no-untyped-def]
    """Writes into `found`, an array and where in it to begin, the places in the order of all triangles, but `face` and those of
    `piece`, whose boxes overlap a box: that around the points `one` and `two`, `size` mm larger. Returns how many. `boxes` are
    the arrays of `Boxes`."""
    order, first, bounds = boxes
    places, behind = found
    count, waiting = 0, 0
    low_x, low_y, low_z = min(one[0], two[0]) - size, min(one[1], two[1]) - size, min(one[2], two[2]) - size
    high_x, high_y, high_z = max(one[0], two[0]) + size, max(one[1], two[1]) + size, max(one[2], two[2]) + size
    levels, nodes = scratch(_DEEP, I64), scratch(_DEEP, I64)
    if order.size:
        levels[0], nodes[0], waiting = first.size - 2, 0, 1
    while waiting:
        waiting -= 1
        level, node = levels[waiting], nodes[waiting]
        for child in range(node, min(node + WIDE, first[level + 1] - first[level])):
            b = first[level] + child
            if _apart(bounds, b, low_x, low_y, low_z, high_x, high_y, high_z):
                continue
            if level > 0:
                levels[waiting], nodes[waiting] = level - 1, WIDE * child
                waiting += 1
                for line in (0, 8, 16):
                    fetch_ahead(bounds, 6 * (first[level - 1] + WIDE * child) + line)
            elif order[child] != face and pieces[order[child]] != piece:
                places[behind + count] = child
                count += 1
    return count


@called
def first_of(table, boxes, found, count, origin, step, fine):  # type: ignore[no-untyped-def]
    """The first triangle met of the first `count` in `found`, after what part of a way that goes on by `fine` mm, and its weights
    there. `table` is `packed`."""
    order, _, bounds = boxes
    places, behind = found
    face, part, b1, b2 = -1, np.inf, 0.0, 0.0
    if count == 0:
        return face, part, b1, b2
    square = dot(step, step)
    long = 1.0 + min(fine / max(np.sqrt(square), 1e-300), FARTHEST)
    end_x, end_y, end_z = origin[0] + step[0] * long, origin[1] + step[1] * long, origin[2] + step[2] * long
    low_x, low_y, low_z = min(origin[0], end_x), min(origin[1], end_y), min(origin[2], end_z)
    high_x, high_y, high_z = max(origin[0], end_x), max(origin[1], end_y), max(origin[2], end_z)
    for k in range(count):
        b = places[behind + k]
        if _apart(bounds, b, low_x, low_y, low_z, high_x, high_y, high_z):
            continue
        f = order[b]
        row = WIDTH * f
        e1, e2, s = at(table, row + EDGE1), at(table, row + EDGE2), minus(origin, at(table, row + CORNER))
        p = cross(step, e2)
        det = dot(e1, p)
        if abs(det) <= LEVEL * np.sqrt(square * dot(e1, e1) * dot(e2, e2)):
            continue
        q = cross(s, e1)
        u, v, t = dot(s, p) / det, dot(step, q) / det, dot(e2, q) / det
        hit = u >= -EDGE and v >= -EDGE and u + v <= 1.0 + EDGE and t >= 0 and t <= long
        if hit and (t < part or (t == part and f < face)):
            face, part, b1, b2 = f, t, u, v
    return face, part, b1, b2


@inlined
def _apart(bounds, b, low_x, low_y, low_z, high_x, high_y, high_z):  # type: ignore[no-untyped-def]
    """Whether a box does not overlap another one: asked along all axes at once, as one of the answers is as likely as another."""
    x = (bounds[b, 0] > high_x) | (bounds[b, 3] < low_x)
    y = (bounds[b, 1] > high_y) | (bounds[b, 4] < low_y)
    return x | y | (bounds[b, 2] > high_z) | (bounds[b, 5] < low_z)
