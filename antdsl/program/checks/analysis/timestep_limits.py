"""Computes the limit of an updated value as the step length `dt` goes to 0, to find updates that depend on the frame rate.

An update is independent of the frame rate under two conditions. In a step of length 0 the value does not change, and in a short
step the change is proportional to `dt`. Then two half steps change the value as much as one full step. The analysis therefore
finds, for each part of an expression, how fast it vanishes, its limit, and whether it contains the previous value."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum

from antdsl.program.model import Constant, Expr, InlinedBehaviour, OperationExpr, ReduceExpr
from antdsl.program.tables.vocabulary import DRAWING_OPERATIONS
from antdsl.program.traverse import iterate_parts
from antdsl.program.typed import AttributeRef, Binding, BindingRef, ThingRef

UpdateTarget = str | Binding  # the attribute that an update sets, or the memory


class StepInfluence(IntEnum):
    """How strongly the value before an update determines the value after it, in a very short step. NONE: not at all. VANISHING:
    less and less as the step gets shorter. SAME: the value does not change. UNSURE: unknown. CHANGED: it changes in any step."""

    NONE = 0
    VANISHING = 1
    SAME = 2
    UNSURE = 3
    CHANGED = 4


@dataclass(frozen=True, slots=True)
class ShortStepValue:
    """The behaviour of a value as the step length `dt` goes to 0.
    - `power`: the value is proportional to `dt ** power` and vanishes if this is above 0. `limit`: its limit, if known.
    - `deviation_exponent`: the exponent of `dt` in the deviation from the limit or previous value; infinite if there is none.
    - `changing_parts`: the first two operations that change the previous value.
    - `cause`: the operation that causes the deviation or makes the value vanish."""

    influence: StepInfluence = StepInfluence.NONE
    power: float = 0.0
    limit: float | None = None
    deviation_exponent: float = math.inf
    changing_parts: tuple[Expr, ...] = ()
    cause: Expr | None = None

    @property
    def is_vanishing(self) -> bool:
        return self.influence <= StepInfluence.VANISHING and self.power > 0

    @property
    def depends_on_dt(self) -> bool:
        changes = self.deviation_exponent < math.inf or self.power < 0 or self.influence is StepInfluence.VANISHING
        return changes and self.influence <= StepInfluence.VANISHING


OperandValues = Sequence[ShortStepValue]
_UNSURE_VALUE = ShortStepValue(StepInfluence.UNSURE)
_QUERY_OPERATIONS = frozenset(("lt", "le", "gt", "ge", "eq", "ne", "is_some", "is_none", "chance", "event", "touching"))
_RATE_FREE_OPERATIONS = frozenset(("chance", "event"))  # equally frequent at any frame rate


def find_rate_dependent_operations(value: Expr, target: UpdateTarget, has_other_change: bool = False) -> tuple[Expr, ...]:
    """Return at most two operations that make the effect of an update depend on the frame rate.

    Each changes the attribute or memory `target` even if `dt` is near 0, or out of proportion to `dt`. `check --strict` reports
    uses of the unit `step` instead. `value`: the new value. `has_other_change`: whether another line also changes the attribute.
    """
    short = _analyse_value(value, target, has_other_change)
    if short.influence is StepInfluence.CHANGED:
        makers = short.changing_parts
    else:
        is_slow = short.influence is StepInfluence.SAME and not _has_growing_power(short.deviation_exponent, value)
        wrong = is_slow or short.influence is StepInfluence.VANISHING
        makers = (short.cause,) if wrong and short.cause is not None else ()
    return tuple(each for each in makers if not _uses_step_unit(each))


def is_rate(value: Expr, target: UpdateTarget) -> bool:
    """Return whether `value` is an amount per second. The update multiplies it by `dt` and adds the product to the target."""
    short = _analyse_value(value, target, False)
    return short.influence is StepInfluence.UNSURE or _has_growing_power(short.power + 1, value) or _uses_step_unit(value)


def depends_on_step(value: Expr) -> bool:
    """Return whether an expression depends on the length of a step."""
    return any(_is_dt(part) or (isinstance(part, Constant) and bool(part.step)) for part in iterate_parts(value))


def is_update_target(part: Expr, target: UpdateTarget) -> bool:
    """Return whether an expression is the attribute or memory that the update sets."""
    if isinstance(target, str):
        return isinstance(part, AttributeRef) and part.owner is None and part.name == target
    return isinstance(part, BindingRef) and part.binding is target


def reads_update_target(expr: Expr, target: UpdateTarget) -> bool:
    """Return whether any part of an expression reads the attribute or memory that an update sets."""
    return any(isinstance(part, Expr) and is_update_target(part, target) for part in iterate_parts(expr))


def _has_growing_power(power: float, value: Expr) -> bool:
    """Return whether the sum of values proportional to `dt ** power`, one per step, is independent of the step length. This is
    so for the power 1 and, for random draws, 0.5: their sum grows with the square root of the time."""
    has_draw = any(isinstance(part, OperationExpr) and part.name in DRAWING_OPERATIONS for part in iterate_parts(value))
    return power == math.inf or math.isclose(power, 1) or (has_draw and math.isclose(power, 0.5))


def _uses_step_unit(value: Expr) -> bool:
    return any(isinstance(part, Constant) and part.step for part in iterate_parts(value))


def _is_dt(part: object) -> bool:
    first = part.args[0] if isinstance(part, OperationExpr) and part.name == "run" else None
    return isinstance(first, ThingRef) and first.name == "dt"


def _analyse_value(value: Expr, target: UpdateTarget, has_other_change: bool) -> ShortStepValue:
    known: dict[int, ShortStepValue] = {}
    for part in _iterate_dependencies(value, target):
        below = [known[id(each)] for each in _list_operands(part, target)]
        if is_update_target(part, target):
            short = ShortStepValue(StepInfluence.SAME)
        elif isinstance(part, OperationExpr) and part.name == "if":
            short = _analyse_if(part, below, target, has_other_change)
        elif isinstance(part, OperationExpr):
            short = _ANALYSIS_RULES.get(part.name, _analyse_unknown)(part, below)
        elif isinstance(part, Constant):
            short = _analyse_constant(part)
        elif isinstance(part, ReduceExpr):
            short = _analyse_combination(part, below)
            short = short if short.is_vanishing else ShortStepValue()  # values inside a set belong to other agents
        else:
            short = below[0] if below else ShortStepValue()
        known[id(part)] = short
    return known[id(value)]


def _iterate_dependencies(value: Expr, target: UpdateTarget) -> Iterator[Expr]:
    """Yield the parts of an expression on which its value depends, without duplicates. Operands come before their operation."""
    stack: list[tuple[Expr, bool]] = [(value, False)]
    visited: set[int] = set()
    while stack:
        part, is_expanded = stack.pop()
        if is_expanded:
            yield part
        elif id(part) not in visited:
            visited.add(id(part))
            stack.append((part, True))
            stack += [(each, False) for each in reversed(_list_operands(part, target))]


def _list_operands(part: Expr, target: UpdateTarget) -> list[Expr]:
    if is_update_target(part, target):
        return []
    if isinstance(part, BindingRef) and part.binding.role in ("let", "argument") and part.binding.value is not None:
        return [part.binding.value]
    if isinstance(part, InlinedBehaviour):
        return [part.result]
    if isinstance(part, ReduceExpr):
        return [part.body] if part.reducer in ("sum", "mean", "min", "max") and part.body is not None else []
    return [arg for arg in part.args if arg is not None] if isinstance(part, OperationExpr) else []


def _analyse_constant(part: Constant) -> ShortStepValue:
    if part.number == 0:
        return _make_vanishing_value(math.inf)
    if part.step:
        return _make_vanishing_value(part.step) if part.step > 0 else ShortStepValue(power=part.step)
    return ShortStepValue(limit=None if part.unit_power else part.number)


def _make_vanishing_value(power: float, kind: StepInfluence = StepInfluence.NONE, cause: Expr | None = None) -> ShortStepValue:
    return ShortStepValue(kind, power, 0.0, power, cause=cause)


def _collect_changers(operands: Iterable[ShortStepValue], *extra: Expr) -> tuple[Expr, ...]:
    return tuple(dict.fromkeys([*(each for one in operands for each in one.changing_parts), *extra]))[:2]


def _make_changed_value(op: Expr, operands: OperandValues) -> ShortStepValue:
    power = min([0.0, *(each.power for each in operands)])
    return ShortStepValue(StepInfluence.CHANGED, power, changing_parts=_collect_changers(operands, op))


def _make_offset_value(previous_value: ShortStepValue, deviation_power: float, cause: Expr | None) -> ShortStepValue:
    """Return the previous value plus a deviation that is proportional to `dt ** deviation_power`."""
    is_greater = previous_value.influence is StepInfluence.SAME and deviation_power < previous_value.deviation_exponent
    return replace(previous_value, deviation_exponent=deviation_power, cause=cause) if is_greater else previous_value


def _find_strongest_influence(operands: OperandValues) -> StepInfluence:
    return max((each.influence for each in operands), default=StepInfluence.NONE)


def _is_nearly_equal(value: float | None, number: float) -> bool:
    return value is not None and math.isclose(value, number, abs_tol=1e-12)


def _analyse_sum(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    a, b = operands
    if op.name == "sub" and any(isinstance(each, OperationExpr) and each.name == "floor" for each in iterate_parts(op.args[1])):
        return a  # `x - floor(x)` moves the value back into its range
    own, other = (a, b) if a.influence >= b.influence else (b, a)
    if own.influence is StepInfluence.UNSURE:
        return _UNSURE_VALUE
    if own.influence is StepInfluence.CHANGED:
        extra = () if other.is_vanishing or other.influence is StepInfluence.UNSURE else (op,)
        return replace(own, changing_parts=_collect_changers(operands, *extra))
    if own.influence is StepInfluence.SAME:
        if other.influence is StepInfluence.SAME or not other.is_vanishing or (op.name == "sub" and own is b):
            return _make_changed_value(op, operands)
        return _make_offset_value(own, other.power, op)
    off = min(a.deviation_exponent, b.deviation_exponent)
    to = None if a.limit is None or b.limit is None else a.limit - b.limit if op.name == "sub" else a.limit + b.limit
    if _is_nearly_equal(to, 0):
        return _make_vanishing_value(off, own.influence, own.cause)
    return ShortStepValue(power=min(a.power, b.power, 0.0), limit=to, deviation_exponent=off)


def _analyse_product(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    a, b = operands
    if StepInfluence.UNSURE in (a.influence, b.influence):
        return _UNSURE_VALUE
    power = a.power + b.power
    own, other = (a, b) if a.influence >= b.influence else (b, a)
    if power > 0:
        cause = op if own.influence >= StepInfluence.SAME else own.cause
        return _make_vanishing_value(power, min(own.influence, StepInfluence.VANISHING), cause)
    if own.influence is StepInfluence.NONE:
        to = a.limit * b.limit if a.limit is not None and b.limit is not None and power == 0 else None
        return ShortStepValue(power=power, limit=to, deviation_exponent=min(a.deviation_exponent, b.deviation_exponent))
    if own.influence >= StepInfluence.SAME and other.influence is StepInfluence.NONE and _is_nearly_equal(other.limit, 1):
        return _make_offset_value(own, other.deviation_exponent, op)
    return replace(_make_changed_value(op, operands), power=power)


def _analyse_quotient(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    a, b = operands
    if b.influence > StepInfluence.VANISHING:
        return _analyse_product(op, (a, b if b.influence is StepInfluence.UNSURE else _make_changed_value(op, (b,))))
    if b.power == math.inf:
        return _UNSURE_VALUE
    to, off = (1 / b.limit, b.deviation_exponent) if b.limit else (None, math.inf)
    inverse = ShortStepValue(b.influence, -b.power, to, off, cause=b.cause)
    return _analyse_product(op, (a, inverse))


def _analyse_negative(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    a = operands[0]
    if a.influence is StepInfluence.UNSURE or a.influence <= StepInfluence.VANISHING:
        return replace(a, limit=None if a.limit is None else -a.limit)
    return _make_changed_value(op, operands)


def _analyse_power(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    a, b = operands
    if StepInfluence.UNSURE in (a.influence, b.influence) or b.influence is StepInfluence.VANISHING:
        return _UNSURE_VALUE
    if b.influence > StepInfluence.VANISHING or a.influence > StepInfluence.VANISHING:
        if a.influence is StepInfluence.SAME and _is_nearly_equal(b.limit, 1):
            return a if b.deviation_exponent == math.inf else _UNSURE_VALUE
        return _UNSURE_VALUE if b.depends_on_dt else _make_changed_value(op, operands)
    if b.limit is None:
        return _UNSURE_VALUE if a.depends_on_dt or b.depends_on_dt else ShortStepValue()
    if b.is_vanishing:
        return ShortStepValue(limit=1.0, deviation_exponent=b.deviation_exponent) if a.power == 0 else _UNSURE_VALUE
    if a.power and not b.depends_on_dt:
        power = a.power * b.limit
        return _make_vanishing_value(power, a.influence, a.cause) if power > 0 else ShortStepValue(power=power)
    to = None if a.limit is None else _evaluate_function(lambda x: x ** (b.limit or 0.0), a.limit)
    return ShortStepValue(limit=to, deviation_exponent=min(a.deviation_exponent, b.deviation_exponent))


def _evaluate_function(function: Callable[[float], float], argument: float) -> float | None:
    try:
        result = function(argument)
    except (ValueError, OverflowError, ZeroDivisionError):
        return None
    return result if isinstance(result, float) and math.isfinite(result) else None


def _make_function_rule(function: Callable[[float], float]) -> Callable[[OperationExpr, OperandValues], ShortStepValue]:
    def apply_function(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
        a = operands[0]
        if a.influence > StepInfluence.VANISHING:
            return _UNSURE_VALUE if a.influence is StepInfluence.UNSURE else _make_changed_value(op, operands)
        if a.power < 0:
            return _UNSURE_VALUE
        limit = None if a.limit is None else _evaluate_function(function, a.limit)
        vanishing = _make_vanishing_value(a.deviation_exponent, a.influence, a.cause)
        return vanishing if _is_nearly_equal(limit, 0) else ShortStepValue(limit=limit, deviation_exponent=a.deviation_exponent)

    return apply_function


def _analyse_mix(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    a, b, share = operands
    if share.influence is StepInfluence.UNSURE:
        return _UNSURE_VALUE
    for side, end in ((a, 0), (b, 1)):
        if share.influence <= StepInfluence.VANISHING and _is_nearly_equal(share.limit, end):
            if side.influence is StepInfluence.NONE:
                power = min(side.power, share.deviation_exponent) if side.power else 0.0
                return replace(side, deviation_exponent=min(side.deviation_exponent, share.deviation_exponent), power=power)
            return _make_offset_value(side, share.deviation_exponent, op)
    return _analyse_combination(op, operands[:2]) if share.influence is StepInfluence.NONE else _make_changed_value(op, operands)


def _analyse_rotation(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    own, by = operands[0], operands[-1]
    if not by.is_vanishing:
        return _analyse_combination(op, operands)
    return _make_offset_value(own, by.power, op) if own.influence >= StepInfluence.SAME else own


def _analyse_combination(op: Expr, operands: OperandValues) -> ShortStepValue:
    """Return the short-step value of an operation such as a vector or a draw. It vanishes if all operands vanish."""
    influence = _find_strongest_influence(operands)
    if influence >= StepInfluence.SAME:
        return _UNSURE_VALUE if influence is StepInfluence.UNSURE else _make_changed_value(op, operands)
    if operands and all(each.is_vanishing for each in operands):
        cause = next((each.cause for each in operands if each.cause), None)
        return _make_vanishing_value(min(each.power for each in operands), influence, cause)
    off = min((each.deviation_exponent for each in operands), default=math.inf)
    return ShortStepValue(power=min([0.0, *(each.power for each in operands)]), deviation_exponent=off)


def _analyse_first_operand(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    """Return the short-step value of a length or a component of a vector. It vanishes if the vector vanishes."""
    a = operands[0]
    if a.influence <= StepInfluence.VANISHING:
        return a
    return _analyse_combination(op, operands[:1]) if op.name == "length" else _analyse_pass_through(op, operands)


def _analyse_pass_through(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    influence = _find_strongest_influence(operands)
    if influence is StepInfluence.CHANGED:
        return replace(next(each for each in operands if each.influence is influence), changing_parts=_collect_changers(operands))
    if influence is StepInfluence.SAME:
        return min((each for each in operands if each.influence is influence), key=lambda operand: operand.deviation_exponent)
    return _analyse_unknown(op, operands)


def _analyse_clamp(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    """Return the short-step value of `min`, `max` or `clamp`. The result is a known number if all operands are."""
    tos = [each.limit for each in operands if each.limit is not None]
    if _find_strongest_influence(operands) > StepInfluence.VANISHING or len(tos) < len(operands):
        return _analyse_pass_through(op, operands)
    to = min(max(tos[0], tos[1]), tos[2]) if op.name == "clamp" else min(tos) if op.name == "min" else max(tos)
    left = [each for each in operands if each.limit == to]
    off = min(each.deviation_exponent for each in left)
    how, by = _find_strongest_influence(left), next((each.cause for each in left if each.cause), None)
    return _make_vanishing_value(off, how, by) if _is_nearly_equal(to, 0) else ShortStepValue(limit=to, deviation_exponent=off)


def _analyse_if(op: OperationExpr, operands: OperandValues, target: UpdateTarget, has_other_change: bool) -> ShortStepValue:
    """Return the short-step value of `if`. A change by chance or by an event happens equally often at any frame rate.
    `has_other_change`: another line changes the value, so a branch may move it back (`if turn > 1 then turn - 1 else turn`)."""
    (test, *ends), branches = op.args, operands[1:]
    assert test is not None
    if (influence := _find_strongest_influence(branches)) < StepInfluence.SAME:
        return _analyse_combination(op, branches)
    ends_as_before = any(end is not None and is_update_target(end, target) for end in ends) and reads_update_target(test, target)
    if (has_other_change and ends_as_before) or any(
        isinstance(each, OperationExpr) and each.name in _RATE_FREE_OPERATIONS for each in iterate_parts(test)
    ):
        return ShortStepValue(StepInfluence.SAME)
    lost = [each.cause for each in branches if each.influence is StepInfluence.VANISHING and each.cause is not None]
    if not lost or influence is StepInfluence.UNSURE:
        return _analyse_pass_through(op, branches)
    return ShortStepValue(StepInfluence.CHANGED, changing_parts=_collect_changers(branches, *lost))


def _analyse_query(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    return ShortStepValue()  # the effect of a condition is analysed where it is used


def _analyse_unknown(op: OperationExpr, operands: OperandValues) -> ShortStepValue:
    influence = _find_strongest_influence(operands)
    if influence is StepInfluence.UNSURE or any(each.depends_on_dt for each in operands):
        return _UNSURE_VALUE
    return _make_changed_value(op, operands) if influence >= StepInfluence.SAME else ShortStepValue()


_ANALYSIS_RULES: dict[str, Callable[[OperationExpr, OperandValues], ShortStepValue]] = {
    "add": _analyse_sum, "sub": _analyse_sum, "mul": _analyse_product, "div": _analyse_quotient, "dot": _analyse_product,
    "cross": _analyse_product, "neg": _analyse_negative, "pow": _analyse_power,
    "sqrt": lambda op, operands: _analyse_power(op, (*operands, ShortStepValue(limit=0.5))),
    "exp": _make_function_rule(math.exp), "log": _make_function_rule(math.log), "sin": _make_function_rule(math.sin),
    "cos": _make_function_rule(math.cos), "mix": _analyse_mix, "rotate": _analyse_rotation,
    "run": lambda op, operands: _make_vanishing_value(1.0) if _is_dt(op) else ShortStepValue(),
    "min": _analyse_clamp, "max": _analyse_clamp, "clamp": _analyse_clamp, "abs": _analyse_first_operand,
    "limit": _analyse_first_operand, "project": _analyse_first_operand, "length": _analyse_first_operand,
    **dict.fromkeys(("first", "floor", "unit", "and", "or"), _analyse_pass_through),
    **dict.fromkeys(("vector", "uniform", "normal", "pick"), _analyse_combination),
    **dict.fromkeys(_QUERY_OPERATIONS, _analyse_query),
}  # fmt: skip
