"""The triangulation of polygons for .obj, .ply, USD and bodies, and of triangle strips.

NumPy splits all polygons with the same number of corners at once, if a fan from one of their corners covers them. A convex
polygon is a fan from its first corner. Other polygons, for example with two arms, are split one by one by mapbox_earcut on an
integer grid. All products on this grid are exact, so every processor gets the same triangles."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
GridCorner = tuple[int, int]

MAX_POLYGON_CORNERS = 20_000  # limit for one polygon that no fan covers; cutting it takes about a second
MAX_TRIANGULATION_WORK = (
    16 * MAX_POLYGON_CORNERS**2
)  # limit for all such polygons of a file: sum of squared corner counts, plus calls
_WORK_UNITS_PER_EARCUT_CALL = 20_000  # cost of each polygon in this sum for its call
_MAX_FAN_TRIES = 8  # corners that are tried as the centre of a fan
_GRID_CELLS = 2.0**24  # cells of the grid across a polygon; products of two sides stay below 2**53
_FLAT_AREA_RATIO = 1e-10  # share of the squared extent of a polygon; triangles with less area count as empty
_AREA_TOLERANCE = 1e-5  # share of a polygon's area; its triangles may differ from it by rounding to the grid


class TooManyCornersError(Exception):
    """Error for polygons that would take too long to triangulate. The message fits after a file's name."""


@dataclass(frozen=True, slots=True, eq=False)
class Triangulation:
    """The triangles of polygons.

    `corners` int64[m, 3]: indices into the list of the corners of all polygons.
    `polygon_indices` int64[m]: the polygon of each triangle, ascending.
    `cut_count`: the number of polygons with more than three corners.
    `concave_count`: how many of these have a corner that points inward.
    `crossing_polygons`: the indices of polygons that cross or cover themselves."""

    corners: Integers
    polygon_indices: Integers
    cut_count: int = 0
    concave_count: int = 0
    crossing_polygons: tuple[int, ...] = ()


def triangulate_polygons(points: Floats, counts: Integers, indices: Integers) -> Triangulation:
    """Return polygons split into triangles with the same winding. Raises TooManyCornersError if a polygon has too many corners.

    `points` float64[n, 3].
    `counts` int64[p]: the number of corners of each polygon; polygons with fewer than three give no triangles.
    `indices` int64[counts.sum()]: the point of each corner, below n.
    Of consecutive corners at one position, only the first is used."""
    if len(counts) and (counts == 3).all():
        return Triangulation(np.arange(3 * len(counts)).reshape(-1, 3), np.arange(len(counts)))
    own = np.arange(len(indices))
    while (again := _find_repeated_corners(points[indices[own]], counts)).any():
        counts = counts - np.bincount(np.repeat(np.arange(len(counts)), counts)[again], minlength=len(counts))
        own = own[~again]
    triangulation = _cut_polygons(points, counts, indices[own])
    return replace(triangulation, corners=own[triangulation.corners])


def _find_repeated_corners(points: Floats, counts: Integers) -> NDArray[np.bool_]:
    """Return whether each corner is at the same position as the previous corner of its polygon. The last corner also counts if
    it is at the position of the first.

    The result is false for polygons with fewer than four corners, or with fewer than three corners at different positions."""
    large = counts > 3
    start = np.cumsum(counts) - counts
    begin, end = start[large], start[large] + counts[large] - 1
    again = np.zeros(len(points), np.bool_)
    again[1:] = (points[1:] == points[:-1]).all(axis=1) & np.repeat(large, counts)[1:]
    again[begin] = False
    again[end] |= (points[end] == points[begin]).all(axis=1)
    left = counts - np.bincount(np.repeat(np.arange(len(counts)), counts)[again], minlength=len(counts))
    return again & np.repeat(left > 2, counts)


