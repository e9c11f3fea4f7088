"""What lies around walkers besides the next face of their surface: what stands in their way, what continues beyond a border."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.boxes import Boxes, first_met
from antdsl.ground.mesh.crossings import Met, crossed
from antdsl.ground.mesh.surface_clearance import Parts
from antdsl.ground.mesh.topology import Topology
from antdsl.ground.mesh.walk import Landing, Walkers, in_space, inside, nearest
from antdsl.numerics.vectors import dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

LIFT = 0.02  # of a body: how far above the surface an agent looks ahead
STEEPEST = 8.0  # of that height is the way left at least: who climbs comes up by it besides
GAP = 0.02  # of a body: how far beyond a border it looks for what continues there
HIGH, DEEP = 0.5, 0.25  # of a body: how far above and below a border it looks, and how deep back
NOISE = 1e-4  # of the extent of a ground: more than distances to other pieces err by
LEAST = 1e-6  # of that extent: least height of eyes
FINE = 1e-8  # of that extent: nearer surfaces are at one place
TOUCH = 1e-9  # of that extent: how near feet are to what cuts their face when they are on it
TURNED = -0.17  # cosine between two normals, of about 100 degrees: below it nothing leads from the one over a border to the other


@dataclass(frozen=True, slots=True)
class Scale:
    """Lengths in mm that depend on the size of a ground: NOISE, LEAST, FINE and TOUCH of it, and how far above feet what shows
    its back may be and still be below them."""

    noise: float
    least: float
    fine: float
    touch: float
    under: float

    @staticmethod
    def of(extent: float) -> Scale:
        return Scale(NOISE * extent, LEAST * extent, FINE * extent, TOUCH * extent, 10 * FINE * extent)


class Around:
    """Looks of walkers with a `body` (mm) each: straight ways against all faces, which lie in `boxes`."""

    def __init__(self, table: Topology, boxes: Boxes, parts: Parts, scale: Scale, body: Floats) -> None:
        self._table, self._boxes, self._parts, self._scale, self._body = table, boxes, parts, scale, body

    def near(self, walkers: Walkers, rows: Index | slice, length: Floats) -> NDArray[np.bool_]:
        """Who of `rows` may meet another piece of surface within `length`."""
        clear = self._parts.of(walkers.face[rows], walkers.b1[rows], walkers.b2[rows])
        return clear <= length + np.fmax(LIFT * self._body[rows], self._scale.noise) + self._scale.noise

    def ahead(self, walkers: Walkers, rows: Index, length: Floats) -> Landing:
        """What stands in the way: what cuts the own face, or another piece that is nearer."""
        asked = np.flatnonzero(self.near(walkers, rows, length) & (length > 0))
        if not asked.size:
            return Landing.nowhere()
        rows = rows.take(asked)
        met = crossed(self._table, walkers, rows, length.take(asked), self._scale.touch)
        if self._table.pieces > 1:
            other = self._other(walkers, rows, met.gone)
            nearer = np.flatnonzero(other.face >= 0)
            met.put(nearer, other.take(nearer))
        who = np.flatnonzero(met.face >= 0)
        return self._landing(asked[who], met.take(who))

    def _other(self, walkers: Walkers, rows: Index, length: Floats) -> Met:
        """Another piece of surface within the way, seen from just above the ground; where the own piece lies before it, from a
        grain above, as feet go under that."""
        least = np.full(rows.size, self._scale.least)
        high = np.fmax(np.fmin(LIFT * self._body.take(rows), walkers.left.take(rows) / STEEPEST), least)
        met, hidden = self._seen(walkers, rows, length, high)
        if hidden.size:
            met.put(hidden, self._seen(walkers, rows[hidden], length[hidden], least[hidden])[0])
        return met

    def _seen(self, walkers: Walkers, rows: Index, length: Floats, high: Floats) -> tuple[Met, Index]:
        """Another piece within the way, seen from so high, below a low ceiling from half its height; or at the way's end between
        that eye and the ground. And who of `rows` would come to it through the own piece."""
        t, fine = self._table, self._scale.fine
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        own = walkers.face.take(rows)
        piece = t.piece.take(own)
        roof, part, _, _ = self._first(place, up * high, fine, piece=piece)
        # What shows its back a grain above the agent is below it: feet may be that far in the ground that they climb.
        front = dot(t.normal.take(roof, axis=1), up) < 0
        low = (roof >= 0) & (front | (high * part > self._scale.under))
        high = np.where(low, high * np.where(low, part, 1.0) / 2, high)
        met = Met.nothing(way, length)
        eye, step = place + up * high, way * length
        face, part, b1, b2 = self._first(eye, step, fine, piece=piece)
        found = np.flatnonzero(face >= 0)
        met.face[found], met.b1[found], met.b2[found] = face[found], b1[found], b2[found]
        met.gone[found] = np.minimum(part[found], 1.0) * length[found]
        climb = np.sqrt(met.gone * met.gone + high * high)
        # What has come between the eye and the ground is below the next eye, that of the face round the edge or of the next step.
        still = np.flatnonzero(face < 0)
        down = up * -high
        face, _, b1, b2 = self._first((eye + step).take(still, axis=1), down.take(still, axis=1), 0.0, piece=piece.take(still))
        under = np.flatnonzero(face >= 0)
        between = still[under]
        met.face[between], met.b1[between], met.b2[between] = face[under], b1[under], b2[under]
        met.towards[:, between] = down[:, between]
        met.gone[:] = np.where(met.face >= 0, np.minimum(climb, walkers.left.take(rows)), met.gone)
        asked = np.flatnonzero(met.face >= 0)
        grain, down[:, found] = place + up * fine, 0.0
        hidden = np.zeros(asked.size, bool)
        for start, leg, further in ((grain, up * (high - fine), 0.0), (eye, step, fine), (eye + step, down, 0.0)):
            first = self._first(start.take(asked, axis=1), leg.take(asked, axis=1), further, face=own.take(asked))[0]
            hidden |= (first >= 0) & (t.piece.take(first) == piece.take(asked))
        return met, asked[hidden]

    def beyond(self, walkers: Walkers, rows: Index, half: Index) -> Landing:
        """Past the open border half-edges `half` where `rows` stand: what is met first on a way that leads up off the own face,
        out over the border and down beyond it, and then back towards it from below, a little and deeper.

        Each part of that way begins where the one before it ended and goes no further than the first surface in it: so nothing
        behind a sheet is stepped onto. It is as wide as the gap that is stepped over, on both sides of the border.
        """
        t, own = self._table, walkers.face.take(rows)
        place, up = walkers.place(t, rows), walkers.up(t, rows)
        out = in_space(t, own, t.edge_s.take(half), -t.edge_c.take(half))
        body = np.fmax(self._body.take(rows), self._scale.least / LIFT)
        gap, high, fine = GAP * body, HIGH * body, self._scale.fine
        hair = out * (2 * fine)  # besides a border that ends or begins exactly over or below the own one
        roof, part, _, _ = self._first(place - hair + up * fine, up * (high - fine), 0.0, face=own)
        high = np.where(roof >= 0, (fine + np.where(roof >= 0, part, 0.0) * (high - fine)) / 2, high)
        shut = self._first(place + up * high, out * gap, 0.0, face=own)[0] >= 0
        high = np.where(shut, np.minimum(high, LIFT * body), high)
        face, part, b1, b2 = self._first(place + up * high, out * gap, 0.0, face=own)
        met, rise, done = Met.nothing(out, gap * np.minimum(part, 1.0)), high.copy(), face >= 0
        met.face[:], met.b1[:], met.b2[:] = face, b1, b2
        over = place + out * gap
        fall = -up * (high + HIGH * body)
        face, part, b1, b2 = self._first(over + up * high, fall, 0.0, face=own)
        level = np.where(face >= 0, high - np.where(face >= 0, part, 0.0) * (high + HIGH * body), -HIGH * body)
        onto = np.flatnonzero(~done & self._leads(walkers, rows, face, fall))
        met.face[onto], met.b1[onto], met.b2[onto], met.towards[:, onto] = face[onto], b1[onto], b2[onto], fall[:, onto]
        rise[onto], done[onto] = level[onto], True
        upon = onto
        back = -2 * gap * out
        for deep in (GAP * body, DEEP * body):
            asked = np.flatnonzero(~done & (level < -deep))
            low = (over - up * deep).take(asked, axis=1)
            face, part, b1, b2 = self._first(low, back.take(asked, axis=1), 0.0, face=own.take(asked))
            done[asked[face >= 0]] = True
            onto = np.flatnonzero(self._leads(walkers, rows.take(asked), face, back.take(asked, axis=1)))
            who = asked[onto]
            met.face[who], met.b1[who], met.b2[who], met.towards[:, who] = face[onto], b1[onto], b2[onto], back[:, who]
            rise[who], met.gone[who] = -deep[who], np.abs(gap[who] - part[onto] * (2 * gap[who]))
        # Onto the nearest that there is of what lies below, from where that is not overhead.
        self._nearest(met, rise, own, place, up, high, gap, upon)
        # Down at the border itself, where what was met may be met sooner; straight across to what is near.
        deeper = np.flatnonzero((met.face >= 0) & (rise < -gap))
        fall = (up * (rise + fine)).take(deeper, axis=1)
        edge = (place + hair - up * fine).take(deeper, axis=1)
        face, part, b1, b2 = self._first(edge, fall, 0.0, face=own.take(deeper))
        sooner = np.flatnonzero(face >= 0)
        who = deeper[sooner]
        met.face[who], met.b1[who], met.b2[who], met.towards[:, who] = face[sooner], b1[sooner], b2[sooner], fall[:, sooner]
        rise[who], met.gone[who] = part[sooner] * (rise[who] + fine) - fine, 0.0
        flat = np.abs(rise) <= gap
        met.gone[:] = np.where(flat, np.sqrt(met.gone * met.gone + rise * rise), met.gone)
        rise = np.where(flat, 0.0, rise)
        who = np.flatnonzero(self._leads(walkers, rows, met.face, met.towards))
        return self._landing(who, met.take(who), rise[who])

    def _nearest(
        self, met: Met, rise: Floats, own: Index, place: Floats, up: Floats, high: Floats, gap: Floats, rows: Index
    ) -> None:
        """For `rows` that meet a face from above: the point of it that is nearest to a place over the border which is no lower
        than its plane there, or of what lies between, and how high that place is; changes `met` and `rise`."""
        t, face = self._table, met.face.take(rows)
        place, up, level = place.take(rows, axis=1), up.take(rows, axis=1), rise.take(rows)
        normal, corner = t.normal.take(face, axis=1), t.corner.take(face, axis=1)
        plane = dot(corner - place, normal) / dot(up, normal)
        level = np.where(plane > level, np.minimum(plane, high.take(rows)), level)
        level = np.where(np.abs(level) <= gap.take(rows), 0.0, level)
        above = place + up * level
        edge1, edge2 = t.edge1.take(face, axis=1), t.edge2.take(face, axis=1)
        b1, b2, away = nearest(edge1, edge2, above - corner)
        onto = corner + edge1 * b1 + edge2 * b2 - above
        first, part, one, two = self._first(above, onto, 0.0, face=own.take(rows))
        before = part * away < away - self._scale.fine
        met.face[rows], met.b1[rows], met.b2[rows] = (np.where(before, *v) for v in ((first, face), (one, b1), (two, b2)))
        met.towards[:, rows] = np.where(before, onto, met.towards[:, rows])
        met.gone[rows], rise[rows] = np.where(before, np.where(before, part, 0.0) * away, away), level

    def _first(
        self, origin: Floats, step: Floats, fine: float, face: Index | None = None, piece: NDArray[np.int32] | None = None
    ) -> tuple[Index, Floats, Floats, Floats]:
        """As `first_met`, for ways that go on by `fine` mm."""
        n = origin.shape[1]
        none = np.full(n, -1, np.int32)
        passed, beside = none.astype(np.int64) if face is None else face, none if piece is None else piece
        return first_met(self._boxes, self._table, origin, step, fine, passed, beside)

    def _leads(self, walkers: Walkers, rows: Index, face: Index, towards: Floats) -> NDArray[np.bool_]:
        """Who of `rows` may step over a border to the faces that are met (-1 for none): nobody to the other side of what is
        walked on, nor to what turns back below it as that side does."""
        own, side = walkers.face.take(rows), _side(self._table, face, towards)
        level = dot(self._table.normal.take(face, axis=1) * side, walkers.up(self._table, rows))
        return (face >= 0) & (level > TURNED) & self._table.together(own, walkers.side.take(rows), face, side)

    def _landing(self, who: Index, met: Met, rise: Floats | None = None) -> Landing:
        b1, b2 = inside(met.b1 + 0.0, met.b2 + 0.0)  # no -0.0
        rise = np.zeros(who.size) if rise is None else rise
        return Landing(who, met.face, b1, b2, _side(self._table, met.face, met.towards), met.gone, rise, met.shut)


def _side(table: Topology, face: Index, towards: Floats) -> Floats:
    """The side of a face that a way came from is the side to walk on."""
    return np.where(dot(table.normal.take(face, axis=1), towards) > 0, -1.0, 1.0)
