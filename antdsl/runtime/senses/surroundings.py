"""What lies around walkers besides the surface that they are on: rays that find it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.clearances import Parts
from antdsl.runtime.senses.topology import Topology
from antdsl.runtime.senses.walk import Landing, Walkers, dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Cast = Callable[[Floats, Floats, int], tuple[Floats, Index]]
Weights = Callable[[Index, Floats], tuple[Floats, Floats]]

LIFT = 0.02  # of a body: how far above the surface an agent looks ahead
GAP = 0.02  # of a body: how far beyond a border it looks down
HIGH, DEEP = 0.5, 0.25  # of a body: from how far above, and how deep below it looks back
BEYOND = 0.6  # of a body: all that it looks at beyond a border and back below is nearer, but for noise
NOISE = 1e-4  # of the extent of a ground: float32 rays err by less
SKIP = 0.01  # of that noise: how far beyond the own surface, where that hides others, a ray goes on
AGAIN = 4  # times that it goes on


class Around:
    """Rays of walkers against all surfaces of a ground: what stands in their way and what continues beyond a border."""

    def __init__(
        self, table: Topology, cast: Cast, weights: Weights, parts: Parts, noise: float, body: Floats, threads: int
    ) -> None:
        self._table, self._cast, self._weights, self._parts = table, cast, weights, parts
        self._body, self._threads = body, threads
        self._noise = noise

    def of(self, agents: Index) -> Around:
        """The same for some of the agents, whose numbers count from 0."""
        return Around(self._table, self._cast, self._weights, self._parts, self._noise, self._body.take(agents), self._threads)

    def near(self, walkers: Walkers, rows: Index | slice, length: Floats) -> NDArray[np.bool_]:
        """Who of `rows` may meet another piece of surface within `length`."""
        clear = self._parts.of(walkers.face[rows], walkers.b1[rows], walkers.b2[rows])
        return clear <= length + np.fmax(LIFT * self._body[rows], self._noise) + self._noise

    def ahead(self, walkers: Walkers, rows: Index, length: Floats) -> Landing:
        """Another piece of surface within the way, seen from just above the ground, below a low ceiling from half its
        height; or at the way's end between that eye and the ground."""
        t = self._table
        asked = np.flatnonzero(self.near(walkers, rows, length))
        if not asked.size:
            return Landing(asked, asked, *np.empty((4, 0)))
        rows, length = rows.take(asked), length.take(asked)
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        lift = np.fmax(LIFT * self._body.take(rows), self._noise)
        piece = t.piece.take(walkers.face.take(rows))
        high = lift.copy()
        below = np.flatnonzero(self.near(walkers, rows, np.zeros(rows.size)))
        if below.size:
            part, face = self._others(place.take(below, axis=1), (up * lift).take(below, axis=1), piece.take(below))
            # What shows its back is not above the agent: the agent is a hair below it, at the foot of a gentle climb.
            low = (face >= 0) & (dot(t.normal.take(face, axis=1), up[:, below]) < 0)
            high[below[low]] = lift[below[low]] * part[low] / 2
        eye = place + up * high
        part, face = self._others(eye, way * length, piece)
        gone = np.where(face >= 0, part, 1.0) * length
        hit, towards = eye + way * gone, way
        # What has come between the eye and the ground is below the next eye, that of the face round the edge or of the next step.
        still = np.flatnonzero((face < 0) & (high > SKIP * self._noise))
        if still.size:
            down = up.take(still, axis=1) * (SKIP * self._noise - high.take(still))
            part, face[still] = self._others(hit.take(still, axis=1), down, piece.take(still))
            found = face[still] >= 0
            between, down = still[found], down[:, found]
            hit[:, between] += down * part[found]
            towards[:, between] = down
        who = np.flatnonzero((face >= 0) & (length > 0))
        if not who.size:
            return Landing(who, who, *np.empty((4, 0)))
        return self._landing(asked[who], face[who], hit[:, who], towards[:, who], gone[who])

    def _others(self, origin: Floats, step: Floats, piece: Index) -> tuple[Floats, Index]:
        """Where rays hit the first surface that is not of their piece: the own one, at an edge or in a hollow, hides none."""
        part, face = self._cast(origin, step, self._threads)
        own = np.flatnonzero((face >= 0) & (self._table.piece.take(face) == piece))
        length = np.sqrt(dot(step, step))
        begin = np.zeros(part.size)
        for _ in range(AGAIN):
            if not own.size:
                break
            begin[own] = part[own] + SKIP * self._noise / length[own]
            rest = 1.0 - begin[own]
            start = origin.take(own, axis=1) + step.take(own, axis=1) * begin[own]
            again, face[own] = self._cast(start, step.take(own, axis=1) * rest, self._threads)
            part[own] = begin[own] + again * rest
            own = own[(face[own] >= 0) & (self._table.piece.take(face[own]) == piece[own])]
        face[own] = -1
        return part, face

    def beyond(self, walkers: Walkers, rows: Index) -> Landing:
        """Past an open border: what a ray down just beyond it meets, else what a ray back from below it meets."""
        t = self._table
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        body = np.maximum(self._body[rows], 2 * self._noise)
        gap = np.maximum(GAP * body, self._noise)
        down = -up * body
        part, face = self._cast(place + way * gap + up * (HIGH * body), down, self._threads)
        hit = place + way * gap + up * (HIGH * body) + down * np.where(np.isfinite(part), part, 0.0)
        met = (face >= 0) & (face != walkers.face[rows])
        back = -way * (gap + HIGH * body)
        start = place + way * gap - up * (DEEP * body)
        part2, face2 = self._cast(start, back, self._threads)
        below = ~met & (face2 >= 0) & (face2 != walkers.face[rows])
        hit = np.where(below, start + back * np.where(np.isfinite(part2), part2, 0.0), hit)
        face, towards = np.where(below, face2, face), np.where(below, back, down)
        who = np.flatnonzero(met | below)
        gone = np.where(below, DEEP * body, gap)[who]
        return self._landing(who, face[who], hit[:, who], towards[:, who], gone)

    def _landing(self, who: Index, face: Index, hit: Floats, towards: Floats, gone: Floats) -> Landing:
        """The side of a face that a ray came from is the side to walk on."""
        side = np.where(dot(self._table.normal.take(face, axis=1), towards) > 0, -1.0, 1.0)
        return Landing(who, face, *self._weights(face, hit), side, gone)
