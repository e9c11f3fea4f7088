"""Reports values that change by a fixed amount per step, so that they change faster at a higher frame rate.

The check computes the limit of each value as steps get shorter. It examines:
- assignments that read the attribute that they set,
- each `keep` that is computed from its previous value,
- added amounts that should be per second but are not."""

from __future__ import annotations

import math
import re

from antdsl.diagnostics import Fix, Label, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.analysis.timestep_limits import (
    UpdateTarget,
    depends_on_step,
    find_rate_dependent_operations,
    is_rate,
    is_update_target,
    reads_update_target,
)
from antdsl.program.checks.steps import ASSUMED_FPS
from antdsl.program.model import Assign, Binding, Dimension, EffectRequest, Expr, Give, OperationExpr, State, TypeKind
from antdsl.program.traverse import iterate_parts
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant
from antdsl.source import Span
from antdsl.syntax.words import QUANTITY_PATTERN

_DECAY_PATTERN = re.compile(r"\w+ \* exp\(-dt / ([0-9.e+-]+ s)\)")
_PER_FRAME_REASON = "happens in every step, so it depends on the frames per second"
_SIMPLE_TERM_PATTERN = re.compile(r"[\w.]+(\([^()]*\))?")


def check_per_frame(context: CheckContext, report: Report) -> None:
    """Report assignments, memories and added amounts that change faster or slower at another frame rate."""
    for species in context.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                _check_lines(state, report)
        for part in iterate_parts((species.machines, species.layers)):
            if isinstance(part, Binding) and part.role == "keep" and part.next_value is not None:
                _check_memory(part, part.next_value, report)


def _check_lines(state: State, report: Report) -> None:
    own = [line for line in state.body if isinstance(line, Assign) and line.pair_agent is None]
    driven = {line.attribute for line in own if line.op != "="}
    for line in state.body:
        if isinstance(line, Assign) and line.op == "=" and line.pair_agent is None:
            _check_assignment(line, line.attribute in driven, report)
        elif isinstance(line, Assign):
            _check_added_amount(line, line.value, line.attribute, line.per_second, f"{line.attribute} {line.op} ", report)
        elif isinstance(line, Give) and line.amount is not None:
            _check_added_amount(line, line.amount, line.attribute, line.per_second, "", report)
        elif isinstance(line, EffectRequest) and line.args and line.args[0] is not None:
            _check_added_amount(line, line.args[0], line.target, line.per_second, "", report)


def _check_added_amount(
    line: Assign | EffectRequest | Give, amount: Expr, attribute: str, per_second: bool, line_start: str, report: Report
) -> None:
    """Report an amount that a state adds in each step although it is not an amount per second. The language multiplies amounts
    per second by `dt`."""
    if not per_second or is_rate(amount, attribute):
        return
    single_amount = (
        amount.args[0] if isinstance(amount, OperationExpr) and amount.name == "div" and _is_dt(amount.args[1]) else None
    )
    help, fix = "what a state adds is multiplied by `dt` already: write an amount per second, without `dt`", None
    if single_amount is not None and not depends_on_step(single_amount) and _is_inside(single_amount.span, line.span):
        fix = Fix(amount.span, _convert_to_per_second(_join_source_lines(single_amount.span)))
        help = f"write `{line_start}{fix.text}`, which is equal at {ASSUMED_FPS} frames a second"
    report.warning("per-frame", f"{quote_source(line.span)} {_PER_FRAME_REASON}", line.span, help, fix=fix)


def _is_dt(expr: Expr | None) -> bool:
    return expr is not None and expr.span.text == "dt" and depends_on_step(expr)


