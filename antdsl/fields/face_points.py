"""Lattice points on faces, at which flows are computed. Each face is divided into n · n equal triangles; n is a power of two.
The lattice points around a footing are found with one table look-up, without a search. The module also chooses the resolution
of the lattice for a flow."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.setting import BorderFlowData, SolvedFlowData, SpreadFlowData

_DEFAULT_PIECES_PER_RADIUS = 8  # pieces per radius or border, if no cell size is set
_DEFAULT_PIECES_PER_EXTENT = 64  # pieces per extent of the ground, if there is no radius either
_DEFAULT_CROWD_PIECES_PER_EXTENT = 48  # the same, for a flow that is solved repeatedly
_MAX_DEFAULT_POINTS = 200_000  # maximum number of points if no cell size is set
_MIN_CELL_EXTENT = 1e-12  # smallest cell, as a share of the extent
Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_WELD_DISTANCE_SHARE = 1e-7  # share of the extent; nearer points are merged
_MAX_PIECES_PER_EDGE = 1024  # maximum number of pieces along an edge


class LatticeTooFineError(ValueError):
    """Error raised if a lattice would need more points than allowed. `needed`: the approximate number of points."""

    def __init__(self, needed_count: int) -> None:
        super().__init__(f"about {needed_count:,} points")
        self.needed = needed_count


def count_slots(edge_pieces: Index) -> int:
    """Return the number of lattice points of each face, for `edge_pieces` pieces along each of its edges."""
    return int(((edge_pieces + 1) * (edge_pieces + 2) // 2).sum())


def count_edge_pieces_by_length(edge_lengths: Floats, cell: float | Floats) -> Index:
    """Return into how many pieces to divide each edge, so that each piece is at most `cell` (mm) long.

    The results are powers of two, and 1 if `cell` is infinite. `edge_lengths`: the lengths of the edges (mm)."""
    with np.errstate(divide="ignore"):
        pieces = np.clip(edge_lengths / cell, 1.0, _MAX_PIECES_PER_EDGE)
    cuts: Index = np.left_shift(1, np.frexp(pieces * (1 - 1e-9))[1].astype(np.int64))
    return cuts


@dataclass(frozen=True, slots=True, eq=False)
class FaceLattice:
    """A lattice of points on faces, called slots. Each face is divided into equal triangles, with slots at their corners.

    `edge_pieces`: for each face, the number n of pieces along an edge; the face has (n + 1)(n + 2) / 2 slots. `first_slots`:
    the first slot of each face. Slots are ordered in rows. Within a row, they proceed towards the face's second corner; the
    rows proceed towards its third corner."""

    edge_pieces: Index
    first_slots: Index

    @staticmethod
    def from_edge_pieces(edge_pieces: Index) -> FaceLattice:
        """Return the lattice that divides each edge of face i into `edge_pieces[i]` pieces."""
        sizes = (edge_pieces + 1) * (edge_pieces + 2) // 2
        return FaceLattice(edge_pieces, np.concatenate(([0], np.cumsum(sizes)))[:-1])

    def __len__(self) -> int:
        return count_slots(self.edge_pieces)

    def find_slots(self, face: Index, b1: Floats, b2: Floats) -> tuple[Index, Floats]:
        """Return, for each position in a face, the three slots around it (3, n), and the interpolation weights of these slots (3,
        n).

        `face`, `b1`, `b2` (n): the faces, and the barycentric weights of their second and third corners."""
        n, start = self.edge_pieces.take(face), self.first_slots.take(face)
        u, v = b1 * n, b2 * n
        j = np.clip(v.astype(np.int64), 0, n - 1)
        i = np.clip(u.astype(np.int64), 0, n - 1 - j)
        u, v = u - i, v - j
        upper = (u + v > 1) & (i + j < n - 1)  # the inverted triangle
        slot = start + j * (n + 1) - j * (j - 1) // 2 + i
        next_row_slot = slot + n + 1 - j
        slots = np.stack([np.where(upper, next_row_slot + 1, slot), slot + 1, next_row_slot])
        weights = np.stack([np.where(upper, u + v - 1, 1 - u - v), np.where(upper, 1 - v, u), np.where(upper, 1 - u, v)])
        return slots, weights

    def get_face_by_slot(self) -> Index:
        """Return the number of the face that each slot is on."""
        return np.repeat(np.arange(len(self.edge_pieces)), (self.edge_pieces + 1) * (self.edge_pieces + 2) // 2)

    def compute_slot_weights(self) -> tuple[Floats, Floats]:
        """Return two barycentric weights of each slot: those of its face's second and third corner."""
        b1, b2 = np.empty(len(self)), np.empty(len(self))
        for n, chosen, i, j in self._group_by_edge_pieces():
            slots = self.first_slots[chosen][:, None] + np.arange(len(i))
            b1[slots], b2[slots] = i / n, j / n
        return b1, b2

    def compute_triangles(self) -> tuple[Index, Index]:
        """Return the triangles between slots: their corners as slot numbers (t, 3), and their faces (t,). The winding is that
        of the face."""
        parts, owners = [np.empty((0, 3), np.int64)], [np.empty(0, np.int64)]
        for n, chosen, i, j in self._group_by_edge_pieces():
            slots = np.arange(len(i))
            low = slots[i + j < n]
            high = slots[i + j < n - 1]
            up = n + 1 - j
            standing = np.stack([low, low + 1, low + up[low]], axis=1)
            on_head = np.stack([high + 1, high + up[high] + 1, high + up[high]], axis=1)
            small = np.concatenate([standing, on_head])
            parts.append((self.first_slots[chosen][:, None, None] + small).reshape(-1, 3))
            owners.append(np.repeat(chosen, len(small)))
        return np.concatenate(parts), np.concatenate(owners)

    def _group_by_edge_pieces(self) -> list[tuple[int, Index, Index, Index]]:
        """Group faces by the number of pieces per edge.

        Return a tuple for each group: the number of pieces, the faces, and two arrays with the column and the row of each slot in
        a face."""
        groups = []
        for n in np.unique(self.edge_pieces).tolist():
            j = np.repeat(np.arange(n + 1), np.arange(n + 1, 0, -1))
            i = np.arange(len(j)) - np.repeat(np.cumsum([0, *range(n + 1, 1, -1)]), np.arange(n + 1, 0, -1))
            groups.append((n, np.flatnonzero(self.edge_pieces == n), i, j))
        return groups


