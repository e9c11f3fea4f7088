"""Writes reads and stores of arrays' elements: of one turn of a loop, or of several side by side.

Elements of turns side by side that follow each other in memory are read and stored at once, others one by one; what counts for
some of the turns alone is read elsewhere for the others, and not stored."""

from __future__ import annotations

import ast

from antdsl.machine_code.kernels.arithmetic import Arithmetic
from antdsl.machine_code.kernels.types import INT, LLVM, TRUTH, Scalar
from antdsl.machine_code.kernels.values import WIDTH, Array, Number, constant, text_type

MOST = 64  # elements that are read at once
ALL = Number(TRUTH, "splat (i1 true)", True, True)  # all turns side by side


class Elements(Arithmetic):
    """`mask` says for which of the turns side by side the text counts; None where one turn is written."""

    mask: Number | None = None

    def offset(self, node: ast.AST, array: Array, numbers: list[Number]) -> Number:
        """How many elements an index is behind the first one."""
        for each in numbers:
            if LLVM[each.kind] != "i64" or (each.known is not None and each.known < 0):
                self.fail(node, "an index is a whole number that is not negative")
        steps = array.steps
        place = numbers[0] if steps is None else self.arithmetic(node, ast.Mult(), numbers[0], steps[0])
        for k, number in enumerate(numbers[1:], 1):
            if steps is None:
                place = self.arithmetic(node, ast.Mult(), place, array.lengths[k])
            else:
                number = self.arithmetic(node, ast.Mult(), number, steps[k])
            place = self.arithmetic(node, ast.Add(), place, number)
        return place

    def fetch(self, array: Array, at: Number) -> Number:
        """The element so far behind the first one."""
        scalar, wide = array.of, at.wide
        if not wide:
            place = self._place(array, at.name)
            found = self.op(f"load {scalar.stored}, ptr {place}", scalar.kind)
        elif at.first:
            place = self._place(array, at.first)
            found = self.op(f"load {text_type(scalar.stored, True)}, ptr {place}, {_aligned(array)}", scalar.kind, True)
        else:
            found = self._gathered(array, at)
        if scalar.kind == TRUTH:
            zero = "zeroinitializer" if wide else "0"
            return self.op(f"icmp ne {text_type('i8', wide)} {found.name}, {zero}", TRUTH, wide)
        if scalar.kind == INT and scalar.stored != "i64":
            word = "zext" if scalar.name.startswith("U") else "sext"
            return self.op(f"{word} {text_type(scalar.stored, wide)} {found.name} to {text_type('i64', wide)}", INT, wide)
        return found

    def keep(self, array: Array, at: Number, item: Number) -> None:
        """Store an element so far behind the first one."""
        value = self.stored(array.of, self.widened(item) if at.wide else item)
        if not at.wide:
            self.do(f"store {value.typed}, ptr {self._place(array, at.name)}")
            return
        mask = self.mask or ALL
        if at.first:
            place = self._place(array, at.first)
            if mask.known is None:
                before = self.op(f"load {value.type}, ptr {place}, {_aligned(array)}", value.kind, True)
                value = self.op(f"select {mask.typed}, {value.typed}, {before.typed}", value.kind, True)
            self.do(f"store {value.typed}, ptr {place}, {_aligned(array)}")
            return
        for lane in range(WIDTH):
            stored, after = "", ""
            if mask.known is None:
                stored, after = self.label("stored"), self.label("after")
                self.branch(self._one(mask, lane), stored, after)
                self.begin(stored)
            place = self._place(array, self._one(at, lane).name)
            self.do(f"store {self._one(value, lane).typed}, ptr {place}")
            if after:
                self.jump(after)
                self.begin(after)

    def stored(self, scalar: Scalar, item: Number) -> Number:
        """A number as an array of this type holds it."""
        value = self.convert(item, scalar.kind)
        if value.kind == TRUTH:
            return self.op(f"zext {value.typed} to {text_type('i8', value.wide)}", "i8", value.wide)
        if LLVM[value.kind] != scalar.stored:
            return self.op(f"trunc {value.typed} to {text_type(scalar.stored, value.wide)}", scalar.stored, value.wide)
        return value

    def row(self, node: ast.AST, of: Array, index: Number) -> Array:
        """What lies at an index of the first axis, an array with one axis less."""
        if index.wide:
            self.fail(node, "a part of an array is the same one for all turns side by side")
        step = constant(1) if of.steps is None else of.steps[0]
        for each in of.lengths[1:] if of.steps is None else ():
            step = self.arithmetic(node, ast.Mult(), step, each)
        address = self._place(of, self.arithmetic(node, ast.Mult(), index, step).name)
        return Array(of.of, address, of.lengths[1:], None if of.steps is None else of.steps[1:], of.origin)

    def _place(self, array: Array, at: str) -> str:
        return self.op(f"getelementptr {array.of.stored}, ptr {array.address}, i64 {at}", "ptr").name

    def _places(self, array: Array, at: Number) -> Number:
        """The addresses of elements; of zeros that nobody writes to for turns that do not count."""
        places = self.op(f"getelementptr {array.of.stored}, ptr {array.address}, {at.typed}", "ptr", True)
        if self.mask is None or self.mask.known is not None:
            return places
        self.declared["zeros"] = f"@zeros = internal constant [{MOST} x i64] zeroinitializer, align 64"
        other = self.widened(Number("ptr", "@zeros"))
        return self.op(f"select {self.mask.typed}, {places.typed}, {other.typed}", "ptr", True)

    def _one(self, value: Number, lane: int) -> Number:
        return self.op(f"extractelement {value.typed}, i64 {lane}", value.kind)

    def consecutive(self, array: Array, at: Number, count: int) -> tuple[Number, ...]:
        """So many elements that follow each other, a multiple of four, of an array of numbers as they are worked with."""
        if not at.wide:
            offsets = [self.arithmetic(ast.Pass(), ast.Add(), at, constant(k)) for k in range(count)]
            return tuple(self.fetch(array, each) for each in offsets)
        places = self._places(array, at)
        lanes = [self._one(places, lane).name for lane in range(WIDTH)]
        return tuple(each for k in range(0, count, 4) for each in self._four(array, lanes, k))

    def _four(self, array: Array, lanes: list[str], offset: int) -> list[Number]:
        """Four elements each of eight rows, so far behind these addresses, one after the other for all of them."""
        kind, type = array.of.kind, f"<4 x {array.of.stored}>"
        rows = []
        for lane in lanes:
            place = self.op(f"getelementptr {array.of.stored}, ptr {lane}, i64 {offset}", "ptr").name
            rows.append(self.op(f"load {type}, ptr {place}, align {array.of.dtype.itemsize}", kind).name)
        eight = tuple(range(8))
        pairs = [self._mixed(array, rows[k], rows[k + 2], eight, 4) for k in (0, 1, 4, 5)]
        found = []
        for odd in (0, 1):
            order = tuple(e + other for e in range(odd, 8, 2) for other in (0, 8))
            a, b = (self._mixed(array, pairs[k], pairs[k + 1], order) for k in (0, 2))
            found.append([self._mixed(array, a, b, tuple(e + k for e in (0, 1, 4, 5, 8, 9, 12, 13))) for k in (0, 2)])
        return [Number(kind, found[odd][half], wide=True) for half in (0, 1) for odd in (0, 1)]

    def _mixed(self, array: Array, a: str, b: str, order: tuple[int, ...], width: int = WIDTH) -> str:
        """Some elements of two vectors, by their numbers in both."""
        text, one = ", ".join(f"i32 {each}" for each in order), f"<{width} x {array.of.stored}>"
        return self.op(f"shufflevector {one} {a}, {one} {b}, <{len(order)} x i32> <{text}>", array.of.kind).name

    def three(self, node: ast.AST, array: Array, row: Number) -> tuple[Number, ...]:
        """The three elements of a row."""
        if not row.first:
            return tuple(self.fetch(array, each) for each in self._offsets(node, array, row))
        place = self._place(array, self.op(f"mul i64 {row.first}, 3", INT).name)
        kind, parts = array.of.kind, []
        for k in range(3):
            at = self.op(f"getelementptr {array.of.stored}, ptr {place}, i64 {WIDTH * k}", "ptr").name
            parts.append(self.op(f"load {text_type(kind, True)}, ptr {at}, {_aligned(array)}", kind).name)
        found = []
        for column in range(3):
            places = range(column, 3 * WIDTH, 3)
            low = self._mixed(array, parts[0], parts[1], tuple(k if k < 2 * WIDTH else 0 for k in places))
            order = tuple(k - WIDTH if k >= 2 * WIDTH else lane for lane, k in enumerate(places))
            found.append(Number(kind, self._mixed(array, low, parts[2], order), wide=True))
        return tuple(found)

    def put_three(self, node: ast.AST, array: Array, row: Number, items: tuple[Number, ...]) -> None:
        """Store the three elements of a row."""
        if not row.first:
            for at, item in zip(self._offsets(node, array, row), items, strict=True):
                self.keep(array, at, item)
            return
        kind, mask = array.of.kind, self.mask or ALL
        values = [self.widened(self.convert(each, kind)) for each in items]
        if mask.known is None:
            values = [self.select(mask, *each) for each in zip(values, self.three(node, array, row), strict=True)]
        place = self._place(array, self.op(f"mul i64 {row.first}, 3", INT).name)
        for part in range(3):
            places = [divmod(k, 3) for k in range(WIDTH * part, WIDTH * (part + 1))]
            two = self._mixed(array, values[0].name, values[1].name, tuple(lane + WIDTH * (c == 1) for lane, c in places))
            order = tuple(WIDTH + lane if c == 2 else k for k, (lane, c) in enumerate(places))
            there = self.op(f"getelementptr {array.of.stored}, ptr {place}, i64 {WIDTH * part}", "ptr").name
            whole = Number(kind, self._mixed(array, two, values[2].name, order), wide=True)
            self.do(f"store {whole.typed}, ptr {there}, {_aligned(array)}")

    def _offsets(self, node: ast.AST, array: Array, row: Number) -> list[Number]:
        """How far the elements of a row are behind the first one of an array."""
        return [self.offset(node, array, [row, constant(k)]) for k in range(3)]

    def fetch_ahead(self, array: Array, at: Number) -> tuple[()]:
        """Have memory brought near."""
        self.declared["llvm.prefetch.p0"] = "declare void @llvm.prefetch.p0(ptr, i32, i32, i32)"
        for lane in range(WIDTH if at.wide else 1):
            place = self._place(array, self._one(at, lane).name if at.wide else at.name)
            self.do(f"call void @llvm.prefetch.p0(ptr {place}, i32 0, i32 3, i32 1)")
        return ()

    def _gathered(self, array: Array, at: Number) -> Number:
        places = self._places(array, at)
        type = text_type(array.of.stored, True)
        found = "poison"
        for lane in range(WIDTH):
            one = self.op(f"load {array.of.stored}, ptr {self._one(places, lane).name}", array.of.stored)
            found = self.op(f"insertelement {type} {found}, {one.typed}, i64 {lane}", array.of.stored).name
        return Number(array.of.kind, found, wide=True)


def _aligned(array: Array) -> str:
    """How several elements of an array lie: at a multiple of one's size, as one element does, not of what they take together."""
    return f"align {array.of.dtype.itemsize}"
