"""Walking over triangles: straight lines that unfold across edges, climb what stands in the way and stop at open borders.
Exact in float64: the point never leaves its triangle, and the way walked is as long as asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import NO_LINK, Topology
from antdsl.numerics.vectors import dot, stacked_cross

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

CROSSINGS = 400  # of edges in one step, after which an agent waits for the next
STUCK = 24  # crossings after which a walker is moved off the corner that it may be circling
GRAIN = 1e-7  # of a face: how far it is moved
INWARD = 1e-6  # of a direction along a border: off it, or rounding would ask about it again and again
HOPS = 6  # from surface to surface, or turns along a border, in one step


@dataclass(frozen=True, slots=True)
class Landing:
    """Where walkers step over to: which of those asked (`who`), the face, its weights, the side, the way to there (`gone`) on the
    level that is `rise` above their own face, in mm, and for whom the way ends there (`shut`), as nothing leads on."""

    who: Index
    face: Index
    b1: Floats
    b2: Floats
    side: Floats
    gone: Floats
    rise: Floats
    shut: NDArray[np.bool_]

    @staticmethod
    def nowhere() -> Landing:
        who, face = np.empty((2, 0), np.int64)
        b1, b2, side, gone, rise = np.empty((5, 0))
        return Landing(who, face, b1, b2, side, gone, rise, np.empty(0, bool))

    def take(self, rows: Index | NDArray[np.bool_]) -> Landing:
        b1, b2, side, gone, rise = (v[rows] for v in (self.b1, self.b2, self.side, self.gone, self.rise))
        return Landing(self.who[rows], self.face[rows], b1, b2, side, gone, rise, self.shut[rows])


class Surroundings(Protocol):
    """What a walk asks about surfaces that are not linked to the one walked on."""

    def ahead(self, walkers: Walkers, rows: Index, length: Floats) -> Landing:
        """What stands in the way of `rows` within `length` along their face."""

    def beyond(self, walkers: Walkers, rows: Index, half: Index) -> Landing:
        """Where `rows`, who stand on the open border half-edges `half`, can step over to."""


@dataclass(slots=True)
class Walkers:
    """Where agents are and head for: face, weights of its corners, side (1 = of the normal, -1), a unit direction and a
    heading in the face's frame, the way left and the way gone in mm, and how far above the border of their face those are who
    are stepping over it (mm, 0 for others). All arrays have one length. With `straight` their ways end at open borders."""

    face: Index
    b1: Floats
    b2: Floats
    side: Floats
    c: Floats
    s: Floats
    heading_c: Floats
    heading_s: Floats
    left: Floats
    gone: Floats
    blocked: NDArray[np.bool_]
    over: Floats
    straight: bool = False

    def place(self, table: Topology, rows: Index | slice = slice(None)) -> Floats:
        """Positions on their faces, (3, k)."""
        f = self.face[rows]
        return (
            table.corner.take(f, axis=1)
            + self.b1[rows] * table.edge1.take(f, axis=1)
            + self.b2[rows] * table.edge2.take(f, axis=1)
        )

    def up(self, table: Topology, rows: Index | slice = slice(None)) -> Floats:
        """Normal of the face on the walker's side, (3, k)."""
        return table.normal.take(self.face[rows], axis=1) * self.side[rows]

    def direction(self, table: Topology, rows: Index | slice = slice(None)) -> Floats:
        """Unit direction of travel, (3, k)."""
        return in_space(table, self.face[rows], self.c[rows], self.s[rows])


def in_space(table: Topology, face: Index, c: Floats, s: Floats) -> Floats:
    """A vector of a face's frame as (3, k)."""
    return table.axis1.take(face, axis=1) * c + table.axis2.take(face, axis=1) * s


def in_frame(table: Topology, face: Index, v: Floats) -> tuple[Floats, Floats]:
    """The part of vectors (3, k) that lies in their face, in its frame."""
    return dot(table.axis1.take(face, axis=1), v), dot(table.axis2.take(face, axis=1), v)


def laid_down(axes: tuple[Floats, Floats], v: Floats, c0: Floats | float, s0: Floats | float) -> tuple[Floats, Floats, Floats]:
    """Vectors (3, n) laid into their face: unit (c, s) in its frame, (c0, s0) where nothing is left, and a length."""
    c, s = dot(axes[0], v), dot(axes[1], v)
    flat = np.sqrt(c * c + s * s)
    usable = flat > 1e-150
    size = np.where(usable, flat, 1.0)
    # Up to 60 degrees off the surface the length is kept; beyond, it falls steadily to nothing.
    length = np.minimum(np.sqrt(dot(v, v)), 2 * flat)
    return np.where(usable, c / size, c0), np.where(usable, s / size, s0), np.where(usable, length, 0.0)


