"""Lower bounds of the distances between pieces of the ground. A piece consists of faces that are connected across edges. With
these bounds, most agents need no search for other pieces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.distance_grid import choose_cell_width, limit_cell_width
from antdsl.casting.grid_filters import filter_maximum, filter_minimum
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.casting.rays import RayScene
from antdsl.numerics import stored_tables

Floats = NDArray[np.float64]
Index = NDArray[np.int64]

_MAX_GRID_CELLS = 400_000
_MAX_FACE_PARTS = 100_000  # maximum number of parts of all faces near other pieces
_MAX_PARTS_PER_EDGE = 8  # parts along each edge of a face
_MAX_PIECES = 500  # with more pieces, faces are not divided and count as touching


@dataclass(frozen=True, slots=True)
class FacePartClearances:
    """Faces divided into parts, and the distance of each part from other pieces of the ground.

    - `reach`: the greatest distance (mm) that is measured
    - `first_parts`: the number of the first part of each face
    - `parts_per_edge`: the number of parts of each face along its first edge and along its second edge; 0 if no other piece is
      within `reach`
    - `clearances`: for each part, a distance (mm) within which there is no other piece"""

    reach: float
    first_parts: Index
    parts_per_edge: NDArray[np.int32]
    clearances: Floats


class PieceClearances:
    """Measures lower bounds of the distance from each face to the nearest other piece of the ground. A coarse grid selects the
    faces to measure.

    - `corners` float64[m,3,3]: the corners of faces
    - `piece` int32[m]: the piece of each face, -1 for none
    - `cut`: faces that are cut by others of their piece; they are treated as a separate piece that touches all others
    - `low`: the lowest corner of the bounding box of all faces
    - `distance_noise`: the measuring error (mm)"""

    def __init__(self, corners: Floats, piece: NDArray[np.int32], cut: NDArray[np.bool_], low: Floats, noise: float) -> None:
        self.distance_noise = noise
        self._is_cut = cut
        piece = np.where(cut, piece.max(initial=-1) + 1, piece).astype(np.int32)
        self._piece = piece
        self._corners, self._low = corners, low
        self._parts: FacePartClearances | None = None
        self._has_several_pieces = len(np.unique(piece[piece >= 0])) > 1

    def get_face_parts(self, reach: float) -> FacePartClearances:
        """Return clearances for distances up to `reach` mm. They are cached, and measured again when a greater reach is
        requested."""
        if self._parts is None or self._parts.reach < reach:
            # Wider than requested: otherwise a crowd that accelerates slowly would cause repeated measurements.
            self._parts = self._build_face_parts(1.5 * reach if self._has_several_pieces else np.inf)
        return self._parts

    def _build_face_parts(self, reach: float) -> FacePartClearances:
        inputs = (self._corners, self._piece, self._is_cut, self._low, self.distance_noise, reach)
        size = len(self._piece) if self._has_several_pieces else 0
        tables = stored_tables.get_or_compute("distances of pieces", size, inputs, partial(self._measure_face_parts, reach))
        return FacePartClearances(reach, tables["first"], tables["count"], tables["least"])

    def _measure_face_parts(self, reach: float) -> stored_tables.Tables:
        """Return the arrays of `FacePartClearances` by field name. Distances are measured up to `reach` mm."""
        m = len(self._piece)
        near = (
            np.flatnonzero(self._find_faces_near_pieces(reach) | self._is_cut)
            if self._has_several_pieces
            else np.empty(0, np.int64)
        )
        count, first = np.zeros(m, np.int32), np.zeros(m, np.int64)
        if not near.size:
            return {"first": first, "count": count, "least": np.empty(0)}
        measurable = len(np.unique(self._piece[near])) <= _MAX_PIECES
        n = min(max(int((_MAX_FACE_PARTS / near.size) ** 0.5), 1), _MAX_PARTS_PER_EDGE) if measurable else 1
        count[near] = n
        first[near] = np.arange(near.size) * n * n
        least = np.zeros((near.size, n * n))
        if measurable:
            for piece in np.unique(self._piece[near]):
                if piece >= 0:
                    own = self._piece[near] == piece
                    least[own] = self._compute_part_clearances(near[own], near[~own & (self._piece[near] >= 0)], n, reach)
        least[self._is_cut[near]] = 0.0
        return {"first": first, "count": count, "least": least.ravel()}

    def _compute_part_clearances(self, own_faces: Index, other_faces: Index, n: int, reach: float) -> Floats:
        """Return the clearances (k, n*n) of the k faces `own_faces`, each divided into n*n parts, from the faces
        `other_faces`."""
        a, b, c = (self._corners[own_faces, k] for k in range(3))
        edge1, edge2 = (b - a) / n, (c - a) / n
        middle = np.arange(n) + 0.5
        one, two = (v.ravel() for v in np.meshgrid(middle, middle, indexing="ij"))
        centre = a[:, None] + one[:, None] * edge1[:, None] + two[:, None] * edge2[:, None]
        radius = np.sqrt(np.maximum(((edge1 + edge2) ** 2).sum(axis=1), ((edge1 - edge2) ** 2).sum(axis=1))) / 2
        low, high = (np.min(centre, axis=(0, 1)) - 2 * reach, np.max(centre, axis=(0, 1)) + 2 * reach)
        other_corners = self._corners[other_faces]
        beside = ((other_corners.min(axis=1) <= high) & (other_corners.max(axis=1) >= low)).all(axis=1)
        if not beside.any():
            return np.full(centre.shape[:2], reach)
        scene = RayScene(other_corners[beside].reshape(-1, 3), np.arange(3 * int(beside.sum()), dtype=np.int32).reshape(-1, 3))
        _, _, _, distance = scene.find_closest(centre.reshape(-1, 3))
        gaps = distance.reshape(centre.shape[:2]) - radius[:, None] - 2 * self.distance_noise
        clear: Floats = np.clip(gaps, 0.0, reach)
        return clear

    def _find_faces_near_pieces(self, reach: float) -> NDArray[np.bool_]:
        """Return a mask of the faces that may have another piece of the ground within `reach` mm: those in a grid cell that has
        two pieces nearby."""
        grid = self._piece_grid
        mixed = grid.find_mixed_cells(int(min(np.ceil(reach / grid.width), grid.size.max())))
        is_near = np.zeros(len(grid.corners_in_cells), bool)
        for cell, which in iterate_triangle_cells(grid.corners_in_cells, exact=False):
            is_near[which[mixed[grid.flatten_cells(np.clip(cell, 0, grid.size - 1))]]] = True
        return is_near

    @cached_property
    def _piece_grid(self) -> _PieceNumberGrid:
        """Return the grid of pieces, built on first use."""
        corners, piece = self._corners, self._piece
        size = corners.max(axis=(0, 1)) - self._low
        width = limit_cell_width(corners, choose_cell_width(size, _MAX_GRID_CELLS))
        cells = np.floor(size / width).astype(np.int64) + 1
        none, count = np.iinfo(np.int32).max, int(cells.prod())
        grid = _PieceNumberGrid(
            width, (corners - self._low) / width, cells, np.full(count, none, np.int32), np.full(count, -1, np.int32)
        )
        live = np.flatnonzero(piece >= 0)
        for cell, which in iterate_triangle_cells(grid.corners_in_cells[live], exact=False):
            flat = grid.flatten_cells(np.minimum(cell, cells - 1))
            np.minimum.at(grid.min_piece, flat, piece[live[which]])
            np.maximum.at(grid.max_piece, flat, piece[live[which]])
        return grid


@dataclass(frozen=True, slots=True, eq=False)
class _PieceNumberGrid:
    """A grid that records which pieces of the ground each cell contains.

    - `width`: the width of a cell (mm)
    - `corners_in_cells`: the corners of faces, in units of cells
    - `size`: the number of cells along each axis
    - `min_piece`, `max_piece`: the least and the greatest piece number in each cell"""

    width: float
    corners_in_cells: Floats
    size: Index
    min_piece: NDArray[np.int32]
    max_piece: NDArray[np.int32]

    def flatten_cells(self, cell: Index) -> Index:
        """Return the indices of cells in the flattened grid."""
        flat: Index = (cell[..., 0] * self.size[1] + cell[..., 1]) * self.size[2] + cell[..., 2]
        return flat

    def find_mixed_cells(self, rings: int) -> NDArray[np.bool_]:
        """Return a mask of the cells that have at least two pieces within `rings` cells."""
        shape = tuple(self.size)
        least = filter_minimum(self.min_piece.reshape(shape), rings)
        most = filter_maximum(self.max_piece.reshape(shape), rings)
        mixed: NDArray[np.bool_] = ((least != most) & (most >= 0)).ravel()
        return mixed
