"""Writes operations on numbers, of one turn of a loop or of several side by side."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import NoReturn

import numpy as np

from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, LLVM, TRUTH, UNSIGNED
from antdsl.machine_code.kernels.values import WIDTH, Number, constant, text_type

_FOLDED: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b, ast.FloorDiv: lambda a, b: a // b,
    ast.Mod: lambda a, b: a % b, ast.LShift: lambda a, b: a << b, ast.RShift: lambda a, b: a >> b, ast.BitAnd: lambda a, b: a & b,
    ast.BitOr: lambda a, b: a | b, ast.BitXor: lambda a, b: a ^ b,
}  # fmt: skip
_FLOATS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_WHOLES = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.LShift: "shl", ast.BitAnd: "and", ast.BitOr: "or", ast.BitXor: "xor",
}  # fmt: skip


class NotInSubset(Exception):
    """A kernel's text has what kernels cannot have, which is our mistake; the message has the place."""


class Text:
    """The text of one function as it is written."""

    def __init__(self, place: str) -> None:
        self.place = place
        self.node: ast.AST = ast.Pass()  # the statement that is written
        self.allocas: list[str] = []
        self.lines: list[str] = []
        self.declared: dict[str, str] = {}
        self._numbers = 0

    def name(self, stem: str = "v") -> str:
        self._numbers += 1
        return f"%{stem}{self._numbers}"

    def op(self, text: str, kind: str, wide: bool = False) -> Number:
        name = self.name()
        self.lines.append(f"  {name} = {text}")
        return Number(kind, name, wide=wide)

    def do(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def slot(self, kind: str, wide: bool = False) -> str:
        name = self.name("a")
        self.allocas.append(f"  {name} = alloca {text_type(kind, wide)}")
        return name

    def load(self, place: str, kind: str, wide: bool = False) -> Number:
        """What lies on the stack."""
        return self.op(f"load {text_type(kind, wide)}, ptr {place}", kind, wide)

    def put(self, place: str, value: Number) -> None:
        self.do(f"store {value.typed}, ptr {place}")

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
        wide = values[0].wide
        name = f"llvm.{stem}.{_suffix(kind, wide)}"
        type = text_type(kind, wide)
        self.declared[name] = f"declare {type} @{name}({', '.join([type] * len(values))})"
        return self.op(f"call {type} @{name}({', '.join(each.typed for each in values)})", kind, wide)

    def fail(self, node: ast.AST, why: str) -> NoReturn:
        raise NotInSubset(f"{self.place}, line {getattr(node, 'lineno', 0)} of the function: {why}")


class Arithmetic(Text):
    """Operations on numbers."""

    def convert(self, value: Number, kind: str) -> Number:
        """As a cast of NumPy does; of a float that no whole number of 64 bits is near to, some number."""
        if value.kind == kind:
            return value
        if value.known is not None and not value.wide and kind in (DOUBLE, INT, UNSIGNED) and value.kind != DOUBLE:
            found = constant(float(value.known) if kind == DOUBLE else int(value.known))
            return Number(kind, found.name, found.known)
        source, target, wide = LLVM[value.kind], LLVM[kind], value.wide
        type = text_type(kind, wide)
        if kind == TRUTH:
            zero = "zeroinitializer" if wide else "0" if source == "i64" else "0.0"
            return self.op(f"{'icmp ne' if source == 'i64' else 'fcmp une'} {value.typed}, {zero}", TRUTH, wide)
        if value.kind == TRUTH:
            return self.op(f"{'zext' if target == 'i64' else 'uitofp'} {value.typed} to {type}", kind, wide)
        if source == target:
            return Number(kind, value.name, wide=wide)
        if source == "i64":
            return self.op(f"{'uitofp' if value.kind == UNSIGNED else 'sitofp'} {value.typed} to {type}", kind, wide)
        if target != "i64":
            return self.op(f"{'fpext' if kind == DOUBLE else 'fptrunc'} {value.typed} to {type}", kind, wide)
        name = f"llvm.fpto{'u' if kind == UNSIGNED else 's'}i.sat.{_suffix(kind, wide)}.{_suffix(value.kind, wide)}"
        self.declared[name] = f"declare {type} @{name}({value.type})"
        return self.op(f"call {type} @{name}({value.typed})", kind, wide)

    def widened(self, value: Number) -> Number:
        """The same for each of the turns side by side."""
        if value.wide:
            return value
        if value.name[0] not in "%@":
            return Number(value.kind, f"splat ({value.type} {value.name})", value.known, True)
        type = text_type(value.kind, True)
        first = self.op(f"insertelement {type} poison, {value.typed}, i64 0", value.kind, True)
        return self.op(f"shufflevector {first.typed}, {type} poison, <{WIDTH} x i32> zeroinitializer", value.kind, True)

    def alike(self, a: Number, b: Number) -> tuple[Number, Number]:
        """Both wide if one is."""
        return (self.widened(a), self.widened(b)) if a.wide or b.wide else (a, b)

    def floating(self, value: Number) -> Number:
        return value if value.kind in (DOUBLE, FLOAT) else self.convert(value, DOUBLE)

    def paired(self, a: Number, b: Number) -> tuple[Number, Number]:
        """Two numbers of one kind, as NumPy has it: a number of the text takes the type of the other one. NotInSubset for a
        float32 and a number of another type, or one of the text that float32 does not have."""
        if FLOAT in (a.kind, b.kind) and TRUTH not in (a.kind, b.kind):
            a, b = self._as_float32(a), self._as_float32(b)
        kinds = {a.kind, b.kind}
        a, b = self.alike(a, b)
        if len(kinds) == 1:
            return (a, b) if a.kind != TRUTH else (self.convert(a, INT), self.convert(b, INT))
        if kinds <= {INT, UNSIGNED, TRUTH}:
            kind = UNSIGNED if UNSIGNED in kinds and (a.known is not None or b.known is not None) else INT
            if UNSIGNED in kinds and kind == INT:
                self.fail(self.node, "a signed and an unsigned whole number")
        else:
            kind = FLOAT if kinds == {FLOAT, TRUTH} else DOUBLE
        return self.convert(a, kind), self.convert(b, kind)

    def _as_float32(self, value: Number) -> Number:
        if value.kind == FLOAT:
            return value
        if value.known is None:
            self.fail(self.node, "a float32 and a number of another type: convert one with `np.float64` or `np.float32`")
        single = np.float32(value.known)
        if float(single) != value.known and value.known == value.known:
            self.fail(self.node, f"float32 has no {value.known}: write `np.float32({value.known})`")
        found = constant(single)
        return self.widened(found) if value.wide else found

    def arithmetic(self, node: ast.AST, operator: ast.operator, a: Number, b: Number) -> Number:
        word = type(operator)
        folded = not (a.wide or b.wide)
        if folded and a.known is not None and b.known is not None and word in _FOLDED and DOUBLE not in (a.kind, b.kind):
            found = constant(_FOLDED[word](int(a.known), int(b.known)))
            return Number(UNSIGNED, found.name, found.known) if UNSIGNED in (a.kind, b.kind) else found
        if a.kind == b.kind == TRUTH and word in (ast.BitAnd, ast.BitOr, ast.BitXor):
            a, b = self.alike(a, b)
            return self.op(f"{_WHOLES[word]} {a.typed}, {b.name}", TRUTH, a.wide)
        if word is ast.Div:
            a, b = self.floating(a), self.floating(b)
        first = self._first(word, a, b)
        a, b = self.paired(a, b)
        if a.kind in (DOUBLE, FLOAT):
            if word not in _FLOATS:
                self.fail(node, "no such operation of floats")
            return self.op(f"{_FLOATS[word]} {a.typed}, {b.name}", a.kind, a.wide)
        if word is ast.RShift:
            return self.op(f"{'lshr' if a.kind == UNSIGNED else 'ashr'} {a.typed}, {b.name}", a.kind, a.wide)
        if word in _WHOLES:
            found = self.op(f"{_WHOLES[word]} {a.typed}, {b.name}", a.kind, a.wide)
            return Number(found.kind, found.name, None, found.wide, first)
        if word not in (ast.FloorDiv, ast.Mod):
            self.fail(node, "no such operation of whole numbers")
        if b.wide and b.known is None:  # turns for which it does not count may have 0
            b = self.select(self.compare("eq", b, constant(0)), constant(1), b)
        if a.kind == UNSIGNED:
            return self.op(f"{'udiv' if word is ast.FloorDiv else 'urem'} {a.typed}, {b.name}", a.kind, a.wide)
        rest = self.op(f"srem {a.typed}, {b.name}", INT, a.wide)
        other = self.compare("lt", self.op(f"xor {rest.typed}, {b.name}", INT, a.wide), constant(0))
        down = self.op(f"and {other.typed}, {self.compare('ne', rest, constant(0)).name}", TRUTH, a.wide)
        if word is ast.Mod:
            return self.op(f"add {rest.typed}, {self.select(down, b, constant(0)).name}", INT, a.wide)
        quotient = self.op(f"sdiv {a.typed}, {b.name}", INT, a.wide)
        return self.op(f"sub {quotient.typed}, {self.convert(down, INT).name}", INT, a.wide)

    def _first(self, word: type[ast.operator], a: Number, b: Number) -> str:
        """The first of a sum of numbers that each are one more than the turn before, and one that is the same for all."""
        if word not in (ast.Add, ast.Sub) or not (a.first or b.first) or (b.first and (a.wide or word is ast.Sub)):
            return ""
        if a.first and b.wide:
            return ""
        one, other = (a.first, b.name) if a.first else (a.name, b.first)
        return self.op(f"{_WHOLES[word]} i64 {one}, {other}", INT).name

    def negated(self, a: Number) -> Number:
        if a.known is not None and not a.wide:
            return constant(-a.known)
        if a.kind in (DOUBLE, FLOAT):
            return self.op(f"fneg {a.typed}", a.kind, a.wide)
        a = self.convert(a, INT)
        return self.op(f"sub {a.type} {'zeroinitializer' if a.wide else 0}, {a.name}", INT, a.wide)

    def compare(self, word: str, a: Number, b: Number) -> Number:
        if a.known is not None and b.known is not None and not (a.wide or b.wide):
            x, y = a.known, b.known
            held = {"lt": x < y, "le": x <= y, "gt": x > y, "ge": x >= y, "eq": x == y, "ne": x != y}
            return constant(held[word])
        a, b = self.paired(a, b)
        if a.kind in (DOUBLE, FLOAT):
            return self.op(f"fcmp {'u' if word == 'ne' else 'o'}{word} {a.typed}, {b.name}", TRUTH, a.wide)
        sign = "" if word in ("eq", "ne") else "u" if a.kind == UNSIGNED else "s"
        return self.op(f"icmp {sign}{word} {a.typed}, {b.name}", TRUTH, a.wide)

    def select(self, condition: Number, then: Number, other: Number) -> Number:
        if condition.known is not None:
            return then if condition.known else other
        then, other = self.paired(then, other) if then.kind != other.kind else self.alike(then, other)
        if condition.wide:
            then, other = self.widened(then), self.widened(other)
        return self.op(f"select {condition.typed}, {then.typed}, {other.typed}", then.kind, then.wide)


def _suffix(kind: str, wide: bool) -> str:
    """What stands behind the name of an intrinsic function."""
    return f"{f'v{WIDTH}' if wide else ''}{ {DOUBLE: 'f64', FLOAT: 'f32'}.get(kind, 'i64') }"
