"""Reports on what an agent sensed in a step: nearby agents and items, fields at its position, rays, curves, flows and random
draws."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from antdsl.explain.model import NearbyObject, ObservedSet, RandomDraw, SenseReading
from antdsl.explain.tracing import AgentTrace
from antdsl.plan.ir import PlanNode
from antdsl.program.tables import rows
from antdsl.program.tables.senses import SENSE_BY_OPERATION
from antdsl.runtime.backends.reference import SetMember
from antdsl.runtime.world import Population, World

MAX_LISTED_OBJECTS = 10  # maximum number of reported elements of a set
NO_AGENT = -1  # the id that means no agent
_MAX_TEXT_CHARACTERS = 72  # characters of a text


def list_observed_sets(world: World, trace: AgentTrace) -> tuple[ObservedSet, ...]:
    """Return the sets that the agent has searched, in the order of the queries and without duplicates."""
    sets_by_key: dict[tuple[str, tuple[int, ...]], ObservedSet] = {}
    for node, members in trace.set_members.items():
        nearest = sorted(members, key=lambda m: (float(m[4]), m[0]))
        set_name = str(node.attrs[0])
        key = (set_name, tuple(m[0] for m in nearest))
        if key not in sets_by_key:
            near = tuple(_build_nearby_object(world, node, member) for member in nearest[:MAX_LISTED_OBJECTS])
            sets_by_key[key] = ObservedSet(_find_node_text(node), set_name, len(members), near)
    return tuple(sets_by_key.values())


def _build_nearby_object(world: World, node: PlanNode, member: SetMember) -> NearbyObject:
    row, distance, set_name = member[0], float(member[4]), str(node.attrs[0])
    if node.op == "set.items":
        items = world.items[set_name]
        amounts = ", ".join(f"{name} {float(items.visible_values[name][row]):.4g}" for name in items.amounts)
        return NearbyObject(items.names[row], distance, amounts)
    population = world.populations[set_name]
    machines = population.plan.machines
    state = machines[0].states[int(population.start[f"{machines[0].name}.state"][row])] if machines else ""
    return NearbyObject(str(int(population.ids[row])), distance, state)


def read_field_values(world: World, population: Population, row: int) -> tuple[tuple[str, float], ...]:
    """Return the value of every field at the agent's position at the start of the step."""
    rows = np.array([row])
    return tuple((name, float(field.sample(population.cells[name][rows])[0])) for name, field in world.fields.items())


def list_sense_readings(trace: AgentTrace) -> tuple[SenseReading, ...]:
    """Return the readings of senses other than sets, which the agent queried at its position."""
    return tuple(
        sense
        for node, value in sorted(trace.senses.items(), key=lambda pair: pair[0].number)
        for sense in _build_sense_readings(node, value)
    )


def _build_sense_readings(node: PlanNode, value: Any) -> Iterator[SenseReading]:
    row = SENSE_BY_OPERATION[node.op]
    if row.is_untraced or (row.results[0].kind == "l" and value[0] == NO_AGENT):
        return
    kind, _, operation = node.op.partition(".")
    values = tuple(bool(v) if isinstance(v, np.bool_) else float(v) for v in (value if isinstance(value, tuple) else (value,)))
    label, name = (f"{kind} {operation}".strip(), str(node.attrs[0])) if row.thing_kind else ("sense", node.op)
    yield SenseReading(label, name, _find_node_text(node), _describe_sense(row, values), values)


def _describe_sense(row: rows.SenseRow, values: tuple[bool | float, ...]) -> str:
    """Return the reading of a sense as text. The template in the sense's table row formats it. Without a template, it is a list
    of numbers."""
    if row.empty_trace and not values[0]:
        return row.empty_trace
    if row.trace:
        return row.trace.format(**{part.name: values[row.find_result_index(part.name)[0]] for part in row.results if part.name})
    numbers = ", ".join(f"{v:.4g}" for v in values)
    return numbers if len(values) == 1 else f"({numbers})"


def list_random_draws(trace: AgentTrace) -> tuple[RandomDraw, ...]:
    """Return the random draws of the agent. Each has the stable name of the code site that requested it."""
    drawn_numbers = []
    for node, value in trace.draw_values.items():
        index = node.attrs[1] if node.op == "draw" else 0
        site = str(node.attrs[0]) + (f"[{index}]" if index else "")
        drawn_numbers.append(RandomDraw(site, _find_node_text(node), float(value)))
    return tuple(sorted(drawn_numbers, key=lambda draw: draw.site))


def _find_node_text(node: PlanNode) -> str:
    """Return the text in the program or library that made a query. Long text is shortened."""
    text = "" if node.span is None else " ".join(node.span.text.split())
    return text if len(text) <= _MAX_TEXT_CHARACTERS else text[: _MAX_TEXT_CHARACTERS - 1].rstrip() + "…"