def _check_assignment(line: Assign, has_other_change: bool, report: Report) -> None:
    """Report an assignment with an effect that depends on the frame rate. `has_other_change`: whether another line of the state
    adds to the attribute."""
    name, value = line.attribute, line.value
    makers = find_rate_dependent_operations(value, name, has_other_change)
    if not makers:
        return
    added = "" if depends_on_step(value) else _format_added_rate(value, name)
    fix, display_text, addition = None, "", ""
    if added:
        fix, display_text = Fix(line.span, f"{name} {added}"), f"{name} {added}"
    elif len(makers) == 1 and _is_inside(makers[0].span, line.span) and (text := _format_rate_free(makers[0], name)):
        fix, display_text = Fix(makers[0].span, text), f"{name} = {_replace_part(value.span, makers[0].span, text)}"
        decay = _DECAY_PATTERN.fullmatch(text) if makers[0] is value else None
        addition = f", or `relax to 0 over {decay[1]}` where it is declared" if decay else ""
    if display_text:
        help = f"write `{display_text}`, which is equal at {ASSUMED_FPS} frames a second{addition}"
    elif value.type.kind is TypeKind.BOOL:
        help = f"do it once: in `enter {{ }}`, or in a change: `when after 1 s -> … {{ {_join_source_lines(line.span)} }}`"
    elif any(_is_scaled_by_dt(each, name) for each in makers):
        help = f"to keep a share per second, write `{name} = {name} * exp(-dt / 1 s)`; to add an amount, write `{name} += … /s`"
    else:
        help = f"write an amount per second: `{name} += … /s`; what happens once belongs in `enter {{ }}`"
    labels = tuple(Label(each.span, "it is changed here") for each in makers[:1] if not _is_inside(each.span, line.span))
    report.warning("per-frame", f"{quote_source(line.span)} {_PER_FRAME_REASON}", line.span, help, labels=labels, fix=fix)


def _check_memory(memory: Binding, next_value: Expr, report: Report) -> None:
    makers = find_rate_dependent_operations(next_value, memory)
    if not makers:
        return
    text = _format_rate_free(makers[0], memory) if len(makers) == 1 and _is_inside(makers[0].span, next_value.span) else ""
    help = "write an amount per second, times `dt`"
    if text:
        replacement = f"then {_replace_part(next_value.span, makers[0].span, text)}"
        help = f"write `{replacement}`, which is equal at {ASSUMED_FPS} frames a second"
    fix = Fix(makers[0].span, text) if text else None
    report.warning(
        "per-frame", f"`then {_join_source_lines(next_value.span)}` {_PER_FRAME_REASON}", next_value.span, help, fix=fix
    )


# --- what to write instead -------------------------------------------------------------------------------------------


def _format_added_rate(value: Expr, own_name: str) -> str:
    """Return source text that adds a rate instead of a fixed amount. If `value` is `x + 1` and `own_name` is `x`, the text is
    `+= 24 /s`.

    For `x + gain - 0.1`, it is `+= (gain - 0.1) * 24 /s`. The text is empty for values of other forms."""
    if not isinstance(value, OperationExpr) or value.name not in ("add", "sub"):
        return ""
    left, right = value.args
    assert left is not None and right is not None
    if value.name == "add" and is_update_target(right, own_name) and not reads_update_target(left, own_name):
        return f"+= {_convert_to_per_second(_join_source_lines(left.span))}"
    spine = [value]  # left operands in turn: `x + a - b` is (x + a) - b
    while isinstance(inner := spine[-1].args[0], OperationExpr) and inner.name in ("add", "sub"):
        spine.append(inner)
    first, rest = spine[-1].args
    if first is None or rest is None or not is_update_target(first, own_name) or not _is_inside(first.span, value.span):
        return ""
    if any(op.args[1] is None or reads_update_target(op.args[1], own_name) for op in spine):
        return ""
    if len(spine) == 1:
        return f"{'+=' if value.name == 'add' else '-='} {_convert_to_per_second(_join_source_lines(rest.span))}"
    text = " ".join(value.span.source.text[rest.span.start : value.span.end].split())
    return f"+= {_convert_to_per_second(text)}" if spine[-1].name == "add" and text.count("(") == text.count(")") else ""


def _format_rate_free(op: Expr, update_target: UpdateTarget) -> str:
    """Return the text of an operation that has the same effect per second for all step lengths and can replace `op`. The text is
    empty if the source does not determine such an operation."""
    if not isinstance(op, OperationExpr) or len(op.args) < 2 or op.args[0] is None or op.args[1] is None:
        return ""
    left, right = op.args[:2]
    assert left is not None and right is not None
    if any(depends_on_step(each) for each in op.args if each is not None and not reads_update_target(each, update_target)):
        return ""
    if op.name in ("add", "sub") and is_update_target(left, update_target) and not reads_update_target(right, update_target):
        return (
            f"{left.span.text} {'+' if op.name == 'add' else '-'} {_convert_to_per_second(_join_source_lines(right.span))} * dt"
        )
    if op.name == "add" and is_update_target(right, update_target) and not reads_update_target(left, update_target):
        return f"{right.span.text} + {_convert_to_per_second(_join_source_lines(left.span))} * dt"
    if op.name in ("mul", "div") and is_update_target(left, update_target):
        return _format_decaying_value(left, right, -1 if op.name == "div" else 1)
    if op.name == "mul" and is_update_target(right, update_target):
        return _format_decaying_value(right, left, 1)
    if op.name == "mix" and op.args[2] is not None:
        return _format_mix(op, update_target)
    return ""


