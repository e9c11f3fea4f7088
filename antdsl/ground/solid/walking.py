"""Walking on a solid: short steps along the tangent, each put back on the zero level, headings turned as the normal turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Floats, Footing, Index, Move
from antdsl.ground.solid.bricks import Bricks
from antdsl.ground.solid.projecting import CLOSE, settle
from antdsl.ground.solid.trilinear import LEAN, distance, field, smooth
from antdsl.ground.solid.volume import Volume
from antdsl.ground.solid.walk_rules import (
    BACK,
    BISECTIONS,
    CROSSINGS,
    DONE,
    EDGE,
    FARTHER,
    LEAST,
    NEWTON,
    OFF,
    STANCE,
    STRIDE,
    THIN,
)
from antdsl.numerics import compiled
from antdsl.numerics.vectors import Vector, cross, dot, unit

Columns = list[Floats]
Found = tuple[Columns, Columns, Floats]  # places, and the gradient and distance there


@dataclass(slots=True)
class _Walk:
    """Walkers on their way, as columns: place, normal, direction; way left and gone, and the stride that went well."""

    place: Columns
    normal: Columns
    way: Columns
    left: Floats
    gone: Floats
    stride: Floats
    close: Floats
    settled: NDArray[np.bool_]
    blocked: NDArray[np.bool_]
    lost: NDArray[np.bool_]


def move(
    volume: Volume, points: Floats, steps: Floats, heading: Floats, up: Floats, size: Floats | float, number: int = 0
) -> Move:
    """Walk agents who stand on the zero level at `points` [n,3] by `steps` [n,3], laid into the surface and kept in length.

    `up` [n,3] is the unit normal that each stood by, `heading` [n,3] where it looked. Steps turn from there into the surface
    itself; a heading turns as the body tilts, and not with each crumb that is walked over. `size` (mm, one or [n]) is its body:
    places stay within a ten-thousandth of it off the zero level. Who stands in air, because the ground was dug away, first goes
    to the surface. A step that is not finite counts as none, and so does what of a step points off the surface by over
    60 degrees.

    `up` of the result is the normal out of the solid that the body stands by, even over its length, so that it tilts before an
    edge and does not jerk. Who is lost stays where it was. Footings are on the solid of this `number`.
    """
    bricks = volume.bricks
    columns = [_columns(v) for v in (points, steps, heading, up)]
    count = columns[0].shape[1]
    body = np.broadcast_to(np.asarray(size, np.float64), (count,))
    close = np.clip(3e-5 * body, CLOSE * bricks.voxel, 1e-3 * bricks.voxel)
    with np.errstate(over="ignore", invalid="ignore"):
        if compiled.wanted(count):
            return _moved_compiled(bricks, columns, close, stance(bricks, body), number)
        return _moved(bricks, columns, close, stance(bricks, body), number)


def stance(bricks: Bricks, body: Floats) -> Floats:
    """How far around a place a body's normal looks, voxels."""
    return np.maximum(body * (STANCE / bricks.voxel), LEAN)


def upright(bricks: Bricks, place: Columns, lean: Floats, otherwise: Columns) -> Columns:
    """Unit normals to stand by, evened over `lean` voxels; where walls on both sides leave none, `otherwise`."""
    x, y, z = place
    slope = smooth(bricks, x, y, z, lean)
    clear = dot(slope, slope) > THIN * THIN
    return [np.where(clear, s, o) for s, o in zip(_normal_of(slope, otherwise), otherwise, strict=True)]


def _moved(bricks: Bricks, columns: list[Floats], close: Floats, lean: Floats, number: int) -> Move:
    """As `move`, of points, steps, headings and up as (3, n)."""
    place, wish, head, above = (list(c.copy()) for c in columns)
    count = close.size
    sound = np.isfinite(wish[0] + wish[1] + wish[2])
    wish = [np.where(sound, w, 0.0) for w in wish]
    normal = _normal_of(smooth(bricks, *place), above)
    wish = _turned(wish, above, normal, head)
    way, flat = _laid(wish, normal)
    left = np.minimum(np.sqrt(dot(wish, wish)), 2 * flat)
    no = np.zeros(count, bool)
    w = _Walk(place, normal, way, left, np.zeros(count), np.full(count, STRIDE), close, no, no.copy(), no.copy())
    _settle(bricks, w, np.flatnonzero(~(left > 0)))
    rows = np.flatnonzero(left > 0)
    for _ in range(CROSSINGS):
        if not rows.size:
            break
        rows = _step(bricks, w, rows)
    stood = upright(bricks, w.place, lean, w.normal)
    way = _laid(_turned(w.way, w.normal, stood, w.way), stood)[0]
    head = _laid(_turned(head, above, stood, head), stood)[0]
    points = _rows(w.place)
    footing = Footing.on_solids(number, points)
    return Move(footing, points, _rows(stood), _rows(head), _rows(way), w.gone, w.blocked, w.lost)


