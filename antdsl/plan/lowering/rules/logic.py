"""Rules for bools, degrees of truth, if-then-else and values that may be none."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering.expressions import as_truth, lower, presence, scalar, select, truth
from antdsl.plan.lowering.values import LoweredValue
from antdsl.plan.lowering.writer import PlanWriter
from antdsl.program import model

OperationRule = Callable[[PlanWriter, model.OperationExpr], LoweredValue]


def _make_connective(sharp: str, shaded: str) -> OperationRule:
    """Return the rule of `and` or `or`. Bools use the operation `sharp`. Degrees from 0 to 1 use `shaded`, the minimum or maximum
    (Zadeh 1965, section 2)."""

    def rule(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        if e.type.kind is model.TypeKind.NUMBER:
            return w.b(shaded, *(_shade(w, a) for a in e.args if a is not None))
        first, second = (truth(w, a) for a in e.args if a is not None)
        return w.b(sharp, first, second)

    return rule


def _shade(w: PlanWriter, e: model.Expr) -> PlanNode:
    value = lower(w, e)
    if isinstance(value, PlanNode) and value.kind is ValueKind.F32:
        return value
    return w.b("number", as_truth(w, value, e))


def _fuzzy(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return the mean of the rules' outputs, each weighted by the degree of its rule; 0 if all degrees are 0. Degrees are clamped
    to 0..1, and NaN counts as 0."""
    b = w.b
    above = below = b.number(0)
    for degree, said in zip(e.args[::2], e.args[1::2], strict=True):
        assert degree is not None and said is not None
        weight = b("min", b("max", _shade(w, degree), b.number(0)), b.number(1))
        above, below = b("add", above, b("mul", weight, scalar(w, said))), b("add", below, weight)
    return b("where", b("gt", below, b.number(0)), b("div", above, below), b.number(0))


def _not(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    argument = e.args[0]
    assert argument is not None
    if e.type.kind is model.TypeKind.NUMBER:
        return w.b("sub", w.b.number(1), _shade(w, argument))
    return w.b("not", truth(w, argument))


def _if(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    condition, then, other = (a for a in e.args if a is not None)
    return select(w, truth(w, condition), lower(w, then), lower(w, other))


def _is_some(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    argument = e.args[0]
    assert argument is not None
    return presence(w, lower(w, argument), argument)


def _is_none(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    argument = e.args[0]
    assert argument is not None
    return w.b("not", presence(w, lower(w, argument), argument))


def _first(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    choices = [(a, lower(w, a)) for a in e.args if a is not None]
    result = choices[-1][1]
    for expr, value in reversed(choices[:-1]):
        result = select(w, presence(w, value, expr), value, result)
    return result


LOGIC_RULES = {
    "and": _make_connective("and", "min"), "or": _make_connective("or", "max"), "not": _not, "if": _if, "is_some": _is_some,
    "is_none": _is_none,
    "first": _first, "fuzzy": _fuzzy,
}  # fmt: skip
