"""Computes operations on constants before a run, so that `1.5 * 40 mm` becomes one value. Reports errors in these operations."""

from __future__ import annotations

import math
from collections.abc import Callable

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.program.model import BindingRef, ChangeRate, Constant, Expr, OperationExpr, ValueType

_FOLDABLE_OPERATIONS = ("neg", "add", "sub", "mul", "div", "pow")
_FLOAT_FUNCTIONS: dict[str, Callable[[float, float], float]] = {"add": lambda a, b: a + b, "sub": lambda a, b: a - b}


def fold_operation(report: Report, op: OperationExpr) -> Expr:
    """Return the value of an operation as a constant. If the operation is not constant, return it unchanged.

    Report a division by 0, and numbers that are too large to store."""
    values = [find_constant(arg) if arg is not None else None for arg in op.args]
    if op.name == "div" and len(values) == 2 and values[1] is not None and values[1].number == 0:
        report.error("division-by-zero", "this divides by 0", op.span, "divide by a value that is never 0")
        return op
    if op.name == "sqrt" and values[0] is not None and values[0].number < 0:
        report.error("root-of-negative", "the root of a number below 0 does not exist", op.span, "take the root of `abs(…)`")
        return op
    folded = _fold_values(op, [v for v in values if v is not None]) if op.name in _FOLDABLE_OPERATIONS and all(values) else None
    if folded is None:
        return op
    if not math.isfinite(folded.number) or abs(folded.number) > limits.MAX_NUMBER:
        report.error("number-too-large", "the result is too large to store", op.span, "write a smaller number")
        return op
    return folded


def _fold_values(op: OperationExpr, values: list[Constant]) -> Constant | None:
    try:
        if op.name == "neg":
            return _make_constant(op, -values[0].number, values[0].unit_power, values[0].step)
        a, b = values
        if op.name in _FLOAT_FUNCTIONS and (a.unit_power, a.step) == (b.unit_power, b.step):
            return _make_constant(op, _FLOAT_FUNCTIONS[op.name](a.number, b.number), a.unit_power, a.step)
        if op.name == "mul":
            return _make_constant(op, a.number * b.number, a.unit_power + b.unit_power, a.step + b.step)
        if op.name == "div":
            return _make_constant(op, a.number / b.number, a.unit_power - b.unit_power, a.step - b.step)
        if op.name == "pow" and not (b.unit_power or b.step) and (a.number > 0 or b.number == int(b.number)):
            return _make_constant(op, a.number**b.number, a.unit_power * b.number, a.step * b.number)
    except (ValueError, OverflowError, ZeroDivisionError):
        return _make_constant(op, math.inf, 0, 0)
    return None


def _make_constant(op: OperationExpr, value: float, unit_power: float, step_power: float) -> Constant:
    type: ValueType = op.type
    return Constant(
        type, ChangeRate.RUN if unit_power or step_power else ChangeRate.CONST, op.span, value, unit_power, step_power
    )


def find_constant(expr: Expr) -> Constant | None:
    """Return an expression as a constant if it is one, or if it is a behaviour's argument with a constant value. Otherwise
    return None."""
    while isinstance(expr, BindingRef) and expr.binding.role in ("argument", "let") and expr.binding.value is not None:
        expr = expr.binding.value
    return expr if isinstance(expr, Constant) else None
