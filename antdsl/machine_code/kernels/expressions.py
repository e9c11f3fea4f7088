"""Writes expressions of kernels: operators, conditions, indices and calls."""

from __future__ import annotations

import ast
import builtins
from collections.abc import Callable
from itertools import pairwise
from types import ModuleType
from typing import Any, NoReturn

from antdsl.machine_code.kernels.functions import WRITTEN, scratch
from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, LLVM, TRUTH, UNSIGNED, Scalar
from antdsl.machine_code.kernels.values import Array, Item, Number, constant, leaves

_FOLDED: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b, ast.FloorDiv: lambda a, b: a // b,
    ast.Mod: lambda a, b: a % b, ast.LShift: lambda a, b: a << b, ast.RShift: lambda a, b: a >> b, ast.BitAnd: lambda a, b: a & b,
    ast.BitOr: lambda a, b: a | b, ast.BitXor: lambda a, b: a ^ b,
}  # fmt: skip
_FLOATS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_WHOLES = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.LShift: "shl", ast.BitAnd: "and", ast.BitOr: "or", ast.BitXor: "xor",
}  # fmt: skip
_COMPARED = {ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge", ast.Eq: "eq", ast.NotEq: "ne"}


class NotInSubset(Exception):
    """A kernel's text has what kernels cannot have, which is our mistake; the message has the place."""


class Text:
    """The text of one function as it is written."""

    def __init__(self, place: str) -> None:
        self.place = place
        self.allocas: list[str] = []
        self.lines: list[str] = []
        self.declared: dict[str, str] = {}
        self._numbers = 0

    def name(self, stem: str = "v") -> str:
        self._numbers += 1
        return f"%{stem}{self._numbers}"

    def op(self, text: str, kind: str) -> Number:
        name = self.name()
        self.lines.append(f"  {name} = {text}")
        return Number(kind, name)

    def do(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def slot(self, kind: str) -> str:
        name = self.name("a")
        self.allocas.append(f"  {name} = alloca {LLVM.get(kind, kind)}")
        return name

    def label(self, stem: str) -> str:
        self._numbers += 1
        return f"{stem}{self._numbers}"

    def begin(self, label: str) -> None:
        self.lines.append(f"{label}:")

    def jump(self, label: str) -> None:
        self.do(f"br label %{label}")

    def branch(self, condition: Number, then: str, other: str) -> None:
        self.do(f"br {condition.typed}, label %{then}, label %{other}")

    def intrinsic(self, stem: str, kind: str, *values: Number) -> Number:
        suffix = "f64" if kind == DOUBLE else "f32"
        name = f"llvm.{stem}.{suffix}"
        self.declared[name] = f"declare {LLVM[kind]} @{name}({', '.join([LLVM[kind]] * len(values))})"
        return self.op(f"call {LLVM[kind]} @{name}({', '.join(each.typed for each in values)})", kind)

    def fail(self, node: ast.AST, why: str) -> NoReturn:
        raise NotInSubset(f"{self.place}, line {getattr(node, 'lineno', 0)} of the function: {why}")


class Arithmetic(Text):
    """Operations on numbers."""

    def convert(self, value: Number, kind: str) -> Number:
        """As a cast of NumPy does; of a float that no whole number of 64 bits is near to, some number."""
        if value.kind == kind:
            return value
        if value.known is not None and kind in (DOUBLE, INT, UNSIGNED) and value.kind != DOUBLE:
            found = constant(float(value.known) if kind == DOUBLE else int(value.known))
            return Number(kind, found.name, found.known)
        source, target = LLVM[value.kind], LLVM[kind]
        if kind == TRUTH:
            zero = "0" if source == "i64" else "0.0"
            return self.op(f"{'icmp ne' if source == 'i64' else 'fcmp une'} {value.typed}, {zero}", TRUTH)
        if value.kind == TRUTH:
            return self.op(f"{'zext' if target == 'i64' else 'uitofp'} {value.typed} to {target}", kind)
        if source == target:
            return Number(kind, value.name)
        if source == "i64":
            return self.op(f"{'uitofp' if value.kind == UNSIGNED else 'sitofp'} {value.typed} to {target}", kind)
        if target != "i64":
            return self.op(f"{'fpext' if kind == DOUBLE else 'fptrunc'} {value.typed} to {target}", kind)
        name = f"llvm.fpto{'u' if kind == UNSIGNED else 's'}i.sat.i64.{'f64' if value.kind == DOUBLE else 'f32'}"
        self.declared[name] = f"declare i64 @{name}({source})"
        return self.op(f"call i64 @{name}({value.typed})", kind)

    def floating(self, value: Number) -> Number:
        return value if value.kind in (DOUBLE, FLOAT) else self.convert(value, DOUBLE)

    def paired(self, a: Number, b: Number) -> tuple[Number, Number]:
        """Two numbers of one kind: that which NumPy gives to what becomes of two arrays of theirs."""
        kinds = {a.kind, b.kind}
        if len(kinds) == 1:
            return (a, b) if a.kind != TRUTH else (self.convert(a, INT), self.convert(b, INT))
        if kinds <= {INT, UNSIGNED, TRUTH}:
            kind = UNSIGNED if UNSIGNED in kinds and (a.known is not None or b.known is not None) else INT
            if UNSIGNED in kinds and kind == INT:
                raise NotInSubset(f"{self.place}: a signed and an unsigned whole number")
        else:
            kind = DOUBLE if kinds != {FLOAT, TRUTH} else FLOAT
        return self.convert(a, kind), self.convert(b, kind)

    def arithmetic(self, node: ast.AST, operator: ast.operator, a: Number, b: Number) -> Number:
        word = type(operator)
        if a.known is not None and b.known is not None and word in _FOLDED and DOUBLE not in (a.kind, b.kind):
            found = constant(_FOLDED[word](int(a.known), int(b.known)))
            return Number(UNSIGNED, found.name, found.known) if UNSIGNED in (a.kind, b.kind) else found
        if a.kind == b.kind == TRUTH and word in (ast.BitAnd, ast.BitOr, ast.BitXor):
            return self.op(f"{_WHOLES[word]} {a.typed}, {b.name}", TRUTH)
        if word is ast.Div:
            a, b = self.floating(a), self.floating(b)
        a, b = self.paired(a, b)
        if a.kind in (DOUBLE, FLOAT):
            if word not in _FLOATS:
                self.fail(node, "no such operation of floats")
            return self.op(f"{_FLOATS[word]} {a.typed}, {b.name}", a.kind)
        if word is ast.RShift:
            return self.op(f"{'lshr' if a.kind == UNSIGNED else 'ashr'} {a.typed}, {b.name}", a.kind)
        if word in _WHOLES:
            return self.op(f"{_WHOLES[word]} {a.typed}, {b.name}", a.kind)
        if word not in (ast.FloorDiv, ast.Mod):
            self.fail(node, "no such operation of whole numbers")
        if a.kind == UNSIGNED:
            return self.op(f"{'udiv' if word is ast.FloorDiv else 'urem'} {a.typed}, {b.name}", a.kind)
        rest = self.op(f"srem {a.typed}, {b.name}", INT)
        other = self.op(f"icmp slt i64 {self.op(f'xor {rest.typed}, {b.name}', INT).name}, 0", TRUTH)
        down = self.op(f"and i1 {other.name}, {self.op(f'icmp ne {rest.typed}, 0', TRUTH).name}", TRUTH)
        if word is ast.Mod:
            return self.op(f"add {rest.typed}, {self.select(down, b, constant(0)).name}", INT)
        quotient = self.op(f"sdiv {a.typed}, {b.name}", INT)
        return self.op(f"sub {quotient.typed}, {self.convert(down, INT).name}", INT)

    def negated(self, a: Number) -> Number:
        if a.known is not None:
            return constant(-a.known)
        if a.kind in (DOUBLE, FLOAT):
            return self.op(f"fneg {a.typed}", a.kind)
        return self.op(f"sub i64 0, {self.convert(a, INT).name}", INT)

    def compare(self, word: str, a: Number, b: Number) -> Number:
        if a.known is not None and b.known is not None:
            x, y = a.known, b.known
            held = {"lt": x < y, "le": x <= y, "gt": x > y, "ge": x >= y, "eq": x == y, "ne": x != y}
            return constant(held[word])
        a, b = self.paired(a, b)
        if a.kind in (DOUBLE, FLOAT):
            return self.op(f"fcmp {'u' if word == 'ne' else 'o'}{word} {a.typed}, {b.name}", TRUTH)
        sign = "" if word in ("eq", "ne") else "u" if a.kind == UNSIGNED else "s"
        return self.op(f"icmp {sign}{word} {a.typed}, {b.name}", TRUTH)

    def select(self, condition: Number, then: Number, other: Number) -> Number:
        if condition.known is not None:
            return then if condition.known else other
        if then.kind != other.kind:
            then, other = self.paired(then, other)
        return self.op(f"select {condition.typed}, {then.typed}, {other.typed}", then.kind)


class Expressions(Arithmetic):
    """Expressions of Python; `variables` has what a name stands for, `world` the names of the function's module."""

    world: dict[str, Any]

    def read(self, name: str) -> Item:
        raise NotImplementedError

    def called(self, node: ast.Call, function: Any, inputs: list[Item]) -> Item:
        raise NotImplementedError

    def number(self, node: ast.expr) -> Number:
        found = self.value(node)
        if not isinstance(found, Number):
            self.fail(node, "a number is wanted here")
        return found

    def truth(self, node: ast.expr) -> Number:
        value = self.number(node)
        return constant(bool(value.known)) if value.known is not None else self.convert(value, TRUTH)

    def value(self, node: ast.expr) -> Item:
        match node:
            case ast.Constant(value=bool() | int() | float() as known):
                return constant(known)
            case ast.Name(id=name):
                return self.read(name)
            case ast.Tuple(elts=parts):
                return tuple(self.value(each) for each in parts)
            case ast.BinOp(left=left, op=operator, right=right):
                return self.arithmetic(node, operator, self.number(left), self.number(right))
            case ast.UnaryOp(op=operator, operand=operand):
                return self._unary(node, operator, operand)
            case ast.Compare(left=left, ops=operators, comparators=others):
                return self._compared([left, *others], operators)
            case ast.BoolOp(op=operator, values=parts):
                return self._both(isinstance(operator, ast.And), parts)
            case ast.IfExp(test=test, body=then, orelse=other):
                return self._chosen(node, test, then, other)
            case ast.Subscript(value=of, slice=index):
                return self._indexed(node, self.value(of), index)
            case ast.Attribute(value=of, attr=attribute):
                return self._attribute(node, of, attribute)
            case ast.Call(func=function, args=arguments):
                return self._called(node, function, arguments)
        self.fail(node, f"`{ast.unparse(node)}` is not in the subset")

    def _unary(self, node: ast.expr, operator: ast.unaryop, operand: ast.expr) -> Number:
        if isinstance(operator, ast.Not):
            value = self.truth(operand)
            return constant(not value.known) if value.known is not None else self.op(f"xor {value.typed}, true", TRUTH)
        value = self.number(operand)
        if isinstance(operator, ast.USub):
            return self.negated(value)
        if isinstance(operator, ast.Invert):
            return self.op(f"xor {value.typed}, {'true' if value.kind == TRUTH else '-1'}", value.kind)
        self.fail(node, "no such operator")

    def _compared(self, parts: list[ast.expr], operators: list[ast.cmpop]) -> Number:
        values = [self.number(part) for part in parts]
        found = None
        for (a, b), operator in zip(pairwise(values), operators, strict=True):
            if type(operator) not in _COMPARED:
                self.fail(parts[0], "no such comparison")
            held = self.compare(_COMPARED[type(operator)], a, b)
            found = held if found is None else self.op(f"and {found.typed}, {held.name}", TRUTH)
        assert found is not None
        return found

    def _both(self, every: bool, parts: list[ast.expr]) -> Number:
        """What stands behind is asked only where it counts, as in Python."""
        first = self.truth(parts[0])
        if len(parts) == 1 or (first.known is not None and bool(first.known) != every):
            return first
        if first.known is not None:
            return self._both(every, parts[1:])
        place, more, done = self.slot(TRUTH), self.label("more"), self.label("both")
        self.do(f"store {first.typed}, ptr {place}")
        self.branch(first, *((more, done) if every else (done, more)))
        self.begin(more)
        self.do(f"store {self._both(every, parts[1:]).typed}, ptr {place}")
        self.jump(done)
        self.begin(done)
        return self.op(f"load i1, ptr {place}", TRUTH)

    def _chosen(self, node: ast.expr, test: ast.expr, then: ast.expr, other: ast.expr) -> Item:
        condition = self.truth(test)
        if condition.known is not None:
            return self.value(then if condition.known else other)
        yes, no, done = self.label("yes"), self.label("no"), self.label("chosen")
        self.branch(condition, yes, no)
        self.begin(yes)
        first = self.value(then)
        before = len(self.lines)
        self.begin(no)
        second = self.value(other)
        kinds = [a.kind if a.kind == b.kind else self._common(a, b) for a, b in zip(leaves(first), leaves(second), strict=True)]
        places = [self.slot(kind) for kind in kinds]
        self._stored(second, kinds, places)
        self.jump(done)
        rest, self.lines = self.lines[before:], self.lines[:before]
        self._stored(first, kinds, places)
        self.jump(done)
        self.lines += rest
        self.begin(done)
        loaded = iter(
            Number(kind, self.op(f"load {LLVM[kind]}, ptr {place}", kind).name) for kind, place in zip(kinds, places, strict=True)
        )

        def again(item: Item) -> Item:
            if isinstance(item, Array):
                self.fail(node, "arrays cannot be chosen between")
            return tuple(again(each) for each in item) if isinstance(item, tuple) else next(loaded)

        return again(first)

    def _common(self, a: Number, b: Number) -> str:
        kinds = {a.kind, b.kind}
        return DOUBLE if DOUBLE in kinds else FLOAT if kinds == {FLOAT, TRUTH} else DOUBLE if FLOAT in kinds else INT

    def _stored(self, item: Item, kinds: list[str], places: list[str]) -> None:
        for number, kind, place in zip(leaves(item), kinds, places, strict=True):
            self.do(f"store {self.convert(number, kind).typed}, ptr {place}")

    def _attribute(self, node: ast.expr, of: ast.expr, attribute: str) -> Item:
        if isinstance(of, ast.Name) and isinstance(self.world.get(of.id), ModuleType):
            return constant(getattr(self.world[of.id], attribute))
        value = self.value(of)
        if isinstance(value, Array) and attribute == "shape":
            return value.lengths
        if isinstance(value, Array) and attribute == "size":
            found = value.lengths[0]
            for each in value.lengths[1:]:
                found = self.op(f"mul {found.typed}, {each.name}", INT)
            return found
        self.fail(node, f"no `{attribute}`")

    def element(self, node: ast.AST, array: Array, index: ast.expr) -> str:
        """The address of an element."""
        parts = index.elts if isinstance(index, ast.Tuple) else [index]
        numbers = [self.number(part) for part in parts]
        if len(numbers) != len(array.lengths):
            self.fail(node, "an index for each axis is wanted")
        for each in numbers:
            if LLVM[each.kind] != "i64" or (each.known is not None and each.known < 0):
                self.fail(node, "an index is a whole number that is not negative")
        if array.steps is not None:
            terms = [self.op(f"mul {a.typed}, {b.name}", INT) for a, b in zip(numbers, array.steps, strict=True)]
            place = terms[0]
            for term in terms[1:]:
                place = self.op(f"add {place.typed}, {term.name}", INT)
        else:
            place = numbers[0]
            for number, length in zip(numbers[1:], array.lengths[1:], strict=True):
                place = self.op(f"add i64 {self.op(f'mul {place.typed}, {length.name}', INT).name}, {number.name}", INT)
        return self.op(f"getelementptr {array.of.stored}, ptr {array.address}, i64 {place.name}", "ptr").name

    def _indexed(self, node: ast.expr, of: Item, index: ast.expr) -> Item:
        if isinstance(of, tuple) and isinstance(index, ast.Slice):
            return of[slice(*(self._of_text(node, end) for end in (index.lower, index.upper, index.step)))]
        if isinstance(of, tuple):
            at = self.number(index)
            if at.known is None:
                self.fail(node, "a tuple's index stands in the text")
            return of[int(at.known)]
        if not isinstance(of, Array):
            self.fail(node, "only arrays and tuples have elements")
        if not isinstance(index, ast.Tuple) and len(of.lengths) > 1:
            return self._row(node, of, self.number(index))
        place, scalar = self.element(node, of, index), of.of
        found = self.op(f"load {scalar.stored}, ptr {place}{self.access()}", scalar.kind)
        if scalar.kind == TRUTH:
            return self.op(f"icmp ne i8 {found.name}, 0", TRUTH)
        if scalar.kind == INT and scalar.stored != "i64":
            word = "zext" if scalar.name.startswith("U") else "sext"
            return self.op(f"{word} {scalar.stored} {found.name} to i64", INT)
        return found

    def _row(self, node: ast.AST, of: Array, index: Number) -> Array:
        """What lies at an index of the first axis, an array with one axis less."""
        step = constant(1) if of.steps is None else of.steps[0]
        for each in of.lengths[1:] if of.steps is None else ():
            step = self.arithmetic(node, ast.Mult(), step, each)
        place = self.arithmetic(node, ast.Mult(), index, step)
        address = self.op(f"getelementptr {of.of.stored}, ptr {of.address}, i64 {place.name}", "ptr").name
        return Array(of.of, address, of.lengths[1:], None if of.steps is None else of.steps[1:], of.origin)

    def _of_text(self, node: ast.AST, number: ast.expr | None) -> int | None:
        if number is None:
            return None
        known = self.number(number).known
        if not isinstance(known, int):
            self.fail(node, "whole numbers of the text are wanted here")
        return known

    def access(self) -> str:
        """What is written behind a load or a store."""
        return ""

    def _called(self, node: ast.Call, function: ast.expr, arguments: list[ast.expr]) -> Item:
        if node.keywords:
            self.fail(node, "arguments have no names here")
        known = self.known(node, function)
        if known is len:
            value = self.value(arguments[0])
            return value.lengths[0] if isinstance(value, Array) else constant(len(value))
        if known is scratch:
            count, dtype = self.number(arguments[0]), self.known(node, arguments[1])
            if count.known is None or not isinstance(dtype, Scalar):
                self.fail(node, "scratch(COUNT, TYPE) with a count of the text")
            name = self.name("s")
            self.allocas.append(f"  {name} = alloca [{count.known} x {dtype.stored}], align 32")
            return Array(dtype, name, (count,))
        inputs = [self.value(each) for each in arguments]
        try:
            written = WRITTEN.get(known)
        except TypeError:
            written = None
        if written is not None:
            if not all(isinstance(each, Number) for each in inputs):
                self.fail(node, "numbers are wanted here")
            return written(self, *inputs)
        return self.called(node, known, inputs)

    def known(self, node: ast.AST, name: ast.expr) -> Any:
        """What a name of the module, of a package in it or of Python stands for."""
        if isinstance(name, ast.Attribute) and isinstance(name.value, ast.Name):
            package = self.world.get(name.value.id)
            if isinstance(package, ModuleType):
                return getattr(package, name.attr)
        if isinstance(name, ast.Name):
            if name.id in self.world:
                return self.world[name.id]
            if hasattr(builtins, name.id):
                return getattr(builtins, name.id)
        self.fail(node, f"`{ast.unparse(name)}` is not known")
