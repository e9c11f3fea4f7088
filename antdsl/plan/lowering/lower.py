"""Lowers the checked program to a plan: species by species, then fields, items and params.

`on collision(other)` runs when an agent's body starts to touch another body. It handles one other agent per step. Registers
store the ids of the agents that are already touched, so that a lasting contact is handled only once. If several contacts begin
in one step, the deepest is handled first. The others are handled in the next steps if they last."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import log

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.plan import ir
from antdsl.plan.builder import PlanBuilder
from antdsl.plan.field_components import name_field_components
from antdsl.plan.ir import Block, PlanNode, ValueKind
from antdsl.plan.lowering import appearance, birth, blending, clips, pair_values
from antdsl.plan.lowering.actions import STEER_TEMP, report_unsupported, write_statements
from antdsl.plan.lowering.expressions import lower_condition, lower_scalar, lower_vector, read_own_attribute
from antdsl.plan.lowering.machines import MachineWriter
from antdsl.plan.lowering.rules import LOWERING_RULES
from antdsl.plan.lowering.source_map import NotingWriter, SourceNotes
from antdsl.plan.lowering.values import EntityRef, VectorNodes, scale_vector, subtract_vectors
from antdsl.plan.lowering.values import add_vectors as add_vectors
from antdsl.plan.lowering.writer import AXES, BodyProportions, PlanWriter, UnsupportedConstruct
from antdsl.plan.traverse import collect_required_nodes, find_shared_senses, iterate_statements, list_operands
from antdsl.program import model
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.traverse import iterate_parts

# maximum number of Python frames for the recursion over expressions; the parser and the checker limit nesting
MAX_RECURSION_FRAMES = 20_000


def lower(
    program: model.Program,
    *,
    orders: Mapping[str, Sequence[str]] | None = None,
    notes: dict[str, SourceNotes] | None = None,
    scene_attributes: Mapping[str, Collection[str]] | None = None,
    proportions: Mapping[str, BodyProportions] | None = None,
    period: tuple[float, float, float] | None = None,
) -> tuple[ir.Plan, Report]:
    """Return the plan of a program, and errors for constructs that pass the checks but cannot run yet.

    - `orders`: by species, the order of the layers. Each layer is named by its text or by the word before its bracket.
    - `notes`: receives, for each species, the nodes of each part of its source text.
    - `scene_attributes`: by species, the attributes that the scene may set at an agent's birth.
    - `proportions`: by species, the proportions of bodies if the program sets their height.
    - `period`: the widths (mm) of a periodic world along x, y and z, 0 along axes that do not wrap."""
    report = Report()
    builder = PlanBuilder()
    pushes = _needs_moved_register(program)

    def species_plan(s: model.Species) -> ir.SpeciesPlan:
        if notes is None:
            w = PlanWriter(builder, program, s, report, LOWERING_RULES)
        else:
            notes[s.name] = SourceNotes()
            w = NotingWriter(builder, program, s, report, LOWERING_RULES, notes[s.name])
        w.has_moved_register, w.period = pushes, period
        w.scene_attributes = frozenset((scene_attributes or {}).get(s.name, ()))
        w.proportions = (proportions or {}).get(s.name, w.proportions)
        return _lower_species(w, (orders or {}).get(s.name))

    with _allow_deep_recursion():
        species = {s.name: species_plan(s) for s in program.species.values()}
        fields = {f.name: f for declared in program.fields.values() for f in _lower_field(builder, program, declared, report)}
        params = {
            p.name: ir.ParamPlan(p.name, _lower_run_constant(builder, program, p.default, report))
            for p in program.params.values()
        }
    world = program.world.values()
    item_groups = [t for t in world if KIND_BY_WORD[t.kind].is_item_group]
    items = {t.name: ir.ItemsPlan(t.name, {a.name: a.default.number for a in t.attributes}) for t in item_groups}
    things = {k: tuple(t.name for t in world if t.kind == k) for k, row in KIND_BY_WORD.items() if not row.has_values}
    return ir.Plan(species, fields, items, params, things, tuple(builder.nodes), period), report


def _needs_moved_register(program: model.Program) -> bool:
    """Return whether the program reads how far contacts have pushed an agent. If so, species have the register `moved`."""
    parts = iterate_parts([*program.species.values(), *program.specs, *program.measures])
    return any(isinstance(part, model.AttributeRef) and part.name == "moved" for part in parts)


@contextmanager
def _allow_deep_recursion() -> Iterator[None]:
    previous_limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(previous_limit, MAX_RECURSION_FRAMES))
    try:
        yield
    finally:
        sys.setrecursionlimit(previous_limit)


# --- species ---------------------------------------------------------------------------------------------------------


def _lower_species(w: PlanWriter, order: Sequence[str] | None) -> ir.SpeciesPlan:
    species = w.species
    birth.declare_registers(w)
    blending.declare_push(w)
    declare_touch_registers(w)
    for latch in species.latches:
        w.declare_register(latch.key or latch.name, ValueKind.BOOL, "memory")
    appearance.declare_registers(w)
    clips.declare_lean_registers(w)
    machines = [MachineWriter(w, machine) for machine in species.machines]
    born = _lower_birth(w, machines)
    with w.collect_block() as finish_block:
        _write_decide(w, machines)
        decide = finish_block()
    with w.collect_block() as finish_block:
        for machine in machines:
            machine.write_actions()
        appearance.apply_appearance(w)
        clips.update_leaning(w)
        write_resting_push(w, machines)
        act = finish_block()
    with w.collect_block() as finish_block:
        layers = blending.write_layer_arbitration(w, order)
        for machine in machines:
            machine.advance_time()
        blend = finish_block()
    nodes = collect_required_nodes(
        node for phase in (decide, act, blend) for _, s in iterate_statements(phase) for node in list_operands(s)
    )
    events = tuple(sorted({node.attrs[0] for node in nodes if node.op == "event"}))
    return ir.SpeciesPlan(
        species.name, w.registers, tuple(m.make_plan() for m in machines), born, decide, act, blend, events, layers,
        find_shared_senses(decide, act, blend),
        {a.name: pair_values.lower_rest_value(w, a) for a in species.attributes if a.pair_species},
        clips.list_clips(species), appearance.list_worn_layers(species), appearance.list_channels(species),
        appearance.list_look_groups(species),
        species.has_body_clearance, species.has_whole_body, birth.list_newer_attributes(species),
    )  # fmt: skip


def _lower_birth(w: PlanWriter, machines: list[MachineWriter]) -> Block:
    """Return the block that runs at birth. Birth counts as a separate step. Therefore the values that it stores are the previous
    values for the agent's first normal step."""
    w.is_birth = True
    with w.collect_block() as finish_block:
        birth.write_birth(w, machines)
        block = finish_block()
    w.is_birth = False
    w.begin_step()
    return block


