"""Lowers the birth of an agent: its attributes in the order of their dependencies, `on spawn`, and the entry into its start
states."""

from __future__ import annotations

from functools import partial
from graphlib import TopologicalSorter
from math import inf

from antdsl.plan.builder import PlanBuilder
from antdsl.plan.ir import PlanNode, ValueKind, format_birth_register_name
from antdsl.plan.lowering import appearance, clips, pair_values
from antdsl.plan.lowering.actions import report_unsupported, write_statements
from antdsl.plan.lowering.expressions import convert_to_condition, lower_expression, needs_register
from antdsl.plan.lowering.machines import MachineWriter
from antdsl.plan.lowering.values import LoweredValue
from antdsl.plan.lowering.writer import PlanWriter, UnsupportedConstruct
from antdsl.program import model
from antdsl.program.tables.columns import REGISTER_COLUMN_BY_NAME
from antdsl.program.tables.editions import (
    CRAWLING_SIZE_SETTING,
    DEFAULT_BY_SETTING,
    OPTIONAL_ATTRIBUTES,
    STANDING_DEFAULTS,
    STANDING_SIZE_SETTING,
)
from antdsl.program.tables.vocabulary import get_builtin_attributes, is_limit_attribute
from antdsl.program.traverse import iterate_expressions

VECTOR_ATTRIBUTES = tuple(name for name, column in REGISTER_COLUMN_BY_NAME.items() if column.shape)
# Of bodies that stay outside their ground: the shift of the body, how much its feet wait for it, how deep it is inside a surface,
# the direction out of what it has met, and for how many seconds its feet could not move. The runtime sets them.
CLEARANCE_REGISTERS = ("~lift.x", "~lift.y", "~lift.z", "~wait", "~depth", "~out.x", "~out.y", "~out.z", "~idle")
LOWERING_REGISTER = "~lowering"  # of bodies that crouch: by which share of the height a body is lower. The runtime sets it.
# Built-in attributes, each after those that its default reads. The runtime sets `group`, the line of the scene's `crowd`.
BIRTH_ATTRIBUTES = (
    "height", "size", "mass", "radius", "clearance", "max_speed", "min_speed", "upright", "max_slope", "crouch", "response",
    "max_turn", "max_force",
)  # fmt: skip


def declare_registers(w: PlanWriter) -> None:
    """Declare the registers that every agent has, then the registers of the attributes that the author declares."""
    for name in VECTOR_ATTRIBUTES:
        for axis in "xyz":
            w.declare_register(f"{name}.{axis}", ValueKind.F32, "attribute")
    for name in (*_order_birth_attributes(w.species), "group"):
        w.declare_register(name, ValueKind.F32, "attribute")
    if w.has_moved_register:
        w.declare_register("moved", ValueKind.F32, "attribute")
    if w.period is not None:
        for axis in "xyz":
            w.declare_register(f"unwrapped.{axis}", ValueKind.F32, "attribute")
    if w.species.has_body_clearance:
        for name in CLEARANCE_REGISTERS:
            w.declare_register(name, ValueKind.F32, "attribute")
    if "crouch" in list_newer_attributes(w.species):
        w.declare_register(LOWERING_REGISTER, ValueKind.F32, "attribute")
    for attribute in w.species.attributes:
        if attribute.pair_species:
            pair_values.declare_registers(w, attribute)
            continue
        if attribute.name == "push":
            w.report.error("reserved-name", "`push` is reserved", attribute.span, "rename the attribute")
            continue
        if not attribute.is_builtin and attribute.name not in _order_birth_attributes(w.species):
            w.declare_typed(attribute.name, attribute.type, "attribute")


def compute_builtin_default(w: PlanWriter, name: str) -> PlanNode:
    """Return the default of a built-in attribute that the author does not set."""
    b: PlanBuilder = w.b
    if name == CRAWLING_SIZE_SETTING and is_standing(w.species):
        return b("mul", w.read_at_step_start(STANDING_SIZE_SETTING), b.add_number(w.proportions.size_per_height))
    if name == "radius" and is_standing(w.species):
        return b("mul", w.read_at_step_start("size"), b.add_number(w.proportions.radius_per_size))
    if name in OPTIONAL_ATTRIBUTES:
        return b.add_number(OPTIONAL_ATTRIBUTES[name])
    if name in _PLAIN_DEFAULTS:
        return b.add_number(_PLAIN_DEFAULTS[name])
    if name == "radius":
        return b("mul", w.read_at_step_start("size"), b.add_number(0.5))
    # `max_force` reaches full speed within `response`. A kinematic agent (response of at most one step) may reverse at once,
    # which needs twice the force.
    dt = w.read_run_value("dt")
    time = b("max", w.read_at_step_start("response"), dt)
    strength = b("div", b("mul", w.read_at_step_start("mass"), w.read_at_step_start("max_speed")), time)
    is_instant = b("le", w.read_at_step_start("response"), b("mul", dt, b.add_number(1.0001)))
    return b("mul", strength, b("where", is_instant, b.add_number(2), b.add_number(1)))


