"""Reciprocal collision avoidance: of the velocities by which an agent meets nobody within some time the nearest to the one
that it wishes, in the plane of its ground (J. van den Berg, S. Guy, M. Lin, D. Manocha, Reciprocal n-Body Collision Avoidance,
Robotics Research, Springer Tracts in Advanced Robotics 70, 2011, p. 3-19).

Each neighbour allows a half-plane of velocities, the change that is needed being shared by halves (section 4). The nearest
point of all half-planes within the circle of the greatest speed is found by an incremental linear program, a constraint at a
time; where they have none in common, the point that all forbid least (section 5.3). Constraints are added for all agents at
once, the nearest neighbour's first; values are float64 and made of single sums, products, quotients and roots, so that an
agent's result is the same bits whoever else is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Rows = NDArray[np.intp]

_PARALLEL = 1e-9  # sine between two borders, below which they do not cross
_LEAST = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class Others:
    """Neighbours of n agents, at most m each, from the nearest on: float64[n,m] in the plane of the asking agent. `x y` are other
    minus own place, `vx vy` own minus other velocity, `room` is the sum of both radii (mm, mm/s); `there` says which are any,
    `first` in which two on one spot the asking one is the first by species and id."""

    x: Floats
    y: Floats
    vx: Floats
    vy: Floats
    room: Floats
    there: Flags
    first: Flags


@dataclass(frozen=True, slots=True, eq=False)
class Borders:
    """Half-planes of velocities, float64[n,m] each: those to the left of a line through (`px`, `py`) along the unit (`dx`, `dy`),
    where `there`."""

    px: Floats
    py: Floats
    dx: Floats
    dy: Floats
    there: Flags

    def of(self, rows: Rows) -> Borders:
        """Those of some agents."""
        return Borders(*(getattr(self, name)[rows] for name in ("px", "py", "dx", "dy", "there")))

    def up_to(self, count: int) -> Borders:
        """The first ones of each agent."""
        return Borders(*(getattr(self, name)[:, :count] for name in ("px", "py", "dx", "dy", "there")))

    def beyond(self, k: int, x: Floats, y: Floats) -> Floats:
        """How far velocities are on the forbidden side of the k-th border, below 0 on the other; -inf where there is none."""
        away = self.dx[:, k] * (self.py[:, k] - y) - self.dy[:, k] * (self.px[:, k] - x)
        return np.where(self.there[:, k], away, -np.inf)


def clear_velocities(
    others: Others, velocity: tuple[Floats, Floats], wish: tuple[Floats, Floats], fastest: Floats, horizon: Floats, dt: float,
    threads: int = 1,
) -> tuple[Floats, Floats]:  # fmt: skip
    """Velocities (mm/s, float64[n] along both axes of each agent's plane) nearest to a `wish`, no faster than `fastest`, by which
    nobody is met within `horizon` s if the others do their half; those who are in each other part within `dt` s."""
    n = len(fastest)
    if not n:
        return np.empty(0), np.empty(0)
    if compiled.wanted(n):
        from antdsl.senses.clear_velocity_compiled import velocities

        o = others
        columns = compiled.plain(o.x, o.y, o.vx, o.vy, o.room, o.there, o.first)
        own, wished, (most, until) = (compiled.plain(*each) for each in (velocity, wish, (fastest, horizon)))
        found = compiled.in_parts(lambda *part: velocities(columns, own, wished, most, until, dt, *part), n, threads)
        if len(found) == 1:
            return found[0]
        return np.concatenate([each[0] for each in found]), np.concatenate([each[1] for each in found])
    with np.errstate(all="ignore"):
        borders = _borders(others, velocity, horizon, dt)
        x, y, failed = _nearest(borders, fastest, wish, along=False)
        rows = np.flatnonzero(failed < others.x.shape[1])
        if rows.size:
            x[rows], y[rows] = _least_forbidden(borders.of(rows), fastest[rows], x[rows], y[rows], failed[rows])
    return x, y


def _borders(o: Others, velocity: tuple[Floats, Floats], horizon: Floats, dt: float) -> Borders:
    """The half-plane that each neighbour allows (section 4, equation 5)."""
    square, room = o.x * o.x + o.y * o.y, o.room * o.room
    apart = square > room
    seconds = np.where(apart, horizon[:, None], dt)
    # From the middle of the circle at the end of the truncated cone of velocities that meet.
    wx, wy = o.vx - o.x / seconds, o.vy - o.y / seconds
    size = np.sqrt(wx * wx + wy * wy)
    still = ~(size > _LEAST)  # as fast and on one spot: they part along the first axis, one each way
    ux = np.where(still, np.where(o.first, 1.0, -1.0), wx / np.where(still, 1.0, size))
    uy = np.where(still, 0.0, wy / np.where(still, 1.0, size))
    along = wx * o.x + wy * o.y
    round_end = ~apart | ((along < 0) & (along * along > room * (size * size)))
    # Else from one of its legs, that on whose side the velocity is.
    leg = np.sqrt(np.maximum(square - room, 0.0))
    left = o.x * wy - o.y * wx > 0
    over = np.where(square > _LEAST, square, 1.0)
    side = np.where(left, 1.0, -1.0)
    lx, ly = side * (o.x * leg - side * (o.y * o.room)) / over, side * (side * (o.x * o.room) + o.y * leg) / over
    reach = o.vx * lx + o.vy * ly
    change = o.room / seconds - size
    dx, dy = np.where(round_end, uy, lx), np.where(round_end, -ux, ly)
    cx = np.where(round_end, change * ux, reach * lx - o.vx)
    cy = np.where(round_end, change * uy, reach * ly - o.vy)
    px, py = velocity[0][:, None] + 0.5 * cx, velocity[1][:, None] + 0.5 * cy
    sound = o.there & np.isfinite(px) & np.isfinite(py) & np.isfinite(dx) & np.isfinite(dy)
    return Borders(px, py, dx, dy, sound)


def _nearest(b: Borders, fastest: Floats, wish: tuple[Floats, Floats], *, along: bool) -> tuple[Floats, Floats, Rows]:
    """The allowed point nearest to a wish in a circle, or with `along` the farthest along a wish, which is a unit vector then:
    one border after the other. Gives also which border left none (the number of borders where none did); the point is then that
    of before."""
    n, most = b.px.shape
    if along:
        x, y = wish[0] * fastest, wish[1] * fastest
    else:
        size = np.sqrt(wish[0] * wish[0] + wish[1] * wish[1])
        part = np.where(size > fastest, fastest / np.where(size > 0, size, 1.0), 1.0)
        x, y = wish[0] * part, wish[1] * part
    failed = np.full(n, most, np.intp)
    for k in range(most):
        rows = np.flatnonzero((failed == most) & (b.beyond(k, x, y) > 0))
        if rows.size:
            nx, ny, good = _on_border(b.of(rows), k, fastest[rows], (wish[0][rows], wish[1][rows]), along)
            x[rows], y[rows] = np.where(good, nx, x[rows]), np.where(good, ny, y[rows])
            failed[rows[~good]] = k
    return x, y, failed


def _on_border(b: Borders, k: int, fastest: Floats, wish: tuple[Floats, Floats], along: bool) -> tuple[Floats, Floats, Flags]:
    """The same on the k-th border alone, within the circle and what the borders before it allow; False where that is nothing."""
    px, py, dx, dy = b.px[:, k], b.py[:, k], b.dx[:, k], b.dy[:, k]
    middle = px * dx + py * dy
    room = middle * middle + fastest * fastest - (px * px + py * py)
    half = np.sqrt(np.maximum(room, 0.0))
    low, high = -middle - half, -middle + half
    good = room >= 0
    if k:
        before = b.up_to(k)
        cross = dx[:, None] * before.dy - dy[:, None] * before.dx
        away = before.dx * (py[:, None] - before.py) - before.dy * (px[:, None] - before.px)
        level = np.abs(cross) <= _PARALLEL
        at = away / np.where(level, 1.0, cross)
        there = before.there & ~level
        high = np.minimum(high, np.where(there & (cross > 0), at, np.inf).min(axis=1))
        low = np.maximum(low, np.where(there & (cross < 0), at, -np.inf).max(axis=1))
        good &= ~(before.there & level & (away < 0)).any(axis=1) & (low <= high)
    if along:
        t = np.where(wish[0] * dx + wish[1] * dy > 0, high, low)
    else:
        t = np.minimum(np.maximum(dx * (wish[0] - px) + dy * (wish[1] - py), low), high)
    return px + t * dx, py + t * dy, good


def _least_forbidden(b: Borders, fastest: Floats, x: Floats, y: Floats, failed: Rows) -> tuple[Floats, Floats]:
    """Where no point is allowed: that which is least far beyond any border, from the point that those before the `failed` one
    allow (section 5.3: a linear program in three dimensions, by projection)."""
    deepest = np.zeros(len(x))
    for k in range(b.px.shape[1]):
        rows = np.flatnonzero((failed <= k) & (b.beyond(k, x, y) > deepest))
        if not rows.size:
            continue
        some = b.of(rows)
        if k:
            nx, ny, missed = _nearest(_between(some, k), fastest[rows], (-some.dy[:, k], some.dx[:, k]), along=True)
            good = missed == k  # else by rounding alone: the point is on the border already
        else:
            nx, ny, good = -some.dy[:, k] * fastest[rows], some.dx[:, k] * fastest[rows], np.ones(len(rows), np.bool_)
        x[rows], y[rows] = np.where(good, nx, x[rows]), np.where(good, ny, y[rows])
        deepest[rows] = some.beyond(k, x[rows], y[rows])
    return x, y


def _between(b: Borders, k: int) -> Borders:
    """Of each border before the k-th the half-plane of points that are no farther beyond it than beyond the k-th."""
    before = b.up_to(k)
    px, py, dx, dy = (getattr(b, name)[:, k : k + 1] for name in ("px", "py", "dx", "dy"))
    cross = dx * before.dy - dy * before.dx
    level = np.abs(cross) <= _PARALLEL
    part = (before.dx * (py - before.py) - before.dy * (px - before.px)) / np.where(level, 1.0, cross)
    qx = np.where(level, 0.5 * (px + before.px), px + part * dx)
    qy = np.where(level, 0.5 * (py + before.py), py + part * dy)
    wx, wy = before.dx - dx, before.dy - dy
    size = np.sqrt(wx * wx + wy * wy)
    there = before.there & (size > _LEAST) & ~(level & (dx * before.dx + dy * before.dy > 0))
    over = np.where(size > _LEAST, size, 1.0)
    return Borders(qx, qy, wx / over, wy / over, there)
