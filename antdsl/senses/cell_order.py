"""Sorts agents by grid cell, with a counting sort that runs in parallel chunks.

The sort counts the agents of each cell. Running sums of the counts give the first position of each cell, and each agent is
stored at the next position of its cell (D. E. Knuth, The Art of Computer Programming 3, 5.2). Each thread processes one chunk
of agents. Within a cell, agents are ordered by chunk, so the order is the same as with one thread."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import inlined, kernel, load_consecutive, round_to_int, simd_range
from antdsl.machine_code.kernels.types import BOOL, F32, F64, I32, I64, Array1, Array2
from antdsl.machine_code.number_kinds import LANE_COUNT
from antdsl.numerics import parallel
from antdsl.numerics.processor.host import count_available_cores
from antdsl.numerics.sorting import find_lower_bound, sort_stably

Floats = NDArray[np.float32]
Positions = tuple[Floats, Floats, Floats]
Columns = tuple[Array1[F32], Array1[F32], Array1[F32]]
AnyTypeColumns = tuple[Array1[Any], Array1[Any], Array1[Any]]
FourColumns = tuple[Array1[F32], Array1[F32], Array1[F32], Array1[F32]]
FloatTriple = tuple[F64, F64, F64]
CellCounts = tuple[I64, I64, I64]

_MAX_CELLS_PER_AXIS = 1 << 19  # three packed coordinates stay below 2**62
_MAX_AGENTS_PER_COLUMN = 6
_MAX_LAYERS_PER_COLUMN = 2
_MIN_CHUNKED_AGENTS = 8_192  # fewer agents are not worth several threads
WORK_UNITS_PER_CHUNK = 16  # parts of a chunk; a thread processes at least one chunk
SPARE_TABLE_ENTRIES = 3  # additional entries in a table of cells
NO_ORDER = np.empty(0, np.int64)


@dataclass(frozen=True, slots=True)
class GridShape:
    """A box divided into cells. Each list has one value per axis, in the order longest, second, shortest (also called fast,
    middle, slow). `axes`: the axes as indices into x, y, z. `low_corner`: the low corner (mm). `extent`: the size of the box
    (mm). `cell_widths`: the size of a cell (mm). `cells_per_axis`: the number of cells along each axis."""

    axes: tuple[int, ...]
    low_corner: list[float]
    extent: list[float]
    cell_widths: list[float]
    cells_per_axis: list[int]

    @classmethod
    def from_bounds(cls, low_corner: list[float], high_corner: list[float], cell_width: float) -> GridShape:
        """Return a grid that covers the box between `low_corner` and `high_corner` (mm), for queries with radius `cell_width`
        (mm)."""
        x, y, z = high_corner[0] - low_corner[0], high_corner[1] - low_corner[1], high_corner[2] - low_corner[2]
        axes: tuple[int, ...] = (0, 1, 2)
        extent = [x, y, z]
        if not x >= y >= z:
            axes = tuple(sorted(axes, key=lambda axis: -extent[axis]))
            low_corner, extent = ([values[axis] for axis in axes] for values in (low_corner, extent))
        cell_width = cell_width if 0 < cell_width < np.inf else max(extent[0], 1.0)
        # Wider cells only add candidates. The packed key of a widely scattered crowd must not overflow.
        min_width = max(extent[0] / (_MAX_CELLS_PER_AXIS - 4), 1e-30)
        fine, width = max(cell_width / 4, min_width), max(cell_width, min_width)
        size = [int(extent[0] / fine) + 1, int(extent[1] / width) + 1, int(extent[2] / width) + 1]
        return cls(axes, low_corner, extent, [fine, width, width], size)

    @property
    def cell_count(self) -> int:
        """Return the number of cells."""
        return self.cells_per_axis[0] * self.cells_per_axis[1] * self.cells_per_axis[2]

    @property
    def cells_per_mm(self) -> tuple[float, float, float]:
        """Return the number of cells per millimetre along the fast, middle and slow axis."""
        a, b, c = self.cell_widths
        return 1 / a, 1 / b, 1 / c

    def has_cell_table(self, agents: int) -> bool:
        """Return whether a table with one entry per cell is small enough to be used for a crowd of `agents` agents."""
        return self.cell_count <= max(1 << 16, 16 * agents)

    def flatten_to_one_layer(self) -> GridShape:
        """Return the same box with a single layer of cells along its shortest axis."""
        widths, counts = [*self.cell_widths[:2], 2 * self.extent[2]], [*self.cells_per_axis[:2], 1]
        return GridShape(self.axes, self.low_corner, self.extent, widths, counts)

    def is_one_layer_enough(self, positions: Positions) -> bool:
        """Return whether one layer of cells is enough for a crowd at `positions` (float32[n] mm). It is enough if few agents, or
        few layers of cells, are above each other along the shortest axis. On ground, this is usually so."""
        if not self.extent[2] > 0:
            return False  # there is already only one layer of cells
        occupied = np.zeros((2, max(1 << 16, 64 * len(positions[0]))), np.bool_)
        axis_positions = reorder_axes(self.axes, positions)
        low, counts = tuple(self.low_corner), tuple(self.cells_per_axis)
        return bool(_is_one_layer_enough(axis_positions, low, self.cells_per_mm, counts, occupied))


def reorder_axes(axes: tuple[int, ...], positions: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return the x, y and z arrays in the order fast, middle, slow axis. `axes`: the indices of these axes."""
    a, b, c = axes
    return positions[a], positions[b], positions[c]


