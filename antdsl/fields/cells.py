"""Cells that scent lies in: the voxels that surfaces touch, one for each way that the surface faces there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.faces import nearest_on_triangle
from antdsl.casting.rasterise import triangle_cells
from antdsl.casting.rays import Mesh
from antdsl.ground.mesh.topology import facing

Floats = NDArray[np.float64]
Cells = NDArray[np.int32]

NEAREST = 16
_DENSE = 8_000_000  # voxels of a box that may be listed one by one
_ALONG = 1 << 19  # voxels along an axis; three packed with a side stay in 63 bits
BLOCK = tuple((x, y, z) for x, y, z in product((-1, 0, 1), repeat=3))
_CHUNK = 1 << 15


class FieldTooFine(ValueError):
    """A field would need more cells than `limits.FIELD_CELLS`, or more `in_a_row` than can be numbered; nothing was allocated."""

    def __init__(self, needed: int, cap: int, in_a_row: bool = False) -> None:
        super().__init__(f"about {needed:,} cells are needed and {cap:,} are allowed; a larger `cell` needs fewer")
        self.needed, self.cap, self.in_a_row = needed, cap, in_a_row


@dataclass(frozen=True, slots=True)
class Links:
    """Pairs of touching cells of a compatible side as rows of a table: cell a's are `cell[start[a]:start[a+1]]`, ascending."""

    start: NDArray[np.int64]
    cell: Cells


