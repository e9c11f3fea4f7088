"""Lowers pair values: values that an agent stores about a few other agents. Each slot has two registers: the other agent's id,
and the value.

About an agent without a slot, the value is the initial value, which is also the rest value. If all slots are used, a new agent
replaces the weakest. The weakest is the agent with the value nearest to rest; among equals, the one with the greater id."""

from __future__ import annotations

from math import inf, nan

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode, ValueKind
from antdsl.plan.lowering.expressions import lower_expression, lower_scalar
from antdsl.plan.lowering.sets import lower_set, lower_with_binding
from antdsl.plan.lowering.values import ElementGroup, LoweredValue, OwnPosition, SetElement
from antdsl.plan.lowering.writer import PlanWriter
from antdsl.plan.registers import list_slot_register_names
from antdsl.program import model

REST_TOLERANCE = 1e-9  # base units; values nearer to rest have no slot


def declare_registers(w: PlanWriter, attribute: model.AttributeDecl) -> None:
    """Declare the registers of a pair value. Also declare a temp with the name of the attribute, through which every value
    passes before it is stored."""
    holds = (attribute.type.kind.value, *attribute.type.dimension, attribute.pair_species)
    for who, value in list_slot_register_names(attribute.name, attribute.slot_count):
        w.declare_register(who, ValueKind.I64, "pair", -1, attribute.pair_species, holds)
        w.declare_register(value, ValueKind.F32, "pair", language_type=holds)
    w.declare_register(attribute.name, ValueKind.F32, "temp")


def find_pair_attribute(w: PlanWriter, name: str) -> model.AttributeDecl | None:
    """Return the declaration of the pair value `name`, or None if there is none."""
    return next((a for a in w.species.attributes if a.name == name and a.pair_species), None)


def read_pair_attribute(w: PlanWriter, attribute: model.AttributeDecl, other: model.Expr) -> PlanNode:
    """Return the value of `attribute[other]`, such as `likes[other]`."""
    other_id = _lower_agent_id(w, lower_expression(w, other))
    result = lower_rest_value(w, attribute)
    for who, value in reversed(_read_slots(w, attribute)):
        result = w.b("where", w.b("eq", who, other_id), value, result)
    if other_id.op == "other.id":
        return result
    return w.b("where", w.b("eq", other_id, w.b.add_agent_id(-1)), lower_rest_value(w, attribute), result)


def write_relaxation_of_slots(w: PlanWriter, attribute: model.AttributeDecl) -> None:
    """Write the relaxation of each value towards its rest value, at the start of a step. When a value reaches its rest value,
    its slot becomes free."""
    b = w.b
    b.span = attribute.span
    rest = lower_rest_value(w, attribute)
    keep = b.add_number(1)
    if attribute.relax_time is not None:
        keep = b("exp", b("neg", b("div", w.read_run_value("dt"), lower_scalar(w, attribute.relax_time))))
    for (who, value), names in zip(
        _read_slots(w, attribute), list_slot_register_names(attribute.name, attribute.slot_count), strict=True
    ):
        away = b("mul", b("sub", value, rest), keep)
        is_expired = b("or", b("eq", who, b.add_agent_id(-1)), b("le", b("abs", away), b.add_number(REST_TOLERANCE)))
        w.add_store(names[0], b("where", is_expired, b.add_agent_id(-1), who), attribute.span)
        w.add_store(names[1], b("where", is_expired, b.add_number(0), b("add", rest, away)), attribute.span)


def write_assignment(w: PlanWriter, s: model.Assign, attribute: model.AttributeDecl) -> None:
    """Write an assignment or addition to a pair value, about one other agent or about each agent of a set."""
    if s.other_agents is not None:
        _write_set_assignment(w, s, attribute)
        return
    if s.pair_agent is None:
        raise PlanError(f"this value compares two agents, but there is no other agent: {s.span.text!r}")
    other_id = _lower_agent_id(w, lower_expression(w, s.pair_agent))
    value = _compute_changed_value(w, s, read_pair_attribute(w, attribute, s.pair_agent), lower_scalar(w, s.value))
    with w.open_region(w.b("ne", other_id, w.b.add_agent_id(-1)), s.span):
        held = _store_in_temporary(w, f"~{attribute.name}.id", other_id, s)
        _store_in_slot(w, attribute, held, value, s, has_slot=True)


