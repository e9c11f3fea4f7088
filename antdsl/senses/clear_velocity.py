"""Reciprocal collision avoidance in the plane of an agent's ground. Returns the velocity nearest to the wished one with which the
agent hits no other within some time. Source: J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-Body Collision Avoidance,
Robotics Research, Springer Tracts in Advanced Robotics 70, 2011, p. 3-19.

Each neighbour allows a half-plane of velocities; both agents make half of the necessary change (section 4). An incremental linear
program finds the nearest point of all half-planes within the circle of the greatest speed, one constraint at a time. If they have
no common point, it finds the point that violates them least (section 5.3). Constraints are added one by one, the nearest
neighbour's first. Values are float64, made of single sums, products, quotients and roots. Thus an agent's result has the same
bits, whichever other agents are computed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, called, inlined, kernel
from antdsl.numerics import elementary, parallel

_TURN = 2 * np.pi
_ALIKE = 1e-4  # rad: gaps that differ by less are equally wide
Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Column = Array1[F64]
Lines = tuple[Column, Column, Column, Column, Array1[I64]]  # px, py, dx, dy of borders, and 1 where there is one
# x, y, vx, vy and room of others, who are there, and who is the first of two on one spot
Columns = tuple[Array2[F64], Array2[F64], Array2[F64], Array2[F64], Array2[F64], Array2[BOOL], Array2[BOOL]]

_PARALLEL = 1e-9  # sine between two borders, below which they do not cross
_LEAST = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class Neighbours:
    """Neighbours of n agents, at most m each, nearest first: float64[n,m] in the plane of the requesting agent.

    `x y`: other minus own position; `vx vy`: own minus other velocity; `radius_sum`: the sum of both radii (mm, mm/s).
    `is_present`: which entries are valid. `first`: the two are at one position and the requesting one comes first by species and
    id."""

    x: Floats
    y: Floats
    vx: Floats
    vy: Floats
    radius_sum: Floats
    is_present: Flags
    first: Flags


def clear_velocities(
    others: Neighbours, velocity: tuple[Floats, Floats], wish: tuple[Floats, Floats], fastest: Floats, horizon: Floats, dt: float,
    threads: int = 1,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Return velocities (mm/s, float64[n] along both axes of each agent's plane) nearest to a `wish`, no faster than `fastest`.
    They avoid all hits within `horizon` s if the others do their half. Agents that overlap separate within `dt` s."""
    o = others
    columns = parallel.contiguous(o.x, o.y, o.vx, o.vy, o.radius_sum, o.is_present, o.first)
    own, wished, (most, until) = (parallel.contiguous(*each) for each in (velocity, wish, (fastest, horizon)))
    parts = parallel.in_parts(lambda *part: _clear_part(columns, own, wished, most, until, dt, *part), len(fastest), threads)
    if len(parts) == 1:
        return parts[0]
    return np.concatenate([each[0] for each in parts]), np.concatenate([each[1] for each in parts])


