"""Lowers what states change in an agent's appearance, except clips: worn layers, body channels, and look directions of transform
groups.

All machines may request an appearance in each step. An appearance ends in the first step without a request. The registers are:
- `wear#LAYER`: whether the agent wears the layer.
- `channel#NAME`: the channel's value. `channel#NAME.said`: whether a state sets it.
- `look#GROUP.x`, `.y`, `.z`: a unit vector in the agent's frame (heading, up, right). (1, 0, 0) is straight ahead.
Within a step, requests are collected in temps with the same names after a `~`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import pi
from typing import Any

from antdsl.plan.ir import ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower_condition, lower_expression, lower_scalar
from antdsl.plan.lowering.rules.places import compute_offset
from antdsl.plan.lowering.values import VectorNodes
from antdsl.plan.lowering.writer import AXES, PlanWriter
from antdsl.program import model

DEFAULT_LOOK_ANGLE, DEFAULT_LOOK_SECONDS = pi / 3, 0.2  # rad, s: defaults of `within` and `over`
_LOOK_AHEAD = (1.0, 0.0, 0.0)


def list_worn_layers(species: model.Species) -> tuple[str, ...]:
    """Return the layers that states wear, without duplicates, in text order."""
    return tuple(dict.fromkeys(line.layer for line in _iterate_statements(species) if isinstance(line, model.Wear)))


def list_channels(species: model.Species) -> tuple[str, ...]:
    """Return the channels that states set, without duplicates, in text order."""
    return tuple(dict.fromkeys(line.channel for line in _iterate_statements(species) if isinstance(line, model.Channel)))


def list_look_groups(species: model.Species) -> tuple[str, ...]:
    """Return the transform groups that states turn towards a point, without duplicates, in text order."""
    return tuple(dict.fromkeys(line.group for line in _iterate_statements(species) if isinstance(line, model.Look)))


def declare_registers(w: PlanWriter) -> None:
    """Declare the appearance registers of a species."""
    for role, sign in (("memory", ""), ("temp", "~")):
        for layer in list_worn_layers(w.species):
            w.declare_register(f"{sign}wear#{layer}", ValueKind.BOOL, role)
        for name in list_channels(w.species):
            w.declare_register(f"{sign}channel#{name}", ValueKind.F32, role)
            w.declare_register(f"{sign}channel#{name}.said", ValueKind.BOOL, role)
        for group in list_look_groups(w.species):
            for axis, ahead in zip(AXES, _LOOK_AHEAD, strict=True):
                w.declare_register(f"{sign}look#{group}.{axis}", ValueKind.F32, role, ahead)
    for group in list_look_groups(w.species):
        w.declare_register(f"~look#{group}.over", ValueKind.F32, "temp", DEFAULT_LOOK_SECONDS)


def write_state_appearance(w: PlanWriter, state: model.State) -> None:
    """Write the statements that request the start state's appearance at birth. The look directions start straight ahead."""
    for line in state.body:
        if isinstance(line, (model.Wear, model.Channel)):
            w.b.span = line.span
            LOWERER_BY_STATEMENT[type(line)](w, line, "")


def apply_appearance(w: PlanWriter) -> None:
    """Write the stores of the layers and channels that states request, for all machines. Also write one step of the turn of the
    look directions.

    Call this after the `act` part of all machines."""
    store_layers_and_channels(w)
    b = w.b
    for group in list_look_groups(w.species):
        name = f"look#{group}"
        now, wish = w.read_vector(name), w.read_vector(f"~{name}")
        least = b("max", w.read_at_step_start(f"~{name}.over"), w.read_run_value("dt"))
        share = b("sub", b.add_number(1), b("exp", b("neg", b("div", w.read_run_value("dt"), least))))
        turned = values.normalise_vector(
            b, values.add_vectors(b, now, values.scale_vector(b, values.subtract_vectors(b, wish, now), share))
        )
        has_direction = b("gt", values.compute_dot_product(b, turned, turned), b.add_number(0.5))
        w.store_vector(name, values.choose_vector(b, has_direction, turned, now), None)


def store_layers_and_channels(w: PlanWriter) -> None:
    """Copy the layers and channels that states requested in this step from temps to the registers of layers and channels."""
    for layer in list_worn_layers(w.species):
        w.add_store(f"wear#{layer}", w.read_at_step_start(f"~wear#{layer}"), None)
    for name in list_channels(w.species):
        for register in (f"channel#{name}", f"channel#{name}.said"):
            w.add_store(register, w.read_at_step_start(f"~{register}"), None)


def _lower_wear(w: PlanWriter, line: model.Wear, site: str) -> None:
    register = f"~wear#{line.layer}"
    worn = w.b.true if line.condition is None else lower_condition(w, line.condition)
    w.add_store(register, w.b("or", w.read_at_step_start(register), worn), line.span)


def _lower_channel(w: PlanWriter, line: model.Channel, site: str) -> None:
    w.add_store(f"~channel#{line.channel}", lower_scalar(w, line.value), line.span)
    w.add_store(f"~channel#{line.channel}.said", w.b.true, line.span)


def _lower_look(w: PlanWriter, line: model.Look, site: str) -> None:
    """Write the requested look direction towards a point. It is in the agent's own axes and limited to the allowed angle. If
    there is no point, the direction is straight ahead."""
    b, register = w.b, f"~look#{line.group}"
    is_present, offset = compute_offset(w, lower_expression(w, line.at), line.at)
    direction = values.normalise_vector(b, values.select_or_zero(b, is_present, offset))
    heading, up = w.read_vector("heading"), w.read_vector("up")
    side = values.compute_cross_product(b, heading, up)
    local_direction = VectorNodes(
        values.compute_dot_product(b, direction, heading),
        values.compute_dot_product(b, direction, up),
        values.compute_dot_product(b, direction, side),
    )
    limit = b.add_number(DEFAULT_LOOK_ANGLE) if line.max_angle is None else lower_scalar(w, line.max_angle)
    least, widest = b("cos", limit), b("sin", limit)
    aside = values.compute_length(b, VectorNodes(b.add_number(0), local_direction.y, local_direction.z))
    far = b("div", widest, b("max", aside, b.add_number(1e-6)))
    held = VectorNodes(least, b("mul", local_direction.y, far), b("mul", local_direction.z, far))
    wish = values.choose_vector(b, b("lt", local_direction.x, least), held, local_direction)
    ahead = VectorNodes(*(b.add_number(part) for part in _LOOK_AHEAD))
    known = b("and", is_present, b("gt", aside, b.add_number(1e-6)))  # for a point straight behind, neither side is nearer
    w.store_vector(register, values.choose_vector(b, known, wish, ahead), line.span)
    w.add_store(
        f"{register}.over",
        b.add_number(DEFAULT_LOOK_SECONDS) if line.time_constant is None else lower_scalar(w, line.time_constant),
        line.span,
    )


LOWERER_BY_STATEMENT: dict[type, Callable[[PlanWriter, Any, str], None]] = {
    model.Wear: _lower_wear,
    model.Channel: _lower_channel,
    model.Look: _lower_look,
}


def _iterate_statements(species: model.Species) -> Iterator[model.Statement]:
    for machine in species.machines:
        for state in machine.states:
            yield from state.body
