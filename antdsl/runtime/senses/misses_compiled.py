"""Rays that surely meet nothing: what walkers have around them, tested without casting any. The walk's kernels are compiled with
what stands here, and so anew when it changes (`compiling`)."""

from __future__ import annotations

import numpy as np

from antdsl.runtime.compiling import njit
from antdsl.runtime.senses.packing import AXIS1, AXIS2, CORNER, EDGE1, EDGE2, EDGE_C, EDGE_S, NORMAL, WIDTH
from antdsl.runtime.senses.surroundings import DEEP, GAP, HIGH

_THIN = 0.05  # of its longest side: the height of triangles whose normal float32 cannot tell
_SLIM = 1e-4  # sine of the angle between a ray and an edge, below which their common normal is not used


@njit(cache=True, nogil=True, error_model="numpy")
def nothing_ahead(table, lists, noise, margin, body, lift, f, b1, b2, side, c, s, length):  # type: ignore[no-untyped-def]
    """Whether the rays of `Around.ahead` surely meet no other piece."""
    starts, counts, members = lists
    if not (body >= 0 and counts[f] >= 0):
        return False
    place, up, way = _stand(table, WIDTH * f, b1, b2, side, c, s)
    rise = _times(up, max(lift * body, noise))
    eye, step = _plus(place, rise), _times(way, length)
    end = _plus(place, step)
    for k in range(starts[f], starts[f] + counts[f]):
        row = WIDTH * members[k]
        if not (missed(table, row, place, rise, margin) and missed(table, row, eye, step, margin)):
            return False
        if not missed(table, row, end, rise, margin):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy")
def nothing_beyond(table, lists, noise, margin, body, f, edge, b1, b2, side):  # type: ignore[no-untyped-def]
    """Whether the rays of `Around.beyond` surely meet no face but the agent's own."""
    starts, counts, members = lists
    if not (body >= 0 and counts[f] >= 0):
        return False
    row = WIDTH * f
    place, up, out = _stand(table, row, b1, b2, side, table[row + EDGE_S + edge], -table[row + EDGE_C + edge])
    body = max(body, 2 * noise)
    gap, high = max(GAP * body, noise), HIGH * body
    over, rise = _times(out, gap), _times(up, high)
    above, below, back = _plus(place, rise), _plus(place, over), _times(out, -2 * gap)
    start, room = _plus(place, _times(up, min(noise, high / 2))), _times(up, high - min(noise, high / 2))
    top, fall = _plus(below, rise), _times(up, -2 * high)
    little, deep = _plus(below, _times(up, -gap)), _plus(below, _times(up, -DEEP * body))
    for k in range(starts[f], starts[f] + counts[f]):
        row = WIDTH * members[k]
        if not (missed(table, row, start, room, margin) and missed(table, row, above, over, margin)):
            return False
        if not (missed(table, row, top, fall, margin) and missed(table, row, little, back, margin)):
            return False
        if not missed(table, row, deep, back, margin):
            return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _stand(table, row, b1, b2, side, c, s):  # type: ignore[no-untyped-def]
    """Place, normal on the agent's side and direction of travel."""
    place = _plus(_at(table, row + CORNER), _plus(_times(_at(table, row + EDGE1), b1), _times(_at(table, row + EDGE2), b2)))
    way = _plus(_times(_at(table, row + AXIS1), c), _times(_at(table, row + AXIS2), s))
    return place, _times(_at(table, row + NORMAL), side), way


@njit(cache=True, nogil=True, error_model="numpy")
def missed(table, row, origin, step, margin):  # type: ignore[no-untyped-def]
    """Whether a ray from `origin` by `step` surely passes a triangle, `margin` mm away or more: whether an axis parts the two
    (Ericson, Real-Time Collision Detection, 2005, p. 156-159). False where that is not sure."""
    edge1, edge2 = _at(table, row + EDGE1), _at(table, row + EDGE2)
    a = _plus(_at(table, row + CORNER), _times(origin, -1.0))
    b, c = _plus(a, edge1), _plus(a, edge2)
    edge3 = _plus(edge2, _times(edge1, -1.0))
    square = _dot(step, step)
    far = margin * np.sqrt(square)
    low, high = _span(_dot(a, step), _dot(b, step), _dot(c, step))
    if square > 0 and (high < -far or low > square + far):
        return True
    longest = max(_dot(edge1, edge1), _dot(edge2, edge2), _dot(edge3, edge3))
    normal = _cross3(edge1, edge2)
    size = np.sqrt(_dot(normal, normal))
    if size > _THIN * longest:
        height, rise, far = _dot(normal, a), _dot(normal, step), margin * size
        if height > max(rise, 0.0) + far or height < min(rise, 0.0) - far:
            return True
    for edge in (edge1, edge2, edge3):
        axis = _cross3(step, edge)
        size = np.sqrt(_dot(axis, axis))
        if size > _SLIM * np.sqrt(square * _dot(edge, edge)):
            low, high = _span(_dot(axis, a), _dot(axis, b), _dot(axis, c))
            if low > margin * size or high < -margin * size:
                return True
    return False


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _span(a, b, c):  # type: ignore[no-untyped-def]
    return min(a, b, c), max(a, b, c)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _at(table, k):  # type: ignore[no-untyped-def]
    return table[k], table[k + 1], table[k + 2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _plus(a, b):  # type: ignore[no-untyped-def]
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _times(a, factor):  # type: ignore[no-untyped-def]
    return a[0] * factor, a[1] * factor, a[2] * factor


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cross3(a, b):  # type: ignore[no-untyped-def]
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
