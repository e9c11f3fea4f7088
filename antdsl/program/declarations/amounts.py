"""Values that a line adds: a rate per second if it runs in every step, an amount if it happens once."""

from __future__ import annotations

from dataclasses import dataclass

from antdsl.diagnostics import Fix
from antdsl.program.kinds import Dim, Kind, Type
from antdsl.program.names.scope import Scope
from antdsl.program.tables.units import product
from antdsl.program.typed import Expr
from antdsl.program.types.descriptions import fits, mismatch, quoted
from antdsl.program.types.operators import value
from antdsl.syntax import nodes


@dataclass(frozen=True, slots=True)
class Block:
    """The context of statements. `body`: they run in each step. `commuting`: they are in a handler, where several events may
    arrive at once."""

    body: bool
    commuting: bool = False


BODY = Block(body=True)
ACTION = Block(body=False)
HANDLER = Block(body=False, commuting=True)


def added(
    scope: Scope, node: nodes.Expr, type: Type, block: Block, prefix: str, suffix: str = "", level: bool = False
) -> Expr | None:
    """Return the added value: a rate per second in a state's body, else an amount; with `level` always an amount. `prefix` and
    `suffix`: the author's words around it."""
    per_second = Type(type.kind, product(type.dim, Dim(time=1), -1))
    want = per_second if block.body else type
    expr = value(scope, node, want)
    if expr.type.kind is Kind.BAD:
        return None
    if level and expr.type == type:
        return expr
    if fits(expr.type, want):
        return expr
    text = " ".join(node.span.text.split())
    if block.body and fits(expr.type, type):
        better = _as_rate(node, text)
        scope.report.error(
            "not-a-rate", f"{quoted(node.span)} is an amount, and this line runs in every step", node.span,
            f"say per what time: `{prefix}{better}{suffix}`", fix=Fix(node.span, better),
        )  # fmt: skip
    elif not block.body and fits(expr.type, per_second):
        better = text[: -len("/s")].rstrip() if text.endswith("/s") else f"{_bracketed(node, text)} * 1 s"
        scope.report.error(
            "not-an-amount", f"{quoted(node.span)} is a rate, and this happens once", node.span,
            f"say how much: `{prefix}{better}{suffix}`", fix=Fix(node.span, better),
        )  # fmt: skip
    else:
        mismatch(scope.report, node, expr.type, want, f"`{prefix.strip()}`")
    return None


def _as_rate(node: nodes.Expr, text: str) -> str:
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
        return " ".join(node.left.span.text.split())  # a rate is taken times dt as it is
    return f"{_bracketed(node, text)} * 1 /s"


def _bracketed(node: nodes.Expr, text: str) -> str:
    return f"({text})" if isinstance(node, nodes.Binary) and node.op in ("+", "-") else text
