"""Computes the limit of an updated value as the step length `dt` goes to 0, to find updates that depend on the frame rate.

An update is independent of the frame rate under two conditions. In a step of length 0 the value does not change, and in a short
step the change is proportional to `dt`. Then two steps of half the length change the value as much as one step. The analysis
therefore examines each part of an expression for small `dt`: how fast it vanishes, its limit, and whether it contains the
previous value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from antdsl.program.model import Constant, Expr, InlinedBehaviour, OperationExpr, ReduceExpr
from antdsl.program.tables.vocabulary import DRAWING_OPERATIONS
from antdsl.program.traverse import parts
from antdsl.program.typed import AttributeRef, Binding, BindingRef, ThingRef

OwnValue = str | Binding  # the attribute that an update sets, or the memory


class StepInfluence(IntEnum):
    """The influence of the previous value on a result: none, vanishing in short steps, unchanged (SAME), unknown or changed. For
    SAME, two updates in a row equal one, so the number of updates per second does not matter."""

    NONE = 0
    VANISHING = 1
    SAME = 2
    UNSURE = 3
    CHANGED = 4


@dataclass(frozen=True, slots=True)
class ShortStepValue:
    """The behaviour of a value for small `dt`. It is proportional to `dt ** power`; if `power` is above 0, it vanishes.
    - `to`: the limit, if it is known. `makers`: the first two operations that change the previous value.
    - `off`: the deviation from the limit or previous value is proportional to `dt ** off`; infinite if `dt` has no influence.
    - `by`: the operation that causes the deviation, or in which the value vanishes."""

    influence: StepInfluence = StepInfluence.NONE
    power: float = 0.0
    to: float | None = None
    off: float = math.inf
    makers: tuple[Expr, ...] = ()
    by: Expr | None = None

    @property
    def vanishes(self) -> bool:
        return self.influence <= StepInfluence.VANISHING and self.power > 0

    @property
    def depends_on_dt(self) -> bool:
        changes = self.off < math.inf or self.power < 0 or self.influence is StepInfluence.VANISHING
        return changes and self.influence <= StepInfluence.VANISHING


OperandValues = Sequence[ShortStepValue]
_UNSURE_VALUE = ShortStepValue(StepInfluence.UNSURE)
_QUERY_OPERATIONS = frozenset(("lt", "le", "gt", "ge", "eq", "ne", "is_some", "is_none", "chance", "event", "touching"))
_RATE_FREE_OPERATIONS = frozenset(("chance", "event"))  # equally frequent at any frame rate


def find_changers(value: Expr, own: OwnValue, driven: bool = False) -> tuple[Expr, ...]:
    """Return at most two operations that change a value even for `dt` near 0, or not in proportion to `dt`. The result is empty
    if the update is independent of the frame rate, or uses the unit `step`, which `--strict` reports. `driven`: another line also
    changes it."""
    short = _analyse(value, own, driven)
    if short.influence is StepInfluence.CHANGED:
        makers = short.makers
    else:
        is_slow = short.influence is StepInfluence.SAME and not _grows_with_time(short.off, value)
        wrong = is_slow or short.influence is StepInfluence.VANISHING
        makers = (short.by,) if wrong and short.by is not None else ()
    return tuple(each for each in makers if not _uses_step_unit(each))


def is_rate(value: Expr, own: OwnValue) -> bool:
    """Return whether `value` is an amount per second. `value` is the operand that an update multiplies by `dt` and adds."""
    short = _analyse(value, own, False)
    return short.influence is StepInfluence.UNSURE or _grows_with_time(short.power + 1, value) or _uses_step_unit(value)


def depends_on_step(value: Expr) -> bool:
    """Return whether an expression depends on the length of a step."""
    return any(_is_dt(part) or (isinstance(part, Constant) and bool(part.step)) for part in parts(value))


def is_own(part: Expr, own: OwnValue) -> bool:
    if isinstance(own, str):
        return isinstance(part, AttributeRef) and part.of is None and part.name == own
    return isinstance(part, BindingRef) and part.binding is own


def reads(expr: Expr, own: OwnValue) -> bool:
    return any(isinstance(part, Expr) and is_own(part, own) for part in parts(expr))


def _grows_with_time(power: float, value: Expr) -> bool:
    """Return whether the sum of a value proportional to `dt ** power` grows with time. If it has draws, the deviation may grow as
    the root."""
    has_draw = any(isinstance(part, OperationExpr) and part.name in DRAWING_OPERATIONS for part in parts(value))
    return power == math.inf or math.isclose(power, 1) or (has_draw and math.isclose(power, 0.5))


def _uses_step_unit(value: Expr) -> bool:
    return any(isinstance(part, Constant) and part.step for part in parts(value))


def _is_dt(part: object) -> bool:
    if not isinstance(part, OperationExpr) or part.name != "run":
        return False
    return isinstance(part.args[0], ThingRef) and part.args[0].name == "dt"


# --- through an expression -------------------------------------------------------------------------------------------


def _analyse(value: Expr, own: OwnValue, driven: bool) -> ShortStepValue:
    known: dict[int, ShortStepValue] = {}
    for part in _dependencies(value, own):
        below = [known[id(each)] for each in _operands(part, own)]
        if is_own(part, own):
            short = ShortStepValue(StepInfluence.SAME)
        elif isinstance(part, OperationExpr) and part.name == "if":
            short = _conditional(part, below, own, driven)
        elif isinstance(part, OperationExpr):
            short = _ANALYSIS_RULES.get(part.name, _unknown_operation)(part, below)
        elif isinstance(part, Constant):
            short = _constant_value(part)
        elif isinstance(part, ReduceExpr):
            short = _combination(part, below)
            short = short if short.vanishes else ShortStepValue()  # values inside a set belong to other agents
        else:
            short = below[0] if below else ShortStepValue()
        known[id(part)] = short
    return known[id(value)]


def _dependencies(value: Expr, own: OwnValue) -> Iterator[Expr]:
    """Yield the parts of an expression that contribute to its value. Each part comes once, operands before operations."""
    stack: list[tuple[Expr, bool]] = [(value, False)]
    visited: set[int] = set()
    while stack:
        part, is_expanded = stack.pop()
        if is_expanded:
            yield part
        elif id(part) not in visited:
            visited.add(id(part))
            stack.append((part, True))
            stack += [(each, False) for each in reversed(_operands(part, own))]


def _operands(part: Expr, own: OwnValue) -> list[Expr]:
    if is_own(part, own):
        return []
    if isinstance(part, BindingRef) and part.binding.role in ("let", "argument") and part.binding.value is not None:
        return [part.binding.value]
    if isinstance(part, InlinedBehaviour):
        return [part.result]
    if isinstance(part, ReduceExpr):
        return [part.body] if part.how in ("sum", "mean", "min", "max") and part.body is not None else []
    return [arg for arg in part.args if arg is not None] if isinstance(part, OperationExpr) else []


def _constant_value(part: Constant) -> ShortStepValue:
    if part.number == 0:
        return _vanishing(math.inf)
    if part.step:
        return _vanishing(part.step) if part.step > 0 else ShortStepValue(power=part.step)
    return ShortStepValue(to=None if part.u else part.number)


# --- one operation ---------------------------------------------------------------------------------------------------


def _vanishing(power: float, influence: StepInfluence = StepInfluence.NONE, by: Expr | None = None) -> ShortStepValue:
    return ShortStepValue(influence, power, 0.0, power, by=by)


def _collect_changers(below: Iterable[ShortStepValue], *extra: Expr) -> tuple[Expr, ...]:
    return tuple(dict.fromkeys([*(each for one in below for each in one.makers), *extra]))[:2]


def _changed_value(op: Expr, below: OperandValues) -> ShortStepValue:
    return ShortStepValue(StepInfluence.CHANGED, min([0.0, *(each.power for each in below)]), makers=_collect_changers(below, op))


def _with_offset(own: ShortStepValue, off: float, by: Expr | None) -> ShortStepValue:
    """Return the previous value with an added deviation proportional to `dt ** off`."""
    return replace(own, off=off, by=by) if own.influence is StepInfluence.SAME and off < own.off else own


def _strongest_influence(below: OperandValues) -> StepInfluence:
    return max((each.influence for each in below), default=StepInfluence.NONE)


def _is_near(value: float | None, number: float) -> bool:
    return value is not None and math.isclose(value, number, abs_tol=1e-12)


def _sum(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    a, b = below
    if op.name == "sub" and any(isinstance(each, OperationExpr) and each.name == "floor" for each in parts(op.args[1])):
        return a  # `x - floor(x)` moves the value back into its range
    own, other = (a, b) if a.influence >= b.influence else (b, a)
    if own.influence is StepInfluence.UNSURE:
        return _UNSURE_VALUE
    if own.influence is StepInfluence.CHANGED:
        extra = () if other.vanishes or other.influence is StepInfluence.UNSURE else (op,)
        return replace(own, makers=_collect_changers(below, *extra))
    if own.influence is StepInfluence.SAME:
        if other.influence is StepInfluence.SAME or not other.vanishes or (op.name == "sub" and own is b):
            return _changed_value(op, below)
        return _with_offset(own, other.power, op)
    off = min(a.off, b.off)
    to = None if a.to is None or b.to is None else a.to - b.to if op.name == "sub" else a.to + b.to
    if _is_near(to, 0):
        return _vanishing(off, own.influence, own.by)
    return ShortStepValue(power=min(a.power, b.power, 0.0), to=to, off=off)


def _product(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    a, b = below
    if StepInfluence.UNSURE in (a.influence, b.influence):
        return _UNSURE_VALUE
    power = a.power + b.power
    own, other = (a, b) if a.influence >= b.influence else (b, a)
    if power > 0:
        cause = op if own.influence >= StepInfluence.SAME else own.by
        return _vanishing(power, min(own.influence, StepInfluence.VANISHING), cause)
    if own.influence is StepInfluence.NONE:
        to = a.to * b.to if a.to is not None and b.to is not None and power == 0 else None
        return ShortStepValue(power=power, to=to, off=min(a.off, b.off))
    if own.influence >= StepInfluence.SAME and other.influence is StepInfluence.NONE and _is_near(other.to, 1):
        return _with_offset(own, other.off, op)
    return replace(_changed_value(op, below), power=power)


def _quotient(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    a, b = below
    if b.influence > StepInfluence.VANISHING:
        return _product(op, (a, b if b.influence is StepInfluence.UNSURE else _changed_value(op, (b,))))
    if b.power == math.inf:
        return _UNSURE_VALUE
    inverse = ShortStepValue(b.influence, -b.power, 1 / b.to if b.to else None, b.off if b.to else math.inf, by=b.by)
    return _product(op, (a, inverse))


def _negative(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    a = below[0]
    if a.influence is StepInfluence.UNSURE or a.influence <= StepInfluence.VANISHING:
        return replace(a, to=None if a.to is None else -a.to)
    return _changed_value(op, below)


def _root(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    return _power(op, (*below, ShortStepValue(to=0.5)))


def _power(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    a, b = below
    if StepInfluence.UNSURE in (a.influence, b.influence) or b.influence is StepInfluence.VANISHING:
        return _UNSURE_VALUE
    if b.influence > StepInfluence.VANISHING or a.influence > StepInfluence.VANISHING:
        if a.influence is StepInfluence.SAME and _is_near(b.to, 1):
            return a if b.off == math.inf else _UNSURE_VALUE
        return _UNSURE_VALUE if b.depends_on_dt else _changed_value(op, below)
    if b.to is None:
        return _UNSURE_VALUE if a.depends_on_dt or b.depends_on_dt else ShortStepValue()
    if b.vanishes:
        return ShortStepValue(to=1.0, off=b.off) if a.power == 0 else _UNSURE_VALUE
    if a.power and not b.depends_on_dt:
        return _vanishing(a.power * b.to, a.influence, a.by) if a.power * b.to > 0 else ShortStepValue(power=a.power * b.to)
    return ShortStepValue(to=None if a.to is None else _evaluate(lambda x: x ** (b.to or 0.0), a.to), off=min(a.off, b.off))


def _evaluate(function: Callable[[float], float], at: float) -> float | None:
    try:
        result = function(at)
    except (ValueError, OverflowError, ZeroDivisionError):
        return None
    return result if isinstance(result, float) and math.isfinite(result) else None


def _function_rule(function: Callable[[float], float]) -> Callable[[OperationExpr, OperandValues], ShortStepValue]:
    def rule(op: OperationExpr, below: OperandValues) -> ShortStepValue:
        a = below[0]
        if a.influence > StepInfluence.VANISHING:
            return _UNSURE_VALUE if a.influence is StepInfluence.UNSURE else _changed_value(op, below)
        if a.power < 0:
            return _UNSURE_VALUE
        to = None if a.to is None else _evaluate(function, a.to)
        return _vanishing(a.off, a.influence, a.by) if _is_near(to, 0) else ShortStepValue(to=to, off=a.off)

    return rule


def _mix(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    a, b, share = below
    if share.influence is StepInfluence.UNSURE:
        return _UNSURE_VALUE
    for side, end in ((a, 0), (b, 1)):
        if share.influence <= StepInfluence.VANISHING and _is_near(share.to, end):
            if side.influence is StepInfluence.NONE:
                return replace(side, off=min(side.off, share.off), power=min(side.power, share.off) if side.power else 0.0)
            return _with_offset(side, share.off, op)
    return _combination(op, below[:2]) if share.influence is StepInfluence.NONE else _changed_value(op, below)


def _rotation(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    own, by = below[0], below[-1]
    if not by.vanishes:
        return _combination(op, below)
    return _with_offset(own, by.power, op) if own.influence >= StepInfluence.SAME else own


def _combination(op: Expr, below: OperandValues) -> ShortStepValue:
    """Analyse an operation such as a vector of numbers or a draw between two ends. The result vanishes if all operands vanish."""
    influence = _strongest_influence(below)
    if influence >= StepInfluence.SAME:
        return _UNSURE_VALUE if influence is StepInfluence.UNSURE else _changed_value(op, below)
    if below and all(each.vanishes for each in below):
        return _vanishing(min(each.power for each in below), influence, next((each.by for each in below if each.by), None))
    off = min((each.off for each in below), default=math.inf)
    return ShortStepValue(power=min([0.0, *(each.power for each in below)]), off=off)


def _first_operand(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    """Analyse a length or a component of a vector. The result vanishes if the vector vanishes."""
    a = below[0]
    if a.influence <= StepInfluence.VANISHING:
        return a
    return _combination(op, below[:1]) if op.name == "length" else _pass_through(op, below)


def _pass_through(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    influence = _strongest_influence(below)
    if influence is StepInfluence.CHANGED:
        return replace(next(each for each in below if each.influence is influence), makers=_collect_changers(below))
    if influence is StepInfluence.SAME:
        return min((each for each in below if each.influence is influence), key=lambda each: each.off)
    return _unknown_operation(op, below)


def _clamp(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    """Analyse `min`, `max` and `clamp`. If all operands are known numbers, the result is known."""
    tos = [each.to for each in below if each.to is not None]
    if _strongest_influence(below) > StepInfluence.VANISHING or len(tos) < len(below):
        return _pass_through(op, below)
    to = min(max(tos[0], tos[1]), tos[2]) if op.name == "clamp" else min(tos) if op.name == "min" else max(tos)
    left = [each for each in below if each.to == to]
    off = min(each.off for each in left)
    by = next((each.by for each in left if each.by), None)
    return _vanishing(off, _strongest_influence(left), by) if _is_near(to, 0) else ShortStepValue(to=to, off=off)


def _conditional(op: OperationExpr, below: OperandValues, own: OwnValue, driven: bool) -> ShortStepValue:
    """Analyse `if`. Changes by chance or by an event happen equally often at any rate. `driven`: another line changes the value.
    Then a branch may move it back into its range: `if turn > 1 then turn - 1 else turn`."""
    (test, *ends), branches = op.args, below[1:]
    assert test is not None
    influence = _strongest_influence(branches)
    if influence < StepInfluence.SAME:
        return _combination(op, branches)
    back = driven and reads(test, own) and any(end is not None and is_own(end, own) for end in ends)
    if back or any(isinstance(each, OperationExpr) and each.name in _RATE_FREE_OPERATIONS for each in parts(test)):
        return ShortStepValue(StepInfluence.SAME)
    lost = [each.by for each in branches if each.influence is StepInfluence.VANISHING and each.by is not None]
    if not lost or influence is StepInfluence.UNSURE:
        return _pass_through(op, branches)
    return ShortStepValue(StepInfluence.CHANGED, makers=_collect_changers(branches, *lost))


def _query(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    return ShortStepValue()  # a condition; its effect is analysed where it is used


def _run_value(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    return _vanishing(1.0) if _is_dt(op) else ShortStepValue()


def _unknown_operation(op: OperationExpr, below: OperandValues) -> ShortStepValue:
    influence = _strongest_influence(below)
    if influence is StepInfluence.UNSURE or any(each.depends_on_dt for each in below):
        return _UNSURE_VALUE
    return _changed_value(op, below) if influence >= StepInfluence.SAME else ShortStepValue()


_ANALYSIS_RULES: dict[str, Callable[[OperationExpr, OperandValues], ShortStepValue]] = {
    "add": _sum, "sub": _sum, "mul": _product, "div": _quotient, "dot": _product, "cross": _product, "neg": _negative,
    "pow": _power, "sqrt": _root, "exp": _function_rule(math.exp), "log": _function_rule(math.log),
    "sin": _function_rule(math.sin), "cos": _function_rule(math.cos), "mix": _mix, "rotate": _rotation, "run": _run_value,
    "min": _clamp, "max": _clamp, "clamp": _clamp,
    "abs": _first_operand, "limit": _first_operand, "project": _first_operand, "length": _first_operand,
    **dict.fromkeys(("first", "floor", "unit", "and", "or"), _pass_through),
    **dict.fromkeys(("vector", "uniform", "normal", "pick"), _combination),
    **dict.fromkeys(_QUERY_OPERATIONS, _query),
}  # fmt: skip
