"""Writes reads and stores of arrays' elements: of one turn of a loop, or of several side by side.

Elements of turns side by side that follow each other in memory are read and stored at once, others one by one; what counts for
some of the turns alone is read elsewhere for the others, and not stored."""

from __future__ import annotations

import ast

from antdsl.machine_code.kernels.arithmetic import Arithmetic
from antdsl.machine_code.kernels.types import INT, LLVM, TRUTH, Scalar
from antdsl.machine_code.kernels.values import WIDTH, Array, Number, constant, text_type

ALL = Number(TRUTH, "splat (i1 true)", True, True)  # all turns side by side


class Elements(Arithmetic):
    """`mask` says for which of the turns side by side the text counts; None where one turn is written."""

    mask: Number | None = None
    _elsewhere = ""  # room that is read for turns that do not count

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
        """The addresses of elements; somewhere else for turns that do not count."""
        places = self.op(f"getelementptr {array.of.stored}, ptr {array.address}, {at.typed}", "ptr", True)
        if self.mask is None or self.mask.known is not None:
            return places
        if not self._elsewhere:
            self._elsewhere = self.name("z")
            self.allocas.append(f"  {self._elsewhere} = alloca <4 x i64>")
            self.allocas.append(f"  store <4 x i64> zeroinitializer, ptr {self._elsewhere}")
        other = self.widened(Number("ptr", self._elsewhere))
        return self.op(f"select {self.mask.typed}, {places.typed}, {other.typed}", "ptr", True)

    def _one(self, value: Number, lane: int) -> Number:
        return self.op(f"extractelement {value.typed}, i64 {lane}", value.kind)

    def four(self, array: Array, at: Number) -> tuple[Number, ...]:
        """Four elements that follow each other, of an array of numbers as they are worked with."""
        kind = array.of.kind
        if not at.wide:
            offsets = [self.arithmetic(ast.Pass(), ast.Add(), at, constant(k)) for k in range(4)]
            return tuple(self.fetch(array, each) for each in offsets)
        places, type = self._places(array, at), f"<4 x {array.of.stored}>"
        rows = [self.op(f"load {type}, ptr {self._one(places, lane).name}, align 8", kind).name for lane in range(WIDTH)]

        def mixed(a: str, b: str, order: tuple[int, ...], width: int = 4) -> str:
            text = ", ".join(f"i32 {each}" for each in order)
            one = f"<{width} x {array.of.stored}>"
            return self.op(f"shufflevector {one} {a}, {one} {b}, <{len(order)} x i32> <{text}>", kind).name

        parts = []
        for first in range(0, WIDTH, 4):
            a, b, c, d = rows[first : first + 4]
            even, odd = (0, 4, 2, 6), (1, 5, 3, 7)
            pairs = (mixed(a, b, even), mixed(c, d, even)), (mixed(a, b, odd), mixed(c, d, odd))
            low, high = (0, 1, 4, 5), (2, 3, 6, 7)
            parts.append([mixed(*pair, half) for half in (low, high) for pair in pairs])
        if WIDTH == 4:
            return tuple(Number(kind, each, wide=True) for each in parts[0])
        order = tuple(range(8))
        return tuple(Number(kind, mixed(a, b, order), wide=True) for a, b in zip(*parts, strict=True))

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