def find_bounding_box(positions: Positions) -> tuple[list[float], list[float]]:
    """Return the corners of the bounding box of all finite positions (float32[n] mm); zeros if there are none."""
    ends = np.empty((2, 3))
    _write_bounding_box(*positions, np.empty((6, LANE_COUNT), np.float32), ends)
    low, high = ends.tolist()
    return low, high


class CellOrder:
    """Agents sorted by their cells, with arrays that the next sort reuses. Agents without a finite position are in no cell and
    come last. The index of an agent in the sorted arrays is called its position in the order.

    `columns`: x, y and z of the sorted agents, float32[n + 8] each; the last eight values are spare. `packed_positions`: x, y,
    z and row of each sorted agent, four entries per agent. `rows` int32[n]: the row of each sorted agent. `position_by_row`
    int32[n + 8]: for each row, its position in the order. `cell_starts` int32: the first sorted agent of each cell, then the
    number of agents; empty if there are too many cells. `keys` int64[n]: the cell of each sorted agent; used if `cell_starts`
    is empty. `tables`: the arrays that machine code reads, by name; a new mapping whenever one of them is replaced. Among
    them, `places` [n + 8, 4] has x, y, z and row of each sorted agent, the row as the bits of an int32; `floats` has the low
    corner, width and inverse width of cells along the fast, middle and slow axis; `whole` has the three axes, the numbers of
    cells along them, and the number of agents."""

    def __init__(self, count: int, threads: int) -> None:
        self.count, self.threads = count, threads
        self._chunks = max(1, min(threads, count_available_cores())) if count >= _MIN_CHUNKED_AGENTS else 1
        self._packed_rows = np.zeros((count + LANE_COUNT, 4), np.float32)
        self.position_by_row = np.zeros(count + LANE_COUNT, np.int32)
        self.columns = tuple(np.zeros((3, count + LANE_COUNT), np.float32))
        self._shape_floats, self._shape_integers = np.zeros(9), np.zeros(7, np.int64)
        self._keys, self._table = np.empty(count, np.int64), np.empty((self._chunks, 0), np.int32)
        self._counts, self.keys, self.cell_starts = self._table, NO_ORDER, np.empty(0, np.int32)
        self.shape: GridShape | None = None
        self._cell_numbering: tuple[Any, ...] = ()
        self.packed_positions = self._packed_rows.reshape(-1)
        self._store_targets = (self.packed_positions, self.packed_positions.view(np.int32), self.position_by_row)
        self.tables: dict[str, NDArray[Any] | None] = {
            "places": self._packed_rows,
            "at": self.position_by_row,
            "keys": self.keys,
            "starts": None,
        }
        self.tables |= dict(zip("xyz", self.columns, strict=True)) | {"floats": self._shape_floats, "whole": self._shape_integers}

    @property
    def rows(self) -> NDArray[np.int32]:
        """Return the row of each sorted agent, int32[n]."""
        return self._packed_rows.view(np.int32)[: self.count, 3]

    def sort(self, shape: GridShape, positions: Positions, order: NDArray[np.int64] = NO_ORDER) -> None:
        """Sort agents at positions (float32[n] mm) by cell, then in the given `order` of all rows (empty: ascending)."""
        if shape is not self.shape:
            self._set_shape(shape)
        counts, keys = self._counts, self._keys
        axis_positions = reorder_axes(shape.axes, positions)
        count = partial(_count_cells, axis_positions, *self._cell_numbering, order, keys, counts)
        run_in_chunks(count, self._chunks, self.threads)
        if counts.size:
            convert_counts_to_starts(counts, shape.cell_count)
        else:
            by_cell = sort_stably(keys)
            order = order.take(by_cell) if order.size else by_cell
            self.keys = keys.take(by_cell)
            self.tables = {**self.tables, "keys": self.keys}
        run_in_chunks(partial(_store_agents, positions, order, keys, counts, *self._store_targets), self._chunks, self.threads)
        parallel.run_in_parts(
            partial(_store_columns, self.packed_positions, *self.columns), self.count, self.threads,
            parallel.MIN_LIGHT_ITEMS_PER_THREAD
        )  # fmt: skip

    def _set_shape(self, shape: GridShape) -> None:
        """Store a new shape, and allocate a table of its cells if they are few enough."""
        self.shape, self._cell_numbering = shape, (tuple(shape.low_corner), shape.cells_per_mm, tuple(shape.cells_per_axis), 0)
        self._shape_floats[:] = *shape.low_corner, *shape.cell_widths, *shape.cells_per_mm
        self._shape_integers[:] = *shape.axes, *shape.cells_per_axis, self.count
        has_table, needed = shape.has_cell_table(self.count), shape.cell_count + SPARE_TABLE_ENTRIES
        if has_table and self._table.shape[1] < needed:
            self._table = np.empty((self._chunks, needed + (needed >> 3)), np.int32)
        self._counts = self._table if has_table else self._table[:, :0]
        self.cell_starts = self._counts[-1]
        self.tables = {**self.tables, "starts": self.cell_starts if has_table else None}


