"""Agents in the order of the cells that they lie in: what a cell grid looks through."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics.sorting import stable_order

Floats = NDArray[np.float32]

_MAX_CELLS_ALONG = 1 << 19  # three packed coordinates stay below 2**62
_AGENTS_PER_COLUMN = 6
_LAYERS_PER_COLUMN = 2
_NONE = np.empty(0, np.int64)


@cache
def _kernels() -> Any:
    from antdsl.senses import cell_order_compiled

    return cell_order_compiled


@dataclass(frozen=True, slots=True)
class Shape:
    """The cells of a box: lists go by the fast, middle and slow axis, which are its longest, its second and its shortest. Low
    corner and width in mm."""

    axes: tuple[int, ...]
    low: list[float]
    extent: list[float]
    width: list[float]
    size: list[int]

    @classmethod
    def of(cls, low: list[float], high: list[float], cell: float) -> Shape:
        """Of a box between two corners, for queries of a usual radius."""
        x, y, z = high[0] - low[0], high[1] - low[1], high[2] - low[2]
        axes: tuple[int, ...] = (0, 1, 2)
        extent = [x, y, z]
        if not x >= y >= z:
            axes = tuple(sorted(axes, key=lambda axis: -extent[axis]))
            low, extent = ([values[axis] for axis in axes] for values in (low, extent))
        cell = cell if 0 < cell < np.inf else max(extent[0], 1.0)
        # Wider cells only add candidates; the packed key of a far-flung crowd must not overflow.
        least = max(extent[0] / (_MAX_CELLS_ALONG - 4), 1e-30)
        fine, width = max(cell / 4, least), max(cell, least)
        size = [int(extent[0] / fine) + 1, int(extent[1] / width) + 1, int(extent[2] / width) + 1]
        return cls(axes, low, extent, [fine, width, width], size)

    @property
    def cells(self) -> int:
        return self.size[0] * self.size[1] * self.size[2]

    def listed(self, agents: int) -> bool:
        """Whether the cells are few enough for a table of them, for so many agents."""
        return self.cells <= max(1 << 16, 16 * agents)

    def as_sheet(self) -> Shape:
        """With one layer of cells along the shortest axis."""
        return Shape(self.axes, self.low, self.extent, [*self.width[:2], 2 * self.extent[2]], [*self.size[:2], 1])

    def numbers(self, places: list[NDArray[Any]]) -> list[NDArray[np.int64]]:
        """Numbers of the cells of places (x, y, z, float64[n] mm) along the three axes."""
        along = (places[axis] for axis in self.axes)
        return [np.floor((p - b) / w).astype(np.int64) for p, b, w in zip(along, self.low, self.width, strict=True)]

    def is_sheet(self, places: list[NDArray[Any]]) -> bool:
        """Whether a crowd at these places, as on ground, has so few agents or layers above each other that these need not be told
        apart."""
        wide = [np.asarray(p, np.float64) for p in places]
        return self.extent[2] > 0 and self.sheet_of(self.numbers(wide), wide[0].size)

    def sheet_of(self, cells: list[NDArray[np.int64]], n: int) -> bool:
        """The same of the numbers of cells of so many agents."""
        across, broad, deep = (e / self.width[1] + 2 for e in self.extent)  # columns, and layers
        if across * broad * deep <= max(1 << 16, 64 * n):
            column = cells[1] * int(across) + (cells[0] >> 2)
            columns = _distinct(column, int(across) * int(broad))
            if n <= _AGENTS_PER_COLUMN * columns:
                return True
            cell = column * int(deep) + cells[2]
            return _distinct(cell, int(across) * int(broad) * int(deep)) <= _LAYERS_PER_COLUMN * columns
        column = np.sort((cells[1] << 32) | (cells[0] >> 2))
        return n <= _AGENTS_PER_COLUMN * (1 + int(np.count_nonzero(column[1:] != column[:-1])))


@dataclass(frozen=True, slots=True, eq=False)
class Ordered:
    """Agents at finite places in the order of cells of a `shape`, in each by id: their `rows`, the `keys` of their cells, int64,
    and their `places`, x, y and z float32; `starts` int32, the first of each cell and how many there are, None where there are
    too many cells to be listed."""

    shape: Shape
    rows: NDArray[np.int64]
    keys: NDArray[np.int64]
    places: list[Floats]
    starts: NDArray[np.int32] | None


def ordered(x: Floats, y: Floats, z: Floats, ids: NDArray[np.int64], cell: float) -> Ordered:
    """Agents at places float32[n] (mm) with `ids` int64[n], by cells for queries of a usual radius `cell` (mm)."""
    if compiled.wanted(len(ids)):
        return _by_kernels(compiled.plain(x, y, z), ids, cell)
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(y) & np.isfinite(z))
    if np.any(ids[1:] < ids[:-1]):
        rows = rows[stable_order(ids[rows])]
    places = [np.asarray(a, np.float64)[rows] for a in (x, y, z)]
    low = [float(p.min(initial=np.inf)) if rows.size else 0.0 for p in places]
    high = [float(p.max(initial=-np.inf)) if rows.size else 0.0 for p in places]
    shape = Shape.of(low, high, cell)
    cells = shape.numbers(places)
    shape = _of_layers(shape, cells)
    key = (cells[2] * shape.size[1] + cells[1]) * shape.size[0] + cells[0]
    order = stable_order(key)
    rows, keys, starts = rows.take(order), key[order], None
    if shape.listed(rows.size):
        starts = np.zeros(shape.cells + 1, np.int32)
        np.cumsum(np.bincount(keys, minlength=shape.cells), out=starts[1:])
    return Ordered(shape, rows, keys, [np.ascontiguousarray(a[rows], np.float32) for a in (x, y, z)], starts)


def _of_layers(shape: Shape, cells: list[NDArray[np.int64]]) -> Shape:
    """The shape, or that of a sheet where the numbers of cells say so, which then have one layer."""
    if not (shape.extent[2] > 0 and shape.sheet_of(cells, cells[0].size)):
        return shape
    cells[2][:] = 0
    return shape.as_sheet()


def _by_kernels(places: tuple[NDArray[Any], ...], ids: NDArray[np.int64], cell: float) -> Ordered:
    """The same by a loop that finds the box, one that numbers cells and one that counts how many are in each."""
    kernels, ends = _kernels(), np.empty((2, 3))
    count, ascending = kernels.box(*places, ids, ends)
    low, high = ends.tolist()
    shape = Shape.of(low, high, cell)
    along = tuple(places[axis] for axis in shape.axes)
    rows, cells = np.empty(count, np.int64), list(np.empty((3, count), np.int64))
    kernels.numbered(along, _NONE if ascending else stable_order(ids), tuple(shape.low), tuple(shape.width), rows, *cells)
    shape = _of_layers(shape, cells)
    listed = shape.listed(count)
    starts, order = np.zeros(shape.cells + 1 if listed else 0, np.int32), _NONE
    if not listed:
        order = stable_order((cells[2] * shape.size[1] + cells[1]) * shape.size[0] + cells[0])
    sorted_rows, keys = np.empty((2, count), np.int64)
    found = np.empty((3, count), np.float32)
    kernels.put(rows, *cells, *shape.size[:2], order, places, starts, sorted_rows, keys, found)
    return Ordered(shape, sorted_rows, keys, list(found), starts if listed else None)


def _distinct(numbers: NDArray[np.int64], limit: int) -> int:
    """How many different ones there are of whole numbers from 0 to below a limit."""
    seen = np.zeros(limit, np.bool_)
    seen[numbers] = True
    return int(np.count_nonzero(seen))