class SurfaceCells:
    """Cells of size `cell` (mm) over surfaces, each (vertices float64[n,3], faces int32[m,3]).

    A cell is a voxel, its middle on a lattice through the origin, and a side: the axis direction that the surface's normal is
    nearest to. So a thin plate has two sides, and cells number by place, then side, whatever the order of the faces. Raises
    FieldTooFine before anything large is made.
    """

    def __init__(self, surfaces: Sequence[Mesh], cell: float, cap: int = limits.FIELD_CELLS) -> None:
        if not (np.isfinite(cell) and cell > 0):
            raise ValueError("the size of a cell must be more than 0")
        self.cell = float(cell)
        arrays = [np.asarray(v, np.float64).reshape(-1, 3)[np.asarray(f, np.int64).reshape(-1, 3)] for v, f in surfaces]
        corners = np.concatenate(arrays) if arrays else np.empty((0, 3, 3))
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        area = np.sqrt((across * across).sum(axis=1))
        corners, across, area = (a[area > 0] for a in (corners, across, area))
        needed = float(area.sum() / 2 / self.cell**2)
        extent = corners.max(axis=(0, 1)) - corners.min(axis=(0, 1)) if len(corners) else np.zeros(3)
        if needed > cap:
            raise FieldTooFine(int(needed), cap)
        along = float(extent.max()) / self.cell
        if along > _ALONG:
            raise FieldTooFine(int(along), _ALONG, in_a_row=True)
        scaled = corners / self.cell + 0.5
        self._low = np.floor(scaled.min(axis=(0, 1))).astype(np.int64) if len(corners) else np.zeros(3, np.int64)
        self._size = np.floor(scaled.max(axis=(0, 1))).astype(np.int64) - self._low + 1 if len(corners) else np.ones(3, np.int64)
        self._gather(corners, scaled, across / np.maximum(area, 1e-300)[:, None], cap)
        self._voxels = self._keys // 6
        self._start_table = self._starts()
        self._tables: dict[int, Cells] = {}

    def _gather(self, corners: Floats, scaled: Floats, normal: Floats, cap: int) -> None:
        """Keys, positions and normals of all cells, from the part of each triangle in each voxel that it touches."""
        side = facing(normal)
        keys, sums = np.empty(0, np.int64), np.empty((0, 7))
        waiting: list[tuple[NDArray[np.int64], Floats]] = []
        for voxel, face in triangle_cells(scaled):
            middle = voxel.astype(np.float64) * self.cell
            point = nearest_on_triangle(middle, corners[face])
            part = np.column_stack([point, normal[face], np.ones(len(face))])
            waiting.append(summed(self._key(voxel - self._low, side[face]), part))
            if sum(len(k) for k, _ in waiting) > max(1 << 20, len(keys)):
                keys, sums = summed(*(np.concatenate(c) for c in zip((keys, sums), *waiting, strict=True)))
                waiting.clear()
                if len(keys) > cap:
                    raise FieldTooFine(len(keys), cap)
        keys, sums = summed(*(np.concatenate(c) for c in zip((keys, sums), *waiting, strict=True)))
        if len(keys) > cap:
            raise FieldTooFine(len(keys), cap)
        self._keys = keys
        self.position: Floats = sums[:, :3] / sums[:, 6:]
        length = np.sqrt((sums[:, 3:6] ** 2).sum(axis=1))
        self.normal: Floats = sums[:, 3:6] / np.maximum(length, 1e-300)[:, None]

    def __len__(self) -> int:
        return len(self._keys)

    @property
    def side(self) -> NDArray[np.int64]:
        """Which way each cell faces, as `facing` counts."""
        return self._keys % 6

    def _key(self, voxel: NDArray[np.int64], side: NDArray[np.int64]) -> NDArray[np.int64]:
        key: NDArray[np.int64] = ((voxel[:, 0] * self._size[1] + voxel[:, 1]) * self._size[2] + voxel[:, 2]) * 6 + side
        return key

    def _starts(self) -> NDArray[np.int32] | None:
        """First cell of every voxel of the box, where the box is small enough to list."""
        count = int(self._size[0]) * int(self._size[1]) * int(self._size[2])
        if count > _DENSE:
            return None
        table = np.zeros(count + 1, np.int32)
        np.cumsum(np.bincount(self._voxels, minlength=count), out=table[1:])
        return table

    @cached_property
    def _most(self) -> int:
        """Cells in the fullest voxel."""
        return int(np.unique(self._voxels, return_counts=True)[1].max(initial=0))

    def _in_voxel(self, voxel: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First cell and number of cells in voxels [n,3] counted from the box's corner; none outside the box."""
        within = ((voxel >= 0) & (voxel < self._size)).all(axis=1)
        flat = np.where(within, (voxel[:, 0] * self._size[1] + voxel[:, 1]) * self._size[2] + voxel[:, 2], 0)
        if self._start_table is not None:
            first, last = (self._start_table.take(v).astype(np.int64) for v in (flat, flat + 1))
        else:
            first, last = (self._voxels.searchsorted(v).astype(np.int64) for v in (flat, flat + 1))
        return first, np.where(within, last - first, 0)

    def _cells_in(self, voxel: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
        """The cells of voxels [n,3], one of each at a time, and whether there is one."""
        first, count = self._in_voxel(voxel)
        for step in range(self._most):
            yield np.minimum(first + step, len(self) - 1), step < count

    def lookup(self, points: Floats, normals: Floats) -> Cells:
        """The cell of each point [n,3] on a face with a normal [n,3] (the face's own, not the agent's side).

        Where there is none, the nearest of the 27 voxels around whose side is not the opposite one; else -1.
        """
        return self.lookup_sides(points, facing(np.asarray(normals).reshape(-1, 3)))

    def lookup_sides(self, points: Floats, side: NDArray[np.int64]) -> Cells:
        """As `lookup`, for faces that face as `facing` says, int64[n]."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        if not len(self):
            return np.full(len(points), -1, np.int32)
        key = np.zeros(len(points), np.int64)
        within = np.ones(len(points), np.bool_)
        for axis in range(3):
            step = np.floor(points[:, axis] / self.cell + 0.5) - self._low[axis]
            within &= (step >= 0) & (step < self._size[axis])  # not so for what is no number
            key *= self._size[axis]
            key += np.where(within, step, 0.0).astype(np.int64)
        key = key * 6 + side
        cell = self._find(key, within)
        missed = np.flatnonzero(cell < 0)
        if missed.size:
            missed = missed[np.isfinite(points[missed]).all(axis=1)]
            bounded = np.clip(points[missed] / self.cell + 0.5, -1e15, 1e15)
            voxel = np.floor(bounded).astype(np.int64) - self._low
            cell[missed] = self._nearby(points[missed], voxel, side[missed])
        return cell

    def _find(self, key: NDArray[np.int64], within: NDArray[np.bool_]) -> Cells:
        """The cell of each key that lies within the box, -1 for none."""
        if self._direct is not None:
            return np.where(within, self._direct.take(np.where(within, key, 0)), np.int32(-1))
        at = np.minimum(self._keys.searchsorted(key), len(self) - 1)
        return np.where(within & (self._keys.take(at) == key), at, -1).astype(np.int32)

    @cached_property
    def _direct(self) -> Cells | None:
        """The cell of every voxel and side, -1 for none, where the box is small enough to list."""
        count = 6 * int(self._size[0]) * int(self._size[1]) * int(self._size[2])
        if count > _DENSE:
            return None
        table = np.full(count, -1, np.int32)
        table[self._keys] = np.arange(len(self), dtype=np.int32)
        return table

    def side_of(self, cell: NDArray[np.integer]) -> NDArray[np.int64]:
        return self._keys.take(cell) % 6

    def _nearby(self, points: Floats, voxel: NDArray[np.int64], side: NDArray[np.int64]) -> NDArray[np.int64]:
        best, distance = np.full(len(points), -1, np.int64), np.full(len(points), np.inf)
        for offset in BLOCK:
            for at, there in self._cells_in(voxel + np.array(offset)):
                gap = ((self.position[at] - points) ** 2).sum(axis=1)
                closer = there & compatible(self.side_of(at), side) & (gap < distance)
                best, distance = np.where(closer, at, best), np.where(closer, gap, distance)
        return best

    def _around(self, cells: NDArray[np.int64], block: Sequence[tuple[int, int, int]]) -> NDArray[np.int64]:
        """Compatible cells in a block of voxels around cells, int64[k, n], -1 where there is none."""
        voxels = self._voxels[cells]
        voxel = np.column_stack(
            [voxels // (self._size[1] * self._size[2]), voxels // self._size[2] % self._size[1], voxels % self._size[2]]
        )
        side, rows = self.side_of(cells), []
        for offset in block:
            for at, there in self._cells_in(voxel + np.array(offset)):
                rows.append(np.where(there & compatible(self.side_of(at), side), at, -1))
        return np.stack(rows)

    @cached_property
    def links(self) -> Links:
        """Which cells share a face of their voxels, or a voxel, and do not face opposite ways."""
        block = [o for o in BLOCK if sum(map(abs, o)) <= 1]
        counts, cells = [np.zeros(1, np.int64)], [np.empty(0, np.int32)]
        for a in range(0, len(self), _CHUNK):
            own = np.arange(a, min(a + _CHUNK, len(self)))
            around = np.sort(self._around(own, block), axis=0).T
            here = (around >= 0) & (around != own[:, None])
            counts.append(here.sum(axis=1))
            cells.append(around[here].astype(np.int32))
        return Links(np.cumsum(np.concatenate(counts)), np.concatenate(cells))

    @property
    def block(self) -> Cells:
        """For each cell the nearest 16 of its 3³ block with itself, int32[n,16], ascending; `len(self)` where there are fewer."""
        return self.nearest(NEAREST)

    def nearest(self, k: int) -> Cells:
        """For each cell the nearest `k` of its 3³ block, itself included, by (distance, cell), int32[n,k], ascending."""
        if k not in self._tables:
            self._tables[k] = self._nearest(np.arange(len(self)), k)
        return self._tables[k]

    def _nearest(self, cells: NDArray[np.int64], k: int) -> Cells:
        """Rows of `nearest` for some cells."""
        table = np.full((len(cells), k), len(self), np.int32)
        for a in range(0, len(cells), _CHUNK):
            own = cells[a : a + _CHUNK]
            around = self._around(own, BLOCK)
            gap = np.zeros(around.shape)
            for axis in range(3):
                gap += (self.position[around, axis] - self.position[own, axis]) ** 2
            gap[around < 0] = np.inf
            order = np.lexsort((around, gap), axis=0)[:k]
            chosen = np.take_along_axis(np.where(around < 0, len(self), around), order, axis=0)
            table[a : a + own.size, : len(chosen)] = np.sort(chosen, axis=0).T
        return table


def compatible(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Whether sides are not opposite: what an agent can walk from one to the other of in one cell."""
    other: NDArray[np.bool_] = (a ^ 1) != b
    return other


def summed(keys: NDArray[np.int64], parts: Floats) -> tuple[NDArray[np.int64], Floats]:
    """Distinct keys, ascending, with the sums of their parts."""
    order = np.argsort(keys, kind="stable")
    keys, parts = keys[order], parts[order]
    if not len(keys):
        return keys, parts
    first = np.flatnonzero(np.concatenate(([True], keys[1:] != keys[:-1])))
    return keys[first], np.add.reduceat(parts, first, axis=0)