def _moved_compiled(bricks: Bricks, columns: list[Floats], close: Floats, lean: Floats, number: int) -> Move:
    """As `_moved`."""
    from antdsl.ground.solid.walking_compiled import walk_all

    vectors, gone = np.empty((4, 3, close.size)), np.empty(close.size)
    blocked, lost = np.empty(close.size, bool), np.empty(close.size, bool)
    grid = (bricks.table, bricks.values, *bricks.origin, bricks.voxel, *bricks.shape)
    walk_all(grid, *columns, np.ascontiguousarray(close), np.ascontiguousarray(lean), vectors, gone, blocked, lost)
    place, stood, head, way = (v.T for v in vectors)
    return Move(Footing.on_solids(number, place), place, stood, head, way, gone, blocked, lost)


def _step(bricks: Bricks, w: _Walk, rows: Index) -> Index:
    """One stride of `rows`; gives those with way left."""
    start, before, way = ([c[rows] for c in columns] for columns in (w.place, w.normal, w.way))
    reach = w.stride[rows] * bricks.voxel
    length = np.minimum(w.left[rows], reach)
    at = [p + v * length for p, v in zip(start, way, strict=True)]
    at, slope, off = _onto(bricks, at, start, before, length, w.close[rows])
    normal = _normal_of(slope, before)
    middle = distance(bricks, *((p + q) * 0.5 for p, q in zip(start, at, strict=True)))
    edge = length <= EDGE * bricks.voxel
    went = [q - p for p, q in zip(start, at, strict=True)]
    whole = dot(went, went) <= (FARTHER * length) ** 2
    good = whole & (np.abs(off) <= w.close[rows]) & (np.abs(middle) <= OFF * bricks.voxel) & (edge | (dot(normal, before) > BACK))
    walked = np.flatnonzero(good)
    on = rows[walked]
    _turn(w, on, [c[walked] for c in before], [c[walked] for c in normal])
    for column, values in zip(w.place, at, strict=True):
        column[on] = values[walked]
    rest = w.left[on] - length[walked]
    w.left[on] = np.where(rest > DONE * bricks.voxel, rest, 0.0)
    w.gone[on] += length[walked]
    w.stride[on] = np.minimum(w.stride[on] * 2, STRIDE)
    w.settled[on] = True
    w.blocked[on] = False
    failed = np.flatnonzero(~good)
    if failed.size:
        _retry(bricks, w, rows[failed], length[failed])
    return rows[w.left[rows] > 0]


def _retry(bricks: Bricks, w: _Walk, rows: Index, length: Floats) -> None:
    """Those whose stride went wrong: who has not walked yet may stand off the surface; the others take shorter ones."""
    fresh = ~w.settled[rows]
    _settle(bricks, w, rows[fresh])
    rows, length = rows[~fresh], length[~fresh]
    w.stride[rows] = length * (0.5 / bricks.voxel)
    stuck = rows[w.stride[rows] < LEAST]
    again = stuck[w.blocked[stuck]]
    w.left[again] = 0.0
    _over(bricks, w, stuck[~w.blocked[stuck]])


def _over(bricks: Bricks, w: _Walk, rows: Index) -> None:
    """Turn `rows`, who stand at the very bottom of a groove or the tip of a ridge, to its other wall, once in a move."""
    before, way = [c[rows] for c in w.normal], [c[rows] for c in w.way]
    ahead = [p[rows] + v * (2 * LEAST * bricks.voxel) for p, v in zip(w.place, way, strict=True)]
    _turn(w, rows, before, _normal_of(field(bricks, *ahead)[1:], before))
    w.stride[rows] = EDGE
    w.blocked[rows] = True


def _normal_of(slope: Columns | Vector, otherwise: Columns) -> Columns:
    """The direction of a gradient; another one where the field is flat."""
    x, y, z = slope
    a, b, c = otherwise
    return list(unit((x, y, z), (a, b, c), 1e-6))


def _turn(w: _Walk, rows: Index, before: Columns, normal: Columns) -> None:
    """Give `rows` other normals, and turn their ways along."""
    way = [c[rows] for c in w.way]
    way = _laid(_turned(way, before, normal, way), normal)[0]
    for columns, new in ((w.normal, normal), (w.way, way)):
        for column, values in zip(columns, new, strict=True):
            column[rows] = values


def _settle(bricks: Bricks, w: _Walk, rows: Index) -> None:
    """Put `rows` on the surface; who finds none is lost and stays."""
    if not rows.size:
        return
    before = [c[rows] for c in w.normal]
    place, normal, found = settle(bricks, [c[rows] for c in w.place], before, w.close[rows])
    on = rows[found]
    _turn(w, on, [c[found] for c in before], [c[found] for c in normal])
    for column, values in zip(w.place, place, strict=True):
        column[on] = values[found]
    w.settled[rows] = True
    w.lost[rows[~found]] = True
    w.left[rows[~found]] = 0.0