def _write_decide(w: PlanWriter, machines: list[MachineWriter]) -> None:
    """Write the block `decide`: relaxations, latches, handlers, then the transitions of all machines."""
    for attribute in w.species.attributes:
        if attribute.pair_species:
            pair_values.write_relaxation_of_slots(w, attribute)
        elif attribute.relax_to is not None:
            _write_relaxation(w, attribute)
    for latch in w.species.latches:
        _write_latch(w, latch)
    partners = detect_new_contacts(w)
    for number, handler in enumerate(w.species.handlers, 1):
        _write_handler(w, handler, number, partners)
    for machine in machines:
        machine.write_decision()


def _write_relaxation(w: PlanWriter, attribute: model.AttributeDecl) -> None:
    """Write the relaxation of an attribute towards its rest value. In each step, the fraction 1 - exp(-dt / over) of the
    difference is removed. So the effect per second does not depend on the step length."""
    b = w.b
    assert attribute.relax_to is not None and attribute.relax_time is not None
    b.span = attribute.span
    share = b("sub", b.add_number(1), b("exp", b("neg", b("div", w.read_run_value("dt"), lower_scalar(w, attribute.relax_time)))))
    now = read_own_attribute(w, attribute.name, attribute.type)
    if isinstance(now, VectorNodes):
        rest = lower_vector(w, attribute.relax_to)
        w.store_vector(
            attribute.name, add_vectors(b, now, scale_vector(b, subtract_vectors(b, rest, now), share)), attribute.span
        )
        return
    assert isinstance(now, PlanNode)
    change = b("mul", b("sub", lower_scalar(w, attribute.relax_to), now), share)
    w.add_store(attribute.name, b("add", now, change), attribute.span)


def _write_latch(w: PlanWriter, latch: model.Binding) -> None:
    """Write a latch: it turns on in the step in which its first condition holds, and off in the step in which the second one
    holds."""
    assert latch.value is not None and latch.next_value is not None
    b, name = w.b, latch.key or latch.name
    b.span = latch.span
    try:
        on = b("where", w.read_previous(name), b("not", lower_condition(w, latch.next_value)), lower_condition(w, latch.value))
        w.add_store(name, on, latch.span)
    except UnsupportedConstruct as missing:
        report_unsupported(w, missing)


def _write_handler(w: PlanWriter, handler: model.Handler, number: int, partners: Mapping[str, PlanNode]) -> None:
    """Write a handler. `partners`: for each other species, the node with the id of the agent of this species that has just been
    touched."""
    if handler.event == "spawn":
        return
    if handler.event == "collision":
        bind_partner(w, handler, partners[handler.other_species])
        noticed = w.b("ne", partners[handler.other_species], w.b.add_agent_id(-1))
    else:
        noticed = w.b("event", attrs=(handler.event,))
    with w.open_region(noticed, handler.span):
        write_statements(w, handler.actions, f"{w.species.name}.on.{handler.event}#{number}")


# --- the rest --------------------------------------------------------------------------------------------------------


def _lower_run_constant(builder: PlanBuilder, program: model.Program, e: model.Expr, report: Report) -> PlanNode:
    """Return the node of an expression that does not depend on an agent."""
    empty_species = model.Species("", "", (), (), (), (), (), (), model.LayerStack("budget", (), e.span), e.span)
    return lower_scalar(PlanWriter(builder, program, empty_species, report, LOWERING_RULES), e)


