"""Checks the types of values that a line adds. The value must be a rate per second if the line runs in every step, and an amount
if it runs once."""

from __future__ import annotations

from dataclasses import dataclass

from antdsl.diagnostics import Fix
from antdsl.program.kinds import Dimension, TypeKind, ValueType
from antdsl.program.names.scope import NameScope
from antdsl.program.tables.units import combine_dimensions
from antdsl.program.typed import Expr
from antdsl.program.types.descriptions import is_compatible, quote_source, report_mismatch
from antdsl.program.types.operators import type_value
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class StatementContext:
    """The kind of block in which statements are checked.

    - `is_state_body`: whether the statements run in each step.
    - `must_be_order_independent`: whether they are in a handler, where several events may arrive in one step."""

    is_state_body: bool
    must_be_order_independent: bool = False


BODY_CONTEXT = StatementContext(is_state_body=True)
ACTION_CONTEXT = StatementContext(is_state_body=False)
HANDLER_CONTEXT = StatementContext(is_state_body=False, must_be_order_independent=True)


def type_amount_or_rate(
    scope: NameScope,
    node: nodes.Expr,
    type: ValueType,
    block: StatementContext,
    prefix: str,
    suffix: str = "",
    is_always_amount: bool = False,
) -> Expr | None:
    """Return the typed value that a line adds: a rate per second in a state's body, otherwise an amount.

    - `is_always_amount`: whether the value is an amount even in a state's body.
    - `prefix`, `suffix`: the source text before and after the value, for messages."""
    per_second = ValueType(type.kind, combine_dimensions(type.dimension, Dimension(time=1), -1))
    want = per_second if block.is_state_body else type
    expr = type_value(scope, node, want)
    if expr.type.kind is TypeKind.BAD:
        return None
    if is_always_amount and expr.type == type:
        return expr
    if is_compatible(expr.type, want):
        return expr
    text = " ".join(node.span.text.split())
    if block.is_state_body and is_compatible(expr.type, type):
        better = _format_rate(node, text)
        message = f"{quote_source(node.span)} is an amount, and this line runs in every step"
        advice = f"write an amount per time: `{prefix}{better}{suffix}`"
        scope.report.error("not-a-rate", message, node.span, advice, fix=Fix(node.span, better))
    elif not block.is_state_body and is_compatible(expr.type, per_second):
        better = text[: -len("/s")].rstrip() if text.endswith("/s") else f"{_add_brackets_if_needed(node, text)} * 1 s"
        message = f"{quote_source(node.span)} is a rate, but this line runs once"
        advice = f"write an amount: `{prefix}{better}{suffix}`"
        scope.report.error("not-an-amount", message, node.span, advice, fix=Fix(node.span, better))
    else:
        report_mismatch(scope.report, node, expr.type, want, f"`{prefix.strip()}`")
    return None


def _format_rate(node: nodes.Expr, text: str) -> str:
    if isinstance(node, nodes.Number):
        return f"{text} /s"
    if isinstance(node, nodes.Quantity):
        return f"{text}/s"
    if (
        isinstance(node, nodes.Binary)
        and node.op == "*"
        and isinstance(node.right, nodes.NameRef)
        and node.right.name.text == "dt"
    ):
        return " ".join(node.left.span.text.split())  # a rate is multiplied by dt anyway
    return f"{_add_brackets_if_needed(node, text)} * 1 /s"


def _add_brackets_if_needed(node: nodes.Expr, text: str) -> str:
    return f"({text})" if isinstance(node, nodes.Binary) and node.op in ("+", "-") else text
