"""Which triangles the short rays of a walker can meet at all: lists for the faces where walkers look out for other surfaces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.senses.clearances import Parts
from antdsl.runtime.senses.rasterise import triangle_cells
from antdsl.runtime.senses.topology import NO_LINK, Topology

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_PAIRS = 10_000_000  # of faces and triangles in one cell, above which nothing is listed
_ASKING = 200_000  # faces, likewise
_LONGEST = 200  # of one face's list: testing more costs more than casting a ray
_CELLS = 256  # along the longest side of a ground, at most
_RING = np.stack(np.meshgrid(*(np.arange(-1, 2),) * 3, indexing="ij"), axis=-1).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class Lists:
    """Of face f the triangles `members[first[f]:first[f] + count[f]]`; `count` is -1 where nobody has made a list."""

    first: Index
    count: NDArray[np.int32]
    members: NDArray[np.int32]

    def arrays(self) -> tuple[Index, NDArray[np.int32], NDArray[np.int32]]:
        """As compiled code takes them."""
        return self.first, self.count, self.members


@dataclass(frozen=True, slots=True)
class Candidates:
    """What rays of walkers with a body of up to `body` mm can meet: `ahead` of them on a face near other pieces, triangles of
    those pieces; `beyond` the open border of a face, all triangles but that face. Rays err by less than `margin` mm."""

    body: float
    margin: float
    ahead: Lists
    beyond: Lists

    @staticmethod
    def unknown(faces: int) -> Candidates:
        """Of a ground about which nothing is said."""
        nothing = Lists(np.zeros(faces, np.int64), np.full(faces, -1, np.int32), np.empty(0, np.int32))
        return Candidates(-np.inf, 0.0, nothing, nothing)


class Listing:
    """Makes `Candidates` from the tables, corners float64[m,3,3] and how far rays err (mm); keeps them until more is asked."""

    def __init__(self, table: Topology, corners: Floats, margin: float) -> None:
        self._table, self._corners, self._margin = table, corners, margin
        self._parts: Parts | None = None
        self._kept: Candidates | None = None

    def within(self, parts: Parts, body: float, lift: float, far: float, noise: float) -> Candidates:
        """For faces that `parts` has clearances of. Rays go up to `lift` bodies off a face and `far` bodies from a border, each
        and twice the `noise` (mm)."""
        if self._kept is None or self._parts is not parts or not body <= self._kept.body:
            most = 1.5 * body if np.isfinite(body) else 0.0
            margins = 2 * (noise + self._margin)
            self._kept = Candidates(
                most, self._margin, self._ahead(parts, lift * most + margins), self._beyond(far * most + margins)
            )
            self._parts = parts
        return self._kept

    def _ahead(self, parts: Parts, reach: float) -> Lists:
        asking = np.flatnonzero(parts.count)
        piece = self._table.piece
        one, other = self._pairs(asking, self._corners[asking], reach)
        apart = piece[asking[one]] != piece[other]
        lists = self._lists(asking if one.size else asking[:0], one[apart], other[apart])
        lists.count[self._table.cuts.cut] = -1  # who walks there always asks what cuts it
        return lists

    def _beyond(self, reach: float) -> Lists:
        half = np.flatnonzero((self._table.link == NO_LINK).any(axis=0) & np.repeat(self._table.live, 3))
        face, k = half // 3, half % 3
        start, end = self._corners[face, (k + 1) % 3], self._corners[face, (k + 2) % 3]
        one, other = self._pairs(face, np.stack([start, end, end], axis=1), reach)
        asking, which = np.unique(face if one.size else face[:0], return_inverse=True)
        one = which[one]
        apart = asking[one] != other
        return self._lists(asking, one[apart], other[apart])

    def _pairs(self, asking: Index, corners: Floats, reach: float) -> tuple[Index, Index]:
        """All (number in `corners`, live face) nearer than `reach`, and some more; nothing where that would be too much work."""
        live = np.flatnonzero(self._table.live)
        nothing = np.empty(0, np.int64)
        if not asking.size or asking.size > _ASKING or not live.size:
            return nothing, nothing
        low, high = self._corners[live].min(axis=(0, 1)), self._corners[live].max(axis=(0, 1))
        sides = [np.subtract(*_sides(self._corners[live, :, axis])[::-1]) for axis in range(3)]
        width = max(reach, float(np.median(np.maximum.reduce(sides))), float((high - low).max()) / _CELLS)
        cells = np.floor((high - low) / width).astype(np.int64) + 3  # and a ring around
        one, at = _cells((corners - low) / width, cells, _RING)
        wanted = np.zeros(int(cells.prod()), bool)
        wanted[at] = True
        other, there = _cells((self._corners[live] - low) / width, cells, _RING[len(_RING) // 2 :][:1], wanted)
        order = np.argsort(there, kind="stable")
        other, there = live[other[order]], there[order]
        begin, stop = np.searchsorted(there, at, "left"), np.searchsorted(there, at, "right")
        count = stop - begin
        if count.sum() > _PAIRS:
            return nothing, nothing
        member = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(begin, count)
        one, other = np.repeat(one, count), other[member]
        for axis in range(3):
            least, most = _sides(corners[:, :, axis])
            low_there, high_there = _sides(self._corners[:, :, axis])
            beside = (least[one] - high_there[other] <= reach) & (low_there[other] - most[one] <= reach)
            one, other = one[beside], other[beside]
        pair = np.unique(one * len(self._corners) + other)
        return pair // len(self._corners), pair % len(self._corners)

    def _lists(self, asking: Index, one: Index, other: Index) -> Lists:
        """Lists of the faces `asking` from pairs of a number of them and a face, in any order."""
        pair = np.unique(one * len(self._corners) + other)
        one, other = pair // len(self._corners), pair % len(self._corners)
        first, count = np.zeros(len(self._corners), np.int64), np.full(len(self._corners), -1, np.int32)
        size = np.bincount(one, minlength=asking.size)
        first[asking] = np.cumsum(size) - size
        count[asking] = np.where(size > _LONGEST, -1, size)
        return Lists(first, count, other.astype(np.int32))


def _sides(corners: Floats) -> tuple[Floats, Floats]:
    """The least and the most of three numbers each, [n,3]."""
    a, b, c = corners.T
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _cells(corners: Floats, size: Index, ring: Index, wanted: NDArray[np.bool_] | None = None) -> tuple[Index, Index]:
    """Which triangles [n,3,3] lie in which cells, or beside these by `ring` [k,3]: numbers of triangles and of cells, once each.
    `wanted`: of all cells, those that count."""
    found = [np.empty((2, 0), np.int64)]
    for cell, which in triangle_cells(corners, exact=False):
        around = (cell[:, None] + ring + 1).clip(0, size - 1).reshape(-1, 3)
        flat = (around[:, 0] * size[1] + around[:, 1]) * size[2] + around[:, 2]
        which = np.repeat(which, len(ring))
        if wanted is not None:
            which, flat = which[wanted[flat]], flat[wanted[flat]]
        found.append(np.stack([which, flat]))
    which, flat = np.concatenate(found, axis=1)
    pair = np.unique(which * int(size.prod()) + flat)
    return pair // int(size.prod()), pair % int(size.prod())
