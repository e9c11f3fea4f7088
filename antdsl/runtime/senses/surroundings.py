"""What lies around walkers besides the surface that they are on: rays that find it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.topology import Topology
from antdsl.runtime.senses.walk import Landing, Walkers, dot

Floats = NDArray[np.float64]
Index = NDArray[np.int64]
Cast = Callable[[Floats, Floats, int], tuple[Floats, Index]]
Weights = Callable[[Index, Floats], tuple[Floats, Floats]]

LIFT = 0.02  # of a body: how far above the surface an agent looks ahead
NOISE = 1e-4  # of the extent: float32 rays err by less


class Around:
    """Rays of walkers against all surfaces of a ground: what stands in their way and what continues beyond a border."""

    def __init__(self, table: Topology, cast: Cast, weights: Weights, extent: float, body: Floats, threads: int) -> None:
        self._table, self._cast, self._weights = table, cast, weights
        self._body, self._threads = body, threads
        self._noise = extent * NOISE

    def ahead(self, walkers: Walkers, rows: Index, length: Floats) -> Landing:
        """Another piece of surface within the way, seen from just above the ground; below a low ceiling from half its height."""
        t = self._table
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        lift = np.maximum(LIFT * self._body[rows], self._noise)
        piece = t.piece[walkers.face[rows]]
        part, face = self._cast(place, up * lift, self._threads)
        # What shows its back is not above the agent: the agent is a hair below it, at the foot of a gentle climb.
        low = (face >= 0) & (t.piece[face] != piece) & (dot(t.normal.take(face, axis=1), up) < 0)
        eye = place + up * np.where(low, lift * np.where(low, part, 0.0) / 2, lift)
        part, face = self._cast(eye, way * length, self._threads)
        who = np.flatnonzero((face >= 0) & (t.piece[face] != piece) & (length > 0))
        gone = part[who] * length[who]
        return self._landing(who, face[who], eye[:, who] + way[:, who] * gone, way[:, who], gone)

    def beyond(self, walkers: Walkers, rows: Index) -> Landing:
        """Past an open border: what a ray down just beyond it meets, else what a ray back from below it meets."""
        t = self._table
        place, up, way = walkers.place(t, rows), walkers.up(t, rows), walkers.direction(t, rows)
        body = np.maximum(self._body[rows], 2 * self._noise)
        gap = np.maximum(0.02 * body, self._noise)
        down = -up * body
        part, face = self._cast(place + way * gap + up * (0.5 * body), down, self._threads)
        hit = place + way * gap + up * (0.5 * body) + down * np.where(np.isfinite(part), part, 0.0)
        met = (face >= 0) & (face != walkers.face[rows])
        back = -way * (gap + 0.5 * body)
        start = place + way * gap - up * (0.25 * body)
        part2, face2 = self._cast(start, back, self._threads)
        below = ~met & (face2 >= 0) & (face2 != walkers.face[rows])
        hit = np.where(below, start + back * np.where(np.isfinite(part2), part2, 0.0), hit)
        face, towards = np.where(below, face2, face), np.where(below, back, down)
        who = np.flatnonzero(met | below)
        gone = np.where(below, 0.25 * body, gap)[who]
        return self._landing(who, face[who], hit[:, who], towards[:, who], gone)

    def _landing(self, who: Index, face: Index, hit: Floats, towards: Floats, gone: Floats) -> Landing:
        """The side of a face that a ray came from is the side to walk on."""
        side = np.where(dot(self._table.normal.take(face, axis=1), towards) > 0, -1.0, 1.0)
        return Landing(who, face, *self._weights(face, hit), side, gone)
