"""Machine code that finds the rows of cells within the radii of eight positions, and the agents in these rows."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels.ir import LANE_ORDERS_CONSTANT
from antdsl.machine_code.kernels.values import Number, format_llvm_type
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.machine_code.number_kinds import BOOL, F32, F64, I8, I32, I64, LANE_COUNT, PTR
from antdsl.runtime.backends.native.block_writer import FunctionWriter

RADIUS_SLACK_FACTOR, SEARCH_SLACK_FACTOR = 1.0 + 1e-6, 1.0 + 1e-5  # as in `senses.neighbours`


class CellGridLanes:
    """The cell grid of a search, as lane values that each function loads once."""

    def __init__(self, w: FunctionWriter, number: int) -> None:
        e = w.builder
        floats, integers = w.emit_array_address("grid", number, "floats"), w.emit_array_address("grid", number, "whole")

        def load_grid_value(base: Lanes, k: int, kind: str) -> Lanes:
            return e.load_scalar(base, k, kind)

        self.writer, self.number = w, number
        self.low = [e.broadcast(load_grid_value(floats, k, F64)) for k in range(3)]
        self.width = [e.broadcast(load_grid_value(floats, 3 + k, F64)) for k in range(3)]
        self.inverse_width = [e.broadcast(load_grid_value(floats, 6 + k, F64)) for k in range(3)]
        self.axes = [load_grid_value(integers, k, I64) for k in range(3)]
        self.cell_counts = [e.broadcast(load_grid_value(integers, 3 + k, I64)) for k in range(3)]
        self.max_index = [e.convert(e.convert(size, I32), F64) for size in self.cell_counts]
        self.is_flat = e.broadcast(load_grid_value(integers, 5, I64) == 1)
        self.count = load_grid_value(integers, 6, I64)

    def emit_cell_range(self, axis: int, q: Lanes, half: Lanes) -> tuple[Lanes, Lanes]:
        """Return the first and the last cell (i32) along an axis that the interval [`q` - `half`, `q` + `half`] intersects.

        If it intersects none, the last cell number is less than the first."""
        e = self.writer.builder
        most = self.max_index[axis]
        first = e.emit_clamp((q - half - self.low[axis]) * self.inverse_width[axis], e.make_constant(0.0, F64), most)
        last = e.emit_clamp((q + half - self.low[axis]) * self.inverse_width[axis], e.make_constant(-1.0, F64), most - 1.0)
        return e.to_int32(np.floor(first)), e.to_int32(np.floor(last))

    def emit_row_range(self, z: Lanes, y: Lanes, first: Lanes, last: Lanes, is_within: Lanes) -> tuple[Lanes, Lanes]:
        """Return the index of the first agent in a row of cells, and the number of agents in the row (i32).

        The row is at cells `z` and `y`, from cell `first` to cell `last`. Both results are 0 where `is_within` is false."""
        w, e = self.writer, self.writer.builder
        starts, keys = w.emit_array_address("grid", self.number, "starts"), w.emit_array_address("grid", self.number, "keys")
        begin, end = e.allocate_slot(I32, LANE_COUNT), e.allocate_slot(I32, LANE_COUNT)
        none = e.make_constant(0, I32)
        many = e.op("is_null", BOOL, starts)
        with e.write_if(~many):  # so few cells that 32 bits hold their numbers
            fast, middle = (e.convert(self.cell_counts[k], I32) for k in (0, 1))
            line = (z * middle + y) * fast
            e.store_number(begin, e.gather(starts, e.select_lanes(is_within, line + first, none), I32))
            e.store_number(end, e.gather(starts, e.select_lanes(is_within, line + last + 1, none), I32))
        with e.write_if(many):
            wide = [e.convert(each, I64) for each in (z, y, first, last)]
            line = (wide[0] * self.cell_counts[1] + wide[1]) * self.cell_counts[0]
            name = self._get_bisection_function()
            for slot, key in ((begin, line + wide[2]), (end, line + wide[3] + 1)):
                e.store_number(slot, e.convert(e.call_function(name, I64, keys, self.count, key), I32))
        start = e.load(begin, I32, LANE_COUNT)
        return start, e.select_lanes(is_within, e.load(end, I32, LANE_COUNT) - start, none)

    def _get_bisection_function(self) -> str:
        """Return the name of a function that finds by bisection, for each of eight keys, how many sorted keys are less (i64)."""
        name = "grid.before"
        if name in self.writer.module.functions:
            return name
        f = LaneBuilder(self.writer.module)
        sorted_keys, count, key = (
            f.named_number(PTR, "%keys"),
            f.named_number(I64, "%count"),
            f.named_number(I64, "%key", LANE_COUNT),
        )
        low, high = f.allocate_slot(I64, LANE_COUNT), f.allocate_slot(I64, LANE_COUNT)
        f.store_number(low, f.make_constant(0, I64))
        f.store_number(high, f.broadcast(count))
        with f.write_loop(32):
            a, b = f.load(low, I64, LANE_COUNT), f.load(high, I64, LANE_COUNT)
            middle, is_open = (a + b) >> 1, a < b
            probe = f.gather(sorted_keys, f.select_lanes(is_open, middle, f.make_constant(0, I64)), I64)
            is_below = is_open & (probe < key)
            f.store_number(low, f.select_lanes(is_below, middle + 1, a))
            f.store_number(high, f.select_lanes(is_open & ~is_below, middle, b))
        f.end(name, (sorted_keys, count, key), f.load(low, I64, LANE_COUNT), attribute="noinline")
        return name


class CellRowReader:
    """The rows of cells around each of eight agents, within the agent's greatest radius."""

    def __init__(self, w: FunctionWriter, number: int, place: list[Lanes], radii: list[Lanes], requesting: Lanes) -> None:
        e = self.builder = w.builder
        self.cells = cells = CellGridLanes(w, number)
        widest = radii[0]
        for each in radii[1:]:
            widest = e.apply_function(np.fmax, widest, each)
        usable = requesting & (widest >= np.float32(0))
        for each in place:
            usable = usable & np.isfinite(each)
        self.max_radius, self.is_usable = widest, usable
        self.stack = stack = e.allocate(3, format_llvm_type(F32, LANE_COUNT))
        for k, each in enumerate(place):
            e.store_number(e.emit_offset_address(stack, 32 * k), each)
        along = []
        for k, axis in enumerate(cells.axes):
            value = e.load(e.address(stack, axis, format_llvm_type(F32, LANE_COUNT)), F32, LANE_COUNT)
            along.append(e.select_lanes(usable, e.convert(value, F64), cells.low[k]))
        largest = np.maximum(np.maximum(np.abs(along[0]), np.abs(along[1])), np.abs(along[2]))
        r = e.select_lanes(usable, e.convert(widest, F64), e.make_constant(0.0, F64)) * RADIUS_SLACK_FACTOR + (
            largest * 1e-14 + 1e-18
        )
        self.fast_first, self.fast_last = cells.emit_cell_range(0, along[0], r)
        self.middle_first, self.middle_last = cells.emit_cell_range(1, along[1], r)
        c0, c1 = cells.emit_cell_range(2, along[2], r)
        sheet = cells.is_flat & (np.abs(along[2] - cells.low[2]) <= cells.width[2])
        self.slow_first, self.slow_last = (e.select_lanes(sheet, e.make_constant(0, I32), c) for c in (c0, c1))

    def emit_max_radius_store(self) -> None:
        """Emit code that stores the greatest requested radius. The cell size of the next step depends on it."""
        w = self.cells.writer
        e, place = self.builder, w.emit_array_address("grid", self.cells.number, "widest")
        widest = e.select_lanes(self.is_usable & np.isfinite(self.max_radius), self.max_radius, e.make_constant(0.0, F32))
        e.store_lanes(place, 0, e.apply_function(np.fmax, e.load_lanes(place, 0, F32), widest))

    def emit_row_count(self) -> Lanes:
        """Return how many rows `emit_next_row_read` returns in total (i64), and restart it at the first row."""
        e, nothing = self.builder, self.builder.make_constant(0, I32)
        self._slow_offset, self._middle_offset = e.allocate_slot(I32), e.allocate_slot(I32)
        for slot in (self._slow_offset, self._middle_offset):
            e.store_number(slot, e.make_constant(0, I32, 1))
        depth, self._middle_row_count = (
            e.emit_lane_maximum(e.select_lanes(self.is_usable, z - a, nothing) + 1)
            for a, z in ((self.slow_first, self.slow_last), (self.middle_first, self.middle_last))
        )
        return e.convert(depth * self._middle_row_count, I64)

    def emit_next_row_read(self) -> tuple[Lanes, Lanes]:
        """Return the next row of cells: the index of its first agent, and its number of agents (i32)."""
        e = self.builder
        depth, tall = e.load(self._slow_offset, I32), e.load(self._middle_offset, I32)
        cz, cy = self.slow_first + depth, self.middle_first + tall
        next_one = tall + 1
        over = next_one >= self._middle_row_count
        e.store_number(self._middle_offset, e.select_lanes(over, 0, next_one))
        e.store_number(self._slow_offset, depth + e.convert(over, I32))
        within = self.is_usable & (cy <= self.middle_last) & (cz <= self.slow_last) & (self.fast_first <= self.fast_last)
        return self.cells.emit_row_range(cz, cy, self.fast_first, self.fast_last, within)


def emit_append_numbers(e: LaneBuilder, buffer: Lanes, total: Number, numbers: Lanes, is_inside: Lanes) -> None:
    """Emit code that appends to `buffer` those of eight `numbers` (i32) for which `is_inside` holds. `total`: the length of the
    buffer. All eight numbers are written, but the length grows only by the selected ones, so later calls overwrite the others.
    This avoids a branch that is hard to predict."""
    bits = e.mask_to_i64(is_inside)
    count = e.load(total, I64)
    if e.module.target.has_avx2:
        place = e.address(buffer, count, I32)
        order = e.load_lanes(e.named_number(PTR, LANE_ORDERS_CONSTANT.name), bits << 3, I8)
        packed = e.op("permd", I32, numbers, e.op("zext", I32, order))
        e.emit_void("store", packed, place, x=", align 4")
        e.store_number(total, count + e.op("ctpop", I64, bits))
        return
    for k in range(LANE_COUNT):
        e.store_number(e.address(buffer, count, I32), e.extract_lane(numbers, k))
        count = count + ((bits >> k if k else bits) & 1)
    e.store_number(total, count)