def weld_points(positions: Floats, surface_numbers: NDArray[np.integer]) -> tuple[Index, int]:
    """Merge equal positions (n, 3) on the same surface into points.

    Return the point number of each position, and the number of points."""
    if not len(positions):
        return np.empty(0, np.int64), 0
    low = positions.min(axis=0)
    grain = max(float((positions.max(axis=0) - low).max()) * _WELD_DISTANCE_SHARE, 1e-300)
    # an odd offset, so that round coordinates are not near the border of a cell
    keys = np.floor((positions - low) / grain + 0.318).astype(np.int64)
    order = np.lexsort((keys[:, 2], keys[:, 1], keys[:, 0], surface_numbers))
    rows = np.column_stack([surface_numbers, keys])[order]
    fresh = np.concatenate(([0], np.cumsum((rows[1:] != rows[:-1]).any(axis=1))))
    point = np.empty(len(positions), np.int64)
    point[order] = fresh
    return point, int(fresh[-1]) + 1


def choose_cell_size(flow: SpreadFlowData | BorderFlowData | SolvedFlowData, extent: float) -> float:
    """Return the edge length (mm) of a flow's cells. This is `flow.cell` or, if it is not set, a default for a ground of size
    `extent` (mm)."""
    if flow.cell is not None:
        return flow.cell
    if isinstance(flow, BorderFlowData):
        return flow.max_distance / _DEFAULT_PIECES_PER_RADIUS
    if isinstance(flow, SpreadFlowData):
        return extent / _DEFAULT_PIECES_PER_EXTENT if flow.radius is None else flow.radius / _DEFAULT_PIECES_PER_RADIUS
    cell_size = extent / (_DEFAULT_CROWD_PIECES_PER_EXTENT if flow.crowding else _DEFAULT_PIECES_PER_EXTENT)
    return min(cell_size, flow.clearance / 2) if flow.clearance else cell_size


def choose_edge_pieces(flow: SpreadFlowData | BorderFlowData | SolvedFlowData, edge_lengths: Floats, extent: float) -> Index:
    """Return the number of pieces into which to divide the edges of each face.

    `edge_lengths` (n): the longest edge (mm) of each face, 0 where the flow is not needed. `extent`: the size (mm) of the
    ground. The default cell size is increased if it would give too many points. Raises LatticeTooFineError if the scene sets a
    cell size that is too small."""
    cell = choose_cell_size(flow, extent)
    while True:
        cuts = count_edge_pieces_by_length(edge_lengths, cell)
        points = count_slots(cuts)
        if flow.cell is not None and points > limits.MAX_FLOW_POINTS:
            raise LatticeTooFineError(points)
        if flow.cell is not None or points <= max(_MAX_DEFAULT_POINTS, 3 * len(edge_lengths)):
            return cuts
        cell = max(1.3 * cell, extent * _MIN_CELL_EXTENT)  # a radius near 0 gives a cell size of 0