def _cut_polygons(points: Floats, counts: Integers, indices: Integers) -> Triangulation:
    start = np.cumsum(counts) - counts
    parts: list[tuple[Integers, Integers]] = []
    concave, crossing, hard = 0, [], []
    for count in np.unique(counts[counts > 2]).tolist():
        these = np.flatnonzero(counts == count)
        at = start[these][:, None] + np.arange(count)
        if count == 3:
            parts.append((these, at[:, None, :]))
            continue
        rings = points[indices[at]]
        fans, middle, crossed = _cut_fan_triangles(rings)
        known = middle >= 0
        parts.append((these[known], at[known][np.arange(int(known.sum()))[:, None, None], fans[known]]))
        concave += int(_find_concave_polygons(rings[middle != 0]).sum())
        crossing += these[crossed].tolist()
        hard += these[~known].tolist()
    _check_cutting_work(counts[hard])
    for number in sorted(hard):
        at = np.arange(start[number], start[number] + counts[number])
        triangles, crossed_itself = _cut_ear_triangles(_project_outlines(points[indices[at]][None])[0][0])
        parts.append((np.full(1, number), at[triangles][None]))
        if crossed_itself:
            crossing.append(number)
    polygon = np.concatenate([np.repeat(these, triangles.shape[1]) for these, triangles in parts] or [np.empty(0, np.int64)])
    corners = np.concatenate([triangles.reshape(-1, 3) for _, triangles in parts] or [np.empty((0, 3), np.int64)])
    order = np.argsort(polygon, kind="stable")
    return Triangulation(corners[order], polygon[order], int((counts > 3).sum()), concave, tuple(sorted(crossing)))


def _check_cutting_work(counts: Integers) -> None:
    """Raise TooManyCornersError if the polygons would take too long to triangulate. `counts`: the number of corners of each."""
    if len(counts) and counts.max() > MAX_POLYGON_CORNERS:
        raise TooManyCornersError(f"has a polygon of {counts.max():,} corners, more than {MAX_POLYGON_CORNERS:,}")
    if (counts.astype(np.float64) ** 2 + _WORK_UNITS_PER_EARCUT_CALL).sum() > MAX_TRIANGULATION_WORK:
        raise TooManyCornersError(f"has {len(counts):,} polygons with too many corners to triangulate")


def _project_outlines(rings: Floats) -> tuple[Floats, NDArray[np.bool_]]:
    """Return polygons [p, n, 3] as counter-clockwise outlines [p, n, 2] in a plane. Also return whether each polygon has an
    area.

    The coordinate axis nearest to the normal of a polygon is dropped."""
    low = rings.min(axis=1, keepdims=True)
    extent = np.maximum((rings.max(axis=1, keepdims=True) - low).max(axis=2, keepdims=True), 1e-300)
    unit = (rings - low) / np.ldexp(1.0, np.frexp(extent)[1])  # a power of two, so that nothing is rounded
    following = np.roll(unit, -1, axis=1)
    normal = np.stack(
        [
            ((unit[..., a] * following[..., b]) - (unit[..., b] * following[..., a])).sum(axis=1)
            for a, b in ((1, 2), (2, 0), (0, 1))
        ],
        axis=1,
    )
    axis = np.abs(normal).argmax(axis=1)
    rows = np.arange(len(rings))
    size = normal[rows, axis]
    one, two = (axis + 1) % 3, (axis + 2) % 3
    one, two = np.where(size < 0, two, one), np.where(size < 0, one, two)
    outline = np.stack([unit[rows, :, one], unit[rows, :, two]], axis=2)
    return outline, np.abs(size) > _FLAT_AREA_RATIO


