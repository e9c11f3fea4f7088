"""What short straight ways meet first, exactly, in float64: a tree of boxes over triangles names those that they may meet.

`boxes_compiled` goes through the same tree one way at a time and gives the same bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import Topology
from antdsl.numerics.sorting import interleaved
from antdsl.numerics.vectors import dot, stacked_cross

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

WIDE = 4  # boxes in one box
EDGE = 1e-9  # of a triangle's weights: how far beside it a way still meets it, so that none slips between two that share an edge
FARTHEST = 1e6  # times its length that a way is made longer, at most
LEVEL = 1e-12  # sine between a way and a plane, below which it lies along it and meets nothing
_AT_ONCE = 16_384  # ways
_FINE = 1 << 21  # places along an axis that the order tells apart


@dataclass(frozen=True, slots=True, eq=False)
class Boxes:
    """Triangles in the `order` of the smallest boxes, each around one, and the `bounds` (n, 6) of all boxes, least x, y, z and
    most: those of level k, which hold `WIDE` of the level below each, from `first[k]` to before `first[k + 1]`."""

    order: Index
    first: Index
    bounds: Floats

    @staticmethod
    def of(vertices: Floats, faces: NDArray[np.int32], live: Index, group: NDArray[np.int32]) -> Boxes:
        """Over the `live` ones of triangles; those of one `group` int32[m] follow each other. Within it the order is that of
        Morton, so that neighbours share boxes (Lauterbach et al., Fast BVH Construction on GPUs, 2009, p. 376-378)."""
        order = live[np.lexsort((_morton(vertices[faces[live]].mean(axis=1)), group[live]))]
        counts = [live.size]
        while counts[-1] > 1:
            counts.append(-(-counts[-1] // WIDE))
        first = np.cumsum([0, *counts])
        boxes = Boxes(order, first, np.empty((int(first[-1]), 6)))
        boxes.fit(vertices, faces)
        return boxes

    def fit(self, vertices: Floats, faces: NDArray[np.int32], since: int = 0) -> None:
        """The same triangles elsewhere, but for those before `since` in the order, which have not moved: changes `bounds`."""
        a, b, c = (vertices.take(faces[self.order[since:], k], axis=0) for k in range(3))
        ends = np.concatenate([np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)], axis=1)
        self.bounds[since : self.first[1]] = ends
        for k in range(1, len(self.first) - 1):
            since //= WIDE
            ends = self.bounds[self.first[k - 1] + WIDE * since : self.first[k]]
            ends = np.concatenate([ends, np.repeat(ends[-1:], -len(ends) % WIDE, axis=0)]).reshape(-1, WIDE, 6)
            here = slice(self.first[k] + since, self.first[k + 1])
            self.bounds[here, :3], self.bounds[here, 3:] = ends[:, :, :3].min(axis=1), ends[:, :, 3:].max(axis=1)

    def near(self, low: Floats, high: Floats) -> tuple[Index, Index]:
        """Pairs of a box (3, k) asked about and a triangle whose box overlaps it."""
        asked, node = np.arange(low.shape[1]), np.zeros(low.shape[1], np.int64)
        if not self.order.size:
            return asked[:0], node[:0]
        for k in range(len(self.first) - 2, -1, -1):
            bounds = self.bounds.take(self.first[k] + node, axis=0).T
            over = (bounds[0] <= high[0].take(asked)) & (bounds[3] >= low[0].take(asked))
            for axis in (1, 2):
                over &= (bounds[axis] <= high[axis].take(asked)) & (bounds[3 + axis] >= low[axis].take(asked))
            asked, node = asked[over], node[over]
            if k:
                node = (WIDE * node[:, None] + np.arange(WIDE)).ravel()
                real = node < self.first[k] - self.first[k - 1]
                asked, node = np.repeat(asked, WIDE)[real], node[real]
        return asked, self.order.take(node)


def first_met(
    boxes: Boxes, table: Topology, origin: Floats, step: Floats, fine: float, face: Index, piece: NDArray[np.int32]
) -> tuple[Index, Floats, Floats, Floats]:
    """The first triangle that straight ways (3, n) meet (-1 for none), after what part of them, and its weights there.

    Ways go on by `fine` mm. They pass a `face`, and all of a `piece`; -1 passes none. Met are triangles whose boxes overlap that
    of the way, from both sides, and by no way that lies in their plane; of two that are met at once the first by number (Möller,
    Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997, p. 22-24).
    """
    n = origin.shape[1]
    found, part, b1, b2 = np.full(n, -1, np.int64), np.full(n, np.inf), np.zeros(n), np.zeros(n)
    for start in range(0, n, _AT_ONCE):
        some = slice(start, start + _AT_ONCE)
        o, d = origin[:, some], step[:, some]
        square = dot(d, d)
        long = 1.0 + np.minimum(fine / np.maximum(np.sqrt(square), 1e-300), FARTHEST)
        end = o + d * long
        ray, there = boxes.near(np.minimum(o, end), np.maximum(o, end))
        kept = (there != face[some].take(ray)) & (table.piece.take(there) != piece[some].take(ray))
        ray, there = ray[kept], there[kept]
        e1, e2 = table.edge1.take(there, axis=1), table.edge2.take(there, axis=1)
        way, s = d.take(ray, axis=1), o.take(ray, axis=1) - table.corner.take(there, axis=1)
        p = stacked_cross(way, e2)
        det = dot(e1, p)
        level = np.abs(det) <= LEVEL * np.sqrt(square.take(ray) * dot(e1, e1) * dot(e2, e2))
        safe = np.where(level, 1.0, det)
        q = stacked_cross(s, e1)
        u, v, t = dot(s, p) / safe, dot(way, q) / safe, dot(e2, q) / safe
        hit = ~level & (u >= -EDGE) & (v >= -EDGE) & (u + v <= 1.0 + EDGE) & (t >= 0) & (t <= long.take(ray))
        ray, there, u, v, t = (a[hit] for a in (ray, there, u, v, t))
        order = np.lexsort((there, t, ray))
        ray, nearest = np.unique(ray[order], return_index=True)
        rows, order = ray + start, order[nearest]
        found[rows], part[rows], b1[rows], b2[rows] = there[order], t[order], u[order], v[order]
    return found, part, b1, b2


def _morton(places: Floats) -> NDArray[np.uint64]:
    """Places [n,3] numbered along a curve that keeps together what is near."""
    if not len(places):
        return np.empty(0, np.uint64)
    low = places.min(axis=0)
    size = max(float((places.max(axis=0) - low).max()), 1e-300)
    cell = np.minimum((places - low) / size * _FINE, _FINE - 1).astype(np.uint64)
    return interleaved(cell)
