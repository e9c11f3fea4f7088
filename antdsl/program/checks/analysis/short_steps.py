"""The limit of a value as steps get shorter: whether it depends on its previous value in the same way, and what changes it even
in very short steps.

An update of a value is independent of the frame rate under two conditions. In a step of length 0 the value does not change, and
its change in a short step is proportional to `dt`. Two steps of half the length then change it equally. So each part of an
expression is analysed as `dt` goes to 0: whether it vanishes and how fast, its limit, and whether the previous value passes
through."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from antdsl.program.model import Attribute, Binding, Const, Expr, Inline, Local, Op, Reduce, Thing
from antdsl.program.tables.vocabulary import DRAWS
from antdsl.program.traverse import parts

Own = str | Binding  # the attribute that is set, or the stored memory


class Way(IntEnum):
    """How a value that is read gets into another: not at all, less and less in shorter steps, unchanged, in ways unknown here,
    changed. Unchanged means that doing it twice in a row is the same as once, so the frequency does not matter."""

    NONE = 0
    GONE = 1
    SAME = 2
    UNSURE = 3
    CHANGED = 4


@dataclass(frozen=True, slots=True)
class Short:
    """The behaviour of a value for small `dt`. It is proportional to `dt ** power`; with `power` above 0 it vanishes. `to` is its
    limit, if known. Its deviation from the limit, or from the value read, is proportional to `dt ** off`; infinite if `dt` has no
    influence. `makers`: the first two operations that change the value read. `by`: the operation that causes the deviation, or in
    which the value vanishes."""

    way: Way = Way.NONE
    power: float = 0.0
    to: float | None = None
    off: float = math.inf
    makers: tuple[Expr, ...] = ()
    by: Expr | None = None

    @property
    def vanishes(self) -> bool:
        return self.way <= Way.GONE and self.power > 0

    @property
    def timed(self) -> bool:
        return self.way <= Way.GONE and (self.off < math.inf or self.power < 0 or self.way is Way.GONE)


Below = Sequence[Short]
_UNSURE = Short(Way.UNSURE)
_ASKED = frozenset(("lt", "le", "gt", "ge", "eq", "ne", "is_some", "is_none", "chance", "event", "touching"))
_NOW_AND_THEN = frozenset(("chance", "event"))  # they come as often at any frame rate


def changers(value: Expr, own: Own, driven: bool = False) -> tuple[Expr, ...]:
    """Return the operations, at most two, that change a value however short a step is, or not in proportion to it. Empty if the
    update is independent of the frame rate, or uses the unit `step`, which `--strict` reports. `driven`: something else also
    changes the value."""
    short = _short(value, own, driven)
    if short.way is Way.CHANGED:
        found = short.makers
    else:
        wrong = short.way is Way.GONE or (short.way is Way.SAME and not _like_time(short.off, value))
        found = (short.by,) if wrong and short.by is not None else ()
    return tuple(each for each in found if not _by_step(each))


def is_rate(value: Expr, own: Own) -> bool:
    """Whether a value that is added times `dt` is so much a second, by the same measure."""
    short = _short(value, own, False)
    return short.way is Way.UNSURE or _like_time(short.power + 1, value) or _by_step(value)


def timed(value: Expr) -> bool:
    """Return whether an expression depends on the length of a step."""
    return any(_is_dt(part) or (isinstance(part, Const) and bool(part.step)) for part in parts(value))


def is_own(part: Expr, own: Own) -> bool:
    if isinstance(own, str):
        return isinstance(part, Attribute) and part.of is None and part.name == own
    return isinstance(part, Local) and part.binding is own


def reads(expr: Expr, own: Own) -> bool:
    return any(isinstance(part, Expr) and is_own(part, own) for part in parts(expr))


def _like_time(power: float, value: Expr) -> bool:
    """Return whether something grows with time. A new draw in each step does so by its square, and grows like the root."""
    if power == math.inf or math.isclose(power, 1):
        return True
    return math.isclose(power, 0.5) and any(isinstance(part, Op) and part.name in DRAWS for part in parts(value))


def _by_step(value: Expr) -> bool:
    return any(isinstance(part, Const) and part.step for part in parts(value))


def _is_dt(part: object) -> bool:
    return isinstance(part, Op) and part.name == "run" and isinstance(part.args[0], Thing) and part.args[0].name == "dt"


# --- through an expression -------------------------------------------------------------------------------------------


def _short(value: Expr, own: Own, driven: bool) -> Short:
    known: dict[int, Short] = {}
    for part in _upward(value, own):
        below = [known[id(each)] for each in _below(part, own)]
        if is_own(part, own):
            found = Short(Way.SAME)
        elif isinstance(part, Op):
            found = _chosen(part, below, own, driven) if part.name == "if" else _RULES.get(part.name, _other)(part, below)
        elif isinstance(part, Const):
            found = _constant(part)
        elif isinstance(part, Reduce):
            found = _together(part, below)
            found = found if found.vanishes else Short()  # what is read inside a set is about the others
        else:
            found = below[0] if below else Short()
        known[id(part)] = found
    return known[id(value)]


def _upward(value: Expr, own: Own) -> Iterator[Expr]:
    """Yield the parts of an expression that contribute to its value, each once, operands first."""
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
    if is_own(part, own):
        return []
    if isinstance(part, Local) and part.binding.role in ("let", "argument") and part.binding.value is not None:
        return [part.binding.value]
    if isinstance(part, Inline):
        return [part.result]
    if isinstance(part, Reduce):
        return [part.body] if part.how in ("sum", "mean", "min", "max") and part.body is not None else []
    return [arg for arg in part.args if arg is not None] if isinstance(part, Op) else []


def _constant(part: Const) -> Short:
    if part.number == 0:
        return _gone(math.inf)
    if part.step:
        return _gone(part.step) if part.step > 0 else Short(power=part.step)
    return Short(to=None if part.u else part.number)


# --- one operation ---------------------------------------------------------------------------------------------------


def _gone(power: float, way: Way = Way.NONE, by: Expr | None = None) -> Short:
    return Short(way, power, 0.0, power, by=by)


def _first(below: Iterable[Short], *more: Expr) -> tuple[Expr, ...]:
    return tuple(dict.fromkeys([*(each for one in below for each in one.makers), *more]))[:2]


def _changed(op: Expr, below: Below) -> Short:
    return Short(Way.CHANGED, min([0.0, *(each.power for each in below)]), makers=_first(below, op))


def _kept(own: Short, off: float, by: Expr | None) -> Short:
    """Return the value read, with an added deviation proportional to `dt ** off`."""
    return replace(own, off=off, by=by) if own.way is Way.SAME and off < own.off else own


def _way(below: Below) -> Way:
    return max((each.way for each in below), default=Way.NONE)


def _near(value: float | None, number: float) -> bool:
    return value is not None and math.isclose(value, number, abs_tol=1e-12)


def _sum(op: Op, below: Below) -> Short:
    a, b = below
    if op.name == "sub" and _has_floor(op.args[1]):
        return a  # `x - floor(x)`: put back into its range
    own, other = (a, b) if a.way >= b.way else (b, a)
    if own.way is Way.UNSURE:
        return _UNSURE
    if own.way is Way.CHANGED:
        return replace(own, makers=_first(below, *(() if other.vanishes or other.way is Way.UNSURE else (op,))))
    if own.way is Way.SAME:
        if other.way is Way.SAME or not other.vanishes or (op.name == "sub" and own is b):
            return _changed(op, below)
        return _kept(own, other.power, op)
    off = min(a.off, b.off)
    to = None if a.to is None or b.to is None else a.to - b.to if op.name == "sub" else a.to + b.to
    if _near(to, 0):
        return _gone(off, own.way, own.by)
    return Short(power=min(a.power, b.power, 0.0), to=to, off=off)


def _has_floor(expr: Expr | None) -> bool:
    return any(isinstance(part, Op) and part.name == "floor" for part in parts(expr))


def _product(op: Op, below: Below) -> Short:
    a, b = below
    if Way.UNSURE in (a.way, b.way):
        return _UNSURE
    power = a.power + b.power
    own, other = (a, b) if a.way >= b.way else (b, a)
    if power > 0:
        return _gone(power, min(own.way, Way.GONE), op if own.way >= Way.SAME else own.by)
    if own.way is Way.NONE:
        to = a.to * b.to if a.to is not None and b.to is not None and power == 0 else None
        return Short(power=power, to=to, off=min(a.off, b.off))
    if own.way >= Way.SAME and other.way is Way.NONE and _near(other.to, 1):
        return _kept(own, other.off, op)
    return replace(_changed(op, below), power=power)


def _quotient(op: Op, below: Below) -> Short:
    a, b = below
    if b.way > Way.GONE:
        return _product(op, (a, b if b.way is Way.UNSURE else _changed(op, (b,))))
    if b.power == math.inf:
        return _UNSURE
    return _product(op, (a, Short(b.way, -b.power, 1 / b.to if b.to else None, b.off if b.to else math.inf, by=b.by)))


def _negative(op: Op, below: Below) -> Short:
    a = below[0]
    if a.way is Way.UNSURE or a.way <= Way.GONE:
        return replace(a, to=None if a.to is None else -a.to)
    return _changed(op, below)


def _root(op: Op, below: Below) -> Short:
    return _raised(op, (*below, Short(to=0.5)))


def _raised(op: Op, below: Below) -> Short:
    a, b = below
    if Way.UNSURE in (a.way, b.way) or b.way is Way.GONE:
        return _UNSURE
    if b.way > Way.GONE or a.way > Way.GONE:
        if a.way is Way.SAME and _near(b.to, 1):
            return a if b.off == math.inf else _UNSURE
        return _UNSURE if b.timed else _changed(op, below)
    if b.to is None:
        return _UNSURE if a.timed or b.timed else Short()
    if b.vanishes:
        return Short(to=1.0, off=b.off) if a.power == 0 else _UNSURE
    if a.power and not b.timed:
        return _gone(a.power * b.to, a.way, a.by) if a.power * b.to > 0 else Short(power=a.power * b.to)
    return Short(to=None if a.to is None else _worth(lambda x: x ** (b.to or 0.0), a.to), off=min(a.off, b.off))


def _worth(function: Callable[[float], float], at: float) -> float | None:
    try:
        found = function(at)
    except (ValueError, OverflowError, ZeroDivisionError):
        return None
    return found if isinstance(found, float) and math.isfinite(found) else None


def _function(function: Callable[[float], float]) -> Callable[[Op, Below], Short]:
    def rule(op: Op, below: Below) -> Short:
        a = below[0]
        if a.way > Way.GONE:
            return _UNSURE if a.way is Way.UNSURE else _changed(op, below)
        if a.power < 0:
            return _UNSURE
        to = None if a.to is None else _worth(function, a.to)
        return _gone(a.off, a.way, a.by) if _near(to, 0) else Short(to=to, off=a.off)

    return rule


def _mixed(op: Op, below: Below) -> Short:
    a, b, share = below
    if share.way is Way.UNSURE:
        return _UNSURE
    for side, end in ((a, 0), (b, 1)):
        if share.way <= Way.GONE and _near(share.to, end):
            if side.way is Way.NONE:
                return replace(side, off=min(side.off, share.off), power=min(side.power, share.off) if side.power else 0.0)
            return _kept(side, share.off, op)
    return _together(op, below[:2]) if share.way is Way.NONE else _changed(op, below)


def _turned(op: Op, below: Below) -> Short:
    own, by = below[0], below[-1]
    if not by.vanishes:
        return _together(op, below)
    return _kept(own, by.power, op) if own.way >= Way.SAME else own


def _together(op: Expr, below: Below) -> Short:
    """Made of several, as a vector of its numbers and a draw between two ends: it vanishes where all of them do."""
    way = _way(below)
    if way >= Way.SAME:
        return _UNSURE if way is Way.UNSURE else _changed(op, below)
    if below and all(each.vanishes for each in below):
        return _gone(min(each.power for each in below), way, next((each.by for each in below if each.by), None))
    return Short(power=min([0.0, *(each.power for each in below)]), off=min((each.off for each in below), default=math.inf))


def _of_the_first(op: Op, below: Below) -> Short:
    """Analyse a length or a component of a vector: it vanishes if the vector does."""
    a = below[0]
    return a if a.way <= Way.GONE else _as_it_is(op, below) if op.name != "length" else _together(op, below[:1])


def _as_it_is(op: Op, below: Below) -> Short:
    way = _way(below)
    if way is Way.CHANGED:
        return replace(next(each for each in below if each.way is way), makers=_first(below))
    if way is Way.SAME:
        return min((each for each in below if each.way is way), key=lambda each: each.off)
    return _other(op, below)


def _bounded(op: Op, below: Below) -> Short:
    """Analyse `min`, `max` and `clamp`: for known numbers, the result is known."""
    tos = [each.to for each in below if each.to is not None]
    if _way(below) > Way.GONE or len(tos) < len(below):
        return _as_it_is(op, below)
    to = min(max(tos[0], tos[1]), tos[2]) if op.name == "clamp" else min(tos) if op.name == "min" else max(tos)
    left = [each for each in below if each.to == to]
    off = min(each.off for each in left)
    by = next((each.by for each in left if each.by), None)
    return _gone(off, _way(left), by) if _near(to, 0) else Short(to=to, off=off)


def _chosen(op: Op, below: Below, own: Own, driven: bool) -> Short:
    """Analyse `if`. Changes by chance or by an event happen equally often at any rate. A value that another line drives out of
    its range is only moved back: `if turn > 1 then turn - 1 else turn`."""
    test, *ends = op.args
    assert test is not None
    branches = below[1:]
    way = _way(branches)
    if way < Way.SAME:
        return _together(op, branches)
    back = driven and reads(test, own) and any(end is not None and is_own(end, own) for end in ends)
    if back or any(isinstance(each, Op) and each.name in _NOW_AND_THEN for each in parts(test)):
        return Short(Way.SAME)
    lost = [each.by for each in branches if each.way is Way.GONE and each.by is not None]
    return Short(Way.CHANGED, makers=_first(branches, *lost)) if lost and way is not Way.UNSURE else _as_it_is(op, branches)


def _asked(op: Op, below: Below) -> Short:
    return Short()  # an answer; what is done by it is seen where it is used


def _run(op: Op, below: Below) -> Short:
    return _gone(1.0) if _is_dt(op) else Short()


def _other(op: Op, below: Below) -> Short:
    way = _way(below)
    if way is Way.UNSURE or any(each.timed for each in below):
        return _UNSURE
    return _changed(op, below) if way >= Way.SAME else Short()


_RULES: dict[str, Callable[[Op, Below], Short]] = {
    "add": _sum, "sub": _sum, "mul": _product, "div": _quotient, "dot": _product, "cross": _product, "neg": _negative,
    "pow": _raised, "sqrt": _root, "exp": _function(math.exp), "log": _function(math.log), "sin": _function(math.sin),
    "cos": _function(math.cos), "mix": _mixed, "rotate": _turned, "run": _run,
    "min": _bounded, "max": _bounded, "clamp": _bounded,
    "abs": _of_the_first, "limit": _of_the_first, "project": _of_the_first, "length": _of_the_first,
    **dict.fromkeys(("first", "floor", "unit", "and", "or"), _as_it_is),
    **dict.fromkeys(("vector", "uniform", "normal", "pick"), _together),
    **dict.fromkeys(_ASKED, _asked),
}  # fmt: skip
