"""Walking on a solid: short steps along the tangent, each put back on the zero level, headings turned as the normal turns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.solids.bricks import Bricks
from antdsl.runtime.solids.projecting import CLOSE, settle
from antdsl.runtime.solids.trilinear import distance, field, smooth
from antdsl.runtime.solids.volume import Volume

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Columns = list[Floats]

STRIDE = 0.75  # voxels of one step at most
LEAST = 1 / 32  # voxels of one step, below which there is no way on
OFF = 0.12  # voxels that the middle of a step may be off the surface: else an edge is cut, or a thin wall is passed
BACK = -0.25  # cosine of the turn of the normal in one step, below which another wall is met
NEWTON = 4
CROSSINGS = 400  # steps of one move


@dataclass(frozen=True, slots=True)
class Moved:
    """Where a step led. Vectors are float64[n,3]; lengths mm.

    `up` is the smooth normal out of the solid, `heading` a unit vector at right angles to it, `direction` the unit direction of
    travel at the end, across the normal. `travelled` is the way walked. `blocked` says that the way could not be walked to its
    end, `lost` that there is no surface near to stand on: then the point stays where it was.
    """

    points: Floats
    up: Floats
    heading: Floats
    direction: Floats
    travelled: Floats
    blocked: NDArray[np.bool_]
    lost: NDArray[np.bool_]


@dataclass(slots=True)
class _Walk:
    """Walkers on their way, as columns: place, normal, direction, heading; way left and gone, and the stride that went well."""

    place: Columns
    normal: Columns
    way: Columns
    head: Columns
    left: Floats
    gone: Floats
    stride: Floats
    close: Floats
    settled: NDArray[np.bool_]
    blocked: NDArray[np.bool_]
    lost: NDArray[np.bool_]


def move(volume: Volume, points: Floats, steps: Floats, heading: Floats, up: Floats, size: Floats | float) -> Moved:
    """Walk agents who stand on the zero level at `points` [n,3] by `steps` [n,3], laid into the surface and kept in length.

    `up` [n,3] is the unit normal that each stood by, `heading` [n,3] where it looked, `size` (mm, one or [n]) its body: places
    stay within a ten-thousandth of it off the zero level. Who stands in air, because the ground was dug away, first goes to the
    surface. A step that is not finite counts as none, and so does what of a step points off the surface by over 60 degrees.
    """
    bricks = volume.bricks
    place, wish, head, normal = (_columns(v) for v in (points, steps, heading, up))
    count = place[0].size
    sound = np.isfinite(wish[0] + wish[1] + wish[2])
    wish = [np.where(sound, w, 0.0) for w in wish]
    way, flat = _laid(wish, normal)
    left = np.minimum(np.sqrt(_dot(wish, wish)), 2 * flat)
    body = np.broadcast_to(np.asarray(size, np.float64), (count,))
    close = np.clip(3e-5 * body, CLOSE * bricks.voxel, 1e-3 * bricks.voxel)
    no = np.zeros(count, bool)
    w = _Walk(place, normal, way, head, left, np.zeros(count), np.full(count, STRIDE), close, no, no.copy(), no.copy())
    standing = np.flatnonzero(~(left > 0))
    _settle(bricks, w, standing)
    rows = np.flatnonzero(left > 0)
    for _ in range(CROSSINGS):
        if not rows.size:
            break
        rows = _step(bricks, w, rows)
    stood = _unit(list(smooth(bricks, *w.place)), w.normal)
    turned = _turned(w.head, w.normal, stood, w.way)
    result = (w.place, stood, _laid(turned, stood)[0], w.way)
    return Moved(*(np.stack(v).T for v in result), w.gone, w.blocked, w.lost)


def _step(bricks: Bricks, w: _Walk, rows: Index) -> Index:
    """One stride of `rows`; gives those with way left."""
    start, before, way = ([c[rows] for c in columns] for columns in (w.place, w.normal, w.way))
    reach = w.stride[rows] * bricks.voxel
    length = np.minimum(w.left[rows], reach)
    at = [p + v * length for p, v in zip(start, way, strict=True)]
    at, slope, near = _onto(bricks, at, w.close[rows])
    normal = _unit(slope, before)
    middle = distance(bricks, *((p + q) * 0.5 for p, q in zip(start, at, strict=True)))
    good = near & (np.abs(middle) <= OFF * bricks.voxel) & (_dot(normal, before) > BACK)
    went = np.flatnonzero(good)
    on = rows[went]
    before, normal, way = ([c[went] for c in columns] for columns in (before, normal, way))
    head = _turned([c[on] for c in w.head], before, normal, way)
    way = _laid(_turned(way, before, normal, way), normal)[0]
    for columns, new in ((w.place, [a[went] for a in at]), (w.normal, normal), (w.way, way), (w.head, head)):
        for column, values in zip(columns, new, strict=True):
            column[on] = values
    w.left[on] -= length[went]
    w.gone[on] += length[went]
    w.stride[on] = np.minimum(w.stride[on] * 2, STRIDE)
    w.settled[on] = True
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
    w.blocked[stuck] = True
    w.left[stuck] = 0.0


def _settle(bricks: Bricks, w: _Walk, rows: Index) -> None:
    """Put `rows` on the surface; who finds none is lost and stays."""
    if not rows.size:
        return
    before = [c[rows] for c in w.normal]
    place, normal, found = settle(bricks, [c[rows] for c in w.place], before, w.close[rows])
    on = rows[found]
    normal, before = [c[found] for c in normal], [c[found] for c in before]
    way = [c[on] for c in w.way]
    head = _turned([c[on] for c in w.head], before, normal, way)
    way = _laid(_turned(way, before, normal, way), normal)[0]
    for columns, new in ((w.place, [c[found] for c in place]), (w.normal, normal), (w.way, way), (w.head, head)):
        for column, values in zip(columns, new, strict=True):
            column[on] = values
    w.settled[rows] = True
    w.lost[rows[~found]] = True
    w.left[rows[~found]] = 0.0


def _onto(bricks: Bricks, at: Columns, close: Floats) -> tuple[Columns, Columns, NDArray[np.bool_]]:
    """Newton's way onto the zero level from places near it: the places, the gradient there, and whether it was reached."""
    d, *slope = field(bricks, *at)
    limit = 0.5 * bricks.voxel
    for _ in range(NEWTON):
        rows = np.flatnonzero(np.abs(d) > close)
        if not rows.size:
            break
        g = [s[rows] for s in slope]
        square = np.maximum(_dot(g, g), 1e-4)
        step = -d[rows] / square
        length = np.abs(step) * np.sqrt(square)
        step = np.where(length > limit, step * (limit / np.maximum(length, limit)), step)
        moved = [a[rows] + step * s for a, s in zip(at, g, strict=True)]
        d[rows], *new = field(bricks, *moved)
        for column, values in zip((*at, *slope), (*moved, *new), strict=True):
            column[rows] = values
    return at, slope, np.abs(d) <= close