def run_in_chunks(run_kernel: partial[Any], chunks: int, threads: int) -> None:
    """Call the kernel `run_kernel` for all `chunks` in parallel; each thread processes at least one chunk.

    The kernel's last arguments are the begin and end of a range of chunks, in units of 1 / `WORK_UNITS_PER_CHUNK`."""
    parallel.run_in_parts(run_kernel, WORK_UNITS_PER_CHUNK * chunks, threads, WORK_UNITS_PER_CHUNK)


@kernel
def _write_bounding_box(x: Array1[F32], y: Array1[F32], z: Array1[F32], lanes: Array2[F32], corners: Array2[F64]) -> None:
    """Write the bounding box of all finite positions to `corners` (2, 3): first the least x, y, z, then the greatest. Zeros if
    no position is finite. `lanes` (6, 8): a buffer for the extremes of each SIMD lane."""
    even = x.size & -8
    for lane in simd_range(0, 8):
        low_x, low_y, low_z = np.float32(np.inf), np.float32(np.inf), np.float32(np.inf)
        high_x, high_y, high_z = np.float32(-np.inf), np.float32(-np.inf), np.float32(-np.inf)
        for first in range(0, even, 8):
            a, b, c = x[first + lane], y[first + lane], z[first + lane]
            is_finite = np.isfinite(a) & np.isfinite(b) & np.isfinite(c)
            low_x, low_y, low_z = (
                _take_minimum_if_valid(low_x, a, is_finite),
                _take_minimum_if_valid(low_y, b, is_finite),
                _take_minimum_if_valid(low_z, c, is_finite),
            )
            high_x, high_y, high_z = (
                _take_maximum_if_valid(high_x, a, is_finite),
                _take_maximum_if_valid(high_y, b, is_finite),
                _take_maximum_if_valid(high_z, c, is_finite),
            )
        lanes[0, lane], lanes[1, lane], lanes[2, lane] = low_x, low_y, low_z
        lanes[3, lane], lanes[4, lane], lanes[5, lane] = high_x, high_y, high_z
    for axis in range(3):
        low, high = np.float32(np.inf), np.float32(-np.inf)
        for lane in range(8):
            low, high = min(low, lanes[axis, lane]), max(high, lanes[axis + 3, lane])
        for k in range(even, x.size):
            place = x[k] if axis == 0 else (y[k] if axis == 1 else z[k])
            is_finite = np.isfinite(x[k]) & np.isfinite(y[k]) & np.isfinite(z[k])
            low, high = _take_minimum_if_valid(low, place, is_finite), _take_maximum_if_valid(high, place, is_finite)
        corners[0, axis], corners[1, axis] = (np.float64(low), np.float64(high)) if low <= high else (0.0, 0.0)


