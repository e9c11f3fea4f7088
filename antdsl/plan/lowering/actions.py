"""Lowers statements of the language to statements of the plan, for a state's body and for action blocks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from antdsl.plan import ir
from antdsl.plan.builder import PlanError
from antdsl.plan.field_components import name_field_components
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import appearance, clips, pair_values, values
from antdsl.plan.lowering.expressions import convert_to_node, lower_expression, lower_scalar, lower_vector, read_own_attribute
from antdsl.plan.lowering.values import EntityRef, NamedThing, OwnPosition, VectorNodes
from antdsl.plan.lowering.writer import AXES, PlanWriter, UnsupportedConstruct
from antdsl.program import model
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.vocabulary import is_limit_attribute
from antdsl.source import Span

OperandTuple = tuple[PlanNode | None, ...]
STEER_TEMP, GAZE_TEMP = "~steer", "~gaze"  # `~` cannot occur in names of the program


def write_statements(w: PlanWriter, statements: Sequence[model.Statement], site: str, machine: str = "") -> None:
    """Write statements in the order of the source. Unsupported statements are reported and omitted. `machine`: the machine to
    which the statements belong, if they are the body of a state."""
    for number, statement in enumerate(statements, 1):
        w.b.span = statement.span
        try:
            if isinstance(statement, model.Play):
                clips.lower_play(w, machine, statement)
            else:
                _LOWERER_BY_STATEMENT[type(statement)](w, statement, f"{site}#{number}")
        except UnsupportedConstruct as missing:
            report_unsupported(w, missing)


def report_unsupported(w: PlanWriter, construct: UnsupportedConstruct) -> None:
    """Report an error for a construct that cannot run yet."""
    w.report.error("not-yet", f"{construct.construct} is not supported yet", construct.span, construct.help)


def _scale_by_step(w: PlanWriter, amount: PlanNode, is_rate: bool) -> PlanNode:
    """Return the amount to add in one step. An amount is returned unchanged; a rate per second is multiplied by `dt`."""
    return w.b("mul", amount, w.read_run_value("dt")) if is_rate else amount


def _lower_steer(w: PlanWriter, s: model.Steer, site: str) -> None:
    for axis in AXES:
        w.declare_register(f"{STEER_TEMP}.{axis}", ValueKind.F32, "temp")
    push = lower_vector(w, s.push)
    w.note_steering(s, site, push)
    w.store_vector(STEER_TEMP, values.add_vectors(w.b, w.read_vector(STEER_TEMP), push), s.span)


def _lower_face(w: PlanWriter, s: model.FaceLine, site: str) -> None:
    direction = lower_vector(w, s.direction)
    w.note_steering(s, site, direction)
    store_face_direction(w, GAZE_TEMP, direction, s.span)


def store_face_direction(w: PlanWriter, register: str, direction: VectorNodes, span: Span | None) -> None:
    """Store the direction that a `face` line requests in the temporary register `register`. If an earlier line has stored a
    direction there, it remains."""
    for axis in AXES:
        w.declare_register(f"{register}.{axis}", ValueKind.F32, "temp")
    previous = w.read_vector(register)
    w.store_vector(
        register,
        values.choose_vector(w.b, w.b("gt", values.compute_length(w.b, previous), w.b.add_number(0)), previous, direction),
        span,
    )


def _lower_assign(w: PlanWriter, s: model.Assign, site: str) -> None:
    pair_attribute = pair_values.find_pair_attribute(w, s.attribute)
    if pair_attribute is not None:
        pair_values.write_assignment(w, s, pair_attribute)
        return
    b = w.b
    value = lower_expression(w, s.value)
    if s.op != "=":
        old = read_own_attribute(w, s.attribute, s.value.type)
        if isinstance(value, VectorNodes) and isinstance(old, VectorNodes):
            change = values.scale_vector(b, value, w.read_run_value("dt")) if s.per_second else value
            value = values.add_vectors(b, old, change) if s.op == "+=" else values.subtract_vectors(b, old, change)
        else:
            if not isinstance(value, PlanNode) or not isinstance(old, PlanNode):
                raise PlanError(f"`{s.op}` expects a number, but gets another value: {s.span.text!r}")
            value = b("add" if s.op == "+=" else "sub", old, _scale_by_step(w, value, s.per_second))
    if s.attribute == "heading" and isinstance(value, VectorNodes):
        size = values.compute_length(b, value)
        value = values.choose_vector(
            b,
            b("gt", size, b.add_number(values.MIN_VECTOR_LENGTH)),
            values.divide_vector(b, value, size),
            w.read_vector("heading"),
        )
    w.store_value(s.attribute, value, s.span, allows_infinity=is_limit_attribute(s.attribute))


def _lower_give(w: PlanWriter, s: model.Give, site: str) -> None:
    to = lower_expression(w, s.receiver)
    if isinstance(to, NamedThing):
        every = w.b("set.items", w.b.add_number(float("inf")), attrs=(to.name,))
        to = EntityRef(model.TypeKind.ITEM, to.name, w.b("reduce.item", every, w.b.true, w.b("pair.distance")))
    if not isinstance(to, EntityRef) or to.kind is not model.TypeKind.ITEM:
        raise PlanError(f"a `give` statement cannot have the target {type(to).__name__}")
    amount = None if s.amount is None else _scale_by_step(w, lower_scalar(w, s.amount), s.per_second)
    w.add_statement(ir.Give(to.owner, s.attribute, to.node, amount, s.attribute, s.span))
    w.mark_written(s.attribute)


def _lower_request(w: PlanWriter, s: model.EffectRequest, site: str) -> None:
    """Write a request, with the operands that its row in the table of effects lists. Operands are the arguments of the line, or
    are computed from the arguments."""
    field = w.program.fields.get(s.target) if EFFECT_BY_OPERATION[s.op].target == "field" else None
    if field is not None and field.has_vectors:
        _lower_vector_deposit(w, s)
        return
    rule = OPERAND_LOWERERS.get(s.op)
    if rule is not None:
        operands = rule(w, *s.args)
    else:
        operands = tuple(None if arg is None else _lower_operand(w, arg, s.per_second) for arg in s.args)
    target_species = next(
        (arg.type.referent for arg in s.args if arg is not None and arg.type.kind is model.TypeKind.AGENT), None
    )
    w.add_statement(
        ir.Request(s.op, s.target, operands, s.span, register=s.result_attribute, site=s.draw_key, target_species=target_species)
    )


def _lower_vector_deposit(w: PlanWriter, s: model.EffectRequest) -> None:
    """Write a deposit of a vector as three deposits: its x, y and z components into the scalar fields of the components."""
    (vector_expr,) = s.args
    assert vector_expr is not None
    vector = lower_vector(w, vector_expr)
    for name, component in zip(name_field_components(s.target), vector, strict=True):
        w.add_statement(ir.Request(s.op, name, (_scale_by_step(w, component, s.per_second),), s.span))


def _lower_operand(w: PlanWriter, arg: model.Expr, per_second: bool) -> PlanNode:
    value = lower_expression(w, arg)
    if isinstance(value, OwnPosition):
        return w.b("id")
    node = convert_to_node(w, arg, value)
    return _scale_by_step(w, node, per_second) if node.kind is ValueKind.F32 else node


def _compute_carve_ball(w: PlanWriter, radius_expr: model.Expr | None, direction_expr: model.Expr | None) -> OperandTuple:
    """Return the operands of a request to carve a ball out of the ground.

    The centre of the ball is ahead of the agent, at half a body length plus half of the ball's radius. The lowest point of the
    ball is level with the feet, so an agent that digs ahead stays level."""
    assert radius_expr is not None
    b = w.b
    radius = lower_scalar(w, radius_expr)
    heading = w.read_vector("heading")
    ahead = heading if direction_expr is None else values.normalise_vector(b, lower_vector(w, direction_expr))
    if direction_expr is not None:
        size = values.compute_length(b, ahead)
        ahead = values.choose_vector(b, b("gt", size, b.add_number(0.5)), ahead, heading)
    reach = b("mul", b("add", w.read_at_step_start("size"), radius), b.add_number(0.5))
    middle = values.add_vectors(b, w.read_vector("position"), values.scale_vector(b, w.read_vector("up"), radius))
    middle = values.add_vectors(b, middle, values.scale_vector(b, ahead, reach))
    return radius, middle.x, middle.y, middle.z


# Functions that compute the operands of an effect from its arguments, for rows with computed operands.
OPERAND_LOWERERS: dict[str, Callable[..., OperandTuple]] = {"carve": _compute_carve_ball}
_LOWERER_BY_STATEMENT: dict[type, Callable[[PlanWriter, Any, str], None]] = {
    model.Steer: _lower_steer, model.FaceLine: _lower_face, model.Assign: _lower_assign, model.Give: _lower_give,
    model.EffectRequest: _lower_request,
    **appearance.LOWERER_BY_STATEMENT,
}  # fmt: skip