def walk(table: Topology, walkers: Walkers, near: NDArray[np.bool_], around: Surroundings) -> None:
    """Use up the way left of all walkers. Only those `near` other surfaces look out for what is in their way, and those who come
    to stand on another: `near` is changed."""
    hops = np.zeros(walkers.face.size, np.int8)
    hang(table, walkers, np.flatnonzero((walkers.over != 0) & (walkers.left > 0)), near, hops, around)
    rows = np.flatnonzero((walkers.left > 0) & (walkers.over == 0))
    for turn in range(CROSSINGS):
        if not rows.size:
            return
        if turn >= STUCK and turn % STUCK == 0:
            _leave_corner(walkers, rows)
        rows = _stretch(table, walkers, rows, near, hops, around)
    walkers.left[rows] = 0.0


def _stretch(
    table: Topology, w: Walkers, rows: Index, near: NDArray[np.bool_], hops: NDArray[np.int8], around: Surroundings
) -> Index:
    """Walk `rows` to the end of their way or the edge of their face and across; returns those with way left."""
    everyone = rows.size == w.face.size
    f = w.face if everyone else w.face.take(rows)
    b1, b2, c, s, left = (v if everyone else v.take(rows) for v in (w.b1, w.b2, w.c, w.s, w.left))
    rate1 = c * table.rate1.take(f) - s * table.shear.take(f)
    rate2 = s * table.rate2.take(f)
    until, edge = _way_out((1.0 - b1 - b2, b1, b2), (-(rate1 + rate2), rate1, rate2))
    length = np.minimum(until, left)
    met = climb(table, w, rows, near, length, hops, around)
    on: Index | slice = slice(None) if everyone else rows
    if met is not None:
        stays = np.flatnonzero(~met)
        on = rows.take(stays)
        edge = edge.take(stays)
        until, length, left, rate1, rate2, b1, b2 = (v.take(stays) for v in (until, length, left, rate1, rate2, b1, b2))
    w.b1[on], w.b2[on] = inside(b1 + rate1 * length, b2 + rate2 * length)
    across = np.flatnonzero(until < left)  # before `left`, which may be the walkers' own array, is written
    w.left[on] = np.where(until >= left, 0.0, left - length)
    w.gone[on] += length
    if across.size:
        _cross(table, w, across if isinstance(on, slice) else on.take(across), edge.take(across), near, hops, around)
    return rows[w.left.take(rows) > 0]


def _way_out(weights: tuple[Floats, Floats, Floats], rates: tuple[Floats, Floats, Floats]) -> tuple[Floats, Index]:
    """How far it is to the edge of the face, given weights of its corners and their change per mm, and which edge: the first
    of those opposite corners 0, 1, 2 that are as near."""
    first, second, third = (np.where(r < 0, np.maximum(b, 0.0) / -r, np.inf) for b, r in zip(weights, rates, strict=True))
    nearer = second < first
    until = np.minimum(first, second)
    edge = nearer.astype(np.int64)
    edge[third < until] = 2
    return np.minimum(until, third), edge


def inside(b1: Floats, b2: Floats) -> tuple[Floats, Floats]:
    """Weights moved to the nearest that are of a point of the triangle, against rounding."""
    b1, b2 = np.clip(b1, 0.0, 1.0), np.clip(b2, 0.0, 1.0)
    total = np.maximum(b1 + b2, 1.0)
    return b1 / total, b2 / total


def nearest(edge1: Floats, edge2: Floats, v: Floats) -> tuple[Floats, Floats, Floats]:
    """Weights of the points of triangles nearest to places `v` (3, k) from their first corner, and how far off these are: above
    the inside, else on an edge."""
    edge3 = edge2 - edge1
    d11, d12, d22, d33 = dot(edge1, edge1), dot(edge1, edge2), dot(edge2, edge2), dot(edge3, edge3)
    w1, w2 = dot(v, edge1), dot(v, edge2)
    size = d11 * d22 - d12 * d12
    b1, b2 = (d22 * w1 - d12 * w2) / size, (d11 * w2 - d12 * w1) / size
    within = (size > 0) & (b1 >= 0) & (b2 >= 0) & (b1 + b2 <= 1.0)
    one, two = np.clip(w1 / d11, 0.0, 1.0), np.clip(w2 / d22, 0.0, 1.0)
    three = np.clip(dot(v - edge1, edge3) / d33, 0.0, 1.0)
    best = np.where(within, 0.0, np.inf)
    for x, y in ((one, 0.0 * two), (0.0 * one, two), (1.0 - three, three)):
        off = v - edge1 * x - edge2 * y
        square = dot(off, off)
        nearer = square < best
        b1, b2, best = np.where(nearer, x, b1), np.where(nearer, y, b2), np.where(nearer, square, best)
    off = v - edge1 * b1 - edge2 * b2
    return b1, b2, np.sqrt(dot(off, off))


