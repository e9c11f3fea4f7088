"""Lowers typed expressions to nodes: names, attributes, memories and expanded behaviours. The rules of single operations are in
`rules`."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace
from typing import Any

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.values import (
    ElementGroup,
    EntityRef,
    LoweredValue,
    NamedThing,
    OwnPosition,
    RayHit,
    RayHits,
    SetElement,
    VectorNodes,
)
from antdsl.plan.lowering.writer import AXES, KIND_BY_TYPE_KIND, NONE_BY_KIND, PlanWriter, UnsupportedConstruct
from antdsl.program import expectations, model
from antdsl.program.tables.editions import OPTIONAL_ATTRIBUTES
from antdsl.program.traverse import iterate_expressions, iterate_parts


def lower_expression(w: PlanWriter, expr: model.Expr) -> LoweredValue:
    """Return the nodes of an expression, evaluated at the writer's current position among the statements."""
    outer, w.b.span = w.b.span, expr.span
    try:
        return _LOWERER_BY_EXPRESSION[type(expr)](w, expr)
    finally:
        w.b.span = outer


def lower_scalar(w: PlanWriter, expr: model.Expr) -> PlanNode:
    """Lower an expression to one node: a number, a bool, a state, or the row or id of a reference."""
    return convert_to_node(w, expr, lower_expression(w, expr))


def convert_to_node(w: PlanWriter, expr: model.Expr, value: LoweredValue) -> PlanNode:
    """Return the value of a lowered expression as one node."""
    if isinstance(value, EntityRef):
        return value.node
    if isinstance(value, SetElement):
        return w.b("other.row") if value.kind is model.TypeKind.ITEM else w.b("other.id")
    if not isinstance(value, PlanNode):
        raise PlanError(f"expected one value, not a {type(value).__name__}: {expr.span.text!r}")
    return value


def lower_vector(w: PlanWriter, expr: model.Expr) -> VectorNodes:
    value = lower_expression(w, expr)
    if not isinstance(value, VectorNodes):
        raise PlanError(f"expected a vector, not a {type(value).__name__}: {expr.span.text!r}")
    return value


def lower_condition(w: PlanWriter, expr: model.Expr) -> PlanNode:
    """Lower an expression as a condition. A value that may be none counts as true when it is not none."""
    return convert_to_condition(w, lower_expression(w, expr), expr)


def convert_to_condition(w: PlanWriter, value: LoweredValue, expr: model.Expr) -> PlanNode:
    if isinstance(value, PlanNode) and value.kind is ValueKind.BOOL:
        return value
    if isinstance(value, PlanNode) and value.kind is ValueKind.F32:
        return w.b("gt", value, w.b.add_number(0))
    return lower_presence(w, value, expr)


def lower_presence(w: PlanWriter, value: LoweredValue, expr: model.Expr) -> PlanNode:
    """Return a node that is true if a reference, a hit or a set is present (not none)."""
    if isinstance(value, EntityRef):
        if value.kind is model.TypeKind.ITEM:
            return w.b("item.alive", value.node, attrs=(value.owner,))
        return w.b("agent.alive", value.node, attrs=(value.owner,))
    if isinstance(value, RayHit):
        return value.hit
    if isinstance(value, ElementGroup):
        return w.b("reduce.any", value.nodes, value.condition)
    if isinstance(value, RayHits):
        is_any = w.b.false
        for hit in value.hits:
            is_any = w.b("or", is_any, hit.hit)
        return is_any
    if isinstance(value, SetElement | OwnPosition | VectorNodes):
        return w.b.true
    raise PlanError(f"a {type(value).__name__} is never none: {expr.span.text!r}")


# --- leaves ----------------------------------------------------------------------------------------------------------


def _lower_constant(w: PlanWriter, e: model.Constant) -> LoweredValue:
    if e.type.kind is model.TypeKind.BOOL:
        return w.b.add_boolean(bool(e.number))
    node = w.b.add_number(e.number)
    for name, exponent in (("u", e.unit_power), ("dt", e.step)):
        if exponent:
            node = w.b("mul" if exponent > 0 else "div", node, _lower_unit_power(w, w.read_run_value(name), abs(exponent)))
    return node


def _lower_unit_power(w: PlanWriter, base: PlanNode, exponent: float) -> PlanNode:
    if exponent == int(exponent) and exponent <= 8:
        node = base
        for _ in range(int(exponent) - 1):
            node = w.b("mul", node, base)
        return node
    return w.b("sqrt", base) if exponent == 0.5 else w.b("pow", base, w.b.add_number(exponent))


