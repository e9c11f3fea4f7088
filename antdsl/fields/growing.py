"""Cells on ground that can be dug. Newly dug ground gets additional cells, numbered after the initial ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.rays import MeshArrays
from antdsl.fields.block_index import sum_by_key
from antdsl.fields.cells import VOXEL_BLOCK_OFFSETS, Cells, Floats, SurfaceCells, are_sides_compatible
from antdsl.ground.mesh.topology import classify_normal_directions
from antdsl.machine_code.kernels import F64, I32, I64, Array1, Array2, allocate_scratch, inlined, kernel

_GROWTH_DIVISOR = 8  # capacity grows by 1 / this number, so that most steps need no copy
_MIN_ADDED_CAPACITY = 1024
_NO_KEY = -1
_ISOLATED_VOXEL = -(1 << 60)  # number of a voxel without neighbours
_MAX_NEIGHBOUR_CELLS = 27 * 6  # maximum number of cells in 3³ voxels
VoxelKeysAndCells = tuple[Array1[I64], Array1[I64]]  # voxels and keys of cells


class GrowingCells(SurfaceCells):
    """A variant of `SurfaceCells` to which `add_cells_at_points` can add cells. The number of a cell never changes.

    The initial cells come first, ordered by position, then side. Added cells follow in the order of the steps that added them.
    Unused spare cells come last; no query returns them."""

    def __init__(self, surfaces: Sequence[MeshArrays], cell: float, cap: int = limits.MAX_FIELD_CELLS) -> None:
        super().__init__(surfaces, cell, cap)
        self.initial_count = self.used_count = len(self._keys)
        self._cap = cap
        self._sorted = np.arange(self.used_count)
        self._direct_table  # noqa: B018  # listed now, while every key is a cell's

    @property
    def added_cells(self) -> dict[str, NDArray[np.generic]]:
        """Return the `keys` and `positions` of all cells that were added after the start, in the form that `add_cells` takes."""
        new = slice(self.initial_count, self.used_count)
        return {"keys": self._keys[new], "places": np.concatenate([self.position[new], self.normal[new]], axis=1)}

    def add_cells_at_points(self, positions: Floats, normals: Floats) -> NDArray[np.int64]:
        """Add the cells that do not exist yet for points [n,3], with unit normals [n,3], on new surface. Return the numbers of
        the new cells."""
        voxel = np.floor(positions / self.cell + 0.5).astype(np.int64) - self._low
        is_in_box = ((voxel >= 0) & (voxel < self._size)).all(axis=1)
        positions, normals, voxel = positions[is_in_box], normals[is_in_box], voxel[is_in_box]
        key = self._pack_keys(voxel, classify_normal_directions(normals))
        fresh = self._find_cells_by_key(key, np.ones(len(key), np.bool_)) < 0
        keys, sums = sum_by_key(key[fresh], np.column_stack([positions[fresh], normals[fresh], np.ones(int(fresh.sum()))]))
        normal = sums[:, 3:6] / np.maximum(np.sqrt((sums[:, 3:6] ** 2).sum(axis=1)), 1e-300)[:, None]
        return self.add_cells(keys, np.concatenate([sums[:, :3] / sums[:, 6:], normal], axis=1))

    def add_cells(self, keys: NDArray[np.int64], positions: Floats) -> NDArray[np.int64]:
        """Add cells with new `keys`, and return their numbers. `positions` [n,6]: the position and the normal of each cell."""
        count = min(len(keys), max(self._cap - self.used_count, 0))
        if not count:
            return np.empty(0, np.int64)
        self._reserve_capacity(self.used_count + count)
        new = np.arange(self.used_count, self.used_count + count)
        self.used_count += count
        self._keys[new], self.position[new], self.normal[new] = keys[:count], positions[:count, :3], positions[:count, 3:]
        self._voxel_numbers[new] = self._keys[new] // 6
        if self._direct_table is not None:
            self._direct_table[self._keys[new]] = new
        else:
            self._sorted = np.argsort(self._keys[: self.used_count], kind="stable")
        self.__dict__.pop("links", None)
        self.__dict__.pop("diagonal_links", None)
        changed = np.unique(self._find_neighbour_pairs(new, lambda x, y: 1)[1])
        for k, table in self._tables.items():
            if self._direct_table is not None:
                numbers = (self._voxel_numbers, self._keys)
                fill_nearest_cells(self._direct_table, numbers, self._size, self.position, changed, k, len(self), table)
            else:
                table[changed] = self._compute_nearest_cells(changed, k)
        return new

    def _find_nearby_cells(self, points: Floats, voxel: NDArray[np.int64], side: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the nearest cell of a compatible side in the 27 voxels around each point, -1 for none."""
        if self._direct_table is None:
            return super()._find_nearby_cells(points, voxel, side)
        best = np.empty(len(points), np.int64)
        fill_nearby_cells(self._direct_table, self._size, self.position, points, voxel, side, best)
        return best

    def _reserve_capacity(self, needed_count: int) -> None:
        """Extend the arrays, if necessary, to hold `needed_count` cells."""
        if needed_count <= len(self):
            return
        old_count = len(self)
        added_count = max(needed_count - old_count, old_count // _GROWTH_DIVISOR, _MIN_ADDED_CAPACITY)
        self._keys = np.concatenate([self._keys, np.full(added_count, _NO_KEY)])
        self._voxel_numbers = np.concatenate([self._voxel_numbers, np.full(added_count, _ISOLATED_VOXEL)])
        self.position, self.normal = (np.concatenate([v, np.zeros((added_count, 3))]) for v in (self.position, self.normal))
        for k, table in self._tables.items():
            larger = np.full((old_count + added_count, k), old_count + added_count, np.int32)
            larger[:old_count] = np.where(table == old_count, old_count + added_count, table)
            self._tables[k] = larger

    @property
    def _has_kernel_lookup(self) -> bool:
        """Return whether a table lists every key. Kernels need this table, because the keys of added cells are not ascending."""
        return self._direct_table is not None

    def _find_cells_by_key(self, key: NDArray[np.int64], is_in_box: NDArray[np.bool_]) -> Cells:
        if self._direct_table is not None:
            return super()._find_cells_by_key(key, is_in_box)
        if not len(self._sorted):
            return np.full(len(key), -1, np.int32)
        keys = self._keys.take(self._sorted)
        indices = np.minimum(keys.searchsorted(key), len(keys) - 1)
        return np.where(is_in_box & (keys.take(indices) == key), self._sorted.take(indices), -1).astype(np.int32)

    def _find_neighbour_pairs(
        self, cells: NDArray[np.int64], column: Callable[[int, int], int]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the same pairs as `SurfaceCells._find_neighbour_pairs`. It processes all voxels and sides at once, which
        suits the few cells that a step adds."""
        numbers = self._voxel_numbers[cells]
        voxel = np.stack(
            [numbers // (self._size[1] * self._size[2]), numbers // self._size[2] % self._size[1], numbers % self._size[2]]
        )
        block = [offset for offset in VOXEL_BLOCK_OFFSETS if abs(offset[2]) <= column(*offset[:2])]
        neighbour_voxels = voxel[:, None, :] + np.array(block).T[:, :, None]
        inbound: NDArray[np.bool_] = (neighbour_voxels >= 0) & (neighbour_voxels < self._size[:, None, None])
        is_in_box: NDArray[np.bool_] = np.logical_and.reduce(inbound, axis=0)
        key = (
            np.where(
                is_in_box, (neighbour_voxels[0] * self._size[1] + neighbour_voxels[1]) * self._size[2] + neighbour_voxels[2], 0
            )
            * 6
        )
        keys = key[:, None, :] + np.arange(6)[None, :, None]
        inside = np.repeat(is_in_box[:, None, :], 6, axis=1)
        near_cells = self._find_cells_by_key(keys.ravel(), inside.ravel()).reshape(-1, len(cells))
        near = are_sides_compatible(self.get_sides_of_cells(np.maximum(near_cells, 0)), self.get_sides_of_cells(cells))
        other = np.sort(np.where(near, near_cells, -1).astype(np.int64), axis=0).T
        rows, columns = np.nonzero(other >= 0)
        return rows, other[rows, columns]

    def _iterate_voxel_cells(self, voxel: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
        is_in_box: NDArray[np.bool_] = np.logical_and.reduce((voxel >= 0) & (voxel < self._size), axis=1)
        key = np.where(is_in_box, (voxel[:, 0] * self._size[1] + voxel[:, 1]) * self._size[2] + voxel[:, 2], 0) * 6
        for side in range(6):
            candidate = self._find_cells_by_key(key + side, is_in_box).astype(np.int64)
            yield np.maximum(candidate, 0), candidate >= 0


@inlined
def _compute_squared_distance(position: Array2[F64], cell: I64, x: F64, y: F64, z: F64) -> F64:
    """Return the squared distance (mm²) of a cell's position from a point."""
    dx, dy, dz = position[cell, 0] - x, position[cell, 1] - y, position[cell, 2] - z
    return (dx * dx + dy * dy) + dz * dz


@kernel
def fill_nearest_cells(
    direct_table: Array1[I32], numbers: VoxelKeysAndCells, size: Array1[I64], position: Array2[F64], cells: Array1[I64], k: I64,
    missing_cell: I64, table: Array2[I32],
) -> None:  # fmt: skip
    """Write the `k` nearest cells of each of `cells` to its row of `table`, ascending by number.

    Only the 27 voxels around a cell are searched. If there are fewer than `k`, the row is padded with `missing_cell`."""
    gaps, candidates = allocate_scratch(_MAX_NEIGHBOUR_CELLS, F64), allocate_scratch(_MAX_NEIGHBOUR_CELLS, I64)
    voxels, keys = numbers
    layer_size = size[1] * size[2]
    for cell in cells:
        voxel, side = voxels[cell], keys[cell] % 6
        x, y, z = voxel // layer_size, voxel // size[2] % size[1], voxel % size[2]
        count = 0
        for i in range(max(x - 1, 0), min(x + 2, size[0])):
            for j in range(max(y - 1, 0), min(y + 2, size[1])):
                for m in range(max(z - 1, 0), min(z + 2, size[2])):
                    for s in range(6):
                        candidate = direct_table[((i * size[1] + j) * size[2] + m) * 6 + s]
                        if candidate < 0 or (s ^ 1) == side:
                            continue
                        gap = _compute_squared_distance(
                            position, candidate, position[cell, 0], position[cell, 1], position[cell, 2]
                        )
                        place = count
                        while place > 0 and (
                            gaps[place - 1] > gap or (gaps[place - 1] == gap and candidates[place - 1] > candidate)
                        ):
                            gaps[place], candidates[place] = gaps[place - 1], candidates[place - 1]
                            place -= 1
                        gaps[place], candidates[place] = gap, candidate
                        count += 1
        count = min(count, k)
        for n in range(1, count):
            candidate = candidates[n]
            place = n
            while place > 0 and candidates[place - 1] > candidate:
                candidates[place] = candidates[place - 1]
                place -= 1
            candidates[place] = candidate
        for n in range(k):
            table[cell, n] = candidates[n] if n < count else missing_cell


@kernel
def fill_nearby_cells(
    direct_table: Array1[I32], size: Array1[I64], position: Array2[F64], points: Array2[F64], voxel: Array2[I64],
    side: Array1[I64], nearest_cells: Array1[I64],
) -> None:  # fmt: skip
    """Write the nearest cell of each point to `nearest_cells`, -1 for none. Only cells of compatible sides in the 27 voxels
    around the point are searched."""
    for n in range(nearest_cells.size):
        least_gap = np.inf
        nearest_cells[n] = -1
        for i in range(voxel[n, 0] - 1, voxel[n, 0] + 2):
            for j in range(voxel[n, 1] - 1, voxel[n, 1] + 2):
                for m in range(voxel[n, 2] - 1, voxel[n, 2] + 2):
                    if i < 0 or j < 0 or m < 0 or i >= size[0] or j >= size[1] or m >= size[2]:
                        continue
                    for s in range(6):
                        candidate = direct_table[((i * size[1] + j) * size[2] + m) * 6 + s]
                        if candidate < 0 or (s ^ 1) == side[n]:
                            continue
                        gap = _compute_squared_distance(position, candidate, points[n, 0], points[n, 1], points[n, 2])
                        if gap < least_gap:
                            least_gap, nearest_cells[n] = gap, candidate
