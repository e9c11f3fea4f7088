"""Rules for numbers, vectors, and operators that accept both. A vector is three nodes."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import convert_to_node, lower_expression, lower_scalar, lower_vector
from antdsl.plan.lowering.values import LoweredValue, VectorNodes
from antdsl.plan.lowering.writer import PlanWriter
from antdsl.plan.simplify import get_constant_value
from antdsl.program import model

OperationRule = Callable[[PlanWriter, model.OperationExpr], LoweredValue]


def lower_arguments(w: PlanWriter, e: model.OperationExpr) -> list[PlanNode]:
    """Return all operands as scalars. No operand may be absent."""
    return [lower_scalar(w, a) for a in e.args if a is not None]


def _lower_operand_pair(w: PlanWriter, e: model.OperationExpr) -> tuple[LoweredValue, LoweredValue, Callable[[], list[PlanNode]]]:
    """Return the left operand, the right operand, and a function that returns both as scalar nodes.

    Each operand is lowered only once. Lowering it twice would double the work at each level of nesting."""
    first, second = (a for a in e.args if a is not None)
    left, right = lower_expression(w, first), lower_expression(w, second)
    return left, right, lambda: [convert_to_node(w, first, left), convert_to_node(w, second, right)]


def _make_binary_rule(op: str) -> OperationRule:
    def lower_binary(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        left, right, scalars = _lower_operand_pair(w, e)
        if isinstance(left, VectorNodes) and isinstance(right, VectorNodes):
            return values.apply_by_component(lambda p, q: w.b(op, p, q), left, right)
        return w.b(op, *scalars())

    return lower_binary


def _lower_mul(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    left, right, scalars = _lower_operand_pair(w, e)
    if isinstance(left, VectorNodes) and isinstance(right, PlanNode):
        return values.scale_vector(w.b, left, right)
    if isinstance(right, VectorNodes) and isinstance(left, PlanNode):
        return values.scale_vector(w.b, right, left)
    return w.b("mul", *scalars())


def _lower_div(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    dividend, divisor = (a for a in e.args if a is not None)
    left, right = lower_expression(w, dividend), lower_scalar(w, divisor)
    if isinstance(left, VectorNodes):
        return values.apply_by_component(lambda p: w.b("div", p, right), left)
    return w.b("div", convert_to_node(w, dividend, left), right)


def _lower_neg(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    (operand,) = (a for a in e.args if a is not None)
    inner = lower_expression(w, operand)
    if isinstance(inner, VectorNodes):
        return values.negate_vector(w.b, inner)
    return w.b("neg", convert_to_node(w, operand, inner))


def _lower_pow(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    base, exponent = lower_arguments(w, e)
    known = get_constant_value(exponent)
    if known is None:
        return w.b("pow", base, exponent)
    if known == 0.5:
        return w.b("sqrt", base)
    if known != int(known) or abs(known) > 8:
        return w.b("pow", base, exponent)
    result = w.b.add_number(1)
    for _ in range(abs(int(known))):
        result = w.b("mul", result, base)
    return w.b("div", w.b.add_number(1), result) if known < 0 else result


def _make_scalar_rule(op: str) -> OperationRule:
    return lambda w, e: w.b(op, *lower_arguments(w, e))


def _lower_clamp(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    x, low, high = lower_arguments(w, e)
    return w.b("min", w.b("max", x, low), high)


def compute_share(w: PlanWriter, x: PlanNode, low: PlanNode, high: PlanNode) -> PlanNode:
    """Return the position of x between `low` and `high`, as a fraction from 0 to 1. If `low` equals `high`, the result is 0
    below this value, otherwise 1."""
    b = w.b
    wide = b("sub", high, low)
    between = b("min", b("max", b("div", b("sub", x, low), wide), b.add_number(0)), b.add_number(1))
    step = b("where", b("ge", x, high), b.add_number(1), b.add_number(0))
    return b("where", b("ne", wide, b.add_number(0)), between, step)


def _lower_ramp(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    x, from_low, from_high, to_low, to_high = lower_arguments(w, e)
    return _lower_interpolation(w, to_low, to_high, compute_share(w, x, from_low, from_high))


def _lower_interpolation(w: PlanWriter, a: PlanNode, z: PlanNode, t: PlanNode) -> PlanNode:
    if get_constant_value(a) == 0:
        return w.b("mul", z, t)
    return w.b("add", w.b("mul", a, w.b("sub", w.b.add_number(1), t)), w.b("mul", z, t))


def _lower_mix(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    first, second = (lower_expression(w, a) for a in e.args[:2] if a is not None)
    t = lower_scalar(w, e.args[2])  # type: ignore[arg-type]
    if isinstance(first, VectorNodes) and isinstance(second, VectorNodes):
        return values.apply_by_component(lambda p, q: _lower_interpolation(w, p, q, t), first, second)
    if isinstance(first, PlanNode) and isinstance(second, PlanNode):
        return _lower_interpolation(w, first, second, t)
    raise PlanError("`mix` needs two values of the same type")


def _lower_rising(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return compute_share(w, *lower_arguments(w, e))


def _lower_falling(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return w.b("sub", w.b.add_number(1), compute_share(w, *lower_arguments(w, e)))


def _lower_around(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    x, low, high = lower_arguments(w, e)
    b = w.b
    half = b("mul", b("sub", high, low), b.add_number(0.5))
    middle = b("add", low, half)
    return b("max", b("sub", b.add_number(1), b("div", b("abs", b("sub", x, middle)), half)), b.add_number(0))


def _make_comparison_rule(op: str) -> OperationRule:
    def lower_comparison(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        left, right, scalars = _lower_operand_pair(w, e)
        if isinstance(left, VectorNodes) and isinstance(right, VectorNodes):
            same = w.b.add_conjunction(*(w.b("eq", p, q) for p, q in zip(left, right, strict=True)))
            return same if op == "eq" else w.b("not", same)
        first, second = scalars()
        if first.kind is not second.kind:  # a bool and a number: compare both as numbers
            first, second = (n if n.kind is ValueKind.F32 else w.b("number", n) for n in (first, second))
        return w.b(op, first, second)

    return lower_comparison


NUMBER_RULES = {
    "add": _make_binary_rule("add"), "sub": _make_binary_rule("sub"), "mul": _lower_mul, "div": _lower_div,
    "neg": _lower_neg, "pow": _lower_pow,
    "lt": _make_scalar_rule("lt"), "le": _make_scalar_rule("le"), "gt": _make_scalar_rule("gt"), "ge": _make_scalar_rule("ge"),
    "eq": _make_comparison_rule("eq"), "ne": _make_comparison_rule("ne"),
    "abs": _make_scalar_rule("abs"), "floor": _make_scalar_rule("floor"), "sqrt": _make_scalar_rule("sqrt"),
    "sin": _make_scalar_rule("sin"), "cos": _make_scalar_rule("cos"),
    "exp": _make_scalar_rule("exp"), "log": _make_scalar_rule("log"), "min": _make_scalar_rule("min"),
    "max": _make_scalar_rule("max"),
    "clamp": _lower_clamp, "ramp": _lower_ramp, "mix": _lower_mix, "rising": _lower_rising, "falling": _lower_falling,
    "around": _lower_around,
}  # fmt: skip


def _lower_length(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.compute_length(w.b, lower_vector(w, e.args[0]))  # type: ignore[arg-type]


def _lower_unit(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.normalise_vector(w.b, lower_vector(w, e.args[0]))  # type: ignore[arg-type]


def _lower_vector_pair(w: PlanWriter, e: model.OperationExpr) -> tuple[VectorNodes, VectorNodes]:
    return lower_vector(w, e.args[0]), lower_vector(w, e.args[1])  # type: ignore[arg-type]


def _lower_dot(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.compute_dot_product(w.b, *_lower_vector_pair(w, e))


def _lower_cross(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.compute_cross_product(w.b, *_lower_vector_pair(w, e))


def _lower_angle(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.compute_angle_between(w.b, *_lower_vector_pair(w, e))


def _lower_unit_direction(w: PlanWriter, e: model.Expr) -> VectorNodes:
    """Return a direction scaled to length 1. `up` and `heading` already have this length."""
    if isinstance(e, model.AttributeRef) and e.owner is None and e.name in ("up", "heading"):
        return lower_vector(w, e)
    return values.normalise_vector(w.b, lower_vector(w, e))


def _lower_rotate(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.rotate_vector(w.b, lower_vector(w, e.args[0]), _lower_unit_direction(w, e.args[1]), lower_scalar(w, e.args[2]))  # type: ignore[arg-type]


def _lower_project(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    direction = _lower_unit_direction(w, e.args[1])  # type: ignore[arg-type]
    return values.scale_vector(w.b, direction, values.compute_dot_product(w.b, lower_vector(w, e.args[0]), direction))  # type: ignore[arg-type]


def _lower_limit_length(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.limit_length(w.b, lower_vector(w, e.args[0]), lower_scalar(w, e.args[1]))  # type: ignore[arg-type]


def _lower_vector(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return VectorNodes(*(lower_scalar(w, a) for a in e.args if a is not None))


VECTOR_RULES = {
    "length": _lower_length, "unit": _lower_unit, "dot": _lower_dot, "cross": _lower_cross, "angle": _lower_angle,
    "rotate": _lower_rotate, "project": _lower_project, "limit": _lower_limit_length, "vector": _lower_vector,
}  # fmt: skip
