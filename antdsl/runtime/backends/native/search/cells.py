"""Machine code that finds the rows of cells within the radii of eight positions, and lists the agents in them."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.kernels.ir import LANE_ORDERS_CONSTANT
from antdsl.machine_code.kernels.values import Number, text_type
from antdsl.machine_code.kinds import BOOL, F32, F64, I8, I32, I64, LANE_COUNT, PTR
from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.runtime.backends.native.block import FunctionWriter

RADIUS_SLACK_FACTOR, SEARCH_SLACK_FACTOR = 1.0 + 1e-6, 1.0 + 1e-5  # as in `senses.neighbours`


class SearchCells:
    """The cell grid of a search, as lanes of loop-invariant values."""

    def __init__(self, w: FunctionWriter, number: int) -> None:
        e = w.e
        floats, integers = w.base("grid", number, "floats"), w.base("grid", number, "whole")

        def read(base: Lanes, k: int, kind: str) -> Lanes:
            return e.read_one(base, k, kind)

        self.w, self.number = w, number
        self.low = [e.widened(read(floats, k, F64)) for k in range(3)]
        self.width = [e.widened(read(floats, 3 + k, F64)) for k in range(3)]
        self.inverse = [e.widened(read(floats, 6 + k, F64)) for k in range(3)]
        self.axes = [read(integers, k, I64) for k in range(3)]
        self.size = [e.widened(read(integers, 3 + k, I64)) for k in range(3)]
        self.most = [e.convert(e.convert(size, I32), F64) for size in self.size]
        self.flat = e.widened(read(integers, 5, I64) == 1)
        self.count = read(integers, 6, I64)

    def span(self, axis: int, q: Lanes, half: Lanes) -> tuple[Lanes, Lanes]:
        """Return the first and last cell along an axis that intersect [q - half, q + half], i32. If none does, the last is
        below the first."""
        e = self.w.e
        most = self.most[axis]
        first = e.clamp((q - half - self.low[axis]) * self.inverse[axis], e.constant(0.0, F64), most)
        last = e.clamp((q + half - self.low[axis]) * self.inverse[axis], e.constant(-1.0, F64), most - 1.0)
        return e.to_int32(np.floor(first)), e.to_int32(np.floor(last))

    def row_range(self, z: Lanes, y: Lanes, first: Lanes, last: Lanes, within: Lanes) -> tuple[Lanes, Lanes]:
        """Return where a row of cells, from one cell to another, starts in the grid's order, and its number of agents, i32.

        Both are 0 if `within` is false."""
        w, e = self.w, self.w.e
        starts, keys = w.base("grid", self.number, "starts"), w.base("grid", self.number, "keys")
        begin, end = e.slot(I32, LANE_COUNT), e.slot(I32, LANE_COUNT)
        none = e.constant(0, I32)
        many = e.op("is_null", BOOL, starts)
        with e.inside(~many):  # so few cells that 32 bits hold their numbers
            fast, middle = (e.convert(self.size[k], I32) for k in (0, 1))
            line = (z * middle + y) * fast
            e.put(begin, e.gather(starts, e.where(within, line + first, none), I32))
            e.put(end, e.gather(starts, e.where(within, line + last + 1, none), I32))
        with e.inside(many):
            wide = [e.convert(each, I64) for each in (z, y, first, last)]
            line = (wide[0] * self.size[1] + wide[1]) * self.size[0]
            name = self._bisection()
            for slot, key in ((begin, line + wide[2]), (end, line + wide[3] + 1)):
                e.put(slot, e.convert(e.call(name, I64, keys, self.count, key), I32))
        start = e.load(begin, I32, LANE_COUNT)
        return start, e.where(within, e.load(end, I32, LANE_COUNT) - start, none)

    def _bisection(self) -> str:
        """Return the name of a function that counts how many sorted keys are below each of eight keys, i64."""
        name = "grid.before"
        if name in self.w.module.functions:
            return name
        f = LaneBuilder(self.w.module)
        sorted_keys, count, key = (
            f.named_number(PTR, "%keys"),
            f.named_number(I64, "%count"),
            f.named_number(I64, "%key", LANE_COUNT),
        )
        low, high = f.slot(I64, LANE_COUNT), f.slot(I64, LANE_COUNT)
        f.put(low, f.constant(0, I64))
        f.put(high, f.widened(count))
        with f.loop(32):
            a, b = f.load(low, I64, LANE_COUNT), f.load(high, I64, LANE_COUNT)
            middle, is_open = (a + b) >> 1, a < b
            probe = f.gather(sorted_keys, f.where(is_open, middle, f.constant(0, I64)), I64)
            is_below = is_open & (probe < key)
            f.put(low, f.where(is_below, middle + 1, a))
            f.put(high, f.where(is_open & ~is_below, middle, b))
        f.end(name, (sorted_keys, count, key), f.load(low, I64, LANE_COUNT), attribute="noinline")
        return name


class CellRows:
    """The rows of cells around eight positions, within the widest of each agent's radii."""

    def __init__(self, w: FunctionWriter, number: int, place: list[Lanes], radii: list[Lanes], asks: Lanes) -> None:
        e = self.e = w.e
        self.cells = cells = SearchCells(w, number)
        widest = radii[0]
        for each in radii[1:]:
            widest = e.apply_function(np.fmax, widest, each)
        usable = asks & (widest >= np.float32(0))
        for each in place:
            usable = usable & np.isfinite(each)
        self.widest, self.usable = widest, usable
        self.stack = stack = e.allocate(3, text_type(F32, LANE_COUNT))
        for k, each in enumerate(place):
            e.put(e.field(stack, 32 * k), each)
        along = []
        for k, axis in enumerate(cells.axes):
            value = e.load(e.address(stack, axis, text_type(F32, LANE_COUNT)), F32, LANE_COUNT)
            along.append(e.where(usable, e.convert(value, F64), cells.low[k]))
        largest = np.maximum(np.maximum(np.abs(along[0]), np.abs(along[1])), np.abs(along[2]))
        r = e.where(usable, e.convert(widest, F64), e.constant(0.0, F64)) * RADIUS_SLACK_FACTOR + (largest * 1e-14 + 1e-18)
        self.a0, self.a1 = cells.span(0, along[0], r)
        self.b0, self.b1 = cells.span(1, along[1], r)
        c0, c1 = cells.span(2, along[2], r)
        sheet = cells.flat & (np.abs(along[2] - cells.low[2]) <= cells.width[2])
        self.c0, self.c1 = (e.where(sheet, e.constant(0, I32), c) for c in (c0, c1))

    def note_radius(self) -> None:
        """Store the greatest requested radius. The cell size of the next step is chosen by it."""
        w = self.cells.w
        e, place = self.e, w.base("grid", self.cells.number, "widest")
        widest = e.where(self.usable & np.isfinite(self.widest), self.widest, e.constant(0.0, F32))
        e.write(place, 0, e.apply_function(np.fmax, e.read(place, 0, F32), widest))

    def row_count(self) -> Lanes:
        """Return the number of rows that `next_row` returns in total, i64, and restart it at the first row."""
        e, nothing = self.e, self.e.constant(0, I32)
        self._deep, self._tall = e.slot(I32), e.slot(I32)
        for slot in (self._deep, self._tall):
            e.put(slot, e.constant(0, I32, 1))
        depth, self._most = (
            e.lane_maximum(e.where(self.usable, z - a, nothing) + 1) for a, z in ((self.c0, self.c1), (self.b0, self.b1))
        )
        return e.convert(depth * self._most, I64)

    def next_row(self) -> tuple[Lanes, Lanes]:
        """Return the next row of cells: the index of its first agent in the grid's order, and how many agents may be in reach,
        i32."""
        e = self.e
        depth, tall = e.load(self._deep, I32), e.load(self._tall, I32)
        cz, cy = self.c0 + depth, self.b0 + tall
        next_one = tall + 1
        over = next_one >= self._most
        e.put(self._tall, e.where(over, 0, next_one))
        e.put(self._deep, depth + e.convert(over, I32))
        within = self.usable & (cy <= self.b1) & (cz <= self.c1) & (self.a0 <= self.a1)
        return self.cells.row_range(cz, cy, self.a0, self.a1, within)


def append_numbers(e: LaneBuilder, buffer: Lanes, total: Number, numbers: Lanes, inside: Lanes) -> None:
    """Append those of eight numbers (i32) for which a condition holds.

    All eight are written, and the unneeded ones are overwritten later. This avoids a branch that is hard to predict."""
    bits = e.mask_word(inside)
    count = e.load(total, I64)
    if e.module.target.avx2:
        place = e.address(buffer, count, I32)
        order = e.read(e.named_number(PTR, LANE_ORDERS_CONSTANT.name), bits << 3, I8)
        packed = e.op("permd", I32, numbers, e.op("zext", I32, order))
        e.do("store", packed, place, x=", align 4")
        e.put(total, count + e.op("ctpop", I64, bits))
        return
    for k in range(LANE_COUNT):
        e.put(e.address(buffer, count, I32), e.one(numbers, k))
        count = count + ((bits >> k if k else bits) & 1)
    e.put(total, count)