def _is_scaled_by_dt(op: Expr, own_name: str) -> bool:
    """Return whether an operation multiplies the attribute `own_name` by `dt`, as in `x * dt`. Such a product is near 0 in a
    short step."""
    return (
        isinstance(op, OperationExpr)
        and op.name == "mul"
        and any(e is not None and depends_on_step(e) and not reads_update_target(e, own_name) for e in op.args)
    )


def _format_decaying_value(target: Expr, factor: Expr, power: int) -> str:
    """Return the text of `target` times a decay factor. The decay factor depends on `dt` and replaces `factor ** power` per
    step. The text is empty if there is no such factor."""
    part = _format_decay_factor(factor, power)
    return f"{target.span.text} * {part}" if part else ""


def _format_mix(op: OperationExpr, update_target: UpdateTarget) -> str:
    """Return the text of a call that replaces `mix(x, goal, 0.1)` and does not depend on the frame rate, or "" if there is none.

    In each step, `mix(x, goal, 0.1)` moves `x` towards `goal` by a tenth of the remaining distance."""
    a, z, share = op.args
    assert a is not None and z is not None and share is not None
    known = find_constant(share)
    if known is None or not 0 < known.number < 1 or reads_update_target(share, update_target):
        return ""
    if is_update_target(a, update_target) and not reads_update_target(z, update_target):
        left_over = _format_exponential(math.log1p(-known.number))
        return f"mix({_join_source_lines(a.span)}, {_join_source_lines(z.span)}, 1 - {left_over})"
    if not is_update_target(z, update_target) or reads_update_target(a, update_target):
        return ""
    return f"mix({_join_source_lines(a.span)}, {_join_source_lines(z.span)}, {_format_exponential(math.log(known.number))})"


def _format_decay_factor(factor: Expr, power: int) -> str:
    """Return a text such as `exp(-dt / 0.4 s)`. It replaces the constant `factor ** power` per step. It is empty if the factor
    is not a positive number without a unit."""
    known = find_constant(factor)
    if known is None or known.unit_power or known.number <= 0 or known.number == 1 or known.type.dimension != Dimension():
        return ""
    return _format_exponential(power * math.log(known.number))


def _format_exponential(rate: float) -> str:
    """Return the text of an exponential of `dt`. `rate`: its exponent per step at 24 frames per second."""
    return f"exp({'-' if rate < 0 else ''}dt / {1 / abs(rate) / ASSUMED_FPS:.3g} s)"


def _convert_to_per_second(text: str) -> str:
    """Return the text of an amount per second that is equal to an amount per step at the assumed frame rate. `24 /s` replaces
    `1`, and `48 mm/s` replaces `2 mm`."""
    literal = QUANTITY_PATTERN.fullmatch(text)
    if literal is not None and "/" not in text:
        return f"{float(literal[1]) * ASSUMED_FPS:.6g} {literal[2] or ''}/s"
    return f"{text if _SIMPLE_TERM_PATTERN.fullmatch(text) else f'({text})'} * {ASSUMED_FPS} /s"


def _join_source_lines(span: Span) -> str:
    return " ".join(span.text.split())


def _is_inside(span: Span, outer_span: Span) -> bool:
    return span.source is outer_span.source and outer_span.start <= span.start and span.end <= outer_span.end


def _replace_part(outer_span: Span, span: Span, text: str) -> str:
    """Return the text of `outer_span` on one line, with the part at `span` replaced by `text`. It is empty if `span` is not
    inside `outer_span`."""
    if not _is_inside(span, outer_span):
        return ""
    prefix, suffix = outer_span.text[: span.start - outer_span.start], outer_span.text[span.end - outer_span.start :]
    return " ".join(f"{prefix}{text}{suffix}".split())
