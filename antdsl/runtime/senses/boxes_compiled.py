"""`boxes.first_met` for one way at a time, for compiled walks: same operations in the same order and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.runtime.compiling import njit
from antdsl.runtime.senses.boxes import EDGE, LEVEL, WIDE
from antdsl.runtime.senses.packing import CORNER, EDGE1, EDGE2, WIDTH
from antdsl.runtime.senses.vectors_compiled import at, cross, dot, minus

_DEEP = 128  # boxes that wait to be opened: more than trees of 2**40 triangles ever need


@njit(cache=True, nogil=True, error_model="numpy")
def first_met(table, pieces, boxes, origin, step, over, face, piece):  # type: ignore[no-untyped-def]
    """The first triangle met, after what part of the way, and its weights there. `table` is `packed`, `pieces` those of the
    faces, `boxes` the arrays of `Boxes`."""
    order, first, bounds = boxes
    found, part, b1, b2 = -1, np.inf, 0.0, 0.0
    if order.size == 0:
        return found, part, b1, b2
    long = 1.0 + over
    end_x, end_y, end_z = origin[0] + step[0] * long, origin[1] + step[1] * long, origin[2] + step[2] * long
    low_x, low_y, low_z = min(origin[0], end_x), min(origin[1], end_y), min(origin[2], end_z)
    high_x, high_y, high_z = max(origin[0], end_x), max(origin[1], end_y), max(origin[2], end_z)
    square = dot(step, step)
    levels, nodes = np.empty(_DEEP, np.int64), np.empty(_DEEP, np.int64)
    levels[0], nodes[0], waiting = first.size - 2, 0, 1
    while waiting:
        waiting -= 1
        level, node = levels[waiting], nodes[waiting]
        b = first[level] + node
        if bounds[b, 0] > high_x or bounds[b, 3] < low_x or bounds[b, 1] > high_y or bounds[b, 4] < low_y:
            continue
        if bounds[b, 2] > high_z or bounds[b, 5] < low_z:
            continue
        if level > 0:
            for child in range(WIDE * node, min(WIDE * node + WIDE, first[level] - first[level - 1])):
                levels[waiting], nodes[waiting] = level - 1, child
                waiting += 1
            continue
        for k in range(WIDE * node, min(WIDE * node + WIDE, order.size)):
            f = order[k]
            if f == face or pieces[f] == piece:
                continue
            row = WIDTH * f
            e1, e2, s = at(table, row + EDGE1), at(table, row + EDGE2), minus(origin, at(table, row + CORNER))
            p = cross(step, e2)
            det = dot(e1, p)
            if abs(det) <= LEVEL * np.sqrt(square * dot(e1, e1) * dot(e2, e2)):
                continue
            q = cross(s, e1)
            u, v, t = dot(s, p) / det, dot(step, q) / det, dot(e2, q) / det
            hit = u >= -EDGE and v >= -EDGE and u + v <= 1.0 + EDGE and t >= 0 and t <= long
            if hit and (t < part or (t == part and f < found)):
                found, part, b1, b2 = f, t, u, v
    return found, part, b1, b2
