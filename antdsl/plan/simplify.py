"""Simplifies single operations: computes constant results, and removes operations without effect.

A rewrite must give the same value for every operand, including NaN and infinity; only the sign of a zero may change. Constants
are float32 with the bits that backends compute: a float64 result, rounded again to float32. This double rounding is harmless for
+ - * / and the square root, since 53 >= 2 * 24 + 2. The source is Figueroa, "When is double rounding innocuous?", 1995."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from antdsl.plan.ir import PlanNode, ValueKind

if TYPE_CHECKING:
    from antdsl.plan.builder import PlanBuilder

_FLOAT32_STRUCT = struct.Struct("<f")
ConstantValue = float | int | bool | None
_CONSTANT_OPERATIONS = frozenset(("const", "const.bool", "const.i32", "const.i64"))


def get_constant_value(node: PlanNode) -> Any:
    """Return the value of a constant node (float, int or bool), or None for any other node."""
    return node.attrs[0] if node.op in _CONSTANT_OPERATIONS else None


def simplify_operation(b: PlanBuilder, op: str, args: tuple[PlanNode, ...], attrs: tuple[Any, ...]) -> PlanNode | None:
    """Return a simpler node with the same value as the operation, or None if none is known."""
    if not args:
        return None
    values = [get_constant_value(a) for a in args]
    if all(v is not None for v in values):
        known = _fold_constants(b, op, values)
        if known is not None:
            return known
    rule = _SIMPLIFIER_BY_OPERATION.get(op)
    return rule(b, args, values) if rule else None


def _fold_constants(b: PlanBuilder, op: str, values: list[Any]) -> PlanNode | None:
    if op in ARITHMETIC_FUNCTIONS:
        return b.add_number(round_to_f32(ARITHMETIC_FUNCTIONS[op](*values)))
    if op in COMPARISON_FUNCTIONS:
        return b.add_boolean(COMPARISON_FUNCTIONS[op](*values))
    if op in ("min", "max"):
        chosen = (find_minimum if op == "min" else find_maximum)(*values)
        return None if chosen is None else b.add_number(chosen)
    if op == "number":
        return b.add_number(float(values[0]))
    return None


def _simplify_add(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return args[0] if v[1] == 0 else args[1] if v[0] == 0 else None


def _simplify_sub(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return args[0] if v[1] == 0 else b("neg", args[1]) if v[0] == 0 else None


def _simplify_mul(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    if v[1] == 1:
        return args[0]
    if v[0] == 1:
        return args[1]
    if v[1] == -1:
        return b("neg", args[0])
    return b("neg", args[1]) if v[0] == -1 else None


def _simplify_div(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return args[0] if v[1] == 1 else None


def _simplify_neg(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return args[0].args[0] if args[0].op == "neg" else None


def _simplify_same_operands(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return args[0] if args[0] is args[1] else None


def _simplify_and(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    if v[0] is False or v[1] is False:
        return b.false
    if v[0] is True or args[0] is args[1]:
        return args[1]
    return args[0] if v[1] is True else None


def _simplify_or(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    if v[0] is True or v[1] is True:
        return b.true
    if v[0] is False or args[0] is args[1]:
        return args[1]
    return args[0] if v[1] is False else None


def _simplify_not(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    if v[0] is not None:
        return b.add_boolean(not v[0])
    inner = args[0]
    if inner.op == "not":
        return inner.args[0]
    if inner.op in ("eq", "ne"):  # opposites also for NaN, unlike `lt` and `ge`
        return b("ne" if inner.op == "eq" else "eq", *inner.args)
    return None


def _simplify_where(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    condition, then, other = args
    if v[0] is not None:
        return then if v[0] else other
    if then is other:
        return then
    if condition.op == "not":
        return b("where", condition.args[0], other, then)
    if v[1] is True and v[2] is False:
        return condition
    if v[1] is False and v[2] is True:
        return b("not", condition)
    return None


def _simplify_eq(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return b.true if args[0] is args[1] and args[0].kind is not ValueKind.F32 else None


def _simplify_ne(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return b.false if args[0] is args[1] and args[0].kind is not ValueKind.F32 else None


def _simplify_alive(b: PlanBuilder, args: tuple[PlanNode, ...], v: list[ConstantValue]) -> PlanNode | None:
    return b.false if v[0] == -1 else None


_SIMPLIFIER_BY_OPERATION = {
    "add": _simplify_add, "sub": _simplify_sub, "mul": _simplify_mul, "div": _simplify_div, "neg": _simplify_neg,
    "min": _simplify_same_operands, "max": _simplify_same_operands, "and": _simplify_and, "or": _simplify_or,
    "not": _simplify_not, "where": _simplify_where, "eq": _simplify_eq, "ne": _simplify_ne,
    "item.alive": _simplify_alive, "agent.alive": _simplify_alive,
}  # fmt: skip


def round_to_f32(x: float) -> float:
    """Return the nearest float32, with ties to even. Values beyond the range become infinite."""
    try:
        return float(_FLOAT32_STRUCT.unpack(_FLOAT32_STRUCT.pack(x))[0])
    except OverflowError:
        return math.copysign(math.inf, x)


def _divide_numbers(a: float, b: float) -> float:
    if b != 0:
        return a / b
    if a == 0 or math.isnan(a):
        return math.nan
    return math.copysign(math.inf, a) * math.copysign(1.0, b)


def _compute_sqrt(a: float) -> float:
    return math.sqrt(a) if a >= 0 else math.nan


def _round_down(a: float) -> float:
    return float(math.floor(a)) if math.isfinite(a) and a != 0 else a


ARITHMETIC_FUNCTIONS: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": _divide_numbers,
    "neg": lambda a: -a,
    "abs": abs,
    "floor": _round_down,
    "sqrt": _compute_sqrt,
    "finite": lambda a: a if math.isfinite(a) else 0.0,
}

COMPARISON_FUNCTIONS: dict[str, Callable[..., bool]] = {
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
}


def find_minimum(a: float, b: float) -> float | None:
    """Return the minimum as the backends compute it. Return None for two zeros if the sign of the result would depend on the
    order of the operands."""
    if a == b == 0:
        return None
    if math.isnan(a) or math.isnan(b):
        return b if math.isnan(a) else a
    return min(a, b)


def find_maximum(a: float, b: float) -> float | None:
    """Return the maximum as the backends compute it. Return None for two zeros if the sign of the result would depend on the
    order of the operands."""
    if a == b == 0:
        return None
    if math.isnan(a) or math.isnan(b):
        return b if math.isnan(a) else a
    return max(a, b)