def _lower_none(w: PlanWriter, e: model.NoneRef) -> LoweredValue:
    if e.type.kind is model.TypeKind.ITEM:
        return EntityRef(e.type.kind, e.type.referent or "", w.b.add_row(-1))
    if e.type.kind is model.TypeKind.AGENT:
        return EntityRef(e.type.kind, e.type.referent or "", w.b.add_agent_id(-1))
    if e.type.kind is model.TypeKind.HIT:
        nothing = values.make_zero_vector(w.b)
        return RayHit(w.b.false, w.b.add_number(float("inf")), nothing, nothing)
    raise PlanError(f"none of a {e.type.kind.value}")


def _lower_state(w: PlanWriter, e: model.StateConstant) -> LoweredValue:
    return w.b.add_row(e.index)


def _lower_param(w: PlanWriter, e: model.ParamRef) -> LoweredValue:
    node = w.b("param", attrs=(e.name,))
    return w.b("ne", node, w.b.add_number(0)) if e.type.kind is model.TypeKind.BOOL else node


def _lower_thing(w: PlanWriter, e: model.ThingRef) -> LoweredValue:
    if e.name == "self":
        return OwnPosition()
    return NamedThing(e.type.kind, e.name)


# --- names with a value ----------------------------------------------------------------------------------------------


def _lower_binding(w: PlanWriter, e: model.BindingRef) -> LoweredValue:
    binding = e.binding
    if binding in w.environment:
        value = w.environment[binding]
        if isinstance(value, SetElement) and binding is not w.set_elements[-1]:
            raise UnsupportedConstruct(f"`{binding.name}` inside another set", e.span, "use only elements of the inner set there")
        return value
    if binding.role == "latch":
        return w.read_current(binding.key or binding.name)
    if binding.role == "let":
        return _lower_let(w, binding)
    raise PlanError(f"{binding.role} `{binding.name}` is used outside of the expression that defines it")


def _lower_let(w: PlanWriter, binding: model.Binding) -> LoweredValue:
    """Lower a `let` once and return its value. Each use of the name also advances the memories inside the `let`.

    The nodes of a snapshot are reused during the complete step. Those of other lets, and of all lets at birth, are reused until
    the next store.
    """
    lasting = binding.is_snapshot and not w.is_birth
    known = w.snapshot_lets if lasting else w.current_lets
    for each in _order_needed_lets(w, binding, known):
        assert each.value is not None
        outer_met, w.used_memories = w.used_memories, []
        outer_snapshot, w.is_snapshot = w.is_snapshot, lasting
        try:
            value = lower_expression(w, each.value)
            known[each] = value, tuple(w.used_memories)
        finally:
            w.used_memories, w.is_snapshot = outer_met, outer_snapshot
    value, memories = known[binding]
    for memory in memories:
        w.advance_memory(memory)
    return value


def _order_needed_lets(w: PlanWriter, binding: model.Binding, known_lets: Container[model.Binding]) -> list[model.Binding]:
    """Return a `let` and the lets that it uses, innermost first. If they are lowered in this order, no deep recursion occurs."""
    order: list[model.Binding] = []
    stack: list[tuple[model.Binding, bool]] = [(binding, False)]
    visited: set[model.Binding] = set()
    while stack:
        each, ready = stack.pop()
        if each in visited or each in known_lets:
            continue
        if ready:
            visited.add(each)
            order.append(each)
            continue
        stack.append((each, True))
        assert each.value is not None
        for used in (e.binding for e in iterate_expressions(each.value) if isinstance(e, model.BindingRef)):
            if used.role == "let" and used not in w.environment and used.is_snapshot == binding.is_snapshot:
                stack.append((used, False))
    return order


def _lower_behaviour(w: PlanWriter, e: model.InlinedBehaviour) -> LoweredValue:
    for argument in e.arguments:
        assert argument.value is not None
        w.environment[argument] = lower_expression(w, argument.value)
    for binding in e.body:
        w.environment[binding] = _lower_keep(w, binding) if binding.role == "keep" else _lower_plain_let(w, binding)
    return lower_expression(w, e.result)


def _lower_plain_let(w: PlanWriter, binding: model.Binding) -> LoweredValue:
    assert binding.value is not None
    return lower_expression(w, binding.value)


def _lower_keep(w: PlanWriter, binding: model.Binding) -> LoweredValue:
    """Return the value of `keep x = first then next`. It is `first` in the first step. In later steps, it is `next`, which is
    computed from the previous value.

    The memory is written once per step."""
    assert binding.value is not None and binding.next_value is not None
    on = f"{binding.key}.on"
    w.declare_typed(binding.key, binding.type, "memory")
    w.declare_register(on, ValueKind.BOOL, "memory")
    first = lower_expression(w, binding.value)
    w.environment[binding] = _read_previous(w, binding)
    following = lower_expression(w, binding.next_value)
    now = select_value(w, w.read_previous(on), following, first)
    stores = (
        [(f"{binding.key}.{a}", n, binding.span) for a, n in zip(AXES, now, strict=True)]
        if isinstance(now, VectorNodes)
        else [(binding.key, now.node if isinstance(now, EntityRef) else now, binding.span)]
    )
    w.memory_updates[binding] = (*stores, (on, w.b.true, binding.span))
    w.advance_memory(binding)
    return now


