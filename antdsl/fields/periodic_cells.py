"""The cells of a field in a periodic world. Their voxels have their centres inside the world's box, and voxels at opposite
sides of the box are neighbours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.rays import MeshArrays
from antdsl.fields.cells import CellLookupState, Cells, Floats, SurfaceCells, are_sides_compatible
from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.scene.geometry.clipping import clip_mesh

_MAX_CELL_ERROR = 1e-6  # share of a cell by which a width may differ from a whole number of cells
_RECTANGLE_FACES = 2  # of a level surface over the whole box
MIN_CELLS_ALONG_AXIS = 3  # with fewer, a cell would have the same neighbour on both sides


class CellsDoNotFit(ValueError):
    """Error raised if the width of a periodic world (`width`, mm) is not a whole number of cells, or is less than three cells."""

    def __init__(self, width: float, cell: float) -> None:
        super().__init__(f"the width of {width:g} mm is not a whole number of cells of {cell:g} mm")
        self.width, self.cell = width, cell

    @property
    def fitting_cell(self) -> float:
        """Return a cell size (mm) that fits the width and is nearest to the requested size."""
        return self.width / max(MIN_CELLS_ALONG_AXIS, round(self.width / self.cell))


class PeriodicCells(SurfaceCells):
    """A variant of `SurfaceCells` for a periodic world.

    Raises CellsDoNotFit if a width is not a whole number of cells. The centre of each cell's voxel is inside the box. At the
    sides of the box, periodic images of surfaces cover the voxels that extend beyond it."""

    def __init__(self, surfaces: Sequence[MeshArrays], cell: float, box: PeriodicBox, cap: int = limits.MAX_FIELD_CELLS) -> None:
        self._box = box
        first, count = np.zeros((2, 3), np.int64)
        for axis in box.axes:
            width = box.widths[axis]
            count[axis] = round(width / cell)
            if count[axis] < MIN_CELLS_ALONG_AXIS or abs(width / cell - count[axis]) > _MAX_CELL_ERROR:
                raise CellsDoNotFit(width, cell)
            first[axis] = np.ceil(box.low[axis] / cell - _MAX_CELL_ERROR)
        self._counts = count
        covers = [_cover_voxels(mesh, box, first, count, cell) for mesh in surfaces]
        super().__init__(covers, cell, cap)
        self._keep_voxels(first)
        if [len(faces) for _, faces in covers] == [_RECTANGLE_FACES]:  # the same positions also where triangles meet
            ends = covers[0][0]
            middles = (self._list_voxels(np.arange(len(self))) + self._low) * self.cell
            self.position = np.clip(middles, ends.min(axis=0), ends.max(axis=0))

    def _keep_voxels(self, first: NDArray[np.int64]) -> None:
        """Remove the cells in voxels outside the box. Along an axis that wraps, these are the voxels before `first`, and those
        after the last voxel of the box."""
        wraps = self._counts > 0
        voxels = self._list_voxels(np.arange(len(self))) + self._low
        low, size = np.where(wraps, first, self._low), np.where(wraps, self._counts, self._size)
        inner = np.flatnonzero(((voxels >= low) & (voxels < low + size)).all(axis=1))
        sides = self.side_by_cell[inner].astype(np.int8)
        self._low, self._size = low, size
        self._keys = self._pack_keys(voxels[inner] - low, sides)
        self.position, self.normal = self.position[inner], self.normal[inner]
        self._voxel_numbers = self._keys // 6
        self._start_table = self._build_start_table()

    def _list_voxels(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the voxels of cells, int64[n, 3], relative to the low corner of the box of voxels."""
        rest, z = np.divmod(self._voxel_numbers[cells], self._size[2])
        return np.stack([*np.divmod(rest, self._size[1]), z], axis=1)

    def _fold_voxels(self, voxels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return voxels, int64[n, 3], moved into the box along the axes that wrap."""
        return np.where(self._counts > 0, voxels % np.maximum(self._counts, 1), voxels)

    def _fold_points(self, points: Floats) -> Floats:
        """Return points [n, 3] mm moved by whole box widths into the voxels of the box."""
        folded = points
        for axis in self._box.axes:
            values = points[:, axis]
            with np.errstate(invalid="ignore"):
                turns = np.floor((np.floor(values / self.cell + 0.5) - self._low[axis]) / self._counts[axis])
            moved = np.isfinite(turns) & (turns != 0)
            if moved.any():
                folded = folded.copy() if folded is points else folded
                folded[moved, axis] = values[moved] - turns[moved] * self._box.widths[axis]
        return folded

    def update_cells(
        self,
        points: Floats,
        side: NDArray[np.int8],
        previous_cells: CellLookupState | None,
        result: Cells | None = None,
        threads: int = 1,
    ) -> tuple[Cells, CellLookupState | None]:
        points = self._fold_points(np.asarray(points, np.float64).reshape(-1, 3))
        return super().update_cells(points, side, previous_cells, result, threads)

    def compute_offsets(self, first: Floats, second: Floats) -> Floats:
        """Return the vectors [n, 3] from points `second` to the nearest images of points `first`."""
        offsets = first - second
        return self._box.move_points(offsets, self._box.find_nearest_images(offsets))

    def _find_cell_ranges(self, voxel: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        return super()._find_cell_ranges(self._fold_voxels(voxel))

    def _find_neighbour_pairs(
        self, cells: NDArray[np.int64], column: Callable[[int, int], int]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        voxels = self._list_voxels(cells)
        rows, others = [], []
        for offset in product((-1, 0, 1), repeat=3):
            if abs(offset[2]) > column(offset[0], offset[1]):
                continue
            first, count = self._find_cell_ranges(voxels + np.array(offset))
            one = np.repeat(np.arange(len(cells)), count)
            rows.append(one)
            others.append(np.arange(one.size) + np.repeat(first - (np.cumsum(count) - count), count))
        one, other = np.concatenate(rows), np.concatenate(others)
        compatible = np.flatnonzero(
            are_sides_compatible(self.get_sides_of_cells(other), self.get_sides_of_cells(cells).take(one))
        )
        one, other = one.take(compatible), other.take(compatible)
        order = np.lexsort((other, one))
        return one.take(order), other.take(order)

    def _count_voxel_steps(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
        steps = np.abs(self._list_voxels(first) - self._list_voxels(second))
        steps = np.where(self._counts > 0, np.minimum(steps, np.abs(self._counts - steps)), steps)
        total: NDArray[np.int64] = steps.sum(axis=1)
        return total

    def get_nearest_cells(self, k: int) -> Cells:
        if k not in self._tables:
            self._tables[k] = self._compute_nearest_cells(np.arange(len(self)), k)
        return self._tables[k]


def _cover_voxels(
    mesh: MeshArrays, box: PeriodicBox, first: NDArray[np.int64], count: NDArray[np.int64], cell: float
) -> MeshArrays:
    """Return a mesh together with its periodic images, cut off one cell outside the box of voxels that starts at `first`. A
    level rectangle that covers the complete box is enlarged instead of repeated, because edges between images would displace
    cells."""
    vertices, faces = (np.asarray(mesh[0], np.float64), np.asarray(mesh[1], np.int32))
    wraps, widths = count > 0, np.array(box.widths)
    low = np.where(wraps, (first - 1.5) * cell, -np.inf)
    high = np.where(wraps, (first + count + 0.5) * cell, np.inf)
    begin = np.array(box.low)
    at_low, at_high = wraps & (vertices == begin), wraps & (vertices == begin + widths)
    if len(faces) == _RECTANGLE_FACES and ((at_low | at_high) == wraps).all():
        return np.where(at_low, low, np.where(at_high, high, vertices)), faces
    parts = [clip_mesh(vertices + image * widths, faces, low, high) for image in box.list_images()]
    starts = np.cumsum([0, *(len(v) for v, _ in parts)])[:-1]
    joined = [f + start for (_, f), start in zip(parts, starts, strict=True)]
    return np.concatenate([v for v, _ in parts]), np.concatenate(joined).astype(np.int32)