@inlined
def _take_minimum_if_valid(low: F32, place: F32, is_valid: BOOL) -> F32:
    """Return the lesser of `low` and `place`, or `low` if not `is_valid`."""
    return place if is_valid & (place < low) else low


@inlined
def _take_maximum_if_valid(high: F32, place: F32, is_valid: BOOL) -> F32:
    """Return the greater of `high` and `place`, or `high` if not `is_valid`."""
    return place if is_valid & (place > high) else high


@kernel
def _is_one_layer_enough(
    axis_positions: Columns, low: FloatTriple, inverse: FloatTriple, size: CellCounts, occupied: Array2[BOOL]
) -> BOOL:
    """Return whether one layer of cells is enough: columns contain few agents, or agents in few layers. If there are too many
    columns, several count as one. `occupied` (2, k): buffers with a flag for each column, and each cell, with agents."""
    agents, columns, cells = 0, 0, 0
    for row in range(axis_positions[0].size):
        a, b, c = axis_positions[0][row], axis_positions[1][row], axis_positions[2][row]
        if not (np.isfinite(a) and np.isfinite(b) and np.isfinite(c)):
            continue
        agents += 1
        column = round_to_int(_compute_axis_cell(b, low[1], inverse[1], size[1])) * ((size[0] >> 2) + 1) + (
            round_to_int(_compute_axis_cell(a, low[0], inverse[0], size[0])) >> 2
        )
        cell = column * size[2] + round_to_int(_compute_axis_cell(c, low[2], inverse[2], size[2]))
        column, cell = column % occupied.shape[1], cell % occupied.shape[1]
        columns += not occupied[0, column]
        cells += not occupied[1, cell]
        occupied[0, column], occupied[1, cell] = True, True
    return agents <= _MAX_AGENTS_PER_COLUMN * columns or cells <= _MAX_LAYERS_PER_COLUMN * columns


@inlined
def _compute_axis_cell(place: Any, low: F64, inverse: F64, size: I64) -> F64:
    """Return the index, as float64, of the cell at the coordinate `place` along an axis."""
    return np.floor(min(max((np.float64(place) - low) * inverse, 0.0), np.float64(size - 1)))


@inlined
def compute_cell_key(positions: AnyTypeColumns, row: I64, low: FloatTriple, inverse: FloatTriple, size: CellCounts) -> I64:
    """Return the cell number of the agent at `row`. For an agent without a finite position, it is the total number of cells."""
    fast, middle, slow = positions[0][row], positions[1][row], positions[2][row]
    layer = _compute_axis_cell(slow, low[2], inverse[2], size[2])
    line = layer * np.float64(size[1]) + _compute_axis_cell(middle, low[1], inverse[1], size[1])
    key = round_to_int(line) * size[0] + round_to_int(_compute_axis_cell(fast, low[0], inverse[0], size[0]))
    is_finite = np.isfinite(fast) & np.isfinite(middle) & np.isfinite(slow)
    return key if is_finite else size[0] * size[1] * size[2]