def _read_previous(w: PlanWriter, binding: model.Binding) -> LoweredValue:
    if binding.type.kind is model.TypeKind.VECTOR:
        return VectorNodes(*(w.read_previous(f"{binding.key}.{axis}") for axis in AXES))
    node = w.read_previous(binding.key)
    return EntityRef(binding.type.kind, binding.type.referent or "", node) if binding.type.kind in NONE_BY_KIND else node


def select_value(w: PlanWriter, condition: PlanNode, first: LoweredValue, second: LoweredValue) -> LoweredValue:
    """Return `first` where the condition holds, else `second`. Both must be hits, or values that a register can store."""
    b = w.b
    if isinstance(first, VectorNodes) and isinstance(second, VectorNodes):
        return values.choose_vector(b, condition, first, second)
    if isinstance(first, RayHit) and isinstance(second, RayHit):
        return RayHit(
            b("where", condition, first.hit, second.hit), b("where", condition, first.distance, second.distance),
            values.choose_vector(b, condition, first.normal, second.normal),
            values.choose_vector(b, condition, first.direction, second.direction),
        )  # fmt: skip
    first, second = _convert_to_reference(w, first), _convert_to_reference(w, second)
    if isinstance(first, EntityRef) and isinstance(second, EntityRef):
        return EntityRef(first.kind, first.owner or second.owner, b("where", condition, first.node, second.node))
    if isinstance(first, PlanNode) and isinstance(second, PlanNode):
        return b("where", condition, first, second)
    raise PlanError(f"cannot choose between a {type(first).__name__} and a {type(second).__name__}")


def _convert_to_reference(w: PlanWriter, value: LoweredValue) -> LoweredValue:
    if isinstance(value, SetElement):
        return EntityRef(value.kind, value.owner, w.b("other.row") if value.kind is model.TypeKind.ITEM else w.b("other.id"))
    return value


# --- attributes ------------------------------------------------------------------------------------------------------


def _lower_attribute(w: PlanWriter, e: model.AttributeRef) -> LoweredValue:
    pair_attribute = next((a for a in w.species.attributes if a.name == e.name and a.pair_species), None)
    if pair_attribute is not None and e.owner is not None:
        return w.rules.read_pair_value(w, pair_attribute, e.owner)
    owner = None if e.owner is None else lower_expression(w, e.owner)
    e = replace(e, name="position") if e.name == "unwrapped" and w.period is None else e
    if e.name == "moved" and "moved" not in w.registers and getattr(owner, "kind", None) is not model.TypeKind.ITEM:
        words = "`moved` without another use in the program"
        raise UnsupportedConstruct(words, e.span, "add `let pushed = moved` to a species")
    if owner is None or isinstance(owner, OwnPosition):
        return read_own_attribute(w, e.name, e.type)
    if isinstance(owner, RayHit):
        return _read_hit_attribute(w, owner, e)
    if not isinstance(owner, SetElement | EntityRef):
        raise PlanError(f"`{e.name}` is not a value of a {type(owner).__name__}")
    if e.name == "speed":
        return values.compute_length(
            w.b, VectorNodes(*(_read_other_register(w, owner, f"velocity.{axis}", ValueKind.F32) for axis in AXES))
        )
    if e.name == "id" and owner.kind is model.TypeKind.AGENT:
        return w.b("number", w.b("other.id") if isinstance(owner, SetElement) else owner.node)
    if e.name == "age":
        return w.b("agent.age", w.b("other.id") if isinstance(owner, SetElement) else owner.node, attrs=(owner.owner,))
    if e.name in OPTIONAL_ATTRIBUTES:
        species = w.program.species.get(owner.owner or "")
        if species is not None and not needs_register(species, e.name):
            return w.b.add_number(OPTIONAL_ATTRIBUTES[e.name])
    if e.name == "position" and w.period is not None:
        return w.rules.locate_point(w, owner, e)[1]
    if e.type.kind is model.TypeKind.VECTOR:
        prefix = "" if owner.kind is model.TypeKind.ITEM and e.name == "position" else f"{e.name}."
        return VectorNodes(*(_read_other_register(w, owner, f"{prefix}{axis}", ValueKind.F32) for axis in AXES))
    return convert_to_typed_value(
        w, _read_other_register(w, owner, e.name, KIND_BY_TYPE_KIND[e.type.kind], NONE_BY_KIND.get(e.type.kind)), e.type
    )