# Attributes that the default of another one reads, if agents have them.
_DEFAULT_OPERANDS = {"size": ("height",), "radius": ("size",), "max_force": ("mass", "max_speed", "response")}
_PLAIN_DEFAULTS = {"size": 4.0, "mass": 1.0, "clearance": 0.0, "max_speed": 30.0, "response": 0.15, "max_turn": inf}


def _order_birth_attributes(species: model.Species) -> list[str]:
    """Return the names of the built-in attributes. Each comes after the attributes that its default reads."""
    known = get_builtin_attributes(species.edition)
    names = [name for name in BIRTH_ATTRIBUTES if name in known and needs_register(species, name)]
    return [name for name in names if name != STANDING_SIZE_SETTING or is_standing(species)]


def list_newer_attributes(species: model.Species) -> tuple[str, ...]:
    """Return the built-in attributes of a species that do not exist in edition 1."""
    return tuple(name for name in _order_birth_attributes(species) if name not in get_builtin_attributes(1))


def is_standing(species: model.Species) -> bool:
    """Return whether the bodies of a species stand upright. They do if the species sets their height."""
    return any(attribute.is_builtin and attribute.name == STANDING_SIZE_SETTING for attribute in species.attributes)


def write_birth(w: PlanWriter, machines: list[MachineWriter]) -> None:
    """Write the statements that set the registers of a new agent, followed by its entry into the start states."""
    if w.period is not None:
        w.store_vector("unwrapped", w.read_vector("position"), w.species.span)
    for machine in machines:
        machine.write_start_state()
    for name in _order_attributes(w):
        _write_attribute(w, name)
    for number, handler in enumerate(h for h in w.species.handlers if h.event == "spawn"):
        write_statements(w, handler.actions, f"{w.species.name}.on.spawn#{number + 1}")
    for machine in machines:
        machine.write_start_actions()
    for machine in machines:
        machine.write_per_start_state(partial(appearance.write_state_appearance, w))
    appearance.store_layers_and_channels(w)
    clips.store_start_heading(w)


def _choose_scene_value_or_default(w: PlanWriter, name: str, default: LoweredValue) -> LoweredValue:
    """Return the value that the scene sets for an attribute, or `default` if it sets none. Attributes that are computed
    afterwards use the result."""
    if name not in w.scene_attributes or not isinstance(default, PlanNode) or default.kind not in (ValueKind.F32, ValueKind.BOOL):
        return default
    w.declare_register(format_birth_register_name(name), ValueKind.F32, "temp", inf)
    b, scene_value = w.b, w.read_at_step_start(format_birth_register_name(name))
    value = scene_value if default.kind is ValueKind.F32 else b("ne", scene_value, b.add_number(0))
    return b("where", b("lt", scene_value, b.add_number(inf)), value, default)


def _find_author_attributes(w: PlanWriter) -> dict[str, model.AttributeDecl]:
    """Return, by name, the attributes with a default expression in the program. They are in the author's text, or come from
    newer editions.

    Other built-in attributes have the species' name as their span. This module computes their defaults, because these defaults
    depend on the step length."""
    mine = [a for a in w.species.attributes if not a.pair_species and a.name != "push"]
    newer = (DEFAULT_BY_SETTING.keys() | STANDING_DEFAULTS.keys()) if w.species.edition > 1 else ()
    return {a.name: a for a in mine if a.name in newer or not (a.is_builtin and a.span == w.species.span)}


def _write_attribute(w: PlanWriter, name: str) -> None:
    declared = _find_author_attributes(w)
    if name not in declared:
        value: LoweredValue = _choose_scene_value_or_default(w, name, compute_builtin_default(w, name))
        w.store_value(name, value, None, allows_infinity=is_limit_attribute(name))
        return
    attribute = declared[name]
    w.b.span = attribute.span
    try:
        value = lower_expression(w, attribute.default)
        if attribute.type.kind is model.TypeKind.BOOL:
            value = convert_to_condition(w, value, attribute.default)
        w.store_value(
            name, _choose_scene_value_or_default(w, name, value), attribute.span, allows_infinity=is_limit_attribute(name)
        )
    except UnsupportedConstruct as missing:
        report_unsupported(w, missing)


def _order_attributes(w: PlanWriter) -> list[str]:
    """Return the names of all attributes. Each comes after the attributes that its default reads. The checker has already
    rejected cycles."""
    declared = _find_author_attributes(w)
    needs: dict[str, list[str]] = {name: [] for name in (*_order_birth_attributes(w.species), *declared)}
    for name in needs:
        if name in declared:
            needs[name] = [n for n in find_attributes_read(declared[name].default) if n in needs]
        else:
            needs[name] = [each for each in _DEFAULT_OPERANDS.get(name, ()) if each in needs]
    return list(TopologicalSorter(needs).static_order())


def find_attributes_read(expr: model.Expr) -> list[str]:
    """Return the names of the agent's own attributes that an expression reads, directly or through a `let`."""
    own = [e.name for e in iterate_expressions(expr) if isinstance(e, model.AttributeRef) and e.owner is None]
    return ["velocity" if name == "speed" else name for name in own]