def _onto(
    bricks: Bricks, at: Columns, start: Columns, normal: Columns, length: Floats, close: Floats
) -> tuple[Columns, Columns, Floats]:
    """Onto the zero level from places `at` within `length` of `start`, which is on it: places, gradients and distances there.

    By Newton; where the gradient leaps from cell to cell, as at a sharp edge, his steps may go to and fro and never arrive. But
    just below the start it is solid and just above it is air: between one of these and a place lies the surface.
    """
    far = [a.copy() for a in at]
    d, *slope = field(bricks, *at)
    beyond = d > 0
    limit = 0.5 * bricks.voxel
    rows = np.flatnonzero(np.abs(d) > close)
    for _ in range(NEWTON):
        if not rows.size:
            return at, slope, d
        g = [s[rows] for s in slope]
        square = np.maximum(dot(g, g), 1e-4)
        step = -d[rows] / square
        size = np.abs(step) * np.sqrt(square)
        step = np.where(size > limit, step * (limit / np.maximum(size, limit)), step)
        _put(bricks, at, slope, d, rows, [a[rows] + step * s for a, s in zip(at, g, strict=True)])
        rows = rows[np.abs(d[rows]) > close[rows]]
    part = 0.5
    while rows.size and part > 1e-4:
        depth = np.where(beyond[rows], -part, part) * length[rows]
        near = [p[rows] + depth * n[rows] for p, n in zip(start, normal, strict=True)]
        between = (distance(bricks, *near) > 0) != beyond[rows]
        now = rows[between]
        _bisect(bricks, (at, slope, d), now, [n[between] for n in near], [f[now] for f in far], beyond[now], close[now])
        rows, part = rows[~between], part * 0.2  # the wall opposite is nearer than that
    return at, slope, d


def _bisect(
    bricks: Bricks, found: Found, rows: Index, near: Columns, far: Columns, beyond: NDArray[np.bool_], close: Floats
) -> None:
    """Put `rows` where the surface is between near and far places; the far ones are in air if `beyond`, else in solid."""
    for _ in range(BISECTIONS):
        if not rows.size:
            return
        middle = [(a + b) * 0.5 for a, b in zip(near, far, strict=True)]
        _put(bricks, *found, rows, middle)
        d = found[2][rows]
        outer = (d > 0) == beyond
        near = [np.where(outer, n, m) for n, m in zip(near, middle, strict=True)]
        far = [np.where(outer, m, f) for f, m in zip(far, middle, strict=True)]
        on = np.flatnonzero(np.abs(d) > close)
        rows, beyond, close = rows[on], beyond[on], close[on]
        near, far = [c[on] for c in near], [c[on] for c in far]


def _put(bricks: Bricks, at: Columns, slope: Columns, d: Floats, rows: Index, places: Columns) -> None:
    """Put `rows` at other places, with the field there."""
    d[rows], *new = field(bricks, *places)
    for column, values in zip((*at, *slope), (*places, *new), strict=True):
        column[rows] = values


def _columns(v: Floats) -> Floats:
    return np.ascontiguousarray(np.asarray(v, np.float64).reshape(-1, 3).T)


def _rows(v: Columns) -> Floats:
    return np.stack(v).T


def _laid(v: Columns, normal: Columns) -> tuple[Columns, Floats]:
    """Unit vectors across the normal, as near to v as can be, and how long v is across it."""
    along = dot(v, normal)
    flat = [c - along * n for c, n in zip(v, normal, strict=True)]
    size = np.sqrt(dot(flat, flat))
    clear = size > 1e-9
    if not clear.all():
        steep = np.abs(normal[0]) > 0.9
        axis = [np.where(steep, 0.0, 1.0), np.where(steep, 1.0, 0.0), np.zeros_like(size)]
        off = dot(axis, normal)
        side = [a - off * n for a, n in zip(axis, normal, strict=True)]
        flat = [np.where(clear, f, s) for f, s in zip(flat, side, strict=True)]
        size = np.where(clear, size, np.sqrt(dot(side, side)))
        return [f / size for f in flat], np.where(clear, size, 0.0)
    return [f / size for f in flat], size


def _turned(v: Columns, before: Columns, after: Columns, way: Columns) -> Columns:
    """Vectors turned by the least turn that takes one unit normal into the other; half a turn goes over `way`."""
    cosine = dot(before, after)
    axis = cross(before, after)
    opposite = cosine < -1 + 1e-9
    part = dot(axis, v) / np.where(opposite, 1.0, 1.0 + cosine)
    swept = cross(axis, v)
    result = [cosine * c + s + part * a for c, s, a in zip(v, swept, axis, strict=True)]
    if opposite.any():
        hinge = cross(before, way)
        twice = 2 * dot(hinge, v)
        result = [np.where(opposite, twice * h - c, r) for h, c, r in zip(hinge, v, result, strict=True)]
    return result
