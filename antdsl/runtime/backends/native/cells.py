"""The rows of cells in reach of eight places, as machine code, and the list of those found in them."""

from __future__ import annotations

import numpy as np

from antdsl.machine_code.emitter import Emitter
from antdsl.machine_code.lanes import BOOL, F32, F64, I8, I32, I64, PTR, WIDTH, Lanes, Module
from antdsl.runtime.backends.native.block import Writer

SLACK, BEYOND = 1.0 + 1e-6, 1.0 + 1e-5  # as in `senses.neighbours`


class Cells:
    """The cell grid of a search, as lanes of values that are the same for all."""

    def __init__(self, w: Writer, number: int) -> None:
        e = w.e
        floats, whole = w.base("grid", number, "floats"), w.base("grid", number, "whole")

        def read(base: Lanes, k: int, kind: str) -> Lanes:
            return e.load_one(base, e.constant(k, I64, one=True), kind)

        self.w, self.number = w, number
        self.low = [e.splat(read(floats, k, F64)) for k in range(3)]
        self.width = [e.splat(read(floats, 3 + k, F64)) for k in range(3)]
        self.inverse = [e.splat(read(floats, 6 + k, F64)) for k in range(3)]
        self.axes = [read(whole, k, I64) for k in range(3)]
        self.size = [e.splat(read(whole, 3 + k, I64)) for k in range(3)]
        self.most = [e.convert(e.convert(size, I32), F64) for size in self.size]
        self.flat = e.splat(e.one(f"icmp eq i64 {read(whole, 5, I64).name}, 1", BOOL))
        self.count = read(whole, 6, I64)

    def span(self, axis: int, q: Lanes, half: Lanes) -> tuple[Lanes, Lanes]:
        """First and last cell along an axis that [q - half, q + half] meets, i32; the last is below the first where none."""
        e = self.w.e
        most = self.most[axis]
        first = e.between((q - half - self.low[axis]) * self.inverse[axis], e.constant(0.0, F64), most)
        last = e.between((q + half - self.low[axis]) * self.inverse[axis], e.constant(-1.0, F64), most - 1.0)
        return e.whole(np.floor(first)), e.whole(np.floor(last))

    def between(self, z: Lanes, y: Lanes, first: Lanes, last: Lanes, within: Lanes) -> tuple[Lanes, Lanes]:
        """Place in the grid's order of the first agent of a row of cells from one cell to another, and how many there are, i32;
        0 and 0 where a condition does not hold."""
        w, e = self.w, self.w.e
        starts, keys = w.base("grid", self.number, "starts"), w.base("grid", self.number, "keys")
        begin, end = e.slot(I32), e.slot(I32)
        none = e.constant(0, I32)
        with e.inside(e.one(f"icmp ne ptr {starts.name}, null", BOOL)):  # so few cells that 32 bits hold their numbers
            fast, middle = (e.convert(self.size[k], I32) for k in (0, 1))
            line = e.multiplied(e.multiplied(z, middle) + y, fast)
            e.put(begin, e.gather(starts, e.where(within, line + first, none), I32))
            e.put(end, e.gather(starts, e.where(within, line + last + 1, none), I32))
        with e.inside(e.one(f"icmp eq ptr {starts.name}, null", BOOL)):
            wide = [e.convert(each, I64) for each in (z, y, first, last)]
            line = e.multiplied(e.multiplied(wide[0], self.size[1]) + wide[1], self.size[0])
            name, lanes = self._bisection(), f"<{WIDTH} x i64>"
            for slot, key in ((begin, line + wide[2]), (end, line + wide[3] + 1)):
                text = f"call {lanes} @{name}(ptr {keys.name}, i64 {self.count.name}, {key.typed})"
                e.put(slot, e.convert(e.op(text, I64), I32))
        start = e.get(begin, I32)
        return start, e.where(within, e.get(end, I32) - start, none)

    def _bisection(self) -> str:
        """A function that finds how many of the sorted keys are below each of eight, i64."""
        name = "grid.before"

        def make() -> str:
            f = Emitter(self.w.module)
            sorted_keys, key = Lanes(f, PTR, "%keys", one=True), Lanes(f, I64, "%key")
            low, high = f.slot(I64), f.slot(I64)
            f.put(low, f.constant(0, I64))
            f.put(high, f.splat(Lanes(f, I64, "%count", one=True)))
            with f.loop(f.constant(32, I64, one=True)):
                a, b = f.get(low, I64), f.get(high, I64)
                middle, more = (a + b) >> 1, a < b
                probe = f.gather(sorted_keys, f.where(more, middle, f.constant(0, I64)), I64)
                less = more & (probe < key)
                f.put(low, f.where(less, middle + 1, a))
                f.put(high, f.where(more & ~less, middle, b))
            value = f.get(low, I64)
            body, lanes = "\n".join((*f.allocas, *f.entry, *f.lines)), f"<{WIDTH} x i64>"
            head = f"define internal {lanes} @{name}(ptr %keys, i64 %count, {lanes} %key) noinline"
            return f"{head} {{\nentry:\n{body}\n  ret {value.typed}\n}}"

        self.w.module.function(name, make)
        return name


