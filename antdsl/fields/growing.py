"""Cells on ground that can be dug: what was dug gets cells of its own, behind those that were there from the start."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.casting.rays import Mesh
from antdsl.fields.cells import BLOCK, Cells, Floats, SurfaceCells, compatible
from antdsl.fields.numbered import summed
from antdsl.ground.mesh.topology import facing
from antdsl.numerics import compiled

_ROOM = 8  # cells are added in rooms of this share of what is there, so that most steps move nothing
_LEAST_ROOM = 1024
_NO_KEY = -1
_NOWHERE = -(1 << 60)  # number of a voxel that no other lies beside


class GrowingCells(SurfaceCells):
    """`SurfaceCells` that `grow`. Cells keep their numbers: those from the start, by place, then side; then those added, step by
    step; then room for more, cells that are nowhere and that nothing asks for."""

    def __init__(self, surfaces: Sequence[Mesh], cell: float, cap: int = limits.FIELD_CELLS) -> None:
        super().__init__(surfaces, cell, cap)
        self.at_start = self.used = len(self._keys)
        self._cap = cap
        self._sorted = np.arange(self.used)
        self._direct  # noqa: B018  # listed now, while every key is a cell's

    @property
    def added(self) -> dict[str, NDArray[np.generic]]:
        """What was added since the start, for `add`."""
        new = slice(self.at_start, self.used)
        return {"keys": self._keys[new], "places": np.concatenate([self.position[new], self.normal[new]], axis=1)}

    def grow(self, points: Floats, normals: Floats) -> NDArray[np.int64]:
        """Cells for points [n,3] of new surface with unit normals [n,3] where there are none yet; gives their numbers."""
        voxel = np.floor(points / self.cell + 0.5).astype(np.int64) - self._low
        within = ((voxel >= 0) & (voxel < self._size)).all(axis=1)
        points, normals, voxel = points[within], normals[within], voxel[within]
        key = self._key(voxel, facing(normals))
        fresh = self._find(key, np.ones(len(key), np.bool_)) < 0
        keys, sums = summed(key[fresh], np.column_stack([points[fresh], normals[fresh], np.ones(int(fresh.sum()))]))
        normal = sums[:, 3:6] / np.maximum(np.sqrt((sums[:, 3:6] ** 2).sum(axis=1)), 1e-300)[:, None]
        return self.add(keys, np.concatenate([sums[:, :3] / sums[:, 6:], normal], axis=1))

    def add(self, keys: NDArray[np.int64], places: Floats) -> NDArray[np.int64]:
        """Cells with these keys, which none has yet, and places [n,6]: position and normal. Gives their numbers."""
        count = min(len(keys), max(self._cap - self.used, 0))
        if not count:
            return np.empty(0, np.int64)
        self._make_room(self.used + count)
        new = np.arange(self.used, self.used + count)
        self.used += count
        self._keys[new], self.position[new], self.normal[new] = keys[:count], places[:count, :3], places[:count, 3:]
        self._voxels[new] = self._keys[new] // 6
        if self._direct is not None:
            self._direct[self._keys[new]] = new
        else:
            self._sorted = np.argsort(self._keys[: self.used], kind="stable")
        self.__dict__.pop("links", None)
        self.__dict__.pop("diagonals", None)
        changed = np.unique(self._around(new, lambda x, y: 1)[1])
        for k, table in self._tables.items():
            if self._direct is not None and compiled.wanted(len(changed)):
                self._fill(table, changed, k)
            else:
                table[changed] = self._nearest(changed, k)
        return new

    def _fill(self, table: Cells, cells: NDArray[np.int64], k: int) -> None:
        """Make some rows of a table of the nearest anew, compiled."""
        from antdsl.fields.growing_compiled import nearest

        nearest(self._direct, (self._voxels, self._keys), self._size, self.position, cells, k, len(self), table)

    def _nearby(self, points: Floats, voxel: NDArray[np.int64], side: NDArray[np.int64]) -> NDArray[np.int64]:
        if self._direct is None or not compiled.wanted(len(points)):
            return super()._nearby(points, voxel, side)
        from antdsl.fields.growing_compiled import nearby

        best = np.empty(len(points), np.int64)
        nearby(self._direct, self._size, self.position, points, voxel, side, best)
        return best

    def _make_room(self, needed: int) -> None:
        if needed <= len(self):
            return
        before = len(self)
        more = max(needed - before, before // _ROOM, _LEAST_ROOM)
        self._keys = np.concatenate([self._keys, np.full(more, _NO_KEY)])
        self._voxels = np.concatenate([self._voxels, np.full(more, _NOWHERE)])
        self.position, self.normal = (np.concatenate([v, np.zeros((more, 3))]) for v in (self.position, self.normal))
        for k, table in self._tables.items():
            grown = np.full((before + more, k), before + more, np.int32)
            grown[:before] = np.where(table == before, before + more, table)
            self._tables[k] = grown

    @property
    def _numbered(self) -> bool:
        return self._direct is not None

    def _find(self, key: NDArray[np.int64], within: NDArray[np.bool_]) -> Cells:
        if self._direct is not None:
            return super()._find(key, within)
        if not len(self._sorted):
            return np.full(len(key), -1, np.int32)
        keys = self._keys.take(self._sorted)
        at = np.minimum(keys.searchsorted(key), len(keys) - 1)
        return np.where(within & (keys.take(at) == key), self._sorted.take(at), -1).astype(np.int32)

    def _around(self, cells: NDArray[np.int64], column: Callable[[int, int], int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """As for cells that stay, all voxels and sides at once: the cells that are added in a step are few."""
        at = self._voxels[cells]
        voxel = np.stack([at // (self._size[1] * self._size[2]), at // self._size[2] % self._size[1], at % self._size[2]])
        block = [offset for offset in BLOCK if abs(offset[2]) <= column(*offset[:2])]
        there = voxel[:, None, :] + np.array(block).T[:, :, None]
        inbound: NDArray[np.bool_] = (there >= 0) & (there < self._size[:, None, None])
        within: NDArray[np.bool_] = np.logical_and.reduce(inbound, axis=0)
        key = np.where(within, (there[0] * self._size[1] + there[1]) * self._size[2] + there[2], 0) * 6
        keys = key[:, None, :] + np.arange(6)[None, :, None]
        inside = np.repeat(within[:, None, :], 6, axis=1)
        found = self._find(keys.ravel(), inside.ravel()).reshape(-1, len(cells))
        near = compatible(self.side_of(np.maximum(found, 0)), self.side_of(cells))
        other = np.sort(np.where(near, found, -1).astype(np.int64), axis=0).T
        own, which = np.nonzero(other >= 0)
        return own, other[own, which]

    def _cells_in(self, voxel: NDArray[np.int64]) -> Iterator[tuple[NDArray[np.int64], NDArray[np.bool_]]]:
        within: NDArray[np.bool_] = np.logical_and.reduce((voxel >= 0) & (voxel < self._size), axis=1)
        key = np.where(within, (voxel[:, 0] * self._size[1] + voxel[:, 1]) * self._size[2] + voxel[:, 2], 0) * 6
        for side in range(6):
            at = self._find(key + side, within).astype(np.int64)
            yield np.maximum(at, 0), at >= 0