def _lower_field(
    builder: PlanBuilder, program: model.Program, declared_field: model.Field, report: Report
) -> tuple[ir.FieldPlan, ...]:
    """Return the plan of a field as a tuple with one element. For a field with vectors in its cells, there are three elements,
    one for each component."""

    def lower_optional(e: model.Expr | None) -> PlanNode | None:
        return None if e is None else _lower_run_constant(builder, program, e, report)

    for surface in declared_field.surfaces:
        thing = program.world.get(surface)
        if thing is not None and not KIND_BY_WORD[thing.kind].is_ground:
            message = f"a field on the {thing.kind} `{surface}` is not supported yet"
            report.error("not-yet", message, declared_field.span, "write the name of a surface or a solid after `on`")
    cell = lower_optional(declared_field.cell)
    assert cell is not None
    keep, diffuse, limit = (
        _compute_decay_factor(builder, declared_field, lower_optional),
        lower_optional(declared_field.diffuse),
        lower_optional(declared_field.limit),
    )
    plan = ir.FieldPlan(
        declared_field.name,
        declared_field.surfaces,
        cell,
        keep,
        diffuse,
        declared_field.combine,
        limit,
        declared_field.span,
        declared_field.stencil,
        declared_field.deposits,
    )
    if not declared_field.has_vectors:
        return (plan,)
    return tuple(replace(plan, name=name, vector_field=plan.name) for name in name_field_components(plan.name))


def _compute_decay_factor(b: PlanBuilder, declared_field: model.Field, lower_node: object) -> PlanNode | None:
    """Return the factor by which a field is multiplied in each step: 2^(-dt / half_life), exp(-rate dt), or the factor `keeps`.
    Return None if the field does not evaporate."""
    assert callable(lower_node)
    dt = b("run", attrs=("dt",))
    if declared_field.half_life is not None:
        return b("exp", b("div", b("mul", b.add_number(-log(2)), dt), lower_node(declared_field.half_life)))
    if declared_field.evaporate is not None:
        return b("exp", b("neg", b("mul", lower_node(declared_field.evaporate), dt)))
    if declared_field.keeps is None:
        return None
    factor: PlanNode = lower_node(declared_field.keeps)
    return b("mul", factor, dt) if declared_field.keeps.type.dimension.time < 0 else factor


def write_resting_push(w: PlanWriter, machines: Sequence[MachineWriter]) -> None:
    """Write the push of agents in states that do not steer. Call this after the `act` part of all machines."""
    rest = w.species.rest
    if rest is None:
        return
    w.b.span = rest.span
    silent = w.b.true
    for machine in machines:
        if machine.name in rest.resting_states:
            silent = w.b("and", silent, machine.is_in_any_state(rest.resting_states[machine.name]))
    for axis in AXES:
        w.declare_register(f"{STEER_TEMP}.{axis}", ValueKind.F32, "temp")
    with w.open_region(silent, rest.span):
        push = lower_vector(w, rest.push)
        w.note_resting_push(rest, push)
        w.store_vector(STEER_TEMP, push, rest.span)


def declare_touch_registers(w: PlanWriter) -> None:
    """Declare registers for the ids of touched agents. There are some for each species for which there is a collision handler."""
    for of in _find_collision_handlers(w.species):
        for name in _name_touch_registers(w.species, of):
            w.declare_register(name, ValueKind.I64, "memory", -1, of)


def detect_new_contacts(w: PlanWriter) -> dict[str, PlanNode]:
    """Return, by other species, the node with the id of an agent that this agent has just started to touch, or -1. The contact
    is recorded, so that it is handled only once."""
    partners = {}
    for of, handler in _find_collision_handlers(w.species).items():
        names = _name_touch_registers(w.species, of)
        w.b.span = handler.span
        contact = w.b("contact", *(w.read_previous(name) for name in names), attrs=(of,))
        for number, name in enumerate(names, 1):
            w.add_store(name, w.b("get", contact, attrs=(number,)), handler.span)
        partners[of] = w.b("get", contact, attrs=(0,))
    return partners


def bind_partner(w: PlanWriter, handler: model.Handler, partner: PlanNode) -> None:
    """Bind the name in the brackets of a collision handler to the agent with the id `partner`."""
    if handler.other is not None:
        w.environment[handler.other] = EntityRef(model.TypeKind.AGENT, handler.other_species, partner)


def _find_collision_handlers(species: model.Species) -> dict[str, model.Handler]:
    """Return, by other species, the first collision handler of a species for agents of this other species."""
    handlers: dict[str, model.Handler] = {}
    for handler in species.handlers:
        if handler.event == "collision":
            handlers.setdefault(handler.other_species, handler)
    return handlers


def _name_touch_registers(species: model.Species, other_species: str) -> Sequence[str]:
    """Return the names of the registers that store the ids of touched agents of `other_species`."""
    return [f"{species.name}.touched.{other_species}#{number}" for number in range(1, limits.MAX_TOUCHED_AGENTS + 1)]
