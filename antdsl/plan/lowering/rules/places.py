"""Rules for points: distance, direction, touching. A point may be an item, agent, element, hit, curve, thing or position."""

from __future__ import annotations

from math import inf

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower_expression, lower_scalar
from antdsl.plan.lowering.values import EntityRef, LoweredValue, NamedThing, OwnPosition, RayHit, SetElement, VectorNodes
from antdsl.plan.lowering.writer import AXES, PlanWriter, UnsupportedConstruct
from antdsl.program import model


def locate_point(w: PlanWriter, value: LoweredValue, e: model.Expr) -> tuple[PlanNode, VectorNodes]:
    """Return a node that is true if the point exists, and the point's position (mm). In a periodic world, this is the image
    nearest to the agent."""
    b = w.b
    if isinstance(value, VectorNodes):
        return b.true, value
    if isinstance(value, OwnPosition):
        return b.true, w.read_vector("position")
    value = _find_nearest_member(w, value)
    if isinstance(value, EntityRef) and w.period is None:
        return _read_ref_position(w, value)
    if isinstance(value, SetElement) and w.period is None:
        prefix = "" if value.kind is model.TypeKind.ITEM else "position."
        return b.true, VectorNodes(*(b("other", attrs=(prefix + axis,), kind=ValueKind.F32) for axis in AXES))
    is_present, offset = compute_offset(w, value, e)
    return is_present, values.add_vectors(b, w.read_vector("position"), offset)


def compute_offset(w: PlanWriter, value: LoweredValue, e: model.Expr) -> tuple[PlanNode, VectorNodes]:
    """Return a node that is true if the point exists, and the vector from the agent to it (mm)."""
    b = w.b
    value = _find_nearest_member(w, value)
    if isinstance(value, SetElement):
        return b.true, VectorNodes(b("pair.x"), b("pair.y"), b("pair.z"))
    if isinstance(value, RayHit):
        return value.hit, values.scale_vector(b, value.direction, value.distance)
    if isinstance(value, NamedThing) and value.row.nearest_op == "obstacle.near":
        near = b(value.row.nearest_op, b.add_number(inf), attrs=(value.name,))
        within, distance, x, y, z = (b("get", near, attrs=(i,)) for i in range(5))
        return within, values.scale_vector(b, VectorNodes(x, y, z), b("neg", distance))
    if isinstance(value, NamedThing) and value.row.nearest_op == "curve.closest":
        is_present: PlanNode = b.true
        point = _find_curve_point(w, value.name)
    elif isinstance(value, NamedThing) and value.row.nearest_op == "camera.position":
        is_present, camera = b.true, b(value.row.nearest_op, attrs=(value.name,))
        point = VectorNodes(*(b("get", camera, attrs=(i,)) for i in range(3)))
    elif isinstance(value, EntityRef):
        is_present, point = _read_ref_position(w, value)
    elif isinstance(value, VectorNodes | OwnPosition):
        is_present, point = locate_point(w, value, e)
    else:
        raise PlanError(f"a {type(value).__name__} has no place: {e.span.text!r}")
    return is_present, _find_nearest_image(w, values.subtract_vectors(b, point, w.read_vector("position")))


def _find_nearest_image(w: PlanWriter, offset: VectorNodes) -> VectorNodes:
    """Return the shortest periodic image of a vector. In a world that does not wrap, this is the vector itself."""
    return offset if w.period is None else values.wrap_vector(w.b, offset, w.period)


def compute_distance(w: PlanWriter, value: LoweredValue, e: model.Expr) -> PlanNode:
    """Return the distance to a point in mm. It is infinite if the point does not exist."""
    b = w.b
    value = _find_nearest_member(w, value)
    if isinstance(value, SetElement):
        return b("pair.distance")
    if isinstance(value, RayHit):
        return b("where", value.hit, value.distance, b.add_number(inf))
    if isinstance(value, NamedThing) and value.row.nearest_op == "curve.closest":
        return b("get", b(value.row.nearest_op, attrs=(value.name,)), attrs=(0,))
    if isinstance(value, NamedThing) and value.row.nearest_op == "obstacle.near":
        near = b(value.row.nearest_op, b.add_number(inf), attrs=(value.name,))
        return b("where", b("get", near, attrs=(0,)), b("get", near, attrs=(1,)), b.add_number(inf))
    is_present, offset = compute_offset(w, value, e)
    return b("where", is_present, values.compute_length(b, offset), b.add_number(inf))


def _find_nearest_member(w: PlanWriter, value: LoweredValue) -> LoweredValue:
    """Return the member of a group of items, or of a species, that is nearest to the agent. Return any other value unchanged."""
    if isinstance(value, NamedThing) and value.row.nearest_op == "set.items":
        every = w.b(value.row.nearest_op, w.b.add_number(inf), attrs=(value.name,))
        return EntityRef(model.TypeKind.ITEM, value.name, w.b("reduce.item", every, w.b.true, w.b("pair.distance")))
    if isinstance(value, NamedThing) and value.row.nearest_op == "set.every":
        every = w.b(value.row.nearest_op, attrs=(value.name,))
        return EntityRef(model.TypeKind.AGENT, value.name, w.b("reduce.agent", every, w.b.true, w.b("pair.distance")))
    return value


