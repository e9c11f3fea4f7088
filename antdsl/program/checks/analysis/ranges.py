"""Computes the range of a value from constants, the ranges of params and the ranges in the vocabulary."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

from antdsl.program.model import (
    AttributeRef,
    BindingRef,
    Constant,
    Expr,
    InlinedBehaviour,
    OperationExpr,
    Param,
    ParamRef,
    ReduceExpr,
    TypeKind,
)
from antdsl.program.tables.vocabulary import INTERVAL_BY_OPERATION


class Interval(NamedTuple):
    """The numbers from `low` to `high`. An open end is not included."""

    low: float = -math.inf
    high: float = math.inf
    is_low_open: bool = False
    is_high_open: bool = False

    @property
    def is_empty(self) -> bool:
        return self.low > self.high or (self.low == self.high and (self.is_low_open or self.is_high_open))

    def intersect(self, other: Interval) -> Interval:
        low = max((self.low, self.is_low_open), (other.low, other.is_low_open))
        high = min((self.high, not self.is_high_open), (other.high, not other.is_high_open))
        return Interval(low[0], high[0], low[1], not high[1])

    def compute_hull(self, other: Interval) -> Interval:
        low = min((self.low, self.is_low_open), (other.low, other.is_low_open))
        high = max((self.high, not self.is_high_open), (other.high, not other.is_high_open))
        return Interval(low[0], high[0], low[1], not high[1])


ANY_NUMBER, POSITIVE_NUMBERS = Interval(), Interval(0)
_ATTRIBUTE_INTERVALS = {name: POSITIVE_NUMBERS for name in ("speed", "age", "size", "mass", "radius", "distance", "group", "id")}
_OPERATION_INTERVALS: dict[str, Interval] = {op: Interval(*ends) for op, ends in INTERVAL_BY_OPERATION.items()}


def compute_range(expr: Expr | None, params: Mapping[str, Param], known_ranges: dict[int, Interval]) -> Interval:
    """Return a range, in base units, that contains all values of a numeric expression.

    The range of a param is its declared range, because a scene may set any value within it. `known_ranges`: a cache of the
    ranges of bindings by `id()`, because a `let` may be used in many expressions."""
    if expr is None or expr.type.kind is not TypeKind.NUMBER:
        return ANY_NUMBER
    if isinstance(expr, Constant):
        return Interval(expr.number, expr.number) if not (expr.unit_power or expr.step) else _compute_sign_range(expr.number)
    if isinstance(expr, ParamRef):
        return _compute_param_range(params.get(expr.name))
    if isinstance(expr, BindingRef):
        if expr.binding.role not in ("let", "argument") or expr.binding.value is None:
            return ANY_NUMBER
        if id(expr.binding) not in known_ranges:
            known_ranges[id(expr.binding)] = compute_range(expr.binding.value, params, known_ranges)
        return known_ranges[id(expr.binding)]
    if isinstance(expr, AttributeRef):
        return POSITIVE_NUMBERS if expr.name.endswith(".time_in_state") else _ATTRIBUTE_INTERVALS.get(expr.name, ANY_NUMBER)
    if isinstance(expr, InlinedBehaviour):
        return compute_range(expr.result, params, known_ranges)
    if isinstance(expr, ReduceExpr):
        return POSITIVE_NUMBERS if expr.reducer == "count" else ANY_NUMBER
    if isinstance(expr, OperationExpr):
        return _compute_operation_range(expr, params, known_ranges)
    return ANY_NUMBER


def _compute_sign_range(number: float) -> Interval:
    """Return the range of a constant that depends on the scene. Of such a constant, only the sign is known."""
    return Interval(0, 0) if number == 0 else POSITIVE_NUMBERS if number > 0 else Interval(-math.inf, 0)


def _compute_param_range(param: Param | None) -> Interval:
    if param is None or param.low is None or param.high is None:
        return ANY_NUMBER
    if any(end.unit_power or end.step for end in (param.low, param.high)):
        return ANY_NUMBER
    return Interval(param.low.number, param.high.number)


def _compute_operation_range(op: OperationExpr, params: Mapping[str, Param], known_ranges: dict[int, Interval]) -> Interval:
    if op.name in _OPERATION_INTERVALS:
        return _OPERATION_INTERVALS[op.name]
    rule = _INTERVAL_RULES.get(op.name)
    if rule is None:
        return ANY_NUMBER
    parts = [compute_range(arg, params, known_ranges) for arg in op.args]
    bounds = rule(parts)
    return ANY_NUMBER if math.isnan(bounds.low) or math.isnan(bounds.high) else bounds


def _multiply_ends(a: Interval, b: Interval) -> Interval:
    """Return the product of two ends of intervals. The product of infinity and 0 is 0, because actual values are finite."""
    ends = [0.0 if 0 in (x, y) else x * y for x in (a.low, a.high) for y in (b.low, b.high)]
    return Interval(min(ends), max(ends))


def _compute_quotient_interval(a: Interval, b: Interval) -> Interval:
    if b.low <= 0 <= b.high:
        return POSITIVE_NUMBERS if a.low >= 0 and b.low >= 0 else ANY_NUMBER
    return _multiply_ends(a, Interval(1 / b.high, 1 / b.low))


def _compute_absolute_interval(a: Interval) -> Interval:
    return Interval(max(0.0, a.low, -a.high), max(-a.low, a.high))


_INTERVAL_RULES: dict[str, Callable[[list[Interval]], Interval]] = {
    "neg": lambda p: Interval(-p[0].high, -p[0].low),
    "add": lambda p: Interval(p[0].low + p[1].low, p[0].high + p[1].high),
    "sub": lambda p: Interval(p[0].low - p[1].high, p[0].high - p[1].low),
    "mul": lambda p: _multiply_ends(p[0], p[1]),
    "div": lambda p: _compute_quotient_interval(p[0], p[1]),
    "abs": lambda p: _compute_absolute_interval(p[0]),
    "min": lambda p: Interval(min(p[0].low, p[1].low), min(p[0].high, p[1].high)),
    "max": lambda p: Interval(max(p[0].low, p[1].low), max(p[0].high, p[1].high)),
    "clamp": lambda p: Interval(p[1].low, p[2].high),
    "ramp": lambda p: p[3].compute_hull(p[4]),
    "uniform": lambda p: p[0].compute_hull(p[1]),
    "if": lambda p: p[1].compute_hull(p[2]),
}