def _cut_fan_triangles(rings: Floats) -> tuple[Integers, Integers, NDArray[np.bool_]]:
    """Return polygons [p, n, 3] split into fans of triangles.

    There are three results: the triangles [p, n - 2, 3]; the index of the corner from which each fan spreads, or -1 if no fan
    covers the polygon; and whether each polygon crosses itself."""
    count = rings.shape[1]
    outline, has_nonzero_area = _project_outlines(rings)
    crossed = ~has_nonzero_area & _find_self_crossing_polygons(rings)
    middle = np.where(has_nonzero_area, -1, 0)  # a polygon without area has no fan
    step = np.arange(1, count - 1)
    for k in range(min(count, _MAX_FAN_TRIES)):
        open_ = np.flatnonzero(middle < 0)
        if not len(open_):
            break
        side = np.roll(outline[open_], -k, axis=1)
        side = side[:, 1:] - side[:, :1]
        area = side[:, :-1, 0] * side[:, 1:, 1] - side[:, :-1, 1] * side[:, 1:, 0]
        # after more than half a turn about the centre, the fan must not return to its first side
        turn = side[:, :1, 0] * side[:, :, 1] - side[:, :1, 1] * side[:, :, 0]
        past = np.maximum.accumulate(turn < -_FLAT_AREA_RATIO, axis=1)
        covers = (area > _FLAT_AREA_RATIO).all(axis=1) & ~(past[:, :-1] & (turn[:, 1:] >= -_FLAT_AREA_RATIO)).any(axis=1)
        middle[open_[covers]] = k
    if count == 4:  # a quad without a fan crosses itself
        crossed |= middle < 0
        middle = np.maximum(middle, 0)
    around = np.stack([np.zeros(len(step), np.int64), step, step + 1], axis=1)
    fans = (around[None] + np.maximum(middle, 0)[:, None, None]) % count
    return fans, middle, crossed


def _find_concave_polygons(rings: Floats) -> NDArray[np.bool_]:
    """Return whether each of the polygons [p, n, 3] has a corner that points inward."""
    outline, has_nonzero_area = _project_outlines(rings)
    side = np.roll(outline, -1, axis=1) - outline
    previous_side = np.roll(side, 1, axis=1)
    turn = previous_side[..., 0] * side[..., 1] - previous_side[..., 1] * side[..., 0]
    return np.asarray(has_nonzero_area & (turn < -_FLAT_AREA_RATIO).any(axis=1))


def _find_self_crossing_polygons(rings: Floats) -> NDArray[np.bool_]:
    """Return whether each of the polygons [p, n, 3] crosses itself like an 8. The total area of each polygon must be zero.

    Such a polygon crosses itself if one of its triangles has an area."""
    side = rings[:, 1:] - rings[:, :1]
    extent = np.maximum(np.abs(side).max(axis=(1, 2)), 1e-300)
    across = np.abs(np.cross(side[:, :-1], side[:, 1:])).max(axis=(1, 2), initial=0.0)
    return np.asarray(across > 1e-6 * extent * extent)


def _cut_ear_triangles(outline: Floats) -> tuple[Integers, bool]:
    """Return triangles (m, 3) as corner indices of one polygon, and whether the polygon crosses itself.

    `outline` [n, 2]: the corners, counter-clockwise."""
    from mapbox_earcut import triangulate_float64

    grid = np.round(outline * _GRID_CELLS)
    triangles = triangulate_float64(grid, np.array([len(grid)], np.uint32)).astype(np.int64).reshape(-1, 3)
    twice = _compute_double_areas(grid, triangles)
    triangles[twice < 0] = triangles[twice < 0][:, [0, 2, 1]]
    x, y = grid.T
    double_area = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    covered = float(np.abs(twice).sum())
    corners = [(int(a), int(b)) for a, b in grid]
    return np.array(_split_at_corners(triangles.tolist(), corners), np.int64).reshape(-1, 3), abs(
        covered - double_area
    ) > _AREA_TOLERANCE * double_area


def _compute_double_areas(grid: Floats, triangles: Integers) -> Floats:
    a, b, c = (grid[triangles[:, k]] for k in range(3))
    areas: Floats = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    return areas