def _read_ref_position(w: PlanWriter, ref: EntityRef) -> tuple[PlanNode, VectorNodes]:
    b = w.b
    if ref.kind is model.TypeKind.ITEM:
        is_present = b("item.alive", ref.node, attrs=(ref.owner,))
        return is_present, VectorNodes(*(b("item.get", ref.node, attrs=(ref.owner, axis), kind=ValueKind.F32) for axis in AXES))
    is_present = b("agent.alive", ref.node, attrs=(ref.owner,))
    return is_present, VectorNodes(
        *(b("agent.get", ref.node, attrs=(ref.owner, f"position.{axis}"), kind=ValueKind.F32) for axis in AXES)
    )


def _find_curve_point(w: PlanWriter, curve: str) -> VectorNodes:
    closest = w.b("curve.closest", attrs=(curve,))
    return VectorNodes(*(w.b("get", closest, attrs=(1 + i,)) for i in range(3)))


def _lower_point_argument(w: PlanWriter, e: model.OperationExpr, index: int = 0) -> tuple[LoweredValue, model.Expr]:
    expr = e.args[index]
    assert expr is not None
    return lower_expression(w, expr), expr


# --- the rules -------------------------------------------------------------------------------------------------------


def _lower_distance(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return compute_distance(w, *_lower_point_argument(w, e))


def _lower_direction(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    b = w.b
    start, start_expr = _lower_point_argument(w, e)
    if len(e.args) < 2 or e.args[1] is None:
        return _compute_direction(w, start, start_expr)
    end, end_expr = _lower_point_argument(w, e, 1)
    if isinstance(end, OwnPosition):
        return values.negate_vector(b, _compute_direction(w, start, start_expr))
    if isinstance(start, OwnPosition):
        return _compute_direction(w, end, end_expr)
    has_start, from_point = locate_point(w, start, start_expr)
    has_end, to_point = locate_point(w, end, end_expr)
    return values.select_or_zero(
        b,
        b("and", has_start, has_end),
        values.normalise_vector(b, _find_nearest_image(w, values.subtract_vectors(b, to_point, from_point))),
    )


def _compute_direction(w: PlanWriter, value: LoweredValue, e: model.Expr) -> VectorNodes:
    b = w.b
    if isinstance(value, RayHit):
        return values.select_or_zero(b, value.hit, value.direction)
    is_present, offset = compute_offset(w, value, e)
    size = b("pair.distance") if isinstance(value, SetElement) else values.compute_length(b, offset)
    return values.select_or_zero(b, is_present, values.divide_vector(b, offset, size))


def _lower_position(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    is_present, point = locate_point(w, *_lower_point_argument(w, e))
    return values.choose_vector(w.b, is_present, point, w.read_vector("position"))


def _lower_velocity(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    value = _lower_point_argument(w, e)[0]
    if isinstance(value, OwnPosition):
        return w.read_vector("velocity")
    value = _find_nearest_member(w, value)
    if isinstance(value, EntityRef) and value.kind is model.TypeKind.AGENT:
        return VectorNodes(
            *(w.b("agent.get", value.node, attrs=(value.owner, f"velocity.{axis}"), kind=ValueKind.F32) for axis in AXES)
        )
    if isinstance(value, SetElement) and value.kind is model.TypeKind.AGENT:
        return VectorNodes(*(w.b("other", attrs=(f"velocity.{axis}",), kind=ValueKind.F32) for axis in AXES))
    return values.make_zero_vector(w.b)


def _lower_touching(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    value, expr = _lower_point_argument(w, e)
    b = w.b
    radius = w.read_at_step_start("radius")
    if isinstance(value, NamedThing):
        row = value.row
        if row.touching_op:
            return b(row.touching_op, attrs=(value.name,))
        if row.has_faces:
            return b("get", b(row.nearest_op, radius, attrs=(value.name,)), attrs=(0,))
        if row.nearest_op == "set.items":
            every = b(row.nearest_op, b.add_number(inf), attrs=(value.name,))
            reach = b("add", b("other", attrs=("radius",), kind=ValueKind.F32), radius)
            return b("reduce.any", every, b("le", b("pair.distance"), reach))
        if row.nearest_op == "set.every":
            words = "touching any agent of a species"
            raise UnsupportedConstruct(words, e.span, f"any(n in neighbours(size, of: {value.name}): touching(n))")
    if isinstance(value, SetElement):
        radius = b("add", b("other", attrs=("radius",), kind=ValueKind.F32), radius)
    if isinstance(value, EntityRef):
        op = "item.get" if value.kind is model.TypeKind.ITEM else "agent.get"
        radius = b("add", b(op, value.node, attrs=(value.owner, "radius"), kind=ValueKind.F32), radius)
    return b("le", compute_distance(w, value, expr), radius)


def _lower_falloff(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return floor / max(distance, floor), which is 1 within the distance `floor` of a point (decision 19). It is 0 if the point
    does not exist."""
    distance = compute_distance(w, *_lower_point_argument(w, e))
    assert e.args[1] is not None
    floor = lower_scalar(w, e.args[1])
    return w.b("div", floor, w.b("max", distance, floor))


PLACE_RULES = {
    "distance": _lower_distance, "direction": _lower_direction, "position": _lower_position, "velocity": _lower_velocity,
    "touching": _lower_touching, "falloff": _lower_falloff,
}  # fmt: skip
