"""Reports random draws inside conditions. They are repeated in every step, so the frame rate changes how often a condition
holds."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

from antdsl.diagnostics import Fix, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.model import BindingRef, Constant, Expr, OperationExpr
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant

_DRAW_OPERATIONS = frozenset(("uniform", "normal", "pick"))
_ARITHMETIC_OPERATIONS = frozenset(("neg", "add", "sub", "mul", "div", "abs", "clamp", "min", "max", "mix", "if"))
_COMPARISON_OPERATIONS = frozenset(("lt", "le", "gt", "ge", "eq", "ne"))
_FILM_FPS = 24  # frames per second of film


def check_draws(checked: CheckContext, report: Report) -> None:
    """Report conditions that depend on a random draw in each step."""
    for species in checked.program.species.values():
        tests = [change.condition for machine in species.machines for state in machine.states for change in state.transitions]
        tests += [layer.condition for layer in species.layers.layers]
        for test in tests:
            if test is not None:
                _check_test(test, report)


def _check_test(test: Expr, report: Report) -> None:
    within = [part for part in _iterate_reachable_parts(test, ("and", "or", "not")) if isinstance(part, OperationExpr)]
    if any(part.name == "event" for part in within):
        return  # an event lasts one step
    for part in within:
        if part.name in _COMPARISON_OPERATIONS and _has_draw(part):
            rate = _format_chance_rate(part)
            report.warning(
                "draw-in-condition",
                f"{quote_source(part.span)} draws a new number in every step",
                part.span,
                f"write `{rate}`, which is as likely at {_FILM_FPS} frames a second" if rate
                else "write `chance 20 %/s`, or draw once: an attribute, set in `enter`",
                fix=Fix(part.span, rate) if rate else None,
            )  # fmt: skip


def _has_draw(part: OperationExpr) -> bool:
    return any(
        isinstance(inner, OperationExpr) and inner.name in _DRAW_OPERATIONS
        for inner in _iterate_reachable_parts(part, _ARITHMETIC_OPERATIONS)
    )


def _iterate_reachable_parts(root: Expr, entered_operations: Collection[str]) -> Iterator[Expr]:
    """Yield an expression and its parts. The walk enters only the operations in `entered_operations` and the values of names,
    each named value once. It does not enter sets."""
    stack: list[Expr] = [root]
    named: set[int] = set()
    while stack:
        part = stack.pop()
        if isinstance(part, BindingRef) and part.binding.role in ("let", "argument") and part.binding.value is not None:
            if id(part.binding) not in named:
                named.add(id(part.binding))
                stack.append(part.binding.value)
            continue
        yield part
        if isinstance(part, OperationExpr) and (part is root or part.name in entered_operations):
            stack += [arg for arg in part.args if arg is not None]


def _format_chance_rate(part: OperationExpr) -> str | None:
    """Return the text of `uniform(0, 1) < 0.1` as a chance per second."""
    left, right = part.args
    assert left is not None and right is not None
    name = part.name
    if not isinstance(left, OperationExpr):
        left, right, name = right, left, {"lt": "gt", "le": "ge", "gt": "lt", "ge": "le"}.get(name, "")
    edge, ends = find_constant(right), [find_constant(arg) for arg in getattr(left, "args", ()) if arg is not None]
    if not isinstance(left, OperationExpr) or left.name != "uniform" or edge is None or name not in ("lt", "le", "gt", "ge"):
        return None
    low, high = ends if len(ends) == 2 else (None, None)
    if low is None or high is None or not low.number < edge.number < high.number:
        return None
    share = _compute_true_share(low, edge, high)
    return f"chance {-math.log1p(-(share if name in ('lt', 'le') else 1 - share)) * _FILM_FPS:.3g} /s"


def _compute_true_share(low: Constant, edge: Constant, high: Constant) -> float:
    return (edge.number - low.number) / (high.number - low.number)
