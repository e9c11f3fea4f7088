"""Asking about clips: `clip done`, `clip at MARK`."""

from __future__ import annotations

from antdsl.program.model import ClipTest, Expr, Rate, Type
from antdsl.program.names.scope import BOOL, Scope, bad
from antdsl.syntax import nodes


def clip_test(scope: Scope, node: nodes.ClipTest, want: Type | None) -> Expr:
    """`clip done`, `clip at MARK`: of the machine that the place belongs to, or the first."""
    names = scope.species
    if names is None or not names.machines or scope.behaviour is not None:
        scope.report.error(
            "unknown-name", "no clip is known here", node.span, "ask in a state of a species, `when clip done -> …`"
        )
        return bad(node.span)
    if not node.at and node.name.text != "done":
        scope.report.error(
            "unknown-name", f"`clip {node.name.text}` says nothing of a clip", node.span,
            f"write `clip done`, or for a mark `clip at {node.name.text}`",
        )  # fmt: skip
        return bad(node.span)
    machine = scope.machine or next(iter(names.machines.values()))
    return ClipTest(BOOL, Rate.AGENT, node.span, machine.name, node.name.text if node.at else "")