@inlined
def _compute_chunk_range(chunk: I64, chunks: I64, count: I64) -> tuple[I64, I64]:
    """Return the first agent of `chunk` and the agent after its last one, for `count` agents in `chunks` chunks."""
    length = -(-count // (8 * chunks)) * 8
    return min(chunk * length, count), min((chunk + 1) * length, count)


@inlined
def count_cells(
    axis_positions: AnyTypeColumns, low: FloatTriple, inverse: FloatTriple, size: CellCounts, shift: I64, order: Array1[I64],
    keys: Array1[I64], counts: Array2[I32], begin: I64, end: I64,
) -> I64:  # fmt: skip
    """Write each agent's cell number plus `shift` to `keys`, and the number of agents of each cell to `counts`. Returns how
    many ordered pairs of agents in the same chunk share a cell. Each agent also counts as a pair with itself. `order`: the
    rows of the agents; empty for all rows. `counts` [chunks, cells + 3]: the count of a cell is at index cell + 2; the array
    may be empty."""
    shared_cell_pairs = 0
    for chunk in range(begin // WORK_UNITS_PER_CHUNK, end // WORK_UNITS_PER_CHUNK):
        first, last = _compute_chunk_range(chunk, counts.shape[0], keys.size)
        if order.size > 0:
            for k in simd_range(first, last):
                keys[k] = compute_cell_key(axis_positions, order[k], low, inverse, size) + shift
        else:
            for k in simd_range(first, last):
                keys[k] = compute_cell_key(axis_positions, k, low, inverse, size) + shift
        if counts.shape[1] > 0:
            for k in range(size[0] * size[1] * size[2] + SPARE_TABLE_ENTRIES):
                counts[chunk, k] = 0
            for k in range(first, last):
                count = counts[chunk, keys[k] + 2]
                shared_cell_pairs += 2 * count + 1
                counts[chunk, keys[k] + 2] = count + 1
    return shared_cell_pairs


@kernel
def _count_cells(
    axis_positions: Columns, low: FloatTriple, inverse: FloatTriple, size: CellCounts, shift: I64, order: Array1[I64],
    keys: Array1[I64], counts: Array2[I32], begin: I64, end: I64,
) -> None:  # fmt: skip
    """Write cell numbers and counts as `count_cells` does, without a result."""
    count_cells(axis_positions, low, inverse, size, shift, order, keys, counts, begin, end)


@kernel
def convert_counts_to_starts(counts: Array2[I32], cells: I64) -> None:
    """Replace counts by start positions. Entry cell + 1 becomes the index at which the chunk stores its first agent of this
    cell. Once `take_next_sorted_index` has been called for all agents, the last row of `counts` contains the first agent of
    each cell."""
    last, position = counts.shape[0] - 1, 0
    for chunk in range(last):
        for cell in range(cells + 2):
            counts[last, cell] += counts[chunk, cell]
    for cell in range(cells + 2):
        position += counts[last, cell]
        counts[last, cell] = position
    for chunk in range(last):
        for cell in range(cells + 2):
            count = counts[chunk, cell + 1]
            counts[chunk, cell] = counts[last, cell]
            counts[last, cell] += count


@inlined
def take_next_sorted_index(counts: Array2[I32], chunk: I64, k: I64, key: I64) -> I64:
    """Return the next free position for an agent of cell `key`, and advance the cell's counter. If `counts` is empty, return
    `k`, the agent's index."""
    position = k
    if counts.shape[1] > 0:
        position = counts[chunk, key + 1]
        counts[chunk, key + 1] = position + 1
    return position


@kernel
def _store_agents(
    positions: Columns, order: Array1[I64], keys: Array1[I64], counts: Array2[I32], ordered_agents: Array1[F32],
    rows: Array1[I32], position_by_row: Array1[I32], begin: I64, end: I64,
) -> None:  # fmt: skip
    """Write x, y, z and row of each agent at its position in the order, and that position to `position_by_row`.

    `ordered_agents` and `rows` are views of one array with four entries per agent."""
    for chunk in range(begin // WORK_UNITS_PER_CHUNK, end // WORK_UNITS_PER_CHUNK):
        first, last = _compute_chunk_range(chunk, counts.shape[0], keys.size)
        for k in range(first, last):
            row = order[k] if order.size > 0 else k
            position = take_next_sorted_index(counts, chunk, k, keys[k])
            ordered_agents[4 * position], ordered_agents[4 * position + 1] = positions[0][row], positions[1][row]
            ordered_agents[4 * position + 2], rows[4 * position + 3] = positions[2][row], row
            position_by_row[row] = position


@kernel
def _store_columns(ordered_agents: Array1[F32], x: Array1[F32], y: Array1[F32], z: Array1[F32], begin: I64, end: I64) -> None:
    """Copy the positions of the sorted agents to the arrays `x`, `y` and `z`. `ordered_agents`: x, y, z and row of each agent."""
    for n in simd_range(begin, end):
        x[n], y[n], z[n], _ = load_consecutive(ordered_agents, 4 * n, 4)


@kernel
def pack_columns_by_position(
    position_by_row: Array1[I32], registers: FourColumns, table: Array1[F32], begin: I64, end: I64
) -> None:
    """Write four values per agent to `table`, in consecutive entries, in the order of cells. `registers`: the values by row."""
    for row in range(begin, end):
        first = 4 * position_by_row[row]
        table[first], table[first + 1] = registers[0][row], registers[1][row]
        table[first + 2], table[first + 3] = registers[2][row], registers[3][row]


@inlined
def count_agents_before(cell_starts: Array1[I32], keys: Array1[I64], key: I64) -> I64:
    """Return how many sorted agents are in cells with numbers below `key`. If there are no `cell_starts`, search the sorted
    cell numbers `keys` by bisection."""
    if cell_starts.size > 0:
        count = cell_starts[key]
    else:
        count = find_lower_bound(keys, key, 0, keys.size)
    return count
