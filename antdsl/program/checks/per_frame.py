"""Reports values that change by a fixed amount per step, so that the speed of change depends on the frame rate.

The check uses the limit of each value as steps get shorter. It examines:
- assignments that read the attribute they set,
- each `keep` that is computed from its previous value,
- added amounts that should be per second but are not."""

from __future__ import annotations

import math
import re

from antdsl.diagnostics import Fix, Label, Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.program.checks.analysis.short_steps import OwnValue, depends_on_step, find_changers, is_own, is_rate, reads
from antdsl.program.checks.steps import FILM_FPS
from antdsl.program.model import Assign, Binding, Dimension, EffectRequest, Expr, Give, OperationExpr, State, TypeKind
from antdsl.program.traverse import parts
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import constant_behind
from antdsl.source import Span
from antdsl.syntax.words import QUANTITY_PATTERN

_DECAY_PATTERN = re.compile(r"\w+ \* exp\(-dt / ([0-9.e+-]+ s)\)")
_PER_FRAME_REASON = "happens in every step, so it depends on the frames per second"
_SIMPLE_TERM_PATTERN = re.compile(r"[\w.]+(\([^()]*\))?")


def check_per_frame(checked: CheckContext, report: Report) -> None:
    """Report assignments, memories and added amounts of which the speed depends on the frame rate."""
    for species in checked.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                _check_lines(state, report)
        for part in parts((species.machines, species.layers)):
            if isinstance(part, Binding) and part.role == "keep" and part.then is not None:
                _check_memory(part, part.then, report)


def _check_lines(state: State, report: Report) -> None:
    own = [line for line in state.body if isinstance(line, Assign) and line.of is None]
    driven = {line.attribute for line in own if line.op != "="}
    for line in state.body:
        if isinstance(line, Assign) and line.op == "=" and line.of is None:
            _check_assignment(line, line.attribute in driven, report)
        elif isinstance(line, Assign):
            _check_rate(line, line.value, line.attribute, line.per_second, f"{line.attribute} {line.op} ", report)
        elif isinstance(line, Give) and line.amount is not None:
            _check_rate(line, line.amount, line.attribute, line.per_second, "", report)
        elif isinstance(line, EffectRequest) and line.args and line.args[0] is not None:
            _check_rate(line, line.args[0], line.of, line.per_second, "", report)


def _check_rate(
    line: Assign | EffectRequest | Give, amount: Expr, own: str, per_second: bool, begins: str, report: Report
) -> None:
    """Report an amount that a state adds, if it is not an amount per second. The language multiplies such amounts by `dt`."""
    if not per_second or is_rate(amount, own):
        return
    single_amount = (
        amount.args[0] if isinstance(amount, OperationExpr) and amount.name == "div" and _is_dt(amount.args[1]) else None
    )
    help, fix = "what a state adds is multiplied by `dt` already: write an amount per second, without `dt`", None
    if single_amount is not None and not depends_on_step(single_amount) and _is_inside(single_amount.span, line.span):
        fix = Fix(amount.span, _per_second_text(_source_text(single_amount.span)))
        help = f"write `{begins}{fix.text}`, which is as much at {FILM_FPS} frames a second"
    report.warning("per-frame", f"{quote_source(line.span)} {_PER_FRAME_REASON}", line.span, help, fix=fix)


def _is_dt(expr: Expr | None) -> bool:
    return expr is not None and expr.span.text == "dt" and depends_on_step(expr)


def _check_assignment(line: Assign, driven: bool, report: Report) -> None:
    """Report an assignment of which the effect depends on the frame rate. `driven`: another line of the state adds to the
    attribute."""
    name, value = line.attribute, line.value
    makers = find_changers(value, name, driven)
    if not makers:
        return
    added = "" if depends_on_step(value) else _added_rate_text(value, name)
    fix, display_text, addition = None, "", ""
    if added:
        fix, display_text = Fix(line.span, f"{name} {added}"), f"{name} {added}"
    elif len(makers) == 1 and _is_inside(makers[0].span, line.span) and (text := _rate_free_text(makers[0], name)):
        fix, display_text = Fix(makers[0].span, text), f"{name} = {_replace_part(value.span, makers[0].span, text)}"
        decay = _DECAY_PATTERN.fullmatch(text) if makers[0] is value else None
        addition = f", or `relax to 0 over {decay[1]}` where it is declared" if decay else ""
    if display_text:
        help = f"write `{display_text}`, which is as much at {FILM_FPS} frames a second{addition}"
    elif value.type.kind is TypeKind.BOOL:
        help = f"do it once: in `enter {{ }}`, or in a change: `when after 1 s -> … {{ {_source_text(line.span)} }}`"
    elif any(_is_vanishing(each, name) for each in makers):
        help = f"to keep a share per second, write `{name} = {name} * exp(-dt / 1 s)`; to add an amount, write `{name} += … /s`"
    else:
        help = f"write an amount per second: `{name} += … /s`; what happens once belongs in `enter {{ }}`"
    labels = tuple(Label(each.span, "it is changed here") for each in makers[:1] if not _is_inside(each.span, line.span))
    report.warning("per-frame", f"{quote_source(line.span)} {_PER_FRAME_REASON}", line.span, help, labels=labels, fix=fix)


def _check_memory(keep: Binding, then: Expr, report: Report) -> None:
    makers = find_changers(then, keep)
    if not makers:
        return
    text = _rate_free_text(makers[0], keep) if len(makers) == 1 and _is_inside(makers[0].span, then.span) else ""
    help = "write an amount per second, times `dt`"
    if text:
        help = f"write `then {_replace_part(then.span, makers[0].span, text)}`, which is as much at {FILM_FPS} frames a second"
    fix = Fix(makers[0].span, text) if text else None
    report.warning("per-frame", f"`then {_source_text(then.span)}` {_PER_FRAME_REASON}", then.span, help, fix=fix)


