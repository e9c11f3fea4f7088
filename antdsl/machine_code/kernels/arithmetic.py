"""Emits the instructions of arithmetic, either for one iteration of a loop or for several in SIMD lanes."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

import numpy as np

from antdsl.machine_code.kernels.types import DOUBLE, FLOAT, INT, LLVM_TYPE_BY_KIND, TRUTH, UNSIGNED
from antdsl.machine_code.kernels.values import Number, make_literal_number
from antdsl.machine_code.kernels.vectors import VectorBuilder
from antdsl.machine_code.number_kinds import LANE_COUNT

_PYTHON_OPERATORS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: lambda a, b: a + b, ast.Sub: lambda a, b: a - b, ast.Mult: lambda a, b: a * b, ast.FloorDiv: lambda a, b: a // b,
    ast.Mod: lambda a, b: a % b, ast.LShift: lambda a, b: a << b, ast.RShift: lambda a, b: a >> b, ast.BitAnd: lambda a, b: a & b,
    ast.BitOr: lambda a, b: a | b, ast.BitXor: lambda a, b: a ^ b,
}  # fmt: skip
_FLOAT_OPCODES = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
_INTEGER_OPCODES = {ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.BitAnd: "and", ast.BitOr: "or", ast.BitXor: "xor"}
_SHIFT_OPERATORS = (ast.LShift, ast.RShift)
_INT64_RANGE = range(-(1 << 63), 1 << 63)


class ArithmeticEmitter(VectorBuilder[Number]):
    """Emits arithmetic instructions.

    `mask`: the iterations for which the current code has an effect; None if the code is for one iteration. `reached_mask`: the
    same object as `mask` if a branch skips the current code when no iteration is in the mask."""

    mask: Number | None = None  # the active iterations; None if code for one iteration is written
    # a condition that is true if the mask holds for at least one iteration, while `mask` is the mask
    reached_mask: Number | None = None

    def emit_any_lane(self, mask: Number) -> Number:
        """Emit a test of whether a mask is true in at least one lane. Return the result of the test as a condition."""
        bits = self.op("lanes", f"i{LANE_COUNT}", mask, lanes=1)
        return self.op("ne", TRUTH, bits, Number(bits.kind, "0"))

    @property
    def is_always_reached(self) -> bool:
        """Return whether the current code certainly runs for at least one iteration."""
        return self.mask is None or self.mask.literal_value is not None or self.mask is self.reached_mask

    def get_active_mask(self) -> Number | None:
        """Return the condition that the current code has an effect for at least one iteration; None if this is always so."""
        return None if self.mask is None or self.is_always_reached else self.emit_any_lane(self.mask)

    def named_number(self, kind: str, name: str, lanes: int = 1, literal_value: Any = None) -> Number:
        return Number(kind, name, literal_value, lanes)

    def convert(self, value: Number, kind: str) -> Number:
        """Convert a number to `kind` as a NumPy cast does, except that floats outside an integer's range saturate and NaN
        becomes 0."""
        if value.kind == kind:
            return value
        if (
            value.literal_value is not None
            and not value.has_several_lanes
            and kind in (DOUBLE, INT, UNSIGNED)
            and value.kind != DOUBLE
        ):
            literal = make_literal_number(float(value.literal_value) if kind == DOUBLE else int(value.literal_value))
            return Number(
                kind,
                literal.name,
                literal.literal_value if kind == DOUBLE else wrap_to_integer_kind(int(value.literal_value), kind),
            )
        source, target = value.lane_type, LLVM_TYPE_BY_KIND[kind]
        if kind == TRUTH:
            zero = Number(
                value.kind, "zeroinitializer" if value.has_several_lanes else "0" if source == "i64" else "0.0", lanes=value.lanes
            )
            return self.op("ne" if source == "i64" else "fne", TRUTH, value, zero)
        if value.kind == TRUTH:
            return self.op("zext" if target == "i64" else "uitofp", kind, value)
        if source == target:
            known = None if value.literal_value is None else wrap_to_integer_kind(int(value.literal_value), kind)
            return Number(kind, value.name, known, value.lanes)
        if source == "i64":
            return self.op("uitofp" if value.kind == UNSIGNED else "sitofp", kind, value)
        if target != "i64":
            return self.op("fpext" if kind == DOUBLE else "fptrunc", kind, value)
        return self.op("fptoui" if kind == UNSIGNED else "fptosi", kind, value)

    def match_lanes(self, a: Number, b: Number) -> tuple[Number, Number]:
        """Return `a` and `b`. If one of them has several lanes, the other is broadcast to all lanes."""
        return (self.broadcast(a), self.broadcast(b)) if a.has_several_lanes or b.has_several_lanes else (a, b)

    def to_float(self, value: Number) -> Number:
        return value if value.kind in (DOUBLE, FLOAT) else self.convert(value, DOUBLE)

    def match_kinds(self, a: Number, b: Number) -> tuple[Number, Number]:
        """Convert two numbers to one kind by NumPy's rules: a literal takes the type of the other number.

        Raises NotInSubsetError for a float32 and a number of another type, or for a literal that float32 cannot represent."""
        if FLOAT in (a.kind, b.kind) and TRUTH not in (a.kind, b.kind):
            a, b = self._to_float32(a), self._to_float32(b)
        kinds = {a.kind, b.kind}
        a, b = self.match_lanes(a, b)
        if len(kinds) == 1:
            return (a, b) if a.kind != TRUTH else (self.convert(a, INT), self.convert(b, INT))
        if kinds <= {INT, UNSIGNED, TRUTH}:
            kind = UNSIGNED if UNSIGNED in kinds and (a.literal_value is not None or b.literal_value is not None) else INT
            if UNSIGNED in kinds and kind == INT:
                self.fail(self.node, "the operands are a signed and an unsigned integer: convert one of them")
        else:
            kind = FLOAT if kinds == {FLOAT, TRUTH} else DOUBLE
        return self.convert(a, kind), self.convert(b, kind)

    def _to_float32(self, value: Number) -> Number:
        """Return a literal as float32. Raises NotInSubsetError if float32 cannot represent it exactly."""
        if value.kind == FLOAT:
            return value
        if value.literal_value is None:
            self.fail(
                self.node,
                "the operands are a float32 and a number of another type: convert one with `np.float64` or `np.float32`",
            )
        single = np.float32(value.literal_value)
        if float(single) != value.literal_value and value.literal_value == value.literal_value:
            self.fail(self.node, f"float32 cannot represent {value.literal_value}: write `np.float32({value.literal_value})`")
        literal = make_literal_number(single)
        return self.broadcast(literal) if value.has_several_lanes else literal

    def to_kind(self, value: Number, kind: str) -> Number:
        """Convert a number to `kind`. Raises NotInSubsetError if the conversion would change the value of a literal."""
        if value.kind == kind or value.literal_value is None:
            return self.convert(value, kind)
        if kind == FLOAT:
            return self._to_float32(value)
        converted_number = self.convert(value, kind) if value.kind != DOUBLE else None
        if converted_number is None or converted_number.literal_value not in (None, value.literal_value):
            self.fail(self.node, f"{value.literal_value} is not a number of type {kind}")
        return converted_number

    def apply_operator(self, node: ast.AST, operator: ast.operator, a: Number, b: Number) -> Number:
        """Return the result of a Python operator for two numbers. If both numbers are literals, the result is a literal."""
        word = type(operator)
        folded = not (a.has_several_lanes or b.has_several_lanes)
        if (
            folded
            and a.literal_value is not None
            and b.literal_value is not None
            and word in _PYTHON_OPERATORS
            and DOUBLE not in (a.kind, b.kind)
        ):
            return self._fold_literals(node, word, a, b)
        if a.kind == b.kind == TRUTH and word in (ast.BitAnd, ast.BitOr, ast.BitXor):
            return self.op(_INTEGER_OPCODES[word], TRUTH, *self.match_lanes(a, b))
        if word is ast.Div:
            a, b = self.to_float(a), self.to_float(b)
        first = self._add_to_first_lane(word, a, b)
        a, b = self.match_kinds(a, b)
        if a.kind in (DOUBLE, FLOAT):
            if word not in _FLOAT_OPCODES:
                self.fail(node, "floats do not have this operation")
            return self.op(_FLOAT_OPCODES[word], a.kind, a, b)
        if word in _SHIFT_OPERATORS:
            return self._apply_shift(node, word, a, b)
        if word in _INTEGER_OPCODES:
            result = self.op(_INTEGER_OPCODES[word], a.kind, a, b)
            return Number(result.kind, result.name, None, result.lanes, first)
        if word not in (ast.FloorDiv, ast.Mod):
            self.fail(node, "integers do not have this operation")
        return self._emit_floor_division(node, word is ast.Mod, a, b)

    def _fold_literals(self, node: ast.AST, word: type[ast.operator], a: Number, b: Number) -> Number:
        """Return the result of an operation on two integer literals, as an integer literal. `word`: the class of the Python
        operator."""
        kind = UNSIGNED if UNSIGNED in (a.kind, b.kind) else INT
        try:
            value = _PYTHON_OPERATORS[word](int(a.literal_value or 0), int(b.literal_value or 0))
        except (ZeroDivisionError, ValueError) as problem:
            self.fail(node, f"{problem}")
        if kind == INT and value not in _INT64_RANGE:
            self.fail(node, f"{value} does not fit into int64: convert an operand with `np.uint64(…)` if it is unsigned")
        return Number(kind, make_literal_number(wrap_to_integer_kind(value, kind)).name, wrap_to_integer_kind(value, kind))

    def _apply_shift(self, node: ast.AST, word: type[ast.operator], a: Number, b: Number) -> Number:
        """Return the number `a` shifted by `b` modulo 64. `word`: the class of the Python operator."""
        if b.literal_value is None:
            b = self.op("and", b.kind, b, self.match_lanes(make_literal_number(63), b)[0])
        elif not 0 <= b.literal_value < 64:
            self.fail(node, "a shift count must be from 0 to 63")
        return self.op("shl" if word is ast.LShift else "lshr" if a.kind == UNSIGNED else "ashr", a.kind, a, b)

    def _emit_floor_division(self, node: ast.AST, is_remainder: bool, a: Number, b: Number) -> Number:
        """Return the quotient of two integers, rounded down, or with `is_remainder` the remainder.

        The checked build reports division by 0; other builds divide by 1 instead. If the least integer is divided by -1, all
        builds divide by 1 instead, which gives the wrapped result."""
        if b.literal_value == 0:
            self.fail(node, "division by 0")
        if b.literal_value is None:
            counts = None if b.has_several_lanes else self.get_active_mask()
            checked = b if counts is None else self.select(counts, b, self.convert(make_literal_number(1), b.kind))
            self.emit_void("divisor", checked, *([self.mask] if b.has_several_lanes and self.mask is not None else []), node=node)
            without = self.compare("eq", b, make_literal_number(0))
            if a.kind == INT and (a.literal_value is None or a.literal_value == _INT64_RANGE[0]):
                both = self.emit_logical_and(
                    self.compare("eq", b, make_literal_number(-1)), self.compare("eq", a, make_literal_number(_INT64_RANGE[0]))
                )
                without = self.op("or", TRUTH, *self.match_lanes(without, both))
            b = self.select(without, self.convert(make_literal_number(1), b.kind), b)
        elif b.literal_value == -1:
            return self.negate(a) if not is_remainder else self.op("sub", a.kind, a, a)
        if a.kind == UNSIGNED:
            return self.op("urem" if is_remainder else "udiv", a.kind, a, b)
        rest = self.op("srem", INT, a, b)
        other = self.compare("lt", self.op("xor", INT, rest, b), make_literal_number(0))
        down = self.op("and", TRUTH, other, self.compare("ne", rest, make_literal_number(0)))
        if is_remainder:
            return self.op("add", INT, rest, self.select(down, b, make_literal_number(0)))
        return self.op("sub", INT, self.op("sdiv", INT, a, b), self.convert(down, INT))

    def emit_logical_and(self, a: Number, b: Number) -> Number:
        """Emit the logical `and` of two conditions, and return the result."""
        for one, other in ((a, b), (b, a)):
            if one.literal_value is not None:
                return other if one.literal_value else make_literal_number(False)
        return self.op("and", TRUTH, *self.match_lanes(a, b))

    def _add_to_first_lane(self, word: type[ast.operator], a: Number, b: Number) -> Number | None:
        """Return the first lane of a sum or difference if it increases by one from lane to lane. Otherwise return None.

        It does if one operand increases by one from lane to lane and the other is loop-invariant. `word`: the class of the Python
        operator."""
        if word not in (ast.Add, ast.Sub) or a.lane_type != "i64" or b.lane_type != "i64" or (b.first_lane and word is ast.Sub):
            return None
        one, other = (a.first_lane, b) if a.first_lane else (a, b.first_lane)
        return (
            None
            if one is None or other is None or one.has_several_lanes or other.has_several_lanes
            else self.op(_INTEGER_OPCODES[word], INT, one, other)
        )

    def negate(self, a: Number) -> Number:
        if a.literal_value is not None and not a.has_several_lanes:
            if a.kind == INT and a.literal_value == _INT64_RANGE[0]:
                self.fail(self.node, f"{-a.literal_value} does not fit into int64")
            return make_literal_number(-a.literal_value)
        if a.kind in (DOUBLE, FLOAT):
            return self.op("fneg", a.kind, a)
        a = self.convert(a, INT)
        return self.op("sub", INT, Number(INT, "zeroinitializer" if a.has_several_lanes else "0", lanes=a.lanes), a)

    def compare(self, word: str, a: Number, b: Number) -> Number:
        """Emit a comparison of `a` and `b`, and return its result. `word`: the name of the comparison, such as `lt`."""
        if a.literal_value is not None and b.literal_value is not None and not (a.has_several_lanes or b.has_several_lanes):
            x, y = a.literal_value, b.literal_value
            held = {"lt": x < y, "le": x <= y, "gt": x > y, "ge": x >= y, "eq": x == y, "ne": x != y}
            return make_literal_number(held[word])
        a, b = self.match_kinds(a, b)
        if a.kind in (DOUBLE, FLOAT):
            return self.op(f"f{word}", TRUTH, a, b)
        sign = "" if word in ("eq", "ne") else "u" if a.kind == UNSIGNED else "s"
        return self.op(f"{sign}{word}", TRUTH, a, b)

    def select(self, condition: Number, true_value: Number, false_value: Number) -> Number:
        """Return `true_value` in lanes where `condition` is true, and `false_value` in the others."""
        if condition.literal_value is not None:
            return true_value if condition.literal_value else false_value
        true_value, false_value = (
            self.match_kinds(true_value, false_value)
            if true_value.kind != false_value.kind
            else self.match_lanes(true_value, false_value)
        )
        if condition.has_several_lanes:
            true_value, false_value = self.broadcast(true_value), self.broadcast(false_value)
        return self.op("select", true_value.kind, condition, true_value, false_value, lanes=true_value.lanes)


def wrap_to_integer_kind(number: int, kind: str) -> int:
    """Return an integer wrapped around to 64 bits, signed or unsigned as `kind` requires."""
    number &= (1 << 64) - 1
    return number if kind == UNSIGNED or number < 1 << 63 else number - (1 << 64)
