"""The cells of a pheromone field. A voxel that a surface touches has one cell per axis direction that the surface faces there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import product

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.casting.rays import MeshArrays
from antdsl.fields.block_index import EMPTY_BLOCK_INDEX, EMPTY_CELLS, BlockIndex, compute_group_ranks, sum_by_key
from antdsl.fields.cell_lookup import VoxelCellIndex, update_cell_lookups
from antdsl.ground.mesh.topology import classify_normal_directions
from antdsl.numerics import parallel, stored_tables

Floats = NDArray[np.float64]
Cells = NDArray[np.int32]

NEAREST_CELL_COUNT = 16
_MAX_DENSE_VOXELS = 8_000_000  # maximum number of voxels of a box for a table of all voxels
_MAX_VOXELS_PER_AXIS = 1 << 19  # three packed coordinates and a side fit into 63 bits
_MAX_SLIVER_CELL_RATIO = 2.0  # factor of triangle cells above the limit: many slivers may lie in one cell
VOXEL_BLOCK_OFFSETS = tuple((x, y, z) for x, y, z in product((-1, 0, 1), repeat=3))
_POINTS_PER_CHUNK = 1 << 15


class FieldTooFineError(ValueError):
    """Error raised if a field would need more than `limits.MAX_FIELD_CELLS` cells, or (if `is_axis_limit`) too many voxels
    along an axis. It is raised before memory is allocated."""

    def __init__(self, needed_count: int, cap: int, is_axis_limit: bool = False) -> None:
        super().__init__(f"about {needed_count:,} cells are needed, but only {cap:,} are allowed; increase `cell`")
        self.needed, self.cap, self.is_axis_limit = needed_count, cap, is_axis_limit


@dataclass(frozen=True, slots=True)
class CellLinks:
    """The linked neighbours of each cell. Those of cell a are `linked_cells[link_starts[a]:link_starts[a+1]]`, ascending."""

    link_starts: NDArray[np.int64]
    linked_cells: Cells


class SurfaceCells:
    """The cells of a field on surfaces.

    A cell is a voxel that a surface touches, together with a side, which is the axis direction nearest to the surface's
    normal. So a thin plate has separate cells for its two sides. Voxels have the edge length `cell` (mm), and their centres
    are on a lattice through the origin. Cells are numbered by position, then by side; the order of the faces does not matter.
    Each surface is (vertices float64[n,3], faces int32[m,3]). Raises FieldTooFineError before any large allocation."""

    def __init__(self, surfaces: Sequence[MeshArrays], cell: float, cap: int = limits.MAX_FIELD_CELLS) -> None:
        if not (np.isfinite(cell) and cell > 0):
            raise ValueError("the size of a cell must be more than 0")
        self.cell = float(cell)
        arrays = [np.asarray(v, np.float64).reshape(-1, 3)[np.asarray(f, np.int64).reshape(-1, 3)] for v, f in surfaces]
        corners = np.concatenate(arrays) if arrays else np.empty((0, 3, 3))
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.sqrt((normals * normals).sum(axis=1))
        corners, normals, area = (a[area > 0] for a in (corners, normals, area))
        needed = float(area.sum() / 2 / self.cell**2)
        extent = corners.max(axis=(0, 1)) - corners.min(axis=(0, 1)) if len(corners) else np.zeros(3)
        if needed > cap:
            raise FieldTooFineError(int(needed), cap)
        voxels_along_axis = float(extent.max()) / self.cell
        if voxels_along_axis > _MAX_VOXELS_PER_AXIS:
            raise FieldTooFineError(int(voxels_along_axis), _MAX_VOXELS_PER_AXIS, is_axis_limit=True)
        touched_count = float((corners.max(axis=1) - corners.min(axis=1)).max(axis=1).sum()) / self.cell
        if touched_count > _MAX_SLIVER_CELL_RATIO * cap:
            raise FieldTooFineError(int(touched_count), cap)
        scaled = corners / self.cell + 0.5
        self._low = np.floor(scaled.min(axis=(0, 1))).astype(np.int64) if len(corners) else np.zeros(3, np.int64)
        self._size = np.floor(scaled.max(axis=(0, 1))).astype(np.int64) - self._low + 1 if len(corners) else np.ones(3, np.int64)
        normal = normals / np.maximum(area, 1e-300)[:, None]
        work = partial(self._build_cell_tables, corners, scaled, normal, cap)
        tables = stored_tables.get_or_compute("surface cells", len(corners), (corners, self.cell), work)
        if len(tables["keys"]) > cap:
            raise FieldTooFineError(len(tables["keys"]), cap)
        self._keys: NDArray[np.int64] = tables["keys"]
        self.position: Floats = tables["position"]
        self.normal: Floats = tables["normal"]
        self._voxel_numbers = self._keys // 6
        self._start_table = self._build_start_table()
        self._tables: dict[int, Cells] = {}

    def _build_cell_tables(self, corners: Floats, scaled_corners: Floats, normal: Floats, max_cells: int) -> stored_tables.Tables:
        """Return the arrays `keys`, `position` and `normal` of all cells of triangles with the given `corners` and normals.

        `scaled_corners`: the corners in units of voxels. Raises FieldTooFineError if there are more than `max_cells` cells."""
        side = classify_normal_directions(normal)
        keys, sums = np.empty(0, np.int64), np.empty((0, 7))
        waiting: list[tuple[NDArray[np.int64], Floats]] = []
        for voxel, face in iterate_triangle_cells(scaled_corners):
            middle = voxel.astype(np.float64) * self.cell
            point = find_nearest_on_triangle(middle, corners[face])
            part = np.column_stack([point, normal[face], np.ones(len(face))])
            waiting.append(sum_by_key(self._pack_keys(voxel - self._low, side[face]), part))
            if sum(len(k) for k, _ in waiting) > max(1 << 20, len(keys)):
                keys, sums = sum_by_key(*(np.concatenate(c) for c in zip((keys, sums), *waiting, strict=True)))
                waiting.clear()
                if len(keys) > max_cells:
                    raise FieldTooFineError(len(keys), max_cells)
        keys, sums = sum_by_key(*(np.concatenate(c) for c in zip((keys, sums), *waiting, strict=True)))
        length = np.sqrt((sums[:, 3:6] ** 2).sum(axis=1))[:, None]
        return {"keys": keys, "position": sums[:, :3] / sums[:, 6:], "normal": sums[:, 3:6] / np.maximum(length, 1e-300)}

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def side_by_cell(self) -> NDArray[np.int64]:
        """Return the side of each cell: the axis direction that it faces, numbered as by `classify_normal_directions`."""
        return self._keys % 6

    def _pack_keys(self, voxel: NDArray[np.int64], side: NDArray[np.int8]) -> NDArray[np.int64]:
        """Return the key of each pair of a voxel [n,3] and a side. The key is the voxel's number times 6, plus the side."""
        key: NDArray[np.int64] = ((voxel[:, 0] * self._size[1] + voxel[:, 1]) * self._size[2] + voxel[:, 2]) * 6 + side
        return key

    def _build_start_table(self) -> NDArray[np.int32] | None:
        """Return the first cell of every voxel of the box, or None if the box is too large for a table."""
        count = int(self._size[0]) * int(self._size[1]) * int(self._size[2])
        if count > _MAX_DENSE_VOXELS:
            return None
        table = np.zeros(count + 1, np.int32)
        np.cumsum(np.bincount(self._voxel_numbers, minlength=count), out=table[1:])
        return table

    @cached_property
    def _max_cells_per_voxel(self) -> int:
        """Return the greatest number of cells in a voxel."""
        return int(np.unique(self._voxel_numbers, return_counts=True)[1].max(initial=0))

    def _find_cell_ranges(self, voxel: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the first cell of each voxel [n, 3] and the voxel's number of cells (0 outside the box), both int64[n].
        Voxels are given relative to the low corner of the box."""
        is_in_box = ((voxel >= 0) & (voxel < self._size)).all(axis=1)
        flat = np.where(is_in_box, (voxel[:, 0] * self._size[1] + voxel[:, 1]) * self._size[2] + voxel[:, 2], 0)
        if self._start_table is not None:
            first, last = (self._start_table.take(v).astype(np.int64) for v in (flat, flat + 1))
        else:
            first, last = (self._voxel_numbers.searchsorted(v).astype(np.int64) for v in (flat, flat + 1))
        return first, np.where(is_in_box, last - first, 0)

    def _iterate_voxel_cells(self, voxel: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
        """Yield, for k = 0, 1, …, the k-th cell of each voxel [n,3] and a mask of the voxels that have a k-th cell."""
        first, count = self._find_cell_ranges(voxel)
        for step in range(self._max_cells_per_voxel):
            yield np.minimum(first + step, len(self) - 1), step < count

    def find_cells(self, points: Floats, normals: Floats) -> Cells:
        """Return the cell of each point [n,3], int32[n]: the one with the point's voxel and the side of its face. If this cell
        does not exist, the result is the nearest cell in the 27 voxels around the point, except cells of the opposite side. If
        there is none, it is -1. `normals` [n,3]: the normal of the face at each point, not flipped for agents on the back of
        the face."""
        return self.find_cells_by_side(points, classify_normal_directions(np.asarray(normals).reshape(-1, 3)))

    def find_cells_by_side(self, points: Floats, sides: NDArray[np.int8]) -> Cells:
        """Return the same as `find_cells`, for given `sides` of faces, int8[n], numbered as by `classify_normal_directions`."""
        return self.update_cells(points, sides, None)[0]

    def update_cells(
        self, points: Floats, sides: NDArray[np.int8], lookup_state: CellLookupState | None, result: Cells | None = None,
        threads: int = 1
    ) -> tuple[Cells, CellLookupState | None]:  # fmt: skip
        """Return the cells of `find_cells_by_side`, and the state for the next call. The state is None if a kernel cannot
        search the keys. Only points with a changed voxel or side are searched. `result`: int32[n], an array to write the cells
        to. `lookup_state`: the state from the previous call, for the same number of points."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        cell = np.empty(len(points), np.int32) if result is None or len(result) != len(points) else result
        if not len(self):
            cell.fill(-1)
            return cell, None
        state = None
        if self._has_kernel_lookup:
            missing, state = self._locate_cells(points, sides, lookup_state, cell, threads)
        else:
            missing = self._search_all_cells(points, sides, cell)
        if missing:
            missing_points = np.flatnonzero(cell < 0)
            missing_points = missing_points[np.isfinite(points[missing_points]).all(axis=1)]
            bounded = np.clip(points[missing_points] / self.cell + 0.5, -1e15, 1e15)
            voxel = np.floor(bounded).astype(np.int64) - self._low
            cell[missing_points] = self._find_nearby_cells(points[missing_points], voxel, sides[missing_points].astype(np.int64))
        return cell, state

    def _locate_cells(
        self, points: Floats, side: NDArray[np.int8], previous_cells: CellLookupState | None, cell: Cells, threads: int
    ) -> tuple[int, CellLookupState]:
        """Write to `cell` the cell that has each point's voxel and side, -1 for none. Return the number of points without a cell,
        and the state for the next call."""
        state = previous_cells
        if state is None or state.surface_cells is not self or len(state.keys) != len(points):
            state = CellLookupState(self, np.full(len(points), -1), np.full(len(points), -1, np.int32))
        index, direct = (
            (self._block_index, EMPTY_CELLS) if self._direct_table is None else (EMPTY_BLOCK_INDEX, self._direct_table)
        )
        keys = VoxelCellIndex(self.cell, self._low, self._size, direct, self._keys, index.shift, index.block_starts)
        columns = tuple(np.ascontiguousarray(points[:, axis]) for axis in range(3))
        work = partial(update_cell_lookups, columns, side, keys, state.keys, state.cells, cell)
        return sum(parallel.run_in_parts(work, len(points), threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD)), state

    def _search_all_cells(self, points: Floats, side: NDArray[np.int8], cell: Cells) -> int:
        """Do the same as `_locate_cells` without a kernel, for keys in any order. Return the number of points without a cell."""
        key = np.empty(len(points), np.int64)
        is_in_box = np.empty(len(points), np.bool_)
        for a in range(0, len(points), _POINTS_PER_CHUNK):
            rows = slice(a, a + _POINTS_PER_CHUNK)
            self._write_keys(points[rows], side[rows], key[rows], is_in_box[rows])
        cell[:] = self._find_cells_by_key(key, is_in_box)
        return int(np.count_nonzero(cell < 0))

    @property
    def _has_kernel_lookup(self) -> bool:
        """Return whether a kernel can find cells. It can if keys ascend with cell numbers, or if a table lists every key."""
        return True

    def _write_keys(self, points: Floats, side: NDArray[np.int8], key: NDArray[np.int64], is_in_box: NDArray[np.bool_]) -> None:
        """Write to `key` the key of each point, and to `is_in_box` whether the point's voxel is in the box."""
        for axis in range(3):
            step = np.floor(points[:, axis] / self.cell + 0.5)
            step -= self._low[axis]
            inside = (step >= 0) & (step < self._size[axis])  # false for NaN
            integer_steps = np.where(inside, step, 0.0).astype(np.int64)
            if axis:
                key *= self._size[axis]
                key += integer_steps
                is_in_box &= inside
            else:
                key[:], is_in_box[:] = integer_steps, inside
        key *= 6
        key += side

    def _find_cells_by_key(self, key: NDArray[np.int64], is_in_box: NDArray[np.bool_]) -> Cells:
        """Return the cell of each key, -1 if there is none or if `is_in_box` is false."""
        if self._direct_table is not None:
            return np.where(is_in_box, self._direct_table.take(np.where(is_in_box, key, 0)), np.int32(-1))
        cell = np.full(len(key), -1, np.int32)
        for a in range(0, len(key), _POINTS_PER_CHUNK):
            rows = a + np.flatnonzero(is_in_box[a : a + _POINTS_PER_CHUNK])
            row_keys = key[rows]
            indices = self._block_index.count_smaller(self._keys, row_keys)
            matches = np.flatnonzero(self._keys.take(np.minimum(indices, len(self) - 1)) == row_keys)
            cell[rows[matches]] = indices[matches]
        return cell

    @cached_property
    def _block_index(self) -> BlockIndex:
        return BlockIndex.build(self._keys, 6 * int(self._size[0]) * int(self._size[1]) * int(self._size[2]))

    @cached_property
    def _direct_table(self) -> Cells | None:
        """Return the cell of every key in the box, -1 for none; None if the box is too large for a table."""
        count = 6 * int(self._size[0]) * int(self._size[1]) * int(self._size[2])
        if count > _MAX_DENSE_VOXELS:
            return None
        table = np.full(count, -1, np.int32)
        table[self._keys] = np.arange(len(self), dtype=np.int32)
        return table

    def get_sides_of_cells(self, cell: NDArray[np.integer]) -> NDArray[np.int64]:
        """Return the sides of the given cells, numbered as by `classify_normal_directions`."""
        return self._keys.take(cell) % 6

    def _find_nearby_cells(self, points: Floats, voxel: NDArray[np.int64], side: NDArray[np.int64]) -> NDArray[np.int64]:
        best, distance = np.full(len(points), -1, np.int64), np.full(len(points), np.inf)
        for offset in VOXEL_BLOCK_OFFSETS:
            for candidate, has_cell in self._iterate_voxel_cells(voxel + np.array(offset)):
                gap = (self.compute_offsets(self.position[candidate], points) ** 2).sum(axis=1)
                is_closer = has_cell & are_sides_compatible(self.get_sides_of_cells(candidate), side) & (gap < distance)
                best, distance = np.where(is_closer, candidate, best), np.where(is_closer, gap, distance)
        return best

    def _find_neighbour_pairs(
        self, cells: NDArray[np.int64], column: Callable[[int, int], int]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return sorted pairs of compatible cells in nearby voxels, as indices into `cells` and numbers of neighbour cells.
        `column`: a function of an offset (x, y) that returns how many voxels to search above and below; -1 if none."""
        voxels = self._voxel_numbers[cells]
        z, rest = voxels % self._size[2], voxels // self._size[2]
        x, y = rest // self._size[1], rest % self._size[1]
        firsts, counts = [], []
        for dx, dy in product((-1, 0, 1), repeat=2):
            if (far := column(dx, dy)) < 0:
                continue
            is_inside = (x + dx >= 0) & (x + dx < self._size[0]) & (y + dy >= 0) & (y + dy < self._size[1])
            base = np.where(is_inside, ((x + dx) * self._size[1] + (y + dy)) * self._size[2], 0)
            first = self._count_earlier_cells(base + np.maximum(z - far, 0))
            last = self._count_earlier_cells(base + np.minimum(z + far, self._size[2] - 1) + 1)
            firsts.append(first)
            counts.append(np.where(is_inside, last - first, 0))
        first, count = np.stack(firsts, axis=1).ravel(), np.stack(counts, axis=1)
        one, flat = np.repeat(np.arange(len(cells)), count.sum(axis=1)), count.ravel()
        other = np.arange(one.size) + np.repeat(first - (np.cumsum(flat) - flat), flat)
        compatible_pairs = np.flatnonzero(
            are_sides_compatible(self.get_sides_of_cells(other), self.get_sides_of_cells(cells).take(one))
        )
        return one.take(compatible_pairs), other.take(compatible_pairs)

    def _count_earlier_cells(self, voxel: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return, for each voxel number in the box, how many cells are in voxels with smaller numbers."""
        if self._start_table is not None:
            return self._start_table.take(voxel).astype(np.int64)
        return self._voxel_numbers.searchsorted(voxel).astype(np.int64)

    @cached_property
    def links(self) -> CellLinks:
        """Return the links between cells in the same voxel, or in voxels with a common face. Opposite sides are not linked."""
        return self._link_cells(1)

    @cached_property
    def diagonal_links(self) -> CellLinks:
        """Return the links between cells in voxels that share only an edge. Cells of opposite sides are not linked."""
        return self._link_cells(2)

    def _link_cells(self, steps: int) -> CellLinks:
        """Return the links between cells at most one voxel step apart, or if `steps` is 2, two steps along different axes."""
        counts, cells = [np.zeros(1, np.int64)], [np.empty(0, np.int32)]
        for a in range(0, len(self), _POINTS_PER_CHUNK):
            chosen = np.arange(a, min(a + _POINTS_PER_CHUNK, len(self)))
            one, other = self._find_neighbour_pairs(chosen, lambda x, y: min(steps - abs(x) - abs(y), 1))
            is_neighbour = self._count_voxel_steps(chosen.take(one), other) == 2 if steps == 2 else other != one + a
            others = np.flatnonzero(is_neighbour)
            counts.append(np.bincount(one.take(others), minlength=len(chosen)))
            cells.append(other.take(others).astype(np.int32))
        return CellLinks(np.cumsum(np.concatenate(counts)), np.concatenate(cells))

    def _count_voxel_steps(self, first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number of voxel steps between the two cells of each pair, summed over all axes."""
        steps = np.zeros(len(first), np.int64)
        voxels = [self._voxel_numbers.take(cells) for cells in (first, second)]
        for size in (self._size[2], self._size[1]):
            steps += np.abs(voxels[0] % size - voxels[1] % size)
            voxels = [each // size for each in voxels]
        steps += np.abs(voxels[0] - voxels[1])
        return steps

    @property
    def nearest_block_cells(self) -> Cells:
        """Return the 16 nearest cells of each cell, int32[n,16], in the form of `get_nearest_cells`."""
        return self.get_nearest_cells(NEAREST_CELL_COUNT)

    def compute_offsets(self, first: Floats, second: Floats) -> Floats:
        """Return the vectors [n,3] from points `second` to points `first`."""
        return first - second

    def get_nearest_cells(self, k: int) -> Cells:
        """Return the `k` nearest cells of each cell in the 27 voxels around it: int32[n,k], ascending, padded with
        `len(self)`. They include the cell itself. Of cells at equal distances, those with smaller numbers are chosen first."""
        if k not in self._tables:
            inputs = (self._keys, self._size, self.position, float(k))
            work = partial(self._compute_nearest_cells, np.arange(len(self)), k)
            tables = stored_tables.get_or_compute("nearest cells", len(self), inputs, lambda: {"nearest": work()}, "cells")
            self._tables[k] = tables["nearest"]
        return self._tables[k]

    def _compute_nearest_cells(self, cells: NDArray[np.int64], k: int) -> Cells:
        """Return the rows of `get_nearest_cells` for the given `cells`."""
        table = np.full((len(cells), k), len(self), np.int32)
        for a in range(0, len(cells), _POINTS_PER_CHUNK):
            chosen = cells[a : a + _POINTS_PER_CHUNK]
            cell_rows, other = self._find_neighbour_pairs(chosen, lambda x, y: 1)
            count = np.bincount(cell_rows, minlength=len(chosen))
            crowded = np.flatnonzero(count > k)
            if crowded.size:  # most cells have no more neighbours than this
                crowded_pairs = np.flatnonzero((count > k).take(cell_rows))
                one, two = cell_rows.take(crowded_pairs), other.take(crowded_pairs)
                offsets = self.compute_offsets(self.position.take(two, axis=0), self.position.take(chosen.take(one), axis=0))
                gap = (offsets[:, 0] ** 2 + offsets[:, 1] ** 2) + offsets[:, 2] ** 2
                order = np.lexsort((two, gap, one))
                left = crowded_pairs[order[compute_group_ranks(count[crowded]) >= k]]
                is_nearest = np.ones(len(cell_rows), np.bool_)
                is_nearest[left] = False
                cell_rows, other = cell_rows[is_nearest], other[is_nearest]
                count = np.minimum(count, k)
            table[a + cell_rows, compute_group_ranks(count)] = other
        return table


@dataclass(frozen=True, slots=True, eq=False)
class CellLookupState:
    """The state that a cell lookup stores for the next one, so that points that stay in their voxel need no search. It
    contains the `SurfaceCells` searched, the key of each point's voxel and side (-1 outside the box), and each point's cell
    (-1: none)."""

    surface_cells: SurfaceCells
    keys: NDArray[np.int64]
    cells: Cells


def are_sides_compatible(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether the sides `a` and `b` are not opposite. Within a voxel, agents can walk between such compatible sides."""
    other: NDArray[np.bool_] = (a ^ 1) != b
    return other