def convert_to_typed_value(w: PlanWriter, node: PlanNode, type: model.ValueType) -> LoweredValue:
    """Convert a register's node to a value of the language. A number becomes a bool if `type` is a bool."""
    if type.kind in NONE_BY_KIND:
        return EntityRef(type.kind, type.referent or "", node)
    return w.b("ne", node, w.b.add_number(0)) if type.kind is model.TypeKind.BOOL and node.kind is ValueKind.F32 else node


def read_own_attribute(w: PlanWriter, name: str, type: model.ValueType) -> LoweredValue:
    """Return the value of an attribute of the agent itself."""
    if name == "id":
        return w.b("number", w.b("id"))
    if name == "age":
        return w.b("age")
    if name == "speed":
        return values.compute_length(w.b, w.read_vector("velocity"))
    if f"{name}.x" in w.registers:
        return w.read_vector(name)
    if name in OPTIONAL_ATTRIBUTES and name not in w.registers:
        return w.b.add_number(OPTIONAL_ATTRIBUTES[name])
    return convert_to_typed_value(w, w.read_at_step_start(name), type)


def needs_register(species: model.Species, name: str) -> bool:
    """Return whether agents of a species have a register for the attribute `name`. Most attributes always have one. Attributes
    in OPTIONAL_ATTRIBUTES have one only if the species declares or sets them."""
    if name not in OPTIONAL_ATTRIBUTES or any(a.name == name for a in species.attributes):
        return True
    return any(isinstance(part, model.Assign) and part.attribute == name for part in iterate_parts(species))


def _read_other_register(
    w: PlanWriter, owner: SetElement | EntityRef, register: str, kind: ValueKind, none_id: int | None = None
) -> PlanNode:
    if owner.kind is model.TypeKind.ITEM:
        kind = ValueKind.F32  # items have numbers only
    if isinstance(owner, SetElement):
        return w.b("other", attrs=(register,), kind=kind)
    if owner.kind is model.TypeKind.ITEM:
        return w.b("item.get", owner.node, attrs=(owner.owner, register), kind=kind)
    node = w.b("agent.get", owner.node, attrs=(owner.owner, register), kind=kind)
    if none_id is None:
        return node
    return w.b("where", w.b("agent.alive", owner.node, attrs=(owner.owner,)), node, w.b.add_constant(kind, none_id))


def _read_hit_attribute(w: PlanWriter, hit: RayHit, e: model.AttributeRef) -> LoweredValue:
    if e.name == "distance":
        return w.b("where", hit.hit, hit.distance, w.b.add_number(float("inf")))
    if e.name == "normal":
        return values.select_or_zero(w.b, hit.hit, hit.normal)
    reach = values.select_or_zero(w.b, hit.hit, values.scale_vector(w.b, hit.direction, hit.distance))
    return values.add_vectors(w.b, w.read_vector("position"), reach)


# --- operations ------------------------------------------------------------------------------------------------------


def _lower_operation(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    rule = w.rules.operation_rules.get(e.name)
    if rule is None:
        raise UnsupportedConstruct(f"`{e.name}`", e.span, "delete this line")
    return rule(w, e)


def _lower_clip_test(w: PlanWriter, e: model.ClipTest) -> LoweredValue:
    return w.rules.lower_clip_test(w, e)


def _lower_set(w: PlanWriter, e: model.SetExpr) -> LoweredValue:
    return w.rules.lower_set(w, e)


def _lower_reduction(w: PlanWriter, e: model.ReduceExpr) -> LoweredValue:
    return w.rules.lower_reduction(w, e)


def _lower_spec_expression(w: PlanWriter, e: model.Expr) -> LoweredValue:
    return w.lower_spec_expression(e)


_LOWERER_BY_EXPRESSION: dict[type, Callable[[PlanWriter, Any], LoweredValue]] = {
    model.Constant: _lower_constant, model.NoneRef: _lower_none, model.StateConstant: _lower_state,
    model.ClipTest: _lower_clip_test, model.ParamRef: _lower_param, model.ThingRef: _lower_thing,
    model.BindingRef: _lower_binding, model.InlinedBehaviour: _lower_behaviour, model.AttributeRef: _lower_attribute,
    model.OperationExpr: _lower_operation, model.SetExpr: _lower_set, model.ReduceExpr: _lower_reduction,
    **dict.fromkeys(expectations.RUN_EXPRESSIONS, _lower_spec_expression),
}  # fmt: skip