def _leave_corner(w: Walkers, rows: Index) -> None:
    w.b1[rows] = w.b1[rows] * (1 - GRAIN) + GRAIN / 3
    w.b2[rows] = w.b2[rows] * (1 - GRAIN) + GRAIN / 3


def climb(
    table: Topology,
    w: Walkers,
    rows: Index,
    near: NDArray[np.bool_],
    length: Floats,
    hops: NDArray[np.int8],
    around: Surroundings,
) -> NDArray[np.bool_] | None:
    """Step over to surfaces that stand in the way; says which of `rows` did so, None when none can."""
    asked = np.flatnonzero(near[rows])
    if not asked.size:
        return None
    landing = around.ahead(w, rows[asked], length[asked])
    if not landing.who.size:
        return None
    met = np.zeros(rows.size, bool)
    met[asked[landing.who]] = True
    _land(table, w, rows[asked], landing, hops)
    return met


def _land(table: Topology, w: Walkers, asked: Index, landing: Landing, hops: NDArray[np.int8]) -> None:
    """Put walkers on another face, turning direction and heading as the normal turns."""
    rows = asked[landing.who]
    before, direction = w.up(table, rows), w.direction(table, rows)
    heading = in_space(table, w.face[rows], w.heading_c[rows], w.heading_s[rows])
    after = table.normal.take(landing.face, axis=1) * landing.side
    for to_c, to_s, vector in ((w.c, w.s, direction), (w.heading_c, w.heading_s, heading)):
        c, s = in_frame(table, landing.face, turned(vector, before, after, direction))
        size = np.sqrt(c * c + s * s)
        usable = size > 1e-9
        to_c[rows] = np.where(usable, c / np.where(usable, size, 1.0), 1.0)
        to_s[rows] = np.where(usable, s / np.where(usable, size, 1.0), 0.0)
    w.face[rows], w.b1[rows], w.b2[rows], w.side[rows] = landing.face, landing.b1, landing.b2, landing.side
    w.left[rows] = np.maximum(w.left[rows] - landing.gone, 0.0)
    w.gone[rows] += landing.gone
    shut = rows[landing.shut]
    w.left[shut], w.blocked[shut] = 0.0, True
    _spend_hop(w, rows, hops)


def turned(v: Floats, before: Floats, after: Floats, direction: Floats) -> Floats:
    """Vectors turned by the least turn that takes one unit normal into another; half a turn goes over `direction`."""
    cosine = dot(before, after)
    opposite = cosine < -1 + 1e-9
    axis = stacked_cross(before, after)
    part = dot(axis, v) / np.where(opposite, 1.0, 1 + cosine)
    around = cosine * v + stacked_cross(axis, v) + part * axis
    hinge = stacked_cross(before, direction)
    return np.where(opposite, 2 * dot(hinge, v) * hinge - v, around)


def _spend_hop(w: Walkers, rows: Index, hops: NDArray[np.int8]) -> None:
    hops[rows] += 1
    spent = rows[hops[rows] >= HOPS]
    w.left[spent] = 0.0
    w.blocked[spent] = True


def _cross(
    table: Topology,
    w: Walkers,
    rows: Index,
    edge: Index,
    near: NDArray[np.bool_],
    hops: NDArray[np.int8],
    around: Surroundings,
) -> None:
    """Unfold walkers who stand on the edge opposite a corner of their face into the faces beyond."""
    half = 3 * w.face.take(rows) + edge
    side = w.side.take(rows)
    link = table.link[0].take(half)
    if table.forked:
        link = np.where(side < 0, table.link[1].take(half), link)
    shut = link == NO_LINK
    if shut.any():
        border(table, w, rows[shut], half[shut], near, hops, around)
        rows, half, link, edge, side = (v[~shut] for v in (rows, half, link, edge, side))
    there, k2, flip = (link >> 3).astype(np.int64), (link >> 1) & 3, (link & 1).astype(bool)
    half2 = 3 * there + k2
    b1, b2 = w.b1.take(rows), w.b2.take(rows)
    b0 = 1.0 - b1 - b2
    # The corners after the opposite one carry the point; the face beyond counts them the other way round, unless flipped.
    first, second = np.where(edge == 0, b1, np.where(edge == 1, b2, b0)), np.where(edge == 0, b2, np.where(edge == 1, b0, b1))
    first, second = np.where(flip, first, second), np.where(flip, second, first)
    c1, s1, c2, s2 = table.edge_c.take(half), table.edge_s.take(half), table.edge_c.take(half2), table.edge_s.take(half2)
    turn = np.where(flip, 1.0, -1.0)
    for to_c, to_s in ((w.c, w.s), (w.heading_c, w.heading_s)):
        c, s = to_c.take(rows), to_s.take(rows)
        along, out = turn * (c * c1 + s * s1), c * s1 - s * c1
        to_c[rows], to_s[rows] = along * c2 - out * s2, along * s2 + out * c2
    w.b1[rows] = np.maximum(np.where(k2 == 0, first, np.where(k2 == 1, 0.0, second)), 0.0)
    w.b2[rows] = np.maximum(np.where(k2 == 0, second, np.where(k2 == 1, first, 0.0)), 0.0)
    w.side[rows] = np.where(flip, -side, side)
    w.face[rows] = there