def _columns(v: Floats) -> Columns:
    return list(np.array(np.asarray(v, np.float64).reshape(-1, 3).T, order="C"))


def _dot(a: Columns, b: Columns) -> Floats:
    total: Floats = (a[0] * b[0] + a[1] * b[1]) + a[2] * b[2]
    return total


def _unit(v: Columns, otherwise: Columns) -> Columns:
    size = np.sqrt(_dot(v, v))
    clear = size > 1e-6
    over = 1.0 / np.where(clear, size, 1.0)
    return [np.where(clear, c * over, o) for c, o in zip(v, otherwise, strict=True)]


def _laid(v: Columns, normal: Columns) -> tuple[Columns, Floats]:
    """Unit vectors across the normal, as near to v as can be, and how long v is across it."""
    along = _dot(v, normal)
    flat = [c - along * n for c, n in zip(v, normal, strict=True)]
    size = np.sqrt(_dot(flat, flat))
    clear = size > 1e-9
    if not clear.all():
        steep = np.abs(normal[0]) > 0.9
        axis = [np.where(steep, 0.0, 1.0), np.where(steep, 1.0, 0.0), np.zeros_like(size)]
        off = _dot(axis, normal)
        side = [a - off * n for a, n in zip(axis, normal, strict=True)]
        flat = [np.where(clear, f, s) for f, s in zip(flat, side, strict=True)]
        size = np.where(clear, size, np.sqrt(_dot(side, side)))
        return [f / size for f in flat], np.where(clear, size, 0.0)
    return [f / size for f in flat], size


def _turned(v: Columns, before: Columns, after: Columns, way: Columns) -> Columns:
    """Vectors turned by the least turn that takes one unit normal into the other; half a turn goes over `way`."""
    cosine = _dot(before, after)
    axis = _cross(before, after)
    opposite = cosine < -1 + 1e-9
    part = _dot(axis, v) / np.where(opposite, 1.0, 1.0 + cosine)
    swept = _cross(axis, v)
    result = [cosine * c + s + part * a for c, s, a in zip(v, swept, axis, strict=True)]
    if opposite.any():
        hinge = _cross(before, way)
        twice = 2 * _dot(hinge, v)
        result = [np.where(opposite, twice * h - c, r) for h, c, r in zip(hinge, v, result, strict=True)]
    return result


def _cross(a: Columns, b: Columns) -> Columns:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
