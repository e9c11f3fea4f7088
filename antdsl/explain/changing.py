"""Effects of a step on an agent: its attributes and memories before and after, and its requests to the rest of the world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from antdsl.explain.model import Changed, Value
from antdsl.explain.tracing import Trace
from antdsl.explain.value_text import in_unit, said, triple, value
from antdsl.plan.ir import Register
from antdsl.plan.registers import pair_values
from antdsl.program.model import Dim, Kind, Species, Type
from antdsl.program.tables.effects import EFFECTS, Effect, phrase
from antdsl.program.tables.units import unit_of
from antdsl.runtime.requests import Asked, Effects
from antdsl.runtime.world import AXES, Population, World
from antdsl.specs.value_text import place_text

_VECTORS = {"position": "mm", "velocity": "mm/s", "heading": "", "up": ""}


def changes(world: World, population: Population, species: Species, trace: Trace, agent: int) -> tuple[Changed, ...]:
    """Return the stored registers that have changed, in the order of the program. `world` is that after the step. Empty for a
    dead agent."""
    row = int(population.rows_of(np.array([agent]))[0])
    return () if row < 0 else tuple(_changes(world, population, species, trace, row))


def _changes(world: World, population: Population, species: Species, trace: Trace, row: int) -> Iterator[Changed]:
    types = {a.name: a.type for a in species.attributes}
    for name, register in population.plan.registers.items():
        if register.role in ("temp", "pair") or name.endswith((".y", ".z", ".next")):
            continue
        stem = name.removesuffix(".x")
        memory = register.role == "memory"
        if name.endswith(".x") and f"{stem}.y" in population.plan.registers:
            both = [[a[f"{stem}.{axis}"] for axis in AXES] for a in (trace.before, _row(population, stem, row))]
            if any(x != y for x, y in zip(*both, strict=True)):
                yield _vector(world, stem, both, types.get(stem), memory)
            continue
        before, after = trace.before[name], population.now[name][row]
        if before != after:
            type = types.get(name) or _type(name, register, species)
            unit = unit_of(type.dim) if type.kind is Kind.NUMBER else ""
            told = [(value(world, each, type, unit), said(world, each, type, unit)) for each in (before, after)]
            yield Changed(name, told[0][0], told[1][0], unit, (told[0][1], told[1][1]), memory)

    for name, slots in pair_values(population.plan.registers).items():
        kept = [_kept(registers, slots) for registers in (trace.before, {n: a[row] for n, a in population.now.items()})]
        unit = unit_of(types[name].dim)
        for other in sorted(kept[0].keys() | kept[1].keys()):
            if kept[0].get(other) != kept[1].get(other):
                told = [_about(world, each.get(other), types[name], unit) for each in kept]
                yield Changed(f"{name}[{other}]", told[0][0], told[1][0], unit, (told[0][1], told[1][1]), False)


def _kept(registers: Mapping[str, Any], slots: list[tuple[str, str]]) -> dict[int, Any]:
    """Return an agent's values per pair, by the other agent's id."""
    return {int(registers[who]): registers[held] for who, held in slots if registers[who] >= 0}


def _about(world: World, held: Any, type: Type, unit: str) -> tuple[Value, str]:
    return ("nothing", "nothing") if held is None else (value(world, held, type, unit), said(world, held, type, unit))


def _row(population: Population, stem: str, row: int) -> dict[str, Any]:
    return {f"{stem}.{axis}": population.now[f"{stem}.{axis}"][row] for axis in AXES}


def _vector(world: World, name: str, both: list[list[Any]], type: Type | None, memory: bool) -> Changed:
    unit = _VECTORS.get(name, unit_of(type.dim) if type is not None else "")
    origin = world.origin if name == "position" else (0.0, 0.0, 0.0)  # registers are relative to it
    before, after = (triple(in_unit(world, float(x) + o, unit) for x, o in zip(vector, origin, strict=True)) for vector in both)
    if name == "position":
        shown = [f"({place_text(vector, origin, 1.0)}) {unit}" for vector in both]
    else:
        shown = [f"({', '.join(f'{x:.4g}' for x in vector)}) {unit}".strip() for vector in (before, after)]
    return Changed(name, before, after, unit, (shown[0], shown[1]), memory)


def _type(name: str, register: Register, species: Species) -> Type:
    """Return the type of a register that no attribute declares: a machine's register, or a memory."""
    machine, _, part = name.partition(".")
    if part in ("state", "previous") and any(m.name == machine for m in species.machines):
        return Type(Kind.STATE, of=f"{species.name}.{machine}")
    if part == "time_in_state":
        return Type(Kind.NUMBER, Dim(time=1))
    return Type(Kind.AGENT, of=register.of) if register.of else Type(Kind.NUMBER)


def did(effects: Effects) -> tuple[str, ...]:
    """Return the agent's requests to the world, in words: deposits, gifts, digging, calls, births and its death."""
    told = {row.op: [line for entry in effects.asked.get(row.op, ()) if (line := _told(row, entry))] for row in EFFECTS.values()}
    found = told.pop("deposit")
    found += [f"give {entry.statement.own} {float(entry.amount[0]):.4g} to {entry.statement.items}" for entry in effects.gives]
    found += [line for lines in told.values() for line in lines]
    found += [f"a value for `{entry.register}` was no number and was refused" for entry in effects.faults]
    return tuple(found)


def _told(row: Effect, entry: Asked) -> str:
    """Return one request in the words of its row; empty if it has no effect."""
    if row.quiet_at_0 and not float(entry.arg(0)[0]):
        return ""
    args = dict(zip(row.operands, entry.args, strict=True))
    if any(arg is not None and arg[0] < 0 for name, arg in args.items() if name in row.agents):
        return ""
    values = {
        name: None if arg is None else str(int(arg[0])) if name in row.agents else f"{float(arg[0]):.4g}"
        for name, arg in args.items()
    }
    return phrase(row.trace, {**values, "of": entry.request.of, "own": entry.request.own, "whom": entry.request.whom})