def _write_set_assignment(w: PlanWriter, s: model.Assign, attribute: model.AttributeDecl) -> None:
    """Write an assignment to the values about all agents of a set. An agent that already has a slot stays in it. Free slots are
    given to the other agents with the strongest values.

    All values are computed before any is stored, because a value may depend on other pair values."""
    b = w.b
    assert s.other_agents is not None and s.element is not None
    over = lower_set(w, s.other_agents)
    if not isinstance(over, ElementGroup):
        raise PlanError(f"this value compares two agents, but the set contains hits: {s.span.text!r}")
    rest, zero = lower_rest_value(w, attribute), b.add_number(0)
    amount = lower_with_binding(w, s.element, over.element, lambda: _compute_changed_value(w, s, zero, lower_scalar(w, s.value)))
    strength = b("abs", b("sub", amount, rest if s.op == "=" else zero))
    other, slots = b("other.id"), _read_slots(w, attribute)
    sound = b("eq", b("finite", amount), amount)
    wrong = b("reduce.any", over.nodes, b("and", over.condition, b("not", sound)))
    w.add_store(attribute.name, b("where", wrong, b.add_number(nan), zero), s.span)
    holds = b("and", over.condition, sound)
    changed_values = []
    for k, (who, value) in enumerate(slots):
        matched_amount = b("reduce.max", over.nodes, b("and", holds, b("eq", other, who)), amount)
        changed = b(
            "where",
            b("gt", matched_amount, b.add_number(-inf)),
            matched_amount if s.op == "=" else b("add", value, matched_amount),
            value,
        )
        changed_values.append(_store_in_temporary(w, f"~{attribute.name}.{k}", changed, s))
    new = b.add_conjunction(holds, b("gt", strength, b.add_number(REST_TOLERANCE)), *(b("ne", other, who) for who, _ in slots))
    coming = [(f"~{attribute.name}.new.{k}.id", f"~{attribute.name}.new.{k}") for k in range(attribute.slot_count)]
    for names in coming:
        w.declare_register(names[0], ValueKind.I64, "temp", -1)
        w.declare_register(names[1], ValueKind.F32, "temp")
        w.add_store(names[0], b.add_agent_id(-1), s.span)

    def find_strongest(new: PlanNode, left: int) -> None:
        """Find the strongest agent that has no slot, and then the next strongest, by recursion. `left`: how many agents are
        still to be found."""
        other_id = b("reduce.agent", over.nodes, new, b("neg", strength))
        with w.open_region(b("ne", other_id, b.add_agent_id(-1)), s.span):
            matched_amount = b("reduce.max", over.nodes, b("eq", other, other_id), amount)
            who, value = coming[-left]
            w.add_store(who, other_id, s.span)
            w.add_store(value, matched_amount if s.op == "=" else b("add", rest, matched_amount), s.span)
            if left > 1:
                find_strongest(b("and", new, b("ne", other, other_id)), left - 1)

    def come_in(left: int) -> None:
        who, value = coming[-left]
        with w.open_region(b("ne", w.read_at_step_start(who), b.add_agent_id(-1)), s.span):
            _store_in_slot(w, attribute, w.read_at_step_start(who), w.read_at_step_start(value), s, has_slot=False)
            if left > 1:
                come_in(left - 1)

    find_strongest(new, attribute.slot_count)
    for names, value in zip(list_slot_register_names(attribute.name, attribute.slot_count), changed_values, strict=True):
        w.add_store(names[1], value, s.span)
    come_in(attribute.slot_count)


def _store_in_temporary(w: PlanWriter, name: str, value: PlanNode, s: model.Assign) -> PlanNode:
    """Write a store of a value into a temp, and return the node that reads the temp. The node retains this value, whatever is
    stored in other registers later."""
    w.declare_register(name, value.kind, "temp", -1 if value.kind is ValueKind.I64 else 0)
    w.add_store(name, value, s.span)
    return w.read_at_step_start(name)


def _store_in_slot(
    w: PlanWriter, attribute: model.AttributeDecl, other_id: PlanNode, value: PlanNode, s: model.Assign, has_slot: bool
) -> None:
    """Write a store of a value about another agent into the slots of a pair value.

    The slots are visited in order. Each slot compares its value with the new one, stores the stronger of the two, and passes the
    weaker one on to the next slot. The value that the last slot passes on is dropped.
    `has_slot`: whether the other agent may already have a slot. Such a slot is freed first."""
    b, rest = w.b, lower_rest_value(w, attribute)
    carried, amount = other_id, _store_in_temporary(w, attribute.name, value, s)
    strength = b("abs", b("sub", amount, rest))
    changed: list[tuple[PlanNode, PlanNode]] = []
    for who, stored_value in _read_slots(w, attribute):
        if has_slot:
            freed = b("eq", who, other_id)
            who, stored_value = b("where", freed, b.add_agent_id(-1), who), b("where", freed, b.add_number(0), stored_value)
        held = b("where", b("eq", who, b.add_agent_id(-1)), b.add_number(-1), b("abs", b("sub", stored_value, rest)))
        tie = b("and", b("eq", strength, held), b("lt", carried, who))
        stays = b("or", b("gt", strength, held), tie)
        changed.append((b("where", stays, carried, who), b("where", stays, amount, stored_value)))
        carried, amount = b("where", stays, who, carried), b("where", stays, stored_value, amount)
        strength = b("where", stays, held, strength)
    names = list_slot_register_names(attribute.name, attribute.slot_count)
    for (who_name, value_name), (who, stored_value) in zip(
        reversed(names), reversed(changed), strict=True
    ):  # in reverse, so that no store changes a value that a later store reads
        held = _store_in_temporary(w, f"~{attribute.name}.slot", who, s)
        w.add_store(value_name, stored_value, s.span)
        w.add_store(who_name, held, s.span)


def _compute_changed_value(w: PlanWriter, s: model.Assign, old: PlanNode, value: PlanNode) -> PlanNode:
    if s.op == "=":
        return value
    change = w.b("mul", value, w.read_run_value("dt")) if s.per_second else value
    return w.b("add" if s.op == "+=" else "sub", old, change)


def _read_slots(w: PlanWriter, attribute: model.AttributeDecl) -> list[tuple[PlanNode, PlanNode]]:
    return [
        (w.read_at_step_start(who), w.read_at_step_start(value))
        for who, value in list_slot_register_names(attribute.name, attribute.slot_count)
    ]


def lower_rest_value(w: PlanWriter, attribute: model.AttributeDecl) -> PlanNode:
    """Return the initial and rest value of a pair value: a constant or a param."""
    return lower_scalar(w, attribute.default)


def _lower_agent_id(w: PlanWriter, value: LoweredValue) -> PlanNode:
    """Return the id of the agent to which a pair value refers."""
    if isinstance(value, OwnPosition):
        return w.b("id")
    return w.b("other.id") if isinstance(value, SetElement) else value.node  # type: ignore[union-attr]