def border(
    table: Topology,
    w: Walkers,
    rows: Index,
    half: Index,
    near: NDArray[np.bool_],
    hops: NDArray[np.int8],
    around: Surroundings,
) -> None:
    """Step over an open border where something lies beyond it, up or down to its level and then across; else walk along it as far
    as the way leads along, or stop where ways are to be straight. What takes more than the way left is gone on with in the next
    step."""
    landing = around.beyond(w, rows, half)
    onto = np.full(rows.size, -1, np.int64)
    onto[landing.who] = np.arange(landing.who.size)
    level = np.zeros(rows.size)
    level[landing.who] = landing.rise
    there = rise(w, rows, level)
    across = there & (onto >= 0)
    across[across] = w.left[rows[across]] >= landing.gone[onto[across]]
    landed = rows[across]
    if landed.size:
        near[landed] = True
        w.over[landed] = 0.0
        _land(table, w, rows, landing.take(onto[across]), hops)
    waits = rows[~across & ((onto >= 0) | ~there)]
    w.blocked[waits] |= w.gone[waits] == 0  # a whole step is too short for the gap
    w.left[waits] = 0.0
    along = there & (onto < 0)
    rows, half = rows[along], half[along]
    c, s = table.edge_c[half], table.edge_s[half]
    part = w.c[rows] * c + w.s[rows] * s
    turn = np.where(part < 0, -1.0, 1.0)
    w.c[rows], w.s[rows] = turn * c - INWARD * s, turn * s + INWARD * c
    w.left[rows] = 0.0 if w.straight else w.left[rows] * np.abs(part)
    w.blocked[rows] = True
    _spend_hop(w, rows, hops)


def rise(w: Walkers, rows: Index, level: Floats) -> NDArray[np.bool_]:
    """Go up or down over a border to a level (mm above the own face), as far as the way left lasts; says who came there."""
    over, left = w.over[rows], w.left[rows]
    most = level - over
    climb = np.minimum(np.abs(most), left)
    there: NDArray[np.bool_] = climb >= np.abs(most)
    w.over[rows] = np.where(there, level, over + np.where(most < 0, -climb, climb))
    w.left[rows], w.gone[rows] = left - climb, w.gone[rows] + climb
    return there


def hang(table: Topology, w: Walkers, rows: Index, near: NDArray[np.bool_], hops: NDArray[np.int8], around: Surroundings) -> None:
    """Those who are stepping over a border go on with it, or back where they have turned away from it."""
    if not rows.size:
        return
    half, outward = hung(table, w, rows)
    rise(w, rows[~outward], np.zeros(np.count_nonzero(~outward)))
    w.left[rows[~outward]] = np.where(w.over[rows[~outward]] == 0, w.left[rows[~outward]], 0.0)
    if outward.any():
        border(table, w, rows[outward], half[outward], near, hops, around)


def hung(table: Topology, w: Walkers, rows: Index) -> tuple[Index, NDArray[np.bool_]]:
    """The open border half-edge over which walkers step, and whether they head out over it."""
    half = 3 * w.face[rows] + np.arange(3)[:, None]
    b1, b2 = w.b1[rows], w.b2[rows]
    shut = table.link[np.where(w.side[rows] < 0, 1, 0), half] == NO_LINK
    half = half[np.where(shut, [1.0 - b1 - b2, b1, b2], np.inf).argmin(axis=0), np.arange(rows.size)]
    return half, w.c[rows] * table.edge_s[half] - w.s[rows] * table.edge_c[half] > 0
