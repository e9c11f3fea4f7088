"""Reports random draws that are repeated in every step. Repeated draws in a condition make it hold more often at a higher frame
rate. In steering, they change the path: n times as many draws per second give a sum that is sqrt(n) times as large."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

from antdsl.diagnostics import Fix, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.analysis.timestep_limits import depends_on_step
from antdsl.program.checks.steps import ASSUMED_FPS
from antdsl.program.model import (
    Assign,
    AttributeRef,
    BindingRef,
    Constant,
    Expr,
    FaceLine,
    InlinedBehaviour,
    OperationExpr,
    Species,
    Steer,
)
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant
from antdsl.syntax import nodes
from antdsl.syntax.words import QUANTITY_PATTERN

_DRAW_OPERATIONS = frozenset(("uniform", "normal", "pick"))
_ARITHMETIC_OPERATIONS = frozenset(("neg", "add", "sub", "mul", "div", "abs", "clamp", "min", "max", "mix", "if"))
_COMPARISON_OPERATIONS = frozenset(("lt", "le", "gt", "ge", "eq", "ne"))
# Operations after which a draw no longer depends on the frame rate if another operand has `dt`: `drawn * sqrt(dt / 1 s)`.
_SCALING_OPERATIONS = _COMPARISON_OPERATIONS | {"mul", "div"}


def check_draws(context: CheckContext, report: Report) -> None:
    """Report conditions and steering that depend on a random draw in each step."""
    has_library = any(
        isinstance(item, nodes.Use) and item.library is not None for file in context.files for item in file.node.items
    )
    for species in context.program.species.values():
        _check_steering(species, has_library, report)
        tests = [change.condition for machine in species.machines for state in machine.states for change in state.transitions]
        tests += [layer.condition for layer in species.layers.layers]
        for test in tests:
            if test is not None:
                _check_condition(test, report)


def _check_steering(species: Species, has_library: bool, report: Report) -> None:
    """Report draws in the `steer` and `face` lines of states and layers, and draws in attributes that a state sets in every
    step."""
    lines = [line for machine in species.machines for state in machine.states for line in state.body]
    drawn = {
        line.attribute: draws
        for line in lines
        if isinstance(line, Assign) and line.op == "=" and line.pair_agent is None and (draws := _find_step_draws(line.value, {}))
    }
    pushes = [line.push for line in lines if isinstance(line, Steer)]
    pushes += [line.direction for line in lines if isinstance(line, FaceLine)]
    pushes += [layer.push for layer in species.layers.layers if layer.push is not None]
    for draw in {str(draw.span): draw for push in pushes for draw in _find_step_draws(push, drawn)}.values():
        text, addition = _format_jitter(draw), "" if has_library else ", and `use steering`"
        report.warning(
            "draw-in-steering",
            f"{quote_source(draw.span)} draws a new number in every step, so the path depends on the frames per second",
            draw.span,
            f"write `{text}`, which is equal at {ASSUMED_FPS} frames a second{addition}" if text
            else "write `wander()` from `steering`, or draw once: an attribute, set in `enter`",
            fix=Fix(draw.span, text) if text and has_library else None,
        )  # fmt: skip


def _find_step_draws(root: Expr, draws_by_attribute: dict[str, list[OperationExpr]]) -> list[OperationExpr]:
    """Return the draws that are repeated in every step, if the spread of their sum per second depends on the frame rate.

    Draws that are scaled by `dt`, and draws inside sets, are omitted. `draws_by_attribute`: for each attribute, the draws that a
    state assigns to it."""
    draws: list[OperationExpr] = []
    stack, visited = [root], set[int]()
    while stack:
        part = stack.pop()
        if id(part) in visited:
            continue
        visited.add(id(part))
        if isinstance(part, AttributeRef) and part.owner is None:
            draws += draws_by_attribute.get(part.name, [])
        elif isinstance(part, BindingRef):
            value = part.binding.next_value if part.binding.role == "keep" else part.binding.value
            stack += [value] if value is not None and part.binding.role in ("let", "argument", "keep") else []
        elif isinstance(part, InlinedBehaviour):
            stack.append(part.result)
        elif isinstance(part, OperationExpr) and part.name in _DRAW_OPERATIONS:
            draws.append(part)
        elif isinstance(part, OperationExpr):
            args = [arg for arg in part.args if arg is not None]
            if part.name not in _SCALING_OPERATIONS or not any(depends_on_step(arg) for arg in args):
                stack += args
    return draws


def _format_jitter(draw: OperationExpr) -> str | None:
    """Return the call of `jitter` that replaces the draw of an angle, such as `jitter(73.5 deg)` for `normal(0 deg, 15 deg)`.

    Returns None unless the draw is `normal` or `uniform` around 0. After one second at 24 frames per second, `jitter` has spread
    as far as the draws."""
    if draw.name not in ("uniform", "normal") or len(draw.args) < 2:
        return None
    first, second = draw.args[:2]
    low, high = find_constant(first) if first is not None else None, find_constant(second) if second is not None else None
    written = QUANTITY_PATTERN.fullmatch(second.span.text) if second is not None else None
    if low is None or high is None or written is None or written[2] not in ("deg", "rad"):
        return None
    if not (low.number == 0 if draw.name == "normal" else low.number == -high.number):
        return None
    spread = float(written[1]) * math.sqrt(ASSUMED_FPS / (1 if draw.name == "normal" else 3))
    return f"jitter({spread:.3g} {written[2]})"


def _check_condition(test: Expr, report: Report) -> None:
    """Report each comparison in a condition that uses a new random draw in every step."""
    within = [part for part in _iterate_reachable_parts(test, ("and", "or", "not")) if isinstance(part, OperationExpr)]
    if any(part.name == "event" for part in within):
        return  # an event lasts one step
    for part in within:
        if part.name in _COMPARISON_OPERATIONS and _has_draw(part):
            rate = _format_chance_rate(part)
            report.warning(
                "draw-in-condition",
                f"{quote_source(part.span)} draws a new number in every step, so the result depends on the frames per second",
                part.span,
                f"write `{rate}`, which is equally likely at {ASSUMED_FPS} frames a second" if rate
                else "write `chance 20 %/s`, or draw once: an attribute, set in `enter`",
                fix=Fix(part.span, rate) if rate else None,
            )  # fmt: skip


def _has_draw(part: OperationExpr) -> bool:
    return any(
        isinstance(inner, OperationExpr) and inner.name in _DRAW_OPERATIONS
        for inner in _iterate_reachable_parts(part, _ARITHMETIC_OPERATIONS)
    )


def _iterate_reachable_parts(root: Expr, entered_operations: Collection[str]) -> Iterator[Expr]:
    """Yield an expression and the expressions that it contains. The search enters only operations in `entered_operations`, and
    no sets. Each named value is entered once."""
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
    """Return source text with a `chance` per second that replaces a comparison such as `uniform(0, 1) < 0.1`. Return None for
    other comparisons."""
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
    share = _compute_probability_below(low, edge, high)
    return f"chance {-math.log1p(-(share if name in ('lt', 'le') else 1 - share)) * ASSUMED_FPS:.3g} /s"


def _compute_probability_below(low: Constant, edge: Constant, high: Constant) -> float:
    """Return the probability that a uniform draw from `low` to `high` is below `edge`."""
    return (edge.number - low.number) / (high.number - low.number)