def _clear_part(
    others: tuple[NDArray[Any], ...], velocity: tuple[Floats, ...], wish: tuple[Floats, ...], fastest: Floats, horizon: Floats,
    dt: float, begin: int, end: int,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Compute `clear_velocities` for agents from `begin` to `end`; `others` are `Columns`."""
    most = others[0].shape[1]
    borders, between = ((*np.empty((4, most)), np.empty(most, np.int64)) for _ in range(2))
    x, y = np.empty((2, end - begin))
    _clear_rows(others, velocity, wish, fastest, horizon, dt, begin, end, borders, between, x, y)
    return x, y


@kernel
def _clear_rows(
    others: Columns, velocity: tuple[Column, Column], wish: tuple[Column, Column], fastest: Column, horizon: Column, dt: F64,
    begin: I64, end: I64, borders: Lines, between: Lines, x: Column, y: Column,
) -> None:  # fmt: skip
    most = borders[0].size
    for a in range(begin, end):
        for c in range(most):
            if others[5][a, c]:
                _set_border(others, a, c, velocity[0][a], velocity[1][a], horizon[a], dt, borders)
            else:
                borders[4][c] = 0
        wx, wy, limit = wish[0][a], wish[1][a], fastest[a]
        size = math.sqrt(wx * wx + wy * wy)
        part = 1.0
        if size > limit:
            part = limit / (size if size > 0.0 else 1.0)
        vx, vy, failed = _nearest_allowed(borders, most, limit, wx, wy, wx * part, wy * part, False)
        if failed < most:
            vx, vy = _least_violation(borders, between, most, limit, vx, vy, failed)
        x[a - begin], y[a - begin] = vx, vy


@inlined
def _set_border(others: Any, a: I64, c: I64, own_x: F64, own_y: F64, horizon: F64, dt: F64, borders: Lines) -> None:
    """Set the half-plane that neighbour c of agent a allows."""
    xs, ys, vxs, vys, rooms, is_present, first = others
    px, py, dx, dy, sound = borders
    x, y, vx, vy, r = xs[a, c], ys[a, c], vxs[a, c], vys[a, c], rooms[a, c]
    square, square_radius = x * x + y * y, r * r
    is_separate = square > square_radius
    seconds = horizon if is_separate else dt
    wx, wy = vx - x / seconds, vy - y / seconds
    size = math.sqrt(wx * wx + wy * wy)
    ux, uy = 1.0 if first[a, c] else -1.0, 0.0
    if size > _LEAST:
        ux, uy = wx / size, wy / size
    along = wx * x + wy * y
    if not is_separate or (along < 0.0 and along * along > square_radius * (size * size)):
        change = r / seconds - size
        dx[c], dy[c] = uy, -ux
        cx, cy = change * ux, change * uy
    else:
        leg = math.sqrt(max(square - square_radius, 0.0))
        side = 1.0 if x * wy - y * wx > 0.0 else -1.0
        over = square if square > _LEAST else 1.0
        lx, ly = side * (x * leg - side * (y * r)) / over, side * (side * (x * r) + y * leg) / over
        reach = vx * lx + vy * ly
        dx[c], dy[c] = lx, ly
        cx, cy = reach * lx - vx, reach * ly - vy
    px[c], py[c] = own_x + 0.5 * cx, own_y + 0.5 * cy
    good = is_present[a, c] and math.isfinite(px[c]) and math.isfinite(py[c]) and math.isfinite(dx[c]) and math.isfinite(dy[c])
    sound[c] = 1 if good else 0


@inlined
def _excess(borders: Lines, k: I64, x: F64, y: F64) -> F64:
    px, py, dx, dy, _ = borders
    away: float = dx[k] * (py[k] - y) - dy[k] * (px[k] - x)
    return away


@called
def _nearest_allowed(
    borders: Lines, most: I64, fastest: F64, wx: F64, wy: F64, x: F64, y: F64, along: BOOL
) -> tuple[F64, F64, I64]:
    """Return the allowed point nearest to the wish, starting from (x, y) in the circle; with `along`, the farthest in its
    direction. Also return the index of the border that left no allowed point."""
    px, py, dx, dy, is_sound = borders
    bx, by = x, y
    for k in range(most):
        if is_sound[k] == 0 or not _excess(borders, k, bx, by) > 0.0:
            continue
        middle = px[k] * dx[k] + py[k] * dy[k]
        discriminant = middle * middle + fastest * fastest - (px[k] * px[k] + py[k] * py[k])
        if not discriminant >= 0.0:
            return bx, by, k
        half = math.sqrt(discriminant)
        low, high = -middle - half, -middle + half
        for q in range(k):
            if is_sound[q] == 0:
                continue
            cross = dx[k] * dy[q] - dy[k] * dx[q]
            away = dx[q] * (py[k] - py[q]) - dy[q] * (px[k] - px[q])
            if abs(cross) <= _PARALLEL:
                if away < 0.0:
                    return bx, by, k
                continue
            # Either bound is equally likely: both are computed, so no branch has to be predicted.
            at, above = away / cross, cross > 0.0
            high = min(high, at if above else np.inf)
            low = max(low, -np.inf if above else at)
        if not low <= high:
            return bx, by, k
        t = high
        if along:
            if not wx * dx[k] + wy * dy[k] > 0.0:
                t = low
        else:
            t = min(max(dx[k] * (wx - px[k]) + dy[k] * (wy - py[k]), low), high)
        bx, by = px[k] + t * dx[k], py[k] + t * dy[k]
    return bx, by, most


@called
def _least_violation(borders: Lines, between: Any, most: I64, fastest: F64, x: F64, y: F64, failed: I64) -> tuple[F64, F64]:
    """Return the point with the least violation of any border, starting from the point that the borders before `failed` allow."""
    px, py, dx, dy, is_sound = borders
    qx, qy, ex, ey, is_usable = between
    bx, by, deepest = x, y, 0.0
    for k in range(failed, most):
        if is_sound[k] == 0 or not _excess(borders, k, bx, by) > deepest:
            continue
        for q in range(k):
            cross = dx[k] * dy[q] - dy[k] * dx[q]
            level = abs(cross) <= _PARALLEL
            part = (dx[q] * (py[k] - py[q]) - dy[q] * (px[k] - px[q])) / (1.0 if level else cross)
            qx[q] = 0.5 * (px[k] + px[q]) if level else px[k] + part * dx[k]
            qy[q] = 0.5 * (py[k] + py[q]) if level else py[k] + part * dy[k]
            wx, wy = dx[q] - dx[k], dy[q] - dy[k]
            size = math.sqrt(wx * wx + wy * wy)
            over = size if size > _LEAST else 1.0
            ex[q], ey[q] = wx / over, wy / over
            opposed = not (level and dx[k] * dx[q] + dy[k] * dy[q] > 0.0)
            is_usable[q] = 1 if is_sound[q] != 0 and size > _LEAST and opposed else 0
        nx, ny, missed = _nearest_allowed(between, k, fastest, -dy[k], dx[k], -dy[k] * fastest, dx[k] * fastest, True)
        if missed == k:
            bx, by = nx, ny
        deepest = _excess(borders, k, bx, by)
    return bx, by


def widest_gaps(x: Floats, y: Floats, is_present: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return unit directions, float64[n] ahead and to the left, into the middle of the widest gap between the bearings of
    neighbours. Neighbours are at `x` ahead and `y` to the left, float64[n,m], where they are `is_present`. One neighbour leaves a
    gap all round, with its middle straight away from it. Of equally wide gaps, the one nearest to straight ahead wins, then the
    one to the left. Without neighbours the result is 0."""
    n, most = x.shape
    if not most:
        return np.zeros(n), np.zeros(n)
    is_present = is_present & ((x != 0) | (y != 0))  # who stands on the same spot has no bearing
    bearing = elementary.atan2(y.astype(np.float32), x.astype(np.float32)).astype(np.float64)
    bearing = np.sort(np.where(is_present, bearing, np.inf), axis=1)
    known = np.isfinite(bearing)
    count = known.sum(axis=1)
    following = np.concatenate([bearing[:, 1:], np.full((n, 1), np.inf)], axis=1)
    last = known & ~np.isfinite(following)
    following = np.where(last, bearing[:, :1] + _TURN, following)
    gap = np.where(known, following, 0.0) - np.where(known, bearing, 0.0)
    middle = np.where(known, bearing, 0.0) + gap / 2
    middle = np.where(middle > np.pi, middle - _TURN, middle)
    wide = known & (gap >= gap.max(axis=1, keepdims=True) - _ALIKE)
    off = np.where(wide, np.abs(middle), np.inf)
    best = wide & (off <= off.min(axis=1, keepdims=True) + _ALIKE)
    chosen = np.where(best, middle, -np.inf).max(axis=1)  # to the left is above 0
    angle = np.where(count > 0, chosen, 0.0).astype(np.float32)
    weight = np.where(count > 0, 1.0, 0.0)
    return elementary.cos(angle).astype(np.float64) * weight, elementary.sin(angle).astype(np.float64) * weight
