"""Agents in the order of the cells that they lie in: what a cell grid looks through."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F32, F64, I32, I64, Array1, Array2, independent, inlined, kernel
from antdsl.numerics import parallel
from antdsl.numerics.sorting import stable_order

Floats = NDArray[np.float32]
Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]

_MAX_CELLS_ALONG = 1 << 19  # three packed coordinates stay below 2**62
_AGENTS_PER_COLUMN = 6
_LAYERS_PER_COLUMN = 2
_NONE = np.empty(0, np.int64)


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
    places, ends = parallel.plain(x, y, z), np.empty((2, 3))
    count, ascending = _box(*places, ids, ends)
    low, high = ends.tolist()
    shape = Shape.of(low, high, cell)
    along = tuple(places[axis] for axis in shape.axes)
    rows, cells = np.empty(count, np.int64), list(np.empty((3, count), np.int64))
    _number(along, _NONE if ascending else stable_order(ids), tuple(shape.low), tuple(shape.width), rows, *cells)
    if shape.extent[2] > 0 and shape.sheet_of(cells, count):
        shape = shape.as_sheet()
        cells[2][:] = 0
    listed = shape.listed(count)
    starts, order = np.zeros(shape.cells + 1 if listed else 0, np.int32), _NONE
    if not listed:
        order = stable_order((cells[2] * shape.size[1] + cells[1]) * shape.size[0] + cells[0])
    sorted_rows, keys = np.empty((2, count), np.int64)
    found = np.empty((3, count), np.float32)
    _put(rows, *cells, *shape.size[:2], order, places, starts, sorted_rows, keys, found)
    return Ordered(shape, sorted_rows, keys, list(found), starts if listed else None)


def _distinct(numbers: NDArray[np.int64], limit: int) -> int:
    """How many different ones there are of whole numbers from 0 to below a limit."""
    seen = np.zeros(limit, np.bool_)
    seen[numbers] = True
    return int(np.count_nonzero(seen))


@kernel
def _box(x: Array1[F32], y: Array1[F32], z: Array1[F32], ids: Array1[I64], ends: Array2[F64]) -> tuple[I64, BOOL]:
    """How many places are finite, whose least and greatest x, y and z are put into `ends` (2, 3), 0 where there are none; and
    whether the ids of all ascend."""
    count, ascending = 0, True
    low_x, low_y, low_z = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
    high_x, high_y, high_z = np.float32(-np.inf), np.float32(-np.inf), np.float32(-np.inf)
    for k in range(x.size):
        if k > 0 and ids[k] < ids[k - 1]:
            ascending = False
        if np.isfinite(x[k]) and np.isfinite(y[k]) and np.isfinite(z[k]):
            count += 1
            low_x, low_y, low_z = min(low_x, x[k]), min(low_y, y[k]), min(low_z, z[k])
            high_x, high_y, high_z = max(high_x, x[k]), max(high_y, y[k]), max(high_z, z[k])
    ends[0, 0], ends[0, 1], ends[0, 2] = np.float64(low_x), np.float64(low_y), np.float64(low_z)
    ends[1, 0], ends[1, 1], ends[1, 2] = np.float64(high_x), np.float64(high_y), np.float64(high_z)
    if count == 0:
        for k in range(3):
            ends[0, k], ends[1, k] = 0.0, 0.0
    return count, ascending


@inlined
def _along(place: F32, low: F64, width: F64) -> I64:
    return np.int64(np.floor((np.float64(place) - low) / width))


@kernel
def _number(
    along: Columns,
    order: Array1[I64],
    low: tuple[F64, F64, F64],
    width: tuple[F64, F64, F64],
    rows: Array1[I64],
    fast: Array1[I64],
    middle: Array1[I64],
    slow: Array1[I64],
) -> None:
    """The `rows` of agents at finite places, in an `order` of all (empty: as they are), and the numbers of their cells along the
    three axes."""
    count = 0
    for k in range(along[0].size):
        row = order[k] if order.size > 0 else k
        if np.isfinite(along[0][row]) and np.isfinite(along[1][row]) and np.isfinite(along[2][row]):
            rows[count] = row
            count += 1
    for n in independent(0, count):
        own = rows[n]
        fast[n] = _along(along[0][own], low[0], width[0])
        middle[n] = _along(along[1][own], low[1], width[1])
        slow[n] = _along(along[2][own], low[2], width[2])


@kernel
def _put(
    rows: Array1[I64],
    fast: Array1[I64],
    middle: Array1[I64],
    slow: Array1[I64],
    across: I64,
    broad: I64,
    order: Array1[I64],
    places: Columns,
    starts: Array1[I32],
    ordered: Array1[I64],
    keys: Array1[I64],
    found: Array2[F32],
) -> None:
    """Put `rows` in the order of their cells, with the keys of these and their places (3, n): by counting how many are in each,
    which fills `starts`, or where there is no room for that as `order` says."""
    n = rows.size
    if starts.size > 0:
        for k in range(n):
            key = (slow[k] * broad + middle[k]) * across + fast[k]
            if key + 2 < starts.size:
                starts[key + 2] += 1
        for k in range(2, starts.size):
            starts[k] += starts[k - 1]
        for k in range(n):  # where a cell begins goes on to where it ends, which is where the next one begins
            key = (slow[k] * broad + middle[k]) * across + fast[k]
            place = starts[key + 1]
            ordered[place], keys[place] = rows[k], key
            starts[key + 1] += 1
    else:
        for k in range(n):
            other = order[k]
            ordered[k], keys[k] = rows[other], (slow[other] * broad + middle[other]) * across + fast[other]
    for at in independent(0, n):
        row = ordered[at]
        found[0, at], found[1, at], found[2, at] = places[0][row], places[1][row], places[2][row]
