"""What `Around` looks for, for one walker at a time: same operations in the same order and so the same bits."""

from __future__ import annotations

import numpy as np

from antdsl.runtime.compiling import njit
from antdsl.runtime.senses.boxes_compiled import first_met
from antdsl.runtime.senses.packing import AXIS1, AXIS2, CORNER, EDGE1, EDGE2, EDGE_C, EDGE_S, NORMAL, WIDTH
from antdsl.runtime.senses.surroundings import DEEP, FARTHEST, GAP, HIGH, LIFT, TURNED
from antdsl.runtime.senses.vectors_compiled import at, dot, inside, level, minus, more, plus, times, turned


@njit(cache=True, nogil=True, error_model="numpy")
def other_ahead(table, sides, boxes, scale, body, f, b1, b2, side, c, s, length):  # type: ignore[no-untyped-def]
    """As `Around._other`: the face met (-1 for none), weights, side to walk on, way gone."""
    pieces, _ = sides
    noise, fine, under = scale
    row, piece = WIDTH * f, pieces[f]
    place, up, way = stand(table, row, b1, b2, side), times(at(table, row + NORMAL), side), _in_space(table, row, c, s)
    high = more(LIFT * body, noise)
    roof, part, _, _ = _first(table, pieces, boxes, place, times(up, high), fine, -1, piece)
    if roof >= 0 and (dot(at(table, WIDTH * roof + NORMAL), up) < 0 or high * part > under):
        high = high * part / 2
    eye, step = plus(place, times(up, high)), times(way, length)
    face, part, one, two = _first(table, pieces, boxes, eye, step, fine, -1, piece)
    gone, towards = length, way
    if face >= 0:
        gone = min(part, 1.0) * length
    else:
        towards = times(up, -high)
        face, _, one, two = _first(table, pieces, boxes, plus(eye, step), towards, 0.0, -1, piece)
    if face < 0:
        return face, 0.0, 0.0, 1.0, length
    one, two = inside(one + 0.0, two + 0.0)
    return face, one, two, _side(table, face, towards), gone


@njit(cache=True, nogil=True, error_model="numpy")
def beyond(table, sides, boxes, scale, body, f, edge, b1, b2, side):  # type: ignore[no-untyped-def]
    """As `Around.beyond`: the face stepped over to (-1 for none), weights, side, way gone on its level, and how high that is."""
    pieces, _ = sides
    noise, fine, _ = scale
    row = WIDTH * f
    place, up = stand(table, row, b1, b2, side), times(at(table, row + NORMAL), side)
    out = _in_space(table, row, table[row + EDGE_S + edge], -table[row + EDGE_C + edge])
    body = more(body, 2 * noise)
    gap, high = GAP * body, HIGH * body
    most, across = high, times(out, gap)
    roof, part, _, _ = _first(table, pieces, boxes, plus(place, times(up, fine)), times(up, high - fine), 0.0, f, -1)
    if roof >= 0:
        high = (fine + part * (high - fine)) / 2
    if _first(table, pieces, boxes, plus(place, times(up, high)), across, 0.0, f, -1)[0] >= 0:
        high = min(high, more(LIFT * body, fine))
        face, part, one, two = _first(table, pieces, boxes, plus(place, times(up, high)), across, 0.0, f, -1)
        if face >= 0:
            return _leading(table, sides, f, side, up, face, one, two, out, gap * min(part, 1.0), high)
    over, fall = plus(place, across), times(up, -(high + most))
    face, part, one, two = _first(table, pieces, boxes, plus(over, times(up, high)), fall, 0.0, f, -1)
    height = -most
    if face >= 0:
        height = high - part * (high + most)
        found = _leading(table, sides, f, side, up, face, one, two, fall, gap, height)
        if found[0] >= 0:
            return found
    back = times(out, -2 * gap)
    for deep in (GAP * body, DEEP * body):
        if height < -deep:
            face, part, one, two = _first(table, pieces, boxes, minus(over, times(up, deep)), back, 0.0, f, -1)
            if face >= 0:
                gone = abs(gap - part * (2 * gap))
                return _leading(table, sides, f, side, up, face, one, two, back, gone, -deep)
    return -1, 0.0, 0.0, 1.0, 0.0, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def landed(table, f, side, c, s, heading_c, heading_s, to, to_side):  # type: ignore[no-untyped-def]
    """As `walk._land`: direction and heading in the frame of the face `to`."""
    row, there = WIDTH * f, WIDTH * to
    before, after = times(at(table, row + NORMAL), side), times(at(table, there + NORMAL), to_side)
    direction = _in_space(table, row, c, s)
    way = turned(direction, before, after, direction)
    heading = turned(_in_space(table, row, heading_c, heading_s), before, after, direction)
    axis1, axis2 = at(table, there + AXIS1), at(table, there + AXIS2)
    c, s = level(dot(axis1, way), dot(axis2, way))
    heading_c, heading_s = level(dot(axis1, heading), dot(axis2, heading))
    return c, s, heading_c, heading_s


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def stand(table, row, b1, b2, side):  # type: ignore[no-untyped-def]
    """Place on a face."""
    return plus(plus(at(table, row + CORNER), times(at(table, row + EDGE1), b1)), times(at(table, row + EDGE2), b2))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _in_space(table, row, c, s):  # type: ignore[no-untyped-def]
    return plus(times(at(table, row + AXIS1), c), times(at(table, row + AXIS2), s))


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _side(table, face, towards):  # type: ignore[no-untyped-def]
    return -1.0 if dot(at(table, WIDTH * face + NORMAL), towards) > 0 else 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def _first(table, pieces, boxes, origin, step, fine, face, piece):  # type: ignore[no-untyped-def]
    over = min(fine / max(np.sqrt(dot(step, step)), 1e-300), FARTHEST)
    return first_met(table, pieces, boxes, origin, step, over, face, piece)


@njit(cache=True, nogil=True, error_model="numpy")
def _leading(table, sides, f, side, up, face, b1, b2, towards, gone, rise):  # type: ignore[no-untyped-def]
    """As `Around._leads` and `_landing`."""
    pieces, ways = sides
    there = _side(table, face, towards)
    here, other = 1 if side < 0 else 0, 1 if there < 0 else 0
    alike = pieces[f] != pieces[face] or ways[here, f] == ways[other, face]
    if not (alike and dot(times(at(table, WIDTH * face + NORMAL), there), up) > TURNED):
        return -1, 0.0, 0.0, 1.0, 0.0, 0.0
    b1, b2 = inside(b1 + 0.0, b2 + 0.0)
    return face, b1, b2, there, gone, rise
