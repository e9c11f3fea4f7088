"""Where the own piece cuts the face that is walked on: the way goes on upon what cuts it, or ends there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import NO_LINK, Topology
from antdsl.ground.mesh.walk import Walkers, in_frame, inside
from antdsl.numerics.vectors import dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

OFF = 16.0  # touches that feet are put off the face they left: beyond all that is taken for its border
STEEP = 1e-6  # square of the sine of the angle of a cut, below which feet are not moved further off it
LEANING = 1e3  # way along a face for each mm up, above which it is as good as lying


@dataclass(frozen=True, slots=True)
class Met:
    """What ways meet: the face (-1 for none), weights there, the way (3, n) that came to it, the way gone (mm), and for whom it
    ends there (`shut`) as nothing leads on."""

    face: Index
    b1: Floats
    b2: Floats
    towards: Floats
    gone: Floats
    shut: NDArray[np.bool_]

    @staticmethod
    def nothing(towards: Floats, gone: Floats) -> Met:
        n = gone.size
        return Met(np.full(n, -1, np.int64), np.zeros(n), np.zeros(n), towards.copy(), gone.copy(), np.zeros(n, bool))

    def take(self, rows: Index) -> Met:
        face, b1, b2 = self.face.take(rows), self.b1.take(rows), self.b2.take(rows)
        return Met(face, b1, b2, self.towards.take(rows, axis=1), self.gone.take(rows), self.shut.take(rows))

    def put(self, rows: Index, other: Met) -> None:
        """Some rows are those of another."""
        self.face[rows], self.b1[rows], self.b2[rows] = other.face, other.b1, other.b2
        self.towards[:, rows], self.gone[rows], self.shut[rows] = other.towards, other.gone, other.shut


def crossed(table: Topology, walkers: Walkers, rows: Index, length: Floats, touch: float) -> Met:
    """The first face of the own piece that cuts the own face across the way of `rows`: from there the way goes on upon it. It
    ends before the other side of an open sheet, and where there is no room.

    No eye looks for it, for at a cut every height above the feet is in another room somewhere. Feet keep off what cuts their face
    by more than a `touch` (mm) on the side they are on, which is a thousand times what float64 rounds: so they are always on one
    side of it.
    """
    t = table
    way = walkers.direction(t, rows)
    met = Met.nothing(way, length)
    which, other = t.cuts.of(walkers.face.take(rows))
    if not which.size:
        return met
    place, up = walkers.place(t, rows), walkers.up(t, rows)
    normal, step = t.normal.take(other, axis=1), way.take(which, axis=1)
    begins = dot(normal, place.take(which, axis=1) - t.corner.take(other, axis=1))
    ends = begins + dot(normal, step) * length.take(which)
    through = (begins * ends <= 0) | ((np.abs(ends) <= touch) & (np.abs(ends) < np.abs(begins)))
    through &= (np.abs(begins) > touch) & _rises(t, other, place.take(which, axis=1), up.take(which, axis=1), touch)
    which, other, begins, ends = which[through], other[through], begins[through], ends[through]
    step, normal = step[:, through], normal[:, through]
    before = np.clip(begins / np.where(begins != ends, begins - ends, 1.0), 0.0, 1.0) * length.take(which)
    there = place.take(which, axis=1) + step * before
    on = _inside(t, other, there, 4 * touch) & _leads_through(t, walkers, rows.take(which), other, begins, there, touch)
    which, other, before = which[on], other[on], before[on]
    there, normal, step = there[:, on], normal[:, on], step[:, on]
    if not which.size:
        return met
    # Off what was left, or which side of it feet are on could not be told in the next step; and so upon what is first there.
    risen, towards = up.take(which, axis=1), dot(normal, step)
    leans = -dot(risen, normal) / np.where(towards != 0, towards, 1.0)
    order = np.lexsort((other, before + OFF * touch * np.clip(leans, -LEANING, LEANING), which))
    begin = np.unique(which[order], return_index=True)[1]
    first, soonest = order[begin], np.minimum.reduceat(before[order], begin)
    which, other, risen, normal, there = which[first], other[first], risen[:, first], normal[:, first], there[:, first]
    steep = risen - dot(risen, normal) * normal
    off = steep * (OFF * touch / np.maximum(dot(steep, steep), STEEP))
    met.face[which], met.gone[which] = other, before[first]
    met.b1[which], met.b2[which] = weights(t, other, there + off)
    own, side = walkers.face.take(rows[which]), walkers.side.take(rows[which])
    back = ~t.together(own, side, other, np.where(towards[first] > 0, -1.0, 1.0))
    over = np.flatnonzero(back | _tight(t, other, own, there, off, touch))
    # Up to where feet keep off what they come to, or, in a corner, not at all.
    near = soonest[over] - OFF * touch / np.maximum(np.abs(towards[first[over]]), 1 / LEANING)
    stop, near = which[over], np.where(back[over], np.maximum(near, 0.0), 0.0)
    met.face[stop], met.gone[stop], met.shut[stop] = own[over], near, True
    met.b1[stop], met.b2[stop] = weights(t, own[over], place[:, stop] + way[:, stop] * near)
    met.towards[:, stop] = -up[:, stop]
    return met


def weights(table: Topology, face: Index, place: Floats) -> tuple[Floats, Floats]:
    """Weights of the point of each face below places (3, k) near it, in the triangle."""
    if not table.corner.shape[1]:
        return np.zeros(len(face)), np.zeros(len(face))
    c, s = in_frame(table, face, place - table.corner.take(face, axis=1))
    return inside(c * table.rate1.take(face) - s * table.shear.take(face) + 0.0, s * table.rate2.take(face) + 0.0)  # no -0.0


def _tight(table: Topology, face: Index, own: Index, place: Floats, off: Floats, touch: float) -> NDArray[np.bool_]:
    """Where three sheets meet: whether feet put upon a face at a place, and `off` from their own face, would be through a
    third one or touch it. They stay where they are, then."""
    found = np.zeros(face.size, bool)
    which, third = table.cuts.of(face)
    which, third = (v[third != own.take(which)] for v in (which, third))
    normal = table.normal.take(third, axis=1)
    begins = dot(normal, place.take(which, axis=1) - table.corner.take(third, axis=1))
    ends = begins + dot(normal, off.take(which, axis=1))
    met = ((begins * ends < 0) & (np.abs(begins) > touch)) | (np.abs(ends) <= touch)
    met &= _inside(table, third, place.take(which, axis=1), 2 * OFF * touch)
    found[which[met]] = True
    return found


def _rises(table: Topology, face: Index, place: Floats, up: Floats, touch: float) -> NDArray[np.bool_]:
    """Whether faces go up from the plane in which feet are: else they are under the sheet that is walked on."""
    height = dot(up, table.corner.take(face, axis=1) - place)
    ends = (dot(up, edge.take(face, axis=1)) for edge in (table.edge1, table.edge2))
    risen: NDArray[np.bool_] = height + np.fmax(np.fmax(*ends), 0.0) > touch
    return risen


def _leads_through(
    table: Topology, walkers: Walkers, rows: Index, other: Index, begins: Floats, there: Floats, touch: float
) -> NDArray[np.bool_]:
    """Whether the way of `rows`, that comes to the plane of `other` faces from heights `begins` at `there`, goes on behind
    it, or ends. Where the own face only touches the other one, it may be folded back there into a wedge that has no room."""
    sign, own = np.where(begins < 0, -1.0, 1.0), walkers.face.take(rows)
    on = np.ones(rows.size, bool)
    touching = np.flatnonzero(_lowest(table, own, other, sign) >= -touch)
    if touching.size:
        own, other, sign = own[touching], other[touching], sign[touching]
        b1, b2 = weights(table, own, there[:, touching])
        edge = np.argmin([1.0 - b1 - b2, b1, b2], axis=0)
        link = table.link[np.where(walkers.side.take(rows[touching]) < 0, 1, 0), 3 * own + edge]
        beyond = np.where(link == NO_LINK, own, link >> 3)
        on[touching] = (link == NO_LINK) | (_lowest(table, beyond, other, sign) < -touch)
    return on


def _lowest(table: Topology, face: Index, other: Index, sign: Floats) -> Floats:
    """Height of the lowest corner of faces over the planes of others, whose upper side is that of their normal by `sign`."""
    up = table.normal.take(other, axis=1) * sign
    first = dot(up, table.corner.take(face, axis=1) - table.corner.take(other, axis=1))
    one, two = (dot(up, edge.take(face, axis=1)) for edge in (table.edge1, table.edge2))
    return first + np.minimum(np.minimum(one, two), 0.0)


def _inside(table: Topology, face: Index, place: Floats, touch: float) -> NDArray[np.bool_]:
    """Whether places in the planes of faces are in these, or no more than about `touch` mm beside them."""
    c, s = in_frame(table, face, place - table.corner.take(face, axis=1))
    rate1, rate2, shear = table.rate1.take(face), table.rate2.take(face), table.shear.take(face)
    b1, b2 = c * rate1 - s * shear, s * rate2
    over = touch * (np.abs(rate1) + np.abs(rate2) + np.abs(shear))
    found: NDArray[np.bool_] = (b1 >= -over) & (b2 >= -over) & (b1 + b2 <= 1 + over)
    return found
