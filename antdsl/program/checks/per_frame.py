"""Values that change by so much each time: a state's lines run in every step, so how fast they change depends on the frame rate.

What is looked for is an assignment that reads what it sets, and a `keep` whose next value is made of the one before: by going
through the expression, whether the value that is read gets to the one that is set as it is, or is changed on the way."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from enum import IntEnum

from antdsl.diagnostics import Fix, Label, Report
from antdsl.program.checks.checked import Checked
from antdsl.program.checks.steps import FPS
from antdsl.program.folding import constant_behind
from antdsl.program.model import Assign, Attribute, Binding, Const, Dim, Expr, Inline, Kind, Local, Op, Thing
from antdsl.program.walk import parts
from antdsl.program.wording import quoted
from antdsl.source import Span


class _Way(IntEnum):
    """How a value that is read gets into another: not at all, as it is, changed. As it is means that doing it twice in a row is
    the same as once, so that it does not matter how often it is done."""

    NONE = 0
    SAME = 1
    CHANGED = 2


Own = str | Binding  # the attribute that is set, or the memory that is kept
_AS_IT_IS = frozenset(("min", "max", "clamp", "first", "abs", "floor", "unit", "limit", "project", "and", "or"))
_ASKED = frozenset(("lt", "le", "gt", "ge", "eq", "ne", "is_some", "is_none", "chance", "event", "touching"))
_NOW_AND_THEN = frozenset(("chance", "event"))  # they come as often at any frame rate
_LITERAL = re.compile(r"([0-9][0-9.]*(?:e[+-]?[0-9]+)?)\s*(%|[a-z]+)?")
_DECAY = re.compile(r"\w+ \* exp\(-dt / ([0-9.e+-]+ s)\)")
_SO = "happens in every step, so it depends on the frames per second"
_SIMPLE = re.compile(r"[\w.]+(\([^()]*\))?")


def per_frame(checked: Checked, report: Report) -> None:
    for species in checked.program.species.values():
        for machine in species.machines:
            for state in machine.states:
                lines = [line for line in state.body if isinstance(line, Assign) and line.of is None]
                driven = {line.attribute for line in lines if line.op != "="}
                for line in lines:
                    if line.op == "=":
                        _assignment(line, line.attribute in driven, report)
        for part in parts((species.machines, species.layers)):
            if isinstance(part, Binding) and part.role == "keep" and part.then is not None:
                _memory(part, part.then, report)


def _assignment(line: Assign, driven: bool, report: Report) -> None:
    """`driven`: another line of the state adds to the attribute."""
    name, value = line.attribute, line.value
    makers = _makers(value, name, driven)
    if not makers:
        return
    added = _added(value, name)
    fix, shown, more = None, "", ""
    if added:
        fix, shown = Fix(line.span, f"{name} {added}"), f"{name} {added}"
    elif len(makers) == 1 and _inside(makers[0].span, line.span) and (text := _rewritten(makers[0], name)):
        fix, shown = Fix(makers[0].span, text), f"{name} = {_replaced(value.span, makers[0].span, text)}"
        decay = _DECAY.fullmatch(text) if makers[0] is value else None
        more = f", or `relax to 0 over {decay[1]}` where it is declared" if decay else ""
    if shown:
        help = f"write `{shown}`, which is as much at {FPS} frames a second{more}"
    elif value.type.kind is Kind.BOOL:
        help = f"do it once: in `enter {{ }}`, or in a change: `when after 1 s -> … {{ {_text(line.span)} }}`"
    else:
        help = f"say how much a second: `{name} += … /s`; what happens once belongs into `enter {{ }}`"
    labels = tuple(Label(each.span, "here it is changed") for each in makers[:1] if not _inside(each.span, line.span))
    report.warning("per-frame", f"{quoted(line.span)} {_SO}", line.span, help, labels=labels, fix=fix)


def _memory(keep: Binding, then: Expr, report: Report) -> None:
    makers = _makers(then, keep, False)
    if not makers:
        return
    text = _rewritten(makers[0], keep) if len(makers) == 1 and _inside(makers[0].span, then.span) else ""
    help = "say how much a second, times `dt`"
    if text:
        help = f"write `then {_replaced(then.span, makers[0].span, text)}`, which is as much at {FPS} frames a second"
    fix = Fix(makers[0].span, text) if text else None
    report.warning("per-frame", f"`then {_text(then.span)}` {_SO}", then.span, help, fix=fix)


# --- what is changed -------------------------------------------------------------------------------------------------


def _makers(value: Expr, own: Own, driven: bool) -> list[Expr]:
    """The operations that change what an expression reads of `own`, the innermost first; none where nothing does, or where it
    minds how long a step lasts: by `dt`, or by the unit `step`, of which `--strict` tells."""
    ways: dict[int, _Way] = {}
    found: list[Expr] = []
    for part in _upward(value, own):
        if _is_own(part, own):
            ways[id(part)] = _Way.SAME
            continue
        below = [ways[id(each)] for each in _below(part, own)]
        ways[id(part)] = way = _way(part, below, own, driven)
        if way is _Way.CHANGED and isinstance(part, Op) and part.name not in _AS_IT_IS and part.name != "if":
            found.append(part)
    if ways[id(value)] is not _Way.CHANGED or any(_timed(part) for part in parts(value)):
        return []
    return found


def _upward(value: Expr, own: Own) -> Iterator[Expr]:
    """The parts of an expression as far as values come from them, each once, those that others are made of first."""
    stack: list[tuple[Expr, bool]] = [(value, False)]
    seen: set[int] = set()
    while stack:
        part, done = stack.pop()
        if done:
            yield part
        elif id(part) not in seen:
            seen.add(id(part))
            stack.append((part, True))
            stack += [(each, False) for each in reversed(_below(part, own))]


def _below(part: Expr, own: Own) -> list[Expr]:
    if _is_own(part, own):
        return []
    if isinstance(part, Local) and part.binding.role in ("let", "argument") and part.binding.value is not None:
        return [part.binding.value]
    if isinstance(part, Inline):
        return [part.result]
    return [arg for arg in part.args if arg is not None] if isinstance(part, Op) else []


def _is_own(part: Expr, own: Own) -> bool:
    if isinstance(own, str):
        return isinstance(part, Attribute) and part.of is None and part.name == own
    return isinstance(part, Local) and part.binding is own


def _way(part: Expr, below: list[_Way], own: Own, driven: bool) -> _Way:
    way = max(below, default=_Way.NONE)
    if not isinstance(part, Op) or way is _Way.NONE or part.name in _AS_IT_IS:
        return way
    if part.name in _ASKED:
        return _Way.NONE  # an answer; what is done by it is seen where it is used
    if part.name == "if":
        return _chosen(part, below, own, driven)
    if (
        part.name == "sub"
        and part.args[1] is not None
        and any(isinstance(p, Op) and p.name == "floor" for p in parts(part.args[1]))
    ):
        return below[0]  # `x - floor(x)`: put back into its range
    return _Way.CHANGED


def _chosen(part: Op, below: list[_Way], own: Own, driven: bool) -> _Way:
    """Of `if`. What happens by chance or by an event happens as often at any rate. What another line drives out of its range
    is only put back: `if turn > 1 then turn - 1 else turn`."""
    test = part.args[0]
    assert test is not None
    if any(isinstance(each, Op) and each.name in _NOW_AND_THEN for each in parts(test)):
        return _Way.SAME
    back = driven and _reads(test, own) and any(arg is not None and _is_own(arg, own) for arg in part.args[1:])
    return _Way.SAME if back else max(below[1:])


def _timed(part: object) -> bool:
    if isinstance(part, Const):
        return bool(part.step)
    return isinstance(part, Op) and part.name == "run" and isinstance(part.args[0], Thing) and part.args[0].name == "dt"


# --- what to write instead -------------------------------------------------------------------------------------------


def _added(value: Expr, own: str) -> str:
    """`+= 24 /s` for `x + 1`, `+= (gain - 0.1) * 24 /s` for `x + gain - 0.1`; empty for anything else."""
    if not isinstance(value, Op) or value.name not in ("add", "sub"):
        return ""
    left, right = value.args
    assert left is not None and right is not None
    if value.name == "add" and _is_own(right, own) and not _reads(left, own):
        return f"+= {_a_second(_text(left.span))}"
    spine = [value]  # `x + a - b` is a difference of which the left side is a sum
    while isinstance(inner := spine[-1].args[0], Op) and inner.name in ("add", "sub"):
        spine.append(inner)
    first, rest = spine[-1].args
    if first is None or rest is None or not _is_own(first, own) or not _inside(first.span, value.span):
        return ""
    if any(op.args[1] is None or _reads(op.args[1], own) for op in spine):
        return ""
    if len(spine) == 1:
        return f"{'+=' if value.name == 'add' else '-='} {_a_second(_text(rest.span))}"
    text = " ".join(value.span.source.text[rest.span.start : value.span.end].split())
    return f"+= {_a_second(text)}" if spine[-1].name == "add" and text.count("(") == text.count(")") else ""


def _rewritten(op: Expr, own: Own) -> str:
    """The same operation for however long a step lasts; empty where that cannot be told from the text."""
    if not isinstance(op, Op) or len(op.args) < 2 or op.args[0] is None or op.args[1] is None:
        return ""
    left, right = op.args[:2]
    assert left is not None and right is not None
    if op.name in ("add", "sub") and _is_own(left, own) and not _reads(right, own):
        return f"{left.span.text} {'+' if op.name == 'add' else '-'} {_a_second(_text(right.span))} * dt"
    if op.name == "add" and _is_own(right, own) and not _reads(left, own):
        return f"{right.span.text} + {_a_second(_text(left.span))} * dt"
    if op.name in ("mul", "div") and _is_own(left, own):
        return _decay(left, right, -1 if op.name == "div" else 1)
    if op.name == "mul" and _is_own(right, own):
        return _decay(right, left, 1)
    if op.name == "mix" and op.args[2] is not None:
        return _mixed(op, own)
    return ""


def _decay(own: Expr, factor: Expr, power: int) -> str:
    part = _share(factor, power)
    return f"{own.span.text} * {part}" if part else ""


def _mixed(op: Op, own: Own) -> str:
    """`mix(x, goal, 0.1)`: a tenth of the way in each step."""
    a, z, share = op.args
    assert a is not None and z is not None and share is not None
    known = constant_behind(share)
    if known is None or not 0 < known.number < 1 or _reads(share, own):
        return ""
    if _is_own(a, own) and not _reads(z, own):
        return f"mix({_text(a.span)}, {_text(z.span)}, 1 - {_exp(math.log1p(-known.number))})"
    return (
        f"mix({_text(a.span)}, {_text(z.span)}, {_exp(math.log(known.number))})" if _is_own(z, own) and not _reads(a, own) else ""
    )


def _share(factor: Expr, power: int) -> str:
    """`exp(-dt / 0.4 s)` for a factor in each step."""
    known = constant_behind(factor)
    if known is None or known.u or known.number <= 0 or known.number == 1 or known.type.dim != Dim():
        return ""
    return _exp(power * math.log(known.number))


def _exp(rate: float) -> str:
    return f"exp({'-' if rate < 0 else ''}dt / {1 / abs(rate) / FPS:.3g} s)"


def _a_second(text: str) -> str:
    """An amount a step as one a second: `1` as `24 /s`, `2 mm` as `48 mm/s`, `gain` as `gain * 24 /s`."""
    literal = _LITERAL.fullmatch(text)
    if literal is not None:
        return f"{float(literal[1]) * FPS:.6g} {literal[2] or ''}/s"
    return f"{text if _SIMPLE.fullmatch(text) else f'({text})'} * {FPS} /s"


def _reads(expr: Expr, own: Own) -> bool:
    return any(isinstance(part, Expr) and _is_own(part, own) for part in parts(expr))


def _text(span: Span) -> str:
    return " ".join(span.text.split())


def _inside(span: Span, whole: Span) -> bool:
    return span.source is whole.source and whole.start <= span.start and span.end <= whole.end


def _replaced(whole: Span, span: Span, text: str) -> str:
    """The text of a place with a part of it replaced."""
    if not _inside(span, whole):
        return ""
    before, after = whole.text[: span.start - whole.start], whole.text[span.end - whole.start :]
    return " ".join(f"{before}{text}{after}".split())
