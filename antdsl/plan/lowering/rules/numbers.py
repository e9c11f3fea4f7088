"""Rules for numbers and vectors, and for the operators that both have. A vector is three nodes."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower, scalar, single_node, vector
from antdsl.plan.lowering.values import LoweredValue, VectorNodes
from antdsl.plan.lowering.writer import PlanWriter
from antdsl.plan.simplify import constant_value
from antdsl.program import model

OperationRule = Callable[[PlanWriter, model.OperationExpr], LoweredValue]


def args(w: PlanWriter, e: model.OperationExpr) -> list[PlanNode]:
    """Return all operands as scalars. None of them may be absent."""
    return [scalar(w, a) for a in e.args if a is not None]


def _lower_both(w: PlanWriter, e: model.OperationExpr) -> tuple[LoweredValue, LoweredValue, Callable[[], list[PlanNode]]]:
    """Return both operands, and a function that returns them as scalars. Each operand is lowered only once, because two times
    would double the work at each level of nesting."""
    first, second = (a for a in e.args if a is not None)
    left, right = lower(w, first), lower(w, second)
    return left, right, lambda: [single_node(w, first, left), single_node(w, second, right)]


def _make_binary(op: str) -> OperationRule:
    def rule(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        left, right, scalars = _lower_both(w, e)
        if isinstance(left, VectorNodes) and isinstance(right, VectorNodes):
            return values.zip_with(lambda p, q: w.b(op, p, q), left, right)
        return w.b(op, *scalars())

    return rule


def _mul(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    left, right, scalars = _lower_both(w, e)
    if isinstance(left, VectorNodes) and isinstance(right, PlanNode):
        return values.scale(w.b, left, right)
    if isinstance(right, VectorNodes) and isinstance(left, PlanNode):
        return values.scale(w.b, right, left)
    return w.b("mul", *scalars())


def _div(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    dividend, divisor = (a for a in e.args if a is not None)
    left, right = lower(w, dividend), scalar(w, divisor)
    if isinstance(left, VectorNodes):
        return values.zip_with(lambda p: w.b("div", p, right), left)
    return w.b("div", single_node(w, dividend, left), right)


def _neg(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    (operand,) = (a for a in e.args if a is not None)
    inner = lower(w, operand)
    if isinstance(inner, VectorNodes):
        return values.neg(w.b, inner)
    return w.b("neg", single_node(w, operand, inner))


def _pow(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    base, exponent = args(w, e)
    known = constant_value(exponent)
    if known is None:
        return w.b("pow", base, exponent)
    if known == 0.5:
        return w.b("sqrt", base)
    if known != int(known) or abs(known) > 8:
        return w.b("pow", base, exponent)
    result = w.b.number(1)
    for _ in range(abs(int(known))):
        result = w.b("mul", result, base)
    return w.b("div", w.b.number(1), result) if known < 0 else result


def _make_plain(op: str) -> OperationRule:
    return lambda w, e: w.b(op, *args(w, e))


def _clamp(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    x, low, high = args(w, e)
    return w.b("min", w.b("max", x, low), high)


def share(w: PlanWriter, x: PlanNode, low: PlanNode, high: PlanNode) -> PlanNode:
    """Return the position of x between low and high, from 0 to 1. If low equals high, the result jumps from 0 to 1 there."""
    b = w.b
    wide = b("sub", high, low)
    between = b("min", b("max", b("div", b("sub", x, low), wide), b.number(0)), b.number(1))
    step = b("where", b("ge", x, high), b.number(1), b.number(0))
    return b("where", b("ne", wide, b.number(0)), between, step)


def _ramp(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    x, from_low, from_high, to_low, to_high = args(w, e)
    return _interpolate(w, to_low, to_high, share(w, x, from_low, from_high))


def _interpolate(w: PlanWriter, a: PlanNode, z: PlanNode, t: PlanNode) -> PlanNode:
    if constant_value(a) == 0:
        return w.b("mul", z, t)
    return w.b("add", w.b("mul", a, w.b("sub", w.b.number(1), t)), w.b("mul", z, t))


def _mix(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    first, second = (lower(w, a) for a in e.args[:2] if a is not None)
    t = scalar(w, e.args[2])  # type: ignore[arg-type]
    if isinstance(first, VectorNodes) and isinstance(second, VectorNodes):
        return values.zip_with(lambda p, q: _interpolate(w, p, q, t), first, second)
    if isinstance(first, PlanNode) and isinstance(second, PlanNode):
        return _interpolate(w, first, second, t)
    raise PlanError("mix of two unlike values")


def _rising(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return share(w, *args(w, e))


def _falling(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return w.b("sub", w.b.number(1), share(w, *args(w, e)))


def _around(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    x, low, high = args(w, e)
    b = w.b
    half = b("mul", b("sub", high, low), b.number(0.5))
    middle = b("add", low, half)
    return b("max", b("sub", b.number(1), b("div", b("abs", b("sub", x, middle)), half)), b.number(0))


def _make_comparison(op: str) -> OperationRule:
    def rule(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        left, right, scalars = _lower_both(w, e)
        if isinstance(left, VectorNodes) and isinstance(right, VectorNodes):
            same = w.b.all(*(w.b("eq", p, q) for p, q in zip(left, right, strict=True)))
            return same if op == "eq" else w.b("not", same)
        first, second = scalars()
        if first.kind is not second.kind:  # a bool and a number: compare both as numbers
            first, second = (n if n.kind is ValueKind.F32 else w.b("number", n) for n in (first, second))
        return w.b(op, first, second)

    return rule


NUMBER_RULES = {
    "add": _make_binary("add"), "sub": _make_binary("sub"), "mul": _mul, "div": _div, "neg": _neg, "pow": _pow,
    "lt": _make_plain("lt"), "le": _make_plain("le"), "gt": _make_plain("gt"), "ge": _make_plain("ge"),
    "eq": _make_comparison("eq"), "ne": _make_comparison("ne"),
    "abs": _make_plain("abs"), "floor": _make_plain("floor"), "sqrt": _make_plain("sqrt"), "sin": _make_plain("sin"),
    "cos": _make_plain("cos"),
    "exp": _make_plain("exp"), "log": _make_plain("log"), "min": _make_plain("min"), "max": _make_plain("max"),
    "clamp": _clamp, "ramp": _ramp, "mix": _mix, "rising": _rising, "falling": _falling, "around": _around,
}  # fmt: skip


def _length(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.length(w.b, vector(w, e.args[0]))  # type: ignore[arg-type]


def _unit(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.unit(w.b, vector(w, e.args[0]))  # type: ignore[arg-type]


def _pair(w: PlanWriter, e: model.OperationExpr) -> tuple[VectorNodes, VectorNodes]:
    return vector(w, e.args[0]), vector(w, e.args[1])  # type: ignore[arg-type]


def _dot(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.dot(w.b, *_pair(w, e))


def _cross(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.cross(w.b, *_pair(w, e))


def _angle(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.angle_between(w.b, *_pair(w, e))


def _unit_direction(w: PlanWriter, e: model.Expr) -> VectorNodes:
    """Return a direction of length 1. `up` and `heading` already have this length."""
    if isinstance(e, model.AttributeRef) and e.of is None and e.name in ("up", "heading"):
        return vector(w, e)
    return values.unit(w.b, vector(w, e))


def _rotate(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.rotate(w.b, vector(w, e.args[0]), _unit_direction(w, e.args[1]), scalar(w, e.args[2]))  # type: ignore[arg-type]


def _project(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    direction = _unit_direction(w, e.args[1])  # type: ignore[arg-type]
    return values.scale(w.b, direction, values.dot(w.b, vector(w, e.args[0]), direction))  # type: ignore[arg-type]


def _limit(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.limit(w.b, vector(w, e.args[0]), scalar(w, e.args[1]))  # type: ignore[arg-type]


def _vector(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return VectorNodes(*(scalar(w, a) for a in e.args if a is not None))


VECTOR_RULES = {
    "length": _length, "unit": _unit, "dot": _dot, "cross": _cross, "angle": _angle, "rotate": _rotate, "project": _project,
    "limit": _limit, "vector": _vector,
}  # fmt: skip
