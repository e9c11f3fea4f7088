"""A step of one agent over triangles, in space and against all of them: what the loops of `antdsl.ground.mesh` are held against.

It shares the tables of a ground with them (normals, links, pieces, cuts), but no frame, no weights that are carried along, no
tree of boxes and no distance to other pieces: places and directions are vectors, and each look goes over all triangles nearby."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.boxes import EDGE_TOLERANCE, MAX_STEP_EXTENSION_FACTOR, MIN_PLANE_SINE
from antdsl.ground.mesh.crossings import MAX_RUN_PER_RISE, MIN_SQUARED_CUT_SINE, MIN_TOUCHES_OFF_FACE
from antdsl.ground.mesh.stretches import (
    BORDER_INWARD_SHARE,
    CORNER_NUDGE_FRACTION,
    CROSSINGS_BEFORE_NUDGE,
    MAX_EDGE_CROSSINGS,
    MAX_SURFACE_HOPS,
)
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.surroundings import (
    BORDER_GAP_BODY_LENGTHS,
    BORDER_RAY_DEPTH_BODY_LENGTHS,
    BORDER_RAY_HEIGHT_BODY_LENGTHS,
    EYE_HEIGHT_BODY_LENGTHS,
    MIN_COSINE_BETWEEN_NORMALS,
    MIN_LOOK_AHEAD_FACTOR,
)
from antdsl.ground.mesh.topology import NO_LINKED_EDGE

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Hop:
    """Where a walker steps over to: the face, and places (3) with the normals that they are on, from above or below the border in
    the direction of travel to there."""

    face: int
    start: Floats
    up: Floats
    direction: Floats
    end: Floats
    above: Floats


@dataclass(frozen=True)
class Landing:
    """The face that is stepped over to, the place there, the side, the way gone, how far above the own face that is, and whether
    the way ends there."""

    face: int
    place: Floats
    side: float
    distance: float
    rise: float = 0.0
    shut: bool = False


@dataclass
class Walker:
    """An agent on its way: face, place on it, side, unit direction and heading in its plane, way left and gone, and so far over
    a border."""

    face: int
    place: Floats
    side: float
    direction: Floats
    heading: Floats
    left: float
    body: float
    over: float
    straight: bool
    travelled: float = 0.0
    blocked: bool = False
    spent: int = 0
    hops: list[Hop] = field(default_factory=list)


@dataclass(frozen=True)
class Step:
    """What becomes of an agent."""

    face: int
    position: Floats
    up: Floats
    heading: Floats
    direction: Floats
    travelled: float
    blocked: bool
    over: float
    hops: list[Hop]


class Reference:
    """Steps over the surfaces of a ground as they lie now."""

    def __init__(self, ground: MeshGround) -> None:
        vertices, faces, _, self.table = ground.triangles
        self.corners = vertices[faces]
        self.normal = self.table.normal.T
        self.scale = ground._scale
        # Along the normal, and what gives the weights of the second and third corner; how long two sides are.
        one, two = self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        self.across = np.cross(one, two)
        with np.errstate(all="ignore"):
            square = (self.across * self.across).sum(axis=1)[:, None]
            self.second, self.third = np.cross(two, self.across) / square, np.cross(self.across, one) / square
        self.sides = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
        self.low, self.high = self.corners.min(axis=1), self.corners.max(axis=1)
        self.near = np.flatnonzero(self.table.is_live)

    # ---- what is where

    def look_around(self, place: Floats, reach: float) -> None:
        """Take into account the faces within `reach` of a place along each axis."""
        result = (self.low <= place + reach).all(axis=1) & (self.high >= place - reach).all(axis=1)
        self.near = np.flatnonzero(result & self.table.is_live)

    def first(self, origin: Floats, step: Floats, further: float, own: int = -1, piece: int = -1) -> tuple[int, float, Floats]:
        """The first face that a way meets, but `own` and those of a `piece`; after what part of it (which may be `further` mm
        more than all), and the place there."""
        size = np.sqrt(step @ step)
        most = 1 + min(further / max(size, 1e-300), MAX_STEP_EXTENSION_FACTOR)
        end = origin + step * most
        low, high = np.minimum(origin, end), np.maximum(origin, end)
        near = self.near[(self.low[self.near] <= high).all(axis=1) & (self.high[self.near] >= low).all(axis=1)]
        near = near[(near != own) & (self.table.piece[near] != piece)]
        off, across = origin - self.corners[near, 0], self.across[near]
        down = -(across @ step)
        level = np.abs(down) <= MIN_PLANE_SINE * size * self.sides[near]
        with np.errstate(all="ignore"):
            part = (off * across).sum(axis=1) / down
            hit_offset = off + part[:, None] * step
            one, two = (hit_offset * self.second[near]).sum(axis=1), (hit_offset * self.third[near]).sum(axis=1)
            hit = (
                ~level
                & (one >= -EDGE_TOLERANCE)
                & (two >= -EDGE_TOLERANCE)
                & (one + two <= 1 + EDGE_TOLERANCE)
                & (part >= 0)
                & (part <= most)
            )
        if not hit.any():
            return -1, np.inf, origin
        k = np.flatnonzero(hit)[np.argmin(part[hit])]
        return int(near[k]), float(part[k]), origin + part[k] * step

    def onto(self, face: int, place: Floats) -> Floats:
        """The point of a face that belongs to a place near its plane: with weights of the corners between 0 and 1."""
        a, b, c = self.corners[face]
        one, two = np.clip(self.weights(face, place), 0.0, 1.0)
        total = max(one + two, 1.0)
        return a + (b - a) * (one / total) + (c - a) * (two / total)

    def weights(self, face: int, place: Floats) -> tuple[float, float]:
        """The weights of the second and third corner."""
        off = place - self.corners[face, 0]
        return float(off @ self.second[face]), float(off @ self.third[face])

    def side_of(self, face: int, towards: Floats) -> float:
        return -1.0 if self.normal[face] @ towards > 0 else 1.0

    def beyond_edge(self, face: int, side: float, edge: int) -> int:
        return int(self.table.link[1 if side < 0 else 0, 3 * face + edge])

    def together(self, face: int, side: float, other: int, other_side: float) -> bool:
        """Whether sides of faces are of two pieces, or may be come to from each other in one."""
        side_groups, piece = self.table.side_groups, self.table.piece
        return bool(piece[face] != piece[other] or side_groups[int(side < 0), face] == side_groups[int(other_side < 0), other])

    def edge(self, face: int, k: int) -> tuple[Floats, Floats, Floats]:
        """Where the edge opposite a corner begins, its direction, and that across it out of the face."""
        one, two = self.corners[face, (k + 1) % 3], self.corners[face, (k + 2) % 3]
        along = (two - one) / _length(two - one)
        return one, along, _cross(along, self.normal[face])

    # ---- a step

    def step(
        self,
        face: int,
        place: Floats,
        over: float,
        wish: Floats,
        heading: Floats,
        up: Floats,
        body: float,
        straight: bool = False,
    ) -> Step:
        normal = self.normal[face]
        side = -1.0 if up @ normal < 0 else 1.0
        direction, left = self._laid(face, wish, self.table.axis1[:, face])
        w = Walker(face, place, side, direction, self._laid(face, heading, direction)[0], left, body, over * side, straight)
        self.look_around(place, 2 * left + 2 * body + 1e3 * self.scale.distance_noise)
        if w.over != 0 and w.left > 0:
            self._hang(w)
        turn = 0
        while w.left > 0 and w.over == 0 and turn < MAX_EDGE_CROSSINGS:
            if turn >= CROSSINGS_BEFORE_NUDGE and turn % CROSSINGS_BEFORE_NUDGE == 0:
                w.place = w.place * (1 - CORNER_NUDGE_FRACTION) + self.corners[w.face].mean(axis=0) * CORNER_NUDGE_FRACTION
            self._stretch(w)
            turn += 1
        up, weights = self.normal[w.face] * w.side, self.weights(w.face, w.place)
        smooth = self.table.smooth[:, w.face].reshape(3, 3).T @ np.array([1 - weights[0] - weights[1], *weights])
        smooth = smooth / _length(smooth) * w.side
        ahead = _turned(w.heading, up, smooth, w.heading)
        ahead = ahead - (ahead @ smooth) * smooth
        position = w.place + w.over * up
        ahead = ahead / _length(ahead)
        onward = w.direction - up * ((w.direction @ smooth) / (up @ smooth))  # the vector over it in the smooth plane
        return Step(w.face, position, smooth, ahead, onward / _length(onward), w.travelled, w.blocked, w.over * w.side, w.hops)

    def _laid(self, face: int, v: Floats, otherwise: Floats) -> tuple[Floats, float]:
        """The direction of a vector in a face, and its length there: its own up to 60 degrees off the face, then less."""
        flat = v - (v @ self.normal[face]) * self.normal[face]
        size = _length(flat)
        if not (1e-150 < size < np.inf):
            return otherwise, 0.0
        return flat / size, min(_length(v), 2 * size)

    def _stretch(self, w: Walker) -> None:
        """To the edge of the face, and over it; or to where the way ends or something is in it."""
        until, out = np.inf, 0
        for k in range(3):
            one, _, across = self.edge(w.face, k)
            if across @ w.direction > 0:
                far = max(float((one - w.place) @ across), 0.0) / float(across @ w.direction)
                if far < until:
                    until, out = far, k
        length = min(until, w.left)
        landing = self.ahead(w, length) if length > 0 else None
        if landing is not None:
            self._land(w, landing)
            return
        w.place = self.onto(w.face, w.place + w.direction * length)
        w.travelled += length
        if until >= w.left:
            w.left = 0.0
            return
        w.left -= length
        link = self.beyond_edge(w.face, w.side, out)
        if link == NO_LINKED_EDGE:
            self._border(w, out)
            return
        start, along, across = self.edge(w.face, out)
        next_face, other = link >> 3, (link >> 1) & 3
        begin, onward, outward = self.edge(next_face, other)
        if onward @ along < 0:
            begin, onward = self.corners[next_face, (other + 2) % 3], -onward
        turned = [(v @ along) * onward - (v @ across) * outward for v in (w.direction, w.heading)]
        w.place = self.onto(next_face, begin + onward * float((w.place - start) @ along))
        w.face, w.direction, w.heading = next_face, *turned
        w.side = -w.side if link & 1 else w.side

    def _land(self, w: Walker, to: Landing) -> None:
        previous, following, direction = self.normal[w.face] * w.side, self.normal[to.face] * to.side, w.direction
        w.hops.append(Hop(to.face, w.place + previous * to.rise, previous, direction, to.place, following))
        turned = []
        for v in (w.direction, w.heading):
            v = _turned(v, previous, following, direction)
            flat = v - (v @ following) * following
            size = _length(flat)
            turned.append(flat / size if size > 1e-9 else self.table.axis1[:, to.face])
        w.direction, w.heading = turned
        w.face, w.place, w.side = to.face, to.place, to.side
        w.left, w.travelled = max(w.left - to.distance, 0.0), w.travelled + to.distance
        if to.shut:
            w.left, w.blocked = 0.0, True
        self._spend(w)

    def _spend(self, w: Walker) -> None:
        w.spent += 1
        if w.spent >= MAX_SURFACE_HOPS:
            w.left, w.blocked = 0.0, True

    def _rise(self, w: Walker, level: float) -> bool:
        most = level - w.over
        climb = min(abs(most), w.left)
        has_arrived = climb >= abs(most)
        w.over = level if has_arrived else w.over + np.copysign(climb, most)
        w.left, w.travelled = w.left - climb, w.travelled + climb
        return has_arrived

    def _hang(self, w: Walker) -> None:
        """Go on over the border that is stepped over, or back."""
        one, two = self.weights(w.face, w.place)
        weights = [
            np.inf if self.beyond_edge(w.face, w.side, k) != NO_LINKED_EDGE else v
            for k, v in enumerate((1 - one - two, one, two))
        ]
        edge = int(np.argmin(weights))
        if w.direction @ self.edge(w.face, edge)[2] > 0:
            self._border(w, edge)
        elif not self._rise(w, 0.0):
            w.left = 0.0

    def _border(self, w: Walker, edge: int) -> None:
        landing = self.beyond(w.face, w.place, w.side, w.body, edge)
        has_arrived = self._rise(w, 0.0 if landing is None else landing.rise)
        if landing is not None and has_arrived and w.left >= landing.distance:
            w.over = 0.0
            self._land(w, landing)
        elif landing is not None or not has_arrived:
            w.blocked |= w.travelled == 0
            w.left = 0.0
        else:
            _, along, across = self.edge(w.face, edge)
            part = float(w.direction @ along)
            w.direction = (-along if part < 0 else along) - BORDER_INWARD_SHARE * across
            w.left = 0.0 if w.straight else w.left * abs(part)
            w.blocked = True
            self._spend(w)

    # ---- what is in the way

    def ahead(self, w: Walker, length: float) -> Landing | None:
        """What cuts the own face, or another piece that is nearer."""
        hit = self.crossed(w, length)
        if self.table.piece_count > 1:
            other = self._other(w, length if hit is None else hit.distance)
            hit = hit if other is None else other
        return hit

    def crossed(self, w: Walker, length: float) -> Landing | None:
        """The first face of the own piece that cuts the own face across the way."""
        touch, own, up, cuts = self.scale.touch_distance, w.face, self.normal[w.face] * w.side, self.table.cuts
        result = []
        for other in cuts.cutting_faces[cuts.cut_starts[own] : cuts.cut_starts[own + 1]].tolist():
            n, a = self.normal[other], self.corners[other, 0]
            begins = float(n @ (w.place - a))
            ends = begins + float(n @ w.direction) * length
            through = (begins >= 0) != (ends >= 0) or begins * ends == 0 or (abs(ends) <= touch and abs(ends) < abs(begins))
            if not through or abs(begins) <= touch or float(((self.corners[other] - w.place) @ up).max()) <= touch:
                continue
            previous = float(np.clip(begins / (begins - ends) if begins != ends else begins, 0, 1)) * length
            crossing_place = w.place + w.direction * previous
            if self._within(other, crossing_place, 4 * touch) and self._leads_through(w, other, begins, crossing_place):
                leans = -float(up @ n) / (float(n @ w.direction) or 1.0)
                result.append(
                    (
                        previous + MIN_TOUCHES_OFF_FACE * touch * float(np.clip(leans, -MAX_RUN_PER_RISE, MAX_RUN_PER_RISE)),
                        other,
                        previous,
                        crossing_place,
                    )
                )
        if not result:
            return None
        _, other, previous, crossing_place = min(result, key=lambda each: each[:2])
        n, towards = self.normal[other], float(self.normal[other] @ w.direction)
        steep = up - (up @ n) * n
        off = steep * (MIN_TOUCHES_OFF_FACE * touch / max(float(steep @ steep), MIN_SQUARED_CUT_SINE))
        back = not self.together(own, w.side, other, -1.0 if towards > 0 else 1.0)
        if back or self._tight(other, own, crossing_place, off):
            soonest = min(each[2] for each in result)
            near = max(soonest - MIN_TOUCHES_OFF_FACE * touch / max(abs(towards), 1 / MAX_RUN_PER_RISE), 0.0) if back else 0.0
            return Landing(own, self.onto(own, w.place + w.direction * near), self.side_of(own, -up), near, shut=True)
        return Landing(other, self.onto(other, crossing_place + off), -1.0 if towards > 0 else 1.0, previous)

    def _within(self, face: int, place: Floats, touch: float) -> bool:
        t = self.table
        over = touch * (abs(t.rate1[face]) + abs(t.rate2[face]) + abs(t.shear[face]))
        one, two = self.weights(face, place)
        return bool(one >= -over and two >= -over and one + two <= 1 + over)

    def _leads_through(self, w: Walker, other: int, begins: float, crossing_place: Floats) -> bool:
        """Whether the way goes on behind a face that it comes to: where the own face only touches it, the next may fold back."""

        def lowest(face: int) -> float:
            up = self.normal[other] * (-1.0 if begins < 0 else 1.0)
            return float(((self.corners[face] - self.corners[other, 0]) @ up).min())

        if lowest(w.face) < -self.scale.touch_distance:
            return True
        one, two = self.weights(w.face, self.onto(w.face, crossing_place))
        link = self.beyond_edge(w.face, w.side, int(np.argmin([1 - one - two, one, two])))
        return link == NO_LINKED_EDGE or lowest(link >> 3) < -self.scale.touch_distance

    def _tight(self, face: int, own: int, place: Floats, off: Floats) -> bool:
        """Whether feet put upon a face at a place, and off another, would be through a third one or touch it."""
        touch, cuts = self.scale.touch_distance, self.table.cuts
        for third in cuts.cutting_faces[cuts.cut_starts[face] : cuts.cut_starts[face + 1]].tolist():
            begins = float(self.normal[third] @ (place - self.corners[third, 0]))
            ends = begins + float(self.normal[third] @ off)
            hit = (begins * ends < 0 and abs(begins) > touch) or abs(ends) <= touch
            if third != own and hit and self._within(third, place, 2 * MIN_TOUCHES_OFF_FACE * touch):
                return True
        return False

    def _other(self, w: Walker, length: float) -> Landing | None:
        """Another piece within the way, seen from above the ground; where the own piece lies before it, from a grain above."""
        least = self.scale.min_eye_height
        for high in (max(min(EYE_HEIGHT_BODY_LENGTHS * w.body, w.left / MIN_LOOK_AHEAD_FACTOR), least), least):
            landing, hidden = self._look_ahead(w, length, high)
            if landing is None or not hidden:
                return landing
        return landing

    def _look_ahead(self, w: Walker, length: float, high: float) -> tuple[Landing | None, bool]:
        """Another piece seen from so high, below a low ceiling from half its height, or at the way's end from there down; and
        whether the own piece lies before it."""
        up, piece, fine = self.normal[w.face] * w.side, int(self.table.piece[w.face]), self.scale.coincident_distance
        roof, part, _ = self.first(w.place, up * high, fine, piece=piece)
        if roof >= 0 and (self.normal[roof] @ up < 0 or high * part > self.scale.max_below_height):
            high = high * part / 2
        eye, step, down = w.place + up * high, w.direction * length, -up * high
        towards = step
        face, part, hit_place = self.first(eye, step, fine, piece=piece)
        distance = min(part, 1.0) * length
        if face < 0:
            towards, distance = down, length
            face, _, hit_place = self.first(eye + step, down, 0.0, piece=piece)
        if face < 0:
            return None, False
        legs = [(w.place + up * fine, up * (high - fine), 0.0), (eye, step, fine)]
        if towards is down:
            legs.append((eye + step, down, 0.0))
        first = [self.first(*leg, own=w.face)[0] for leg in legs]
        hidden = any(each >= 0 and self.table.piece[each] == piece for each in first)
        total_distance = min(float(np.hypot(distance, high)), w.left)
        return Landing(face, self.onto(face, hit_place), self.side_of(face, towards), total_distance), hidden

    # ---- what is beyond a border

    def beyond(self, own: int, place: Floats, side: float, body: float, edge: int) -> Landing | None:
        """What a way meets that leads up off the own face, out over the border, down beyond it and back towards it."""
        scale, up, out = self.scale, self.normal[own] * side, self.edge(own, edge)[2]
        body, fine = (
            max(body, scale.min_eye_height / EYE_HEIGHT_BODY_LENGTHS)
            if body == body
            else scale.min_eye_height / EYE_HEIGHT_BODY_LENGTHS,
            scale.coincident_distance,
        )
        gap, high = BORDER_GAP_BODY_LENGTHS * body, BORDER_RAY_HEIGHT_BODY_LENGTHS * body
        hair = out * (2 * fine)
        roof, part, _ = self.first(place - hair + up * fine, up * (high - fine), 0.0, own=own)
        if roof >= 0:
            high = (fine + part * (high - fine)) / 2
        if self.first(place + up * high, out * gap, 0.0, own=own)[0] >= 0:
            high = min(high, EYE_HEIGHT_BODY_LENGTHS * body)
        face, part, hit_place = self.first(place + up * high, out * gap, 0.0, own=own)
        if face >= 0:
            return self._landing_if_led(own, side, face, hit_place, out, part * gap, high, gap)
        over, fall = place + out * gap, -up * (high + BORDER_RAY_HEIGHT_BODY_LENGTHS * body)
        face, part, hit_place = self.first(over + up * high, fall, 0.0, own=own)
        lowest = (
            -BORDER_RAY_HEIGHT_BODY_LENGTHS * body if face < 0 else high - part * (high + BORDER_RAY_HEIGHT_BODY_LENGTHS * body)
        )
        if face >= 0 and self._leads(own, side, face, fall):
            face, hit_place, distance, rise, fall = self._nearest(own, place, up, face, lowest, high, gap, fall)
            return self._down(own, side, place, hair, up, face, hit_place, fall, distance, rise, gap)
        for depth in (BORDER_GAP_BODY_LENGTHS * body, BORDER_RAY_DEPTH_BODY_LENGTHS * body):
            if lowest < -depth:
                face, part, hit_place = self.first(over - up * depth, -2 * gap * out, 0.0, own=own)
                if face >= 0:
                    if not self._leads(own, side, face, -out):
                        return None
                    distance = abs(gap - part * 2 * gap)
                    return self._down(own, side, place, hair, up, face, hit_place, -out, distance, -depth, gap)
        return None

    def _nearest(
        self, own: int, place: Floats, up: Floats, face: int, lowest: float, high: float, gap: float, fall: Floats
    ) -> tuple[int, Floats, float, float, Floats]:
        """The point of a face, or of what lies before it, that is nearest to a place over the border no lower than its plane."""
        plane = float((self.corners[face, 0] - place) @ self.normal[face] / (up @ self.normal[face]))
        level = min(plane, high) if plane > lowest else lowest
        level = 0.0 if abs(level) <= gap else level
        above = place + up * level
        nearest_place = _nearest_of(self.corners[face], above)
        away = _length(nearest_place - above)
        first, part, previous = self.first(above, nearest_place - above, 0.0, own=own)
        if part * away < away - self.scale.coincident_distance:
            return first, previous, part * away, level, nearest_place - above
        return face, nearest_place, away, level, fall

    def _down(
        self,
        own: int,
        side: float,
        place: Floats,
        hair: Floats,
        up: Floats,
        face: int,
        hit_place: Floats,
        towards: Floats,
        distance: float,
        rise: float,
        gap: float,
    ) -> Landing | None:
        """What is deep below may be met sooner at the border itself."""
        fine = self.scale.coincident_distance
        if rise < -gap:
            fall = up * (rise + fine)
            sooner, part, hit = self.first(place + hair - up * fine, fall, 0.0, own=own)
            if sooner >= 0:
                return self._landing_if_led(own, side, sooner, hit, fall, 0.0, part * (rise + fine) - fine, gap)
        return self._landing_if_led(own, side, face, hit_place, towards, distance, rise, gap)

    def _landing_if_led(
        self, own: int, side: float, face: int, hit_place: Floats, towards: Floats, distance: float, rise: float, gap: float
    ) -> Landing | None:
        if not self._leads(own, side, face, towards):
            return None
        if abs(rise) <= gap:
            distance, rise = float(np.hypot(distance, rise)), 0.0
        return Landing(face, self.onto(face, hit_place), self.side_of(face, towards), distance, rise)

    def _leads(self, own: int, side: float, face: int, towards: Floats) -> bool:
        """Nothing leads to the other side of what is walked on, nor to what turns back below it as that side does."""
        to_side = self.side_of(face, towards)
        level = float((self.normal[face] * to_side) @ (self.normal[own] * side))
        return level > MIN_COSINE_BETWEEN_NORMALS and self.together(own, side, face, to_side)


def _turned(v: Floats, previous: Floats, following: Floats, direction: Floats) -> Floats:
    """A vector turned by the least turn that takes one unit vector into another (Rodrigues); half a turn goes over a way."""
    axis, cosine = _cross(previous, following), float(previous @ following)
    if cosine < -1 + 1e-9:
        hinge = _cross(previous, direction)
        return 2 * (hinge @ v) * hinge - v
    sine = _length(axis)
    if sine == 0:
        return v
    k = axis / sine
    return v * cosine + _cross(k, v) * sine + k * (k @ v) * (1 - cosine)


def _cross(a: Floats, b: Floats) -> Floats:
    x, y, z = a.tolist()
    u, v, w = b.tolist()
    return np.array((y * w - z * v, z * u - x * w, x * v - y * u))


def _length(v: Floats) -> float:
    return float(np.sqrt(v @ v))


def _nearest_of(corners: Floats, place: Floats) -> Floats:
    """The point of a triangle nearest to a place."""
    a, b, c = corners
    normal = _cross(b - a, c - a)
    inside = place - (normal @ (place - a)) / (normal @ normal) * normal
    if all(_cross(q - p, inside - p) @ normal >= 0 for p, q in ((a, b), (b, c), (c, a))):
        return inside
    result = []
    for p, q in ((a, b), (b, c), (c, a)):
        result.append(p + (q - p) * float(np.clip((place - p) @ (q - p) / ((q - p) @ (q - p)), 0, 1)))
    return min(result, key=lambda each: _length(each - place))
