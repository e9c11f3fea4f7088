"""Rules for bools, degrees of truth, if-then-else, and values that may be none."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering.expressions import (
    convert_to_condition,
    lower_condition,
    lower_expression,
    lower_presence,
    lower_scalar,
    select_value,
)
from antdsl.plan.lowering.values import LoweredValue
from antdsl.plan.lowering.writer import PlanWriter
from antdsl.program import model

OperationRule = Callable[[PlanWriter, model.OperationExpr], LoweredValue]


def _make_connective(bool_operation: str, degree_operation: str) -> OperationRule:
    """Return the rule of `and` or `or`. For bools, the rule uses `bool_operation`. For degrees of truth, 0 to 1, it uses
    `degree_operation`, the minimum or maximum (Zadeh 1965, section 2)."""

    def lower_connective(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        if e.type.kind is model.TypeKind.NUMBER:
            return w.b(degree_operation, *(_lower_degree(w, a) for a in e.args if a is not None))
        first, second = (lower_condition(w, a) for a in e.args if a is not None)
        return w.b(bool_operation, first, second)

    return lower_connective


def _lower_degree(w: PlanWriter, e: model.Expr) -> PlanNode:
    value = lower_expression(w, e)
    if isinstance(value, PlanNode) and value.kind is ValueKind.F32:
        return value
    return w.b("number", convert_to_condition(w, value, e))


def _lower_fuzzy(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return the mean of the fuzzy rules' outputs, weighted by the degree of each rule; 0 if all degrees are 0. Degrees are
    clamped to 0..1, and NaN counts as 0."""
    b = w.b
    above = below = b.add_number(0)
    for degree, said in zip(e.args[::2], e.args[1::2], strict=True):
        assert degree is not None and said is not None
        weight = b("min", b("max", _lower_degree(w, degree), b.add_number(0)), b.add_number(1))
        above, below = b("add", above, b("mul", weight, lower_scalar(w, said))), b("add", below, weight)
    return b("where", b("gt", below, b.add_number(0)), b("div", above, below), b.add_number(0))


def _lower_not(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    argument = e.args[0]
    assert argument is not None
    if e.type.kind is model.TypeKind.NUMBER:
        return w.b("sub", w.b.add_number(1), _lower_degree(w, argument))
    return w.b("not", lower_condition(w, argument))


def _lower_if(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    condition, then, other = (a for a in e.args if a is not None)
    return select_value(w, lower_condition(w, condition), lower_expression(w, then), lower_expression(w, other))


def _lower_is_some(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    argument = e.args[0]
    assert argument is not None
    return lower_presence(w, lower_expression(w, argument), argument)


def _lower_is_none(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    argument = e.args[0]
    assert argument is not None
    return w.b("not", lower_presence(w, lower_expression(w, argument), argument))


def _lower_first(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    choices = [(a, lower_expression(w, a)) for a in e.args if a is not None]
    result = choices[-1][1]
    for expr, value in reversed(choices[:-1]):
        result = select_value(w, lower_presence(w, value, expr), value, result)
    return result


LOGIC_RULES = {
    "and": _make_connective("and", "min"), "or": _make_connective("or", "max"), "not": _lower_not, "if": _lower_if,
    "is_some": _lower_is_some, "is_none": _lower_is_none, "first": _lower_first, "fuzzy": _lower_fuzzy,
}  # fmt: skip
