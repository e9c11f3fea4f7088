"""What lies around walkers besides the surface that they are on: rays that find it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.clearances import Parts
from antdsl.runtime.senses.topology import NO_LINK, Topology
from antdsl.runtime.senses.walk import Landing, Walkers, dot, in_frame, in_space

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Cast = Callable[[Floats, Floats, int], tuple[Floats, Index]]
Met = tuple[Index, Floats, Floats, Floats]  # face (-1 for none), place, way that led there (3, k), mm gone
Weights = Callable[[Index, Floats], tuple[Floats, Floats]]

LIFT = 0.02  # of a body: how far above the surface an agent looks ahead
GAP = 0.02  # of a body: how far beyond a border it looks down
HIGH, DEEP = 0.5, 0.25  # of a body: how far above and below a border it looks, and how deep back
BEYOND = 0.6  # of a body: all that it looks at beyond a border and back below is nearer, but for noise
NOISE = 1e-4  # of the extent of a ground: float32 rays err by less
SKIP = 0.01  # of that noise: how far beyond the own surface, where that hides others, a ray goes on
SHY = 0.1  # of what rays err: how near to a wall no way ends
TURNED = -np.sqrt(0.5)  # cosine between the normals of two surfaces, below which the second is the back of the first
AGAIN = 4  # times that it goes on
TOUCH = 1e-5  # of that noise: how near feet are to what cuts their face when they are on it
OFF = 16.0  # touches that they are put off the face they left: beyond all that is taken for its border
STEEP = 1e-6  # square of the sine of the angle of a cut, below which feet are not moved further off it
LEANING = 1e3  # way along a face for each mm up, above which it is as good as lying


class Around:
    """Rays of walkers against all surfaces of a ground: what stands in their way and what continues beyond a border.

    Rays err by less than the first of `errors` (mm); feet are no more than the second below what they should be on.
    """

    def __init__(
        self,
        table: Topology,
        cast: Cast,
        weights: Weights,
        parts: Parts,
        noise: float,
        errors: tuple[float, float],
        body: Floats,
        threads: int,
    ) -> None:
        self._table, self._cast, self._weights, self._parts = table, cast, weights, parts
        self._body, self._threads = body, threads
        self._noise, self._errors = noise, errors
        self._rounding, self._grain = errors

    def of(self, agents: Index) -> Around:
        """The same for some of the agents, whose numbers count from 0."""
        body = self._body.take(agents)
        return Around(self._table, self._cast, self._weights, self._parts, self._noise, self._errors, body, self._threads)

    def near(self, walkers: Walkers, rows: Index | slice, length: Floats) -> NDArray[np.bool_]:
        """Who of `rows` may meet another piece of surface within `length`."""
        clear = self._parts.of(walkers.face[rows], walkers.b1[rows], walkers.b2[rows])
        return clear <= length + np.fmax(LIFT * self._body[rows], self._noise) + self._noise

    def ahead(self, walkers: Walkers, rows: Index, length: Floats) -> Landing:
        """What stands in the way: what cuts the own face, or another piece that is nearer."""
        asked = np.flatnonzero(self.near(walkers, rows, length))
        if not asked.size:
            return _nothing()
        rows, length = rows.take(asked), length.take(asked)
        face, hit, towards, gone, shut = self._cut(walkers, rows, length)
        if self._table.pieces > 1:
            other, there, down, before = self._other(walkers, rows, gone)
            met = np.flatnonzero(other >= 0)
            face[met], gone[met], shut[met] = other[met], before[met], False
            hit[:, met], towards[:, met] = there[:, met], down[:, met]
        who = np.flatnonzero((face >= 0) & (length > 0))
        if not who.size:
            return _nothing()
        return self._landing(asked[who], face[who], hit[:, who], towards[:, who], gone[who], shut[who])

    def _cut(self, walkers: Walkers, rows: Index, length: Floats) -> tuple[Index, Floats, Floats, Floats, NDArray[np.bool_]]:
        """The first face of the own piece that cuts the own face across the way: from there the way goes on upon it. It ends
        there, as the last array says, before the other side of an open sheet, and where there is no room.

        No eye looks for it, for at a cut every height above the feet is in another room somewhere. Feet keep off what cuts their
        face by more than a touch on the side they are on, which is a thousand times what float64 rounds: so they are always on
        one side of it.
        """
        t, touch = self._table, TOUCH * self._noise
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        face, gone, hit = np.full(rows.size, -1, np.int64), length.copy(), place + way * length
        shut = np.zeros(rows.size, bool)
        which, other = t.cuts.of(walkers.face.take(rows))
        if not which.size:
            return face, hit, way, gone, shut
        normal, step = t.normal.take(other, axis=1), way.take(which, axis=1)
        begins = dot(normal, place.take(which, axis=1) - t.corner.take(other, axis=1))
        ends = begins + dot(normal, step) * length.take(which)
        through = (begins * ends <= 0) | ((np.abs(ends) <= touch) & (np.abs(ends) < np.abs(begins)))
        through &= (np.abs(begins) > touch) & self._rises(other, place.take(which, axis=1), up.take(which, axis=1))
        which, other, begins, ends, step, normal = (v[..., through] for v in (which, other, begins, ends, step, normal))
        before = np.clip(begins / np.where(begins != ends, begins - ends, 1.0), 0.0, 1.0) * length.take(which)
        there = place.take(which, axis=1) + step * before
        inside = self._inside(other, there, 4 * touch) & self._leads_through(walkers, rows.take(which), other, begins, there)
        which, other, before, there, normal, step = (v[..., inside] for v in (which, other, before, there, normal, step))
        # Off what was left, or which side of it feet are on could not be told in the next step; and so upon what is first there.
        risen, towards = up.take(which, axis=1), dot(normal, step)
        leans = -dot(risen, normal) / np.where(towards != 0, towards, 1.0)
        order = np.lexsort((other, before + OFF * touch * np.clip(leans, -LEANING, LEANING), which))
        begin = np.unique(which[order], return_index=True)[1]
        first, soonest = order[begin], np.minimum.reduceat(before[order], begin) if begin.size else before
        which, other, risen, normal, there = which[first], other[first], risen[:, first], normal[:, first], there[:, first]
        steep = risen - dot(risen, normal) * normal
        off = steep * (OFF * touch / np.maximum(dot(steep, steep), STEEP))
        face[which], gone[which], hit[:, which] = other, before[first], there + off
        own, side = walkers.face.take(rows[which]), walkers.side.take(rows[which])
        back = ~self._together(own, side, other, self._side(other, way[:, which]))
        ends = np.flatnonzero(back | self._tight(other, own, there, off))
        # Up to where feet keep off what they come to, or, in a corner, not at all.
        near = soonest[ends] - OFF * touch / np.maximum(np.abs(towards[first[ends]]), 1 / LEANING)
        stop, near = which[ends], np.where(back[ends], np.maximum(near, 0.0), 0.0)
        face[stop], gone[stop], shut[stop] = own[ends], near, True
        hit[:, stop], way[:, stop] = place[:, stop] + way[:, stop] * near, -up[:, stop]
        return face, hit, way, gone, shut

    def _tight(self, face: Index, own: Index, place: Floats, off: Floats) -> NDArray[np.bool_]:
        """Where three sheets meet: whether feet put upon a face at a place, and `off` from their own face, would be through a
        third one or touch it. They stay where they are, then."""
        t, touch = self._table, TOUCH * self._noise
        found = np.zeros(face.size, bool)
        which, third = t.cuts.of(face)
        which, third = (v[third != own.take(which)] for v in (which, third))
        normal = t.normal.take(third, axis=1)
        begins = dot(normal, place.take(which, axis=1) - t.corner.take(third, axis=1))
        ends = begins + dot(normal, off.take(which, axis=1))
        met = ((begins * ends < 0) & (np.abs(begins) > touch)) | (np.abs(ends) <= touch)
        met &= self._inside(third, place.take(which, axis=1), 2 * OFF * touch)
        found[which[met]] = True
        return found

    def _rises(self, face: Index, place: Floats, up: Floats) -> NDArray[np.bool_]:
        """Whether faces go up from the plane in which feet are: else they are under the sheet that is walked on."""
        t = self._table
        height = dot(up, t.corner.take(face, axis=1) - place)
        ends = (dot(up, edge.take(face, axis=1)) for edge in (t.edge1, t.edge2))
        risen: NDArray[np.bool_] = height + np.fmax(np.fmax(*ends), 0.0) > TOUCH * self._noise
        return risen

    def _leads_through(self, walkers: Walkers, rows: Index, other: Index, begins: Floats, there: Floats) -> NDArray[np.bool_]:
        """Whether the way of `rows`, that comes to the plane of `other` faces from heights `begins` at `there`, goes on behind
        it, or ends. Where the own face only touches the other one, it may be folded back there into a wedge that has no room."""
        t = self._table
        sign, own = np.where(begins < 0, -1.0, 1.0), walkers.face.take(rows)
        on = np.ones(rows.size, bool)
        touching = np.flatnonzero(self._lowest(own, other, sign) >= -TOUCH * self._noise)
        if touching.size:
            own, other, sign = own[touching], other[touching], sign[touching]
            b1, b2 = self._weights(own, there[:, touching])
            edge = np.argmin([1.0 - b1 - b2, b1, b2], axis=0)
            link = t.link[np.where(walkers.side.take(rows[touching]) < 0, 1, 0), 3 * own + edge]
            beyond = np.where(link == NO_LINK, own, link >> 3)
            on[touching] = (link == NO_LINK) | (self._lowest(beyond, other, sign) < -TOUCH * self._noise)
        return on

    def _lowest(self, face: Index, other: Index, sign: Floats) -> Floats:
        """Height of the lowest corner of faces over the planes of others, whose upper side is that of their normal by `sign`."""
        t = self._table
        up = t.normal.take(other, axis=1) * sign
        first = dot(up, t.corner.take(face, axis=1) - t.corner.take(other, axis=1))
        one, two = (dot(up, edge.take(face, axis=1)) for edge in (t.edge1, t.edge2))
        return first + np.minimum(np.minimum(one, two), 0.0)

    def _inside(self, face: Index, place: Floats, touch: float) -> NDArray[np.bool_]:
        """Whether places in the planes of faces are in these, or no more than about `touch` mm beside them."""
        t = self._table
        c, s = in_frame(t, face, place - t.corner.take(face, axis=1))
        rate1, rate2, shear = t.rate1.take(face), t.rate2.take(face), t.shear.take(face)
        b1, b2 = c * rate1 - s * shear, s * rate2
        over = touch * (np.abs(rate1) + np.abs(rate2) + np.abs(shear))
        found: NDArray[np.bool_] = (b1 >= -over) & (b2 >= -over) & (b1 + b2 <= 1 + over)
        return found

    def _other(self, walkers: Walkers, rows: Index, length: Floats) -> Met:
        """Another piece of surface within the way, seen from just above the ground, below a low ceiling from half its
        height; or at the way's end between that eye and the ground."""
        t = self._table
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        lift = np.fmax(LIFT * self._body.take(rows), self._noise)
        own = walkers.face.take(rows)
        high = lift.copy()
        below = np.flatnonzero(self.near(walkers, rows, np.zeros(rows.size)))
        if below.size:
            part, face = self._others(place.take(below, axis=1), (up * lift).take(below, axis=1), own.take(below))
            # What shows its back a grain above the agent is below it: feet may be that far in the ground that they climb.
            front = dot(t.normal.take(face, axis=1), up[:, below]) < 0
            low = (face >= 0) & (front | (lift[below] * part > self._grain))
            high[below[low]] = lift[below[low]] * part[low] / 2
        eye = place + up * high
        part, face = self._others(eye, way * length, own)
        gone = np.where(face >= 0, part, 1.0) * length
        hit, towards = eye + way * gone, way
        # What has come between the eye and the ground is below the next eye, that of the face round the edge or of the next step.
        still = np.flatnonzero(face < 0)
        if still.size:
            down = up.take(still, axis=1) * -high.take(still)
            part, face[still] = self._others(hit.take(still, axis=1), down, own.take(still))
            found = face[still] >= 0
            between, down = still[found], down[:, found]
            hit[:, between] += down * part[found]
            towards[:, between] = down
        return face, hit, towards, gone

    def _others(self, origin: Floats, step: Floats, own: Index) -> tuple[Floats, Index]:
        """Where rays hit the first face that is not of the piece of their `own`: that one, at an edge or in a hollow, hides none.

        Rays find faces in float32, a hair before and after their way too; where these are is told in float64. So a way that
        begins where another ended, a thousandth of a hair from a wall, meets it, and one that leads off that wall does not. Nor
        does a way end nearer to a wall before it than rays can tell: round an edge the eye might be behind it.
        """
        length = np.sqrt(dot(step, step))
        hair = self._rounding / np.maximum(length, 1e-300)
        begin, part, face = -hair, np.full(length.size, np.inf), np.full(length.size, -1, np.int64)
        rows = np.arange(length.size)
        for _ in range(AGAIN + 1):
            rest = 1.0 + hair.take(rows) - begin.take(rows)
            on = step.take(rows, axis=1)
            met, there = self._cast(origin.take(rows, axis=1) + on * begin.take(rows), on * rest, self._threads)
            rows, met, there, rest = (v[there >= 0] for v in (rows, met, there, rest))
            if not rows.size:
                break
            at = begin.take(rows) + met * rest
            exact, short = self._crossing(origin.take(rows, axis=1), step.take(rows, axis=1), there, at)
            found = self._table.piece.take(own.take(rows)) != self._table.piece.take(there)
            found &= (exact >= 0) & ((exact <= 1) | (short <= SHY * self._rounding))
            part[rows[found]], face[rows[found]] = np.minimum(exact[found], 1.0), there[found]
            rows, at = rows[~found], at[~found]
            begin[rows] = at + SKIP * self._noise / np.maximum(length.take(rows), 1e-300)
            rows = rows[begin.take(rows) < 1.0 + hair.take(rows)]
        return part, face

    def _crossing(self, origin: Floats, step: Floats, face: Index, at: Floats) -> tuple[Floats, Floats]:
        """After what part of their step rays cross the planes of faces that they meet after about `at` of it, and how far from
        these they end."""
        normal = self._table.normal.take(face, axis=1)
        towards = dot(normal, step)
        apart = dot(normal, self._table.corner.take(face, axis=1) - origin)
        part = np.where(towards != 0, apart / np.where(towards != 0, towards, 1.0), at)
        return part, np.abs(apart - towards)

    def beyond(self, walkers: Walkers, rows: Index, half: Index) -> Landing:
        """Past the open border half-edges `half` where `rows` stand: what is met first on a way that leads up off the own face,
        out over the border and down beyond it, and then back towards it from below, a little and deeper.

        Each part of that way begins where the one before it ended and goes no further than the first surface in it: so nothing
        behind a sheet is stepped onto. It is as wide as the gap that is stepped over, on both sides of the border.
        """
        t = self._table
        place, up = walkers.place(t, rows), walkers.up(t, rows)
        out = in_space(t, walkers.face.take(rows), t.edge_s.take(half), -t.edge_c.take(half))
        body = np.maximum(self._body.take(rows), 2 * self._noise)
        gap = np.maximum(GAP * body, self._noise)
        high = self._room(place, up, HIGH * body)
        shut = self._first(place + up * high, out * gap)[0] >= 0
        high = np.where(shut, np.minimum(high, np.maximum(LIFT * body, self._noise)), high)
        low = np.flatnonzero(shut)
        face, hit, towards = np.full(rows.size, -1, np.int64), place.copy(), out.copy()
        face[low], hit[:, low] = self._first((place + up * high).take(low, axis=1), (out * gap).take(low, axis=1))
        open_ = face < 0
        edge = place + out * gap
        below, floor = self._first(edge + up * high, -up * (high + HIGH * body))
        depth = np.where(below >= 0, -dot(floor - place, up), HIGH * body)
        onto = open_ & (below >= 0) & self._leads(walkers, rows, below, -up)
        face, hit, towards = np.where(onto, below, face), np.where(onto, floor, hit), np.where(onto, -up, towards)
        done = ~open_ | onto
        for deep in (gap, DEEP * body):
            asked = np.flatnonzero(~done & (deep < depth))
            back = (-2 * gap * out).take(asked, axis=1)
            wall, there = self._first((edge - up * deep).take(asked, axis=1), back)
            onto = (wall >= 0) & self._leads(walkers, rows.take(asked), wall, back)
            who = asked[onto]
            face[who], hit[:, who], towards[:, who] = wall[onto], there[:, onto], back[:, onto]
            done[asked[wall >= 0]] = True
        who = np.flatnonzero((face >= 0) & self._leads(walkers, rows, face, towards))
        gone = hit[:, who] - place[:, who]
        return self._landing(who, face[who], hit[:, who], towards[:, who], np.sqrt(dot(gone, gone)))

    def _room(self, place: Floats, up: Floats, high: Floats) -> Floats:
        """How high above places there is room, at most `high`: half of it where there is a ceiling."""
        grain = np.fmin(self._noise, high / 2)
        part, face = self._cast(place + up * grain, up * (high - grain), self._threads)
        return np.where(face >= 0, (grain + np.where(face >= 0, part, 0.0) * (high - grain)) / 2, high)

    def _first(self, origin: Floats, step: Floats) -> tuple[Index, Floats]:
        """The first face that rays meet (-1 for none), and where."""
        part, face = self._cast(origin, step, self._threads)
        return face, origin + step * np.where(face >= 0, part, 1.0)

    def _leads(self, walkers: Walkers, rows: Index, face: Index, towards: Floats) -> NDArray[np.bool_]:
        """Who of `rows` may step over a border to the faces that rays meet (-1 for none): nobody to the other side of what is
        walked on, nor to what turns back below it as that side does."""
        own, side = walkers.face.take(rows), self._side(face, towards)
        level = dot(self._table.normal.take(face, axis=1) * side, walkers.up(self._table, rows))
        return (face >= 0) & (face != own) & (level > TURNED) & self._together(own, walkers.side.take(rows), face, side)

    def _together(self, face: Index, side: Floats, other: Index, there: Floats) -> NDArray[np.bool_]:
        """Whether sides of faces are of two pieces or hang together: other sides of the own sheet are never come to."""
        t = self._table
        way = (t.way[np.where(s < 0, 1, 0), f] for f, s in ((face, side), (other, there)))
        found: NDArray[np.bool_] = (t.piece.take(face) != t.piece.take(other)) | np.equal(*way)
        return found

    def _side(self, face: Index, towards: Floats) -> Floats:
        """The side of a face that a ray came from is the side to walk on."""
        return np.where(dot(self._table.normal.take(face, axis=1), towards) > 0, -1.0, 1.0)

    def _landing(
        self, who: Index, face: Index, hit: Floats, towards: Floats, gone: Floats, shut: NDArray[np.bool_] | None = None
    ) -> Landing:
        shut = np.zeros(who.size, bool) if shut is None else shut
        return Landing(who, face, *self._weights(face, hit), self._side(face, towards), gone, shut)


def _nothing() -> Landing:
    return Landing(*np.empty((2, 0), np.int64), *np.empty((4, 0)), np.empty(0, bool))