class Rows:
    """Rows of cells in reach of eight places, within the widest of some radii of each."""

    def __init__(self, w: Writer, number: int, place: list[Lanes], radii: list[Lanes], asks: Lanes) -> None:
        e = self.e = w.e
        self.cells = cells = Cells(w, number)
        widest = radii[0]
        for each in radii[1:]:
            widest = e.meaning(np.fmax, widest, each)
        usable = asks & (widest >= np.float32(0))
        for each in place:
            usable = usable & np.isfinite(each)
        self.widest, self.usable = widest, usable
        self.stack = stack = e.slot(F32, count=3)
        for k, each in enumerate(place):
            e.put(e.field(stack, 32 * k), each)
        along = []
        for k, axis in enumerate(cells.axes):
            at = e.one(f"getelementptr <{WIDTH} x float>, ptr {stack}, i64 {axis.name}", PTR)
            along.append(e.where(usable, e.convert(e.get(at.name, F32), F64), cells.low[k]))
        largest = np.maximum(np.maximum(np.abs(along[0]), np.abs(along[1])), np.abs(along[2]))
        r = e.where(usable, e.convert(widest, F64), e.constant(0.0, F64)) * SLACK + (largest * 1e-14 + 1e-18)
        self.a0, self.a1 = cells.span(0, along[0], r)
        self.b0, self.b1 = cells.span(1, along[1], r)
        c0, c1 = cells.span(2, along[2], r)
        sheet = cells.flat & (np.abs(along[2] - cells.low[2]) <= cells.width[2])
        self.c0, self.c1 = (e.where(sheet, e.constant(0, I32), c) for c in (c0, c1))

    def note(self) -> None:
        """Remember the greatest radius that was asked for: the next step's cells suit it."""
        w = self.cells.w
        e, place, zero = self.e, w.base("grid", self.cells.number, "widest"), w.e.constant(0, I64, one=True)
        widest = e.where(self.usable & np.isfinite(self.widest), self.widest, e.constant(0.0, F32))
        e.store(place, zero, e.meaning(np.fmax, e.load(place, zero, F32), widest))

    def many(self) -> Lanes:
        """How many rows `following` gives before it comes to the end, i64; from here on the first one comes first."""
        e, nothing = self.e, self.e.constant(0, I32)
        self._deep, self._tall = e.slot(I32, one=True), e.slot(I32, one=True)
        for slot in (self._deep, self._tall):
            e.put(slot, e.constant(0, I32, one=True))
        deep, self._most = (
            e.greatest(e.where(self.usable, z - a, nothing) + 1) for a, z in ((self.c0, self.c1), (self.b0, self.b1))
        )
        return e.convert(e.one(f"mul i32 {deep.name}, {self._most.name}", I32), I64)

    def following(self) -> tuple[Lanes, Lanes]:
        """The next row of cells: where its agents begin in the grid's order, and how many may be in reach, i32."""
        e = self.e
        deep, tall = e.get(self._deep, I32, one=True), e.get(self._tall, I32, one=True)
        cz, cy = self.c0 + e.splat(deep), self.b0 + e.splat(tall)
        next_one = e.one(f"add i32 {tall.name}, 1", I32)
        over = e.one(f"icmp sge i32 {next_one.name}, {self._most.name}", BOOL)
        e.put(self._tall, e.one(f"select i1 {over.name}, i32 0, {next_one.typed}", I32))
        e.put(self._deep, e.one(f"add i32 {deep.name}, {e.one(f'zext i1 {over.name} to i32', I32).name}", I32))
        within = self.usable & (cy <= self.b1) & (cz <= self.c1) & (self.a0 <= self.a1)
        return self.cells.between(cz, cy, self.a0, self.a1, within)


def write_down(e: Emitter, buffer: Lanes, total: str, numbers: Lanes, inside: Lanes) -> None:
    """Append those of eight numbers (i32) for which a condition holds. All are written, and written over where they
    are not to stay: there is no branch that is hard to foretell."""
    bits = e.one(f"zext i8 {e.mask_bits(inside).name} to i64", I64)
    count = e.get(total, I64, one=True)
    place = e.address(buffer, count, I32).name
    if e.module.target.avx2:
        order = e.load(
            e.address(Lanes(e, PTR, _orders(e.module), one=True), e.one(f"shl i64 {bits.name}, 3", I64), I8), zero_of(e), I8
        )
        packed = e.permuted(numbers, e.op(f"zext {order.typed} to <{WIDTH} x i32>", I32))
        e.do(f"store {packed.typed}, ptr {place}, align 4")
        e.module.declare("llvm.ctpop.i64", I64, [I64])
        e.put(total, e.one(f"add i64 {count.name}, {e.one(f'call i64 @llvm.ctpop.i64(i64 {bits.name})', I64).name}", I64))
        return
    for k in range(WIDTH):
        e.put(e.address(buffer, count, I32).name, e.one(f"extractelement {numbers.typed}, i64 {k}", I32))
        shifted = e.one(f"lshr i64 {bits.name}, {k}", I64) if k else bits
        count = e.one(f"add i64 {count.name}, {e.one(f'and i64 {shifted.name}, 1', I64).name}", I64)
    e.put(total, count)


def zero_of(e: Emitter) -> Lanes:
    return e.constant(0, I64, one=True)


def _orders(module: Module) -> str:
    """A table of bytes: for each of the 256 sets of eight lanes, its lanes first."""
    name = "lanes.first"

    def make() -> str:
        rows = [[k for k in range(WIDTH) if bits >> k & 1] for bits in range(256)]
        flat = [f"i8 {k}" for row in rows for k in (*row, *(0,) * (WIDTH - len(row)))]
        return f"@{name} = internal constant [{len(flat)} x i8] [{', '.join(flat)}]"

    module.function(name, make)
    return f"@{name}"