def _split_at_corners(triangles: list[list[int]], corners: list[GridCorner]) -> list[list[int]]:
    """Return triangles in which sides are split at corners that lie on them. earcut omits corners on straight sides.

    Without the split, there would be a gap to a neighbour that uses these corners."""
    count = len(corners)
    border = {(k, (k + 1) % count) for k in range(count)}
    edges = {(t[k], t[(k + 1) % 3]) for t in triangles for k in range(3)}
    loose = {(a, b) for a, b in edges if (a, b) not in border and (b, a) not in edges}
    if not loose:
        return triangles
    # Edges without a triangle so far: sides of the polygon, and the reverse of each unmatched edge.
    needed: dict[int, list[int]] = {}
    for a, b in [*(border - edges), *((b, a) for a, b in loose)]:
        needed.setdefault(a, []).append(b)
    result: list[list[int]] = []
    waiting = [list(t) for t in reversed(triangles)]
    while waiting:
        triangle = waiting.pop()
        for k in range(3):
            a, b, c = triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]
            chain = _find_corner_chain(a, b, needed, corners) if (a, b) in loose else []
            if chain:
                stops = [a, *chain, b]
                waiting += [[one, two, c] for one, two in pairwise(stops)][::-1]
                break
        else:
            result.append(triangle)
    return result


def _find_corner_chain(a: int, b: int, needed_edges: dict[int, list[int]], corners: list[GridCorner]) -> list[int]:
    """Return the corners that lie between `a` and `b` on the straight line from `a` to `b`, in order along a chain of
    `needed_edges`.

    The list is empty if no chain of these edges leads to `b` along the line."""
    (ax, ay), (bx, by) = corners[a], corners[b]
    at = a
    chain: list[int] = []
    while True:
        x, y = corners[at]
        onward = [
            c
            for c in sorted(needed_edges.get(at, ()))
            if c not in chain
            and c != a
            and (c != b or chain)
            and (corners[c][0] - ax) * (by - ay) == (corners[c][1] - ay) * (bx - ax)
            and (corners[c][0] - x) * (bx - ax) + (corners[c][1] - y) * (by - ay) >= 0
            and (bx - corners[c][0]) * (bx - ax) + (by - corners[c][1]) * (by - ay) >= 0
        ]
        if not onward:
            return []
        if b in onward:
            return chain
        at = onward[0]
        chain.append(at)


T = TypeVar("T", bound=np.integer)


def split_triangle_strips(corners: NDArray[T], restart: int = -1) -> NDArray[T]:
    """Return the triangles (n, 3) of a strip of corners. Every second triangle is reversed, so that all face the same side.

    Triangles with a repeated corner are omitted, because they only connect parts of a strip. `restart`: the value that begins a
    new strip."""
    if len(corners) < 3:
        return np.empty((0, 3), corners.dtype)
    place = np.arange(len(corners))
    since = place - np.maximum.accumulate(np.where(corners == restart, place + 1, 0))
    triangles = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    odd = since[2:] % 2 == 1
    triangles[odd] = triangles[odd][:, [1, 0, 2]]
    is_distinct = (
        (triangles[:, 0] != triangles[:, 1]) & (triangles[:, 1] != triangles[:, 2]) & (triangles[:, 0] != triangles[:, 2])
    )
    return np.asarray(triangles[is_distinct & (since[2:] >= 2)])


@dataclass(frozen=True, slots=True, eq=False)
class PolygonMesh:
    """A mesh of polygons, as the readers return it.

    `points` float64[n, 3]: in the file's units.
    `corner_counts` int64[p]: the number of corners of each polygon.
    `point_indices` int64[counts.sum()]: the point of each corner. It may be out of range, because readers need not check it."""

    points: NDArray[np.float64]
    corner_counts: NDArray[np.int64]
    point_indices: NDArray[np.int64]

    @staticmethod
    def from_triangles(points: NDArray[np.float64], triangles: NDArray[np.int64]) -> PolygonMesh:
        """Return a mesh of triangles (m, 3)."""
        return PolygonMesh(points, np.full(len(triangles), 3), triangles.reshape(-1))
