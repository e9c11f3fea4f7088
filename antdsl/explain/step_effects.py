"""The effects of a step: the agent's attributes and memories before and after it, and the agent's requests to the rest of the
world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from antdsl.explain.model import ChangedValue, PlainValue
from antdsl.explain.tracing import AgentTrace
from antdsl.explain.value_text import convert_to_unit, format_author_value, to_float_triple, to_plain_value
from antdsl.plan.ir import Register
from antdsl.plan.registers import find_pair_values
from antdsl.program.model import Dimension, Species, TypeKind, ValueType
from antdsl.program.tables.columns import REGISTER_COLUMN_BY_NAME
from antdsl.program.tables.effects import EFFECT_BY_OPERATION, EffectRow, fill_template
from antdsl.program.tables.units import choose_default_unit
from antdsl.runtime.requests import EffectRequests, RequestEntry
from antdsl.runtime.world import AXES, Population, World
from antdsl.specs.value_text import format_position


def list_changes(
    world: World, population: Population, species: Species, trace: AgentTrace, agent: int
) -> tuple[ChangedValue, ...]:
    """Return how an agent's stored registers changed in the step, in the order of the program. Return () for a dead agent.

    `world`, `population`: in their state after the step."""
    row = int(population.find_rows(np.array([agent]))[0])
    return () if row < 0 else tuple(_find_changed_registers(world, population, species, trace, row))


def _find_changed_registers(
    world: World, population: Population, species: Species, trace: AgentTrace, row: int
) -> Iterator[ChangedValue]:
    """Yield an agent's stored registers that the step has changed, with both values. `row`: the agent's row after the step."""
    types = {a.name: a.type for a in species.attributes}
    for name, register in population.plan.registers.items():
        if register.role in ("temp", "pair") or name.endswith((".y", ".z", ".next")):
            continue
        stem = name.removesuffix(".x")
        memory = register.role == "memory"
        if name.endswith(".x") and f"{stem}.y" in population.plan.registers:
            both = [
                [a[f"{stem}.{axis}"] for axis in AXES]
                for a in (trace.start_registers, _read_vector_registers(population, stem, row))
            ]
            if any(x != y for x, y in zip(*both, strict=True)):
                yield _build_vector_change(world, stem, both, types.get(stem), memory)
            continue
        old_value, new_value = trace.start_registers[name], population.now[name][row]
        if old_value != new_value:
            type = types.get(name) or _find_register_type(name, register, species)
            unit = choose_default_unit(type.dimension) if type.kind is TypeKind.NUMBER else ""
            value_texts = [
                (to_plain_value(world, each, type, unit), format_author_value(world, each, type, unit))
                for each in (old_value, new_value)
            ]
            yield ChangedValue(name, value_texts[0][0], value_texts[1][0], unit, (value_texts[0][1], value_texts[1][1]), memory)

    for name, slots in find_pair_values(population.plan.registers).items():
        pair_maps = [
            _find_pair_values(registers, slots)
            for registers in (trace.start_registers, {n: a[row] for n, a in population.now.items()})
        ]
        unit = choose_default_unit(types[name].dimension)
        for other in sorted(pair_maps[0].keys() | pair_maps[1].keys()):
            if pair_maps[0].get(other) != pair_maps[1].get(other):
                value_texts = [_describe_value(world, each.get(other), types[name], unit) for each in pair_maps]
                yield ChangedValue(
                    f"{name}[{other}]", value_texts[0][0], value_texts[1][0], unit, (value_texts[0][1], value_texts[1][1]), False
                )


def _find_pair_values(registers: Mapping[str, Any], slots: list[tuple[str, str]]) -> dict[int, Any]:
    """Return the values that the agent stores about other agents, by the id of the other agent."""
    return {
        int(registers[id_register]): registers[value_register]
        for id_register, value_register in slots
        if registers[id_register] >= 0
    }


def _describe_value(world: World, value: Any, type: ValueType, unit: str) -> tuple[PlainValue, str]:
    """Return a value for JSON, and the same value as text. The text of a missing value is `nothing`."""
    return (
        ("nothing", "nothing")
        if value is None
        else (to_plain_value(world, value, type, unit), format_author_value(world, value, type, unit))
    )


def _read_vector_registers(population: Population, stem: str, row: int) -> dict[str, Any]:
    """Return the components of one agent's vector register, by component name. `stem`: the common beginning of the names of the
    three registers."""
    return {f"{stem}.{axis}": population.now[f"{stem}.{axis}"][row] for axis in AXES}


def _build_vector_change(
    world: World, name: str, old_and_new: list[list[Any]], type: ValueType | None, memory: bool
) -> ChangedValue:
    """Return the change of a vector register. `old_and_new`: the components before and after the step."""
    unit = (
        REGISTER_COLUMN_BY_NAME[name].unit
        if name in REGISTER_COLUMN_BY_NAME
        else choose_default_unit(type.dimension)
        if type is not None
        else ""
    )
    origin = world.origin if name == "position" else (0.0, 0.0, 0.0)  # registers are relative to the origin
    old_vector, new_vector = (
        to_float_triple(convert_to_unit(world, float(x) + o, unit) for x, o in zip(vector, origin, strict=True))
        for vector in old_and_new
    )
    if name == "position":
        texts = [f"({format_position(vector, origin, 1.0)}) {unit}" for vector in old_and_new]
    else:
        texts = [f"({', '.join(f'{x:.4g}' for x in vector)}) {unit}".strip() for vector in (old_vector, new_vector)]
    return ChangedValue(name, old_vector, new_vector, unit, (texts[0], texts[1]), memory)


def _find_register_type(name: str, register: Register, species: Species) -> ValueType:
    """Return the type of a register that is not declared as an attribute: a register of a machine, or a memory."""
    machine, _, part = name.partition(".")
    if part in ("state", "previous") and any(m.name == machine for m in species.machines):
        return ValueType(TypeKind.STATE, referent=f"{species.name}.{machine}")
    if part == "time_in_state":
        return ValueType(TypeKind.NUMBER, Dimension(time=1))
    return (
        ValueType(TypeKind.AGENT, referent=register.referenced_species)
        if register.referenced_species
        else ValueType(TypeKind.NUMBER)
    )


def describe_effects(effects: EffectRequests) -> tuple[str, ...]:
    """Return a sentence for each request of the agent to the world: deposits, gifts, digging, calls, births, and its own
    death."""
    lines_by_effect = {
        row.op: [line for entry in effects.requests.get(row.op, ()) if (line := _describe_request(row, entry))]
        for row in EFFECT_BY_OPERATION.values()
    }
    sentences = lines_by_effect.pop("deposit")
    sentences += [
        f"give {entry.statement.register} {float(entry.amount[0]):.4g} to {entry.statement.items}" for entry in effects.gifts
    ]
    sentences += [line for lines in lines_by_effect.values() for line in lines]
    sentences += [f"a value for `{entry.register}` is not a number and was rejected" for entry in effects.faults]
    return tuple(sentences)


def _describe_request(row: EffectRow, entry: RequestEntry) -> str:
    """Return a sentence about one request. It is made from the template in the request's table row. It is "" if the request has
    no effect."""
    if row.hides_zero_in_trace and not float(entry.get_required_operand(0)[0]):
        return ""
    args = dict(zip(row.operand_names, entry.args, strict=True))
    if any(arg is not None and arg[0] < 0 for name, arg in args.items() if name in row.agent_operands):
        return ""
    values = {
        name: None if arg is None else str(int(arg[0])) if name in row.agent_operands else f"{float(arg[0]):.4g}"
        for name, arg in args.items()
    }
    return fill_template(
        row.trace_template,
        {**values, "of": entry.request.target, "own": entry.request.register, "receiver": entry.request.target_species},
    )