# --- what to write instead -------------------------------------------------------------------------------------------


def _added_rate_text(value: Expr, own: str) -> str:
    """Return a rewrite that adds a rate: `+= 24 /s` for `x + 1`, `+= (gain - 0.1) * 24 /s` for `x + gain - 0.1`. Empty for other
    forms."""
    if not isinstance(value, OperationExpr) or value.name not in ("add", "sub"):
        return ""
    left, right = value.args
    assert left is not None and right is not None
    if value.name == "add" and is_own(right, own) and not reads(left, own):
        return f"+= {_per_second_text(_source_text(left.span))}"
    spine = [value]  # left operands in turn: `x + a - b` is (x + a) - b
    while isinstance(inner := spine[-1].args[0], OperationExpr) and inner.name in ("add", "sub"):
        spine.append(inner)
    first, rest = spine[-1].args
    if first is None or rest is None or not is_own(first, own) or not _is_inside(first.span, value.span):
        return ""
    if any(op.args[1] is None or reads(op.args[1], own) for op in spine):
        return ""
    if len(spine) == 1:
        return f"{'+=' if value.name == 'add' else '-='} {_per_second_text(_source_text(rest.span))}"
    text = " ".join(value.span.source.text[rest.span.start : value.span.end].split())
    return f"+= {_per_second_text(text)}" if spine[-1].name == "add" and text.count("(") == text.count(")") else ""


def _rate_free_text(op: Expr, own: OwnValue) -> str:
    """Return the text of an operation with the same effect per second at any step length. Empty if the source does not determine
    it."""
    if not isinstance(op, OperationExpr) or len(op.args) < 2 or op.args[0] is None or op.args[1] is None:
        return ""
    left, right = op.args[:2]
    assert left is not None and right is not None
    if any(depends_on_step(each) for each in op.args if each is not None and not reads(each, own)):
        return ""
    if op.name in ("add", "sub") and is_own(left, own) and not reads(right, own):
        return f"{left.span.text} {'+' if op.name == 'add' else '-'} {_per_second_text(_source_text(right.span))} * dt"
    if op.name == "add" and is_own(right, own) and not reads(left, own):
        return f"{right.span.text} + {_per_second_text(_source_text(left.span))} * dt"
    if op.name in ("mul", "div") and is_own(left, own):
        return _decay(left, right, -1 if op.name == "div" else 1)
    if op.name == "mul" and is_own(right, own):
        return _decay(right, left, 1)
    if op.name == "mix" and op.args[2] is not None:
        return _mix_text(op, own)
    return ""


def _is_vanishing(op: Expr, own: str) -> bool:
    """Return whether the operation multiplies the value by `dt`, as in `x * dt`. The value then vanishes in a short step."""
    return (
        isinstance(op, OperationExpr)
        and op.name == "mul"
        and any(e is not None and depends_on_step(e) and not reads(e, own) for e in op.args)
    )


def _decay(own: Expr, factor: Expr, power: int) -> str:
    part = _share(factor, power)
    return f"{own.span.text} * {part}" if part else ""


def _mix_text(op: OperationExpr, own: OwnValue) -> str:
    """Return a rewrite of `mix(x, goal, 0.1)` that does not depend on the frame rate. The original covers a tenth of the distance
    per step. Empty if there is none."""
    a, z, share = op.args
    assert a is not None and z is not None and share is not None
    known = constant_behind(share)
    if known is None or not 0 < known.number < 1 or reads(share, own):
        return ""
    if is_own(a, own) and not reads(z, own):
        return f"mix({_source_text(a.span)}, {_source_text(z.span)}, 1 - {_exp(math.log1p(-known.number))})"
    if not is_own(z, own) or reads(a, own):
        return ""
    return f"mix({_source_text(a.span)}, {_source_text(z.span)}, {_exp(math.log(known.number))})"


def _share(factor: Expr, power: int) -> str:
    """Return a text such as `exp(-dt / 0.4 s)`, which replaces a constant factor per step. Empty if the factor has no such
    form."""
    known = constant_behind(factor)
    if known is None or known.u or known.number <= 0 or known.number == 1 or known.type.dim != Dimension():
        return ""
    return _exp(power * math.log(known.number))


def _exp(rate: float) -> str:
    return f"exp({'-' if rate < 0 else ''}dt / {1 / abs(rate) / FILM_FPS:.3g} s)"


def _per_second_text(text: str) -> str:
    """Convert the text of an amount per step to an amount per second: `1` to `24 /s`, `2 mm` to `48 mm/s`, `gain` to `gain * 24
    /s`."""
    literal = QUANTITY_PATTERN.fullmatch(text)
    if literal is not None and "/" not in text:
        return f"{float(literal[1]) * FILM_FPS:.6g} {literal[2] or ''}/s"
    return f"{text if _SIMPLE_TERM_PATTERN.fullmatch(text) else f'({text})'} * {FILM_FPS} /s"


def _source_text(span: Span) -> str:
    return " ".join(span.text.split())


def _is_inside(span: Span, outer: Span) -> bool:
    return span.source is outer.source and outer.start <= span.start and span.end <= outer.end


def _replace_part(outer: Span, span: Span, text: str) -> str:
    """Return the text of `outer` on one line, with the part at `span` replaced by `text`. Empty if `span` is not inside
    `outer`."""
    if not _is_inside(span, outer):
        return ""
    prefix, suffix = outer.text[: span.start - outer.start], outer.text[span.end - outer.start :]
    return " ".join(f"{prefix}{text}{suffix}".split())
