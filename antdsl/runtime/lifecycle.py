"""Applies deposits, events, deaths and births. Other agents sense these changes in the next step.

Emitted events are also recorded for outputs such as caches. These records are not part of the state, and no step reads them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.fields.cells import Cells
from antdsl.ground.protocol import Footing
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes, iterate_with_positions, list_operands
from antdsl.program.tables.columns import EMIT_COLUMNS, FIXED_COLUMN_BY_NAME, MIGRATED_REGISTERS
from antdsl.runtime.claims import resolve_gifts
from antdsl.runtime.digging import apply_dig_requests
from antdsl.runtime.moving.moving_geometry import compute_agent_rest_positions
from antdsl.runtime.requests import RequestEntry
from antdsl.runtime.sensing.image_pairs import measure_offsets
from antdsl.runtime.world import AXES, Population, World, add_rows, is_start_array_shared, list_stored_registers, retain_rows

_PAIRS_PER_BLOCK = 1 << 22  # pairs of emitter and receiver that are measured at once
_INHERITED_COLUMNS = {
    name: column.inherited_array for name, column in FIXED_COLUMN_BY_NAME.items() if column.inherited_array
}  # fixed columns of newborns


def update_agent_cells(world: World, population: Population) -> None:
    """Find the cell in which each agent is, for every field."""
    if world.fields and len(population):
        sides = world.ground.find_sides(population.footing, world.options.threads)
        place = compute_agent_rest_positions(world, population)
        cells_by_id: dict[int, Cells] = {}  # fields may share their cells
        for name, field in world.fields.items():
            if id(field.cells) not in cells_by_id:
                known, buffer = population.voxels.get(name), population.cells.get(name)
                cells_by_id[id(field.cells)], population.voxels[name] = field.cells.update_cells(
                    place, sides, known, buffer, world.options.threads
                )
            population.cells[name] = cells_by_id[id(field.cells)]


def apply_deposits(world: World) -> None:
    """Add the agents' deposits to the cells in which they are. Deposits take effect when the fields advance."""
    for population in world.populations.values():
        for entry in population.effects.pop_requests("deposit"):
            name = entry.request.target
            world.fields[name].deposit(population.cells[name][entry.rows], entry.get_required_operand(0))


def initialise_cells_of_newborn(world: World) -> None:
    """Apply the requests that newborn agents have made at birth, so that none is pending between two steps."""
    if not any([population.effects.has_pending for population in world.populations.values()]):
        return
    raise_events(world)
    resolve_gifts(world)
    apply_dig_requests(world)
    laying = [p for p in world.populations.values() if "deposit" in p.effects.requests]
    for population in laying:
        update_agent_cells(world, population)
    fields = {entry.request.target for p in laying for entry in p.effects.requests["deposit"]}
    apply_deposits(world)
    for name in fields:
        world.fields[name].advance(1.0, 0.0, world.dt)
    for vectors in world.vector_fields.values():
        vectors.limit_lengths()
    for population in world.populations.values():
        population.effects.claims = []  # claims at birth are not possible: no decision could use the result


def raise_events(world: World) -> None:
    """Deliver emitted events: flag the agents that each event reaches. They sense the event in the next step."""
    for population in world.populations.values():
        for entry in population.effects.pop_requests("emit"):
            event = entry.request.target
            record_emission(world, population, entry.rows, event)
            if entry.args[1] is not None:
                _notify_receiver(world, population, entry)
                continue
            if entry.args[0] is None:
                if event in population.raised_events:
                    population.raised_events[event][entry.rows] = True
                continue
            for other in world.populations.values():
                if event in other.raised_events and len(other):
                    _flag_agents_in_reach(world, population, entry, other, other.raised_events[event])


def _notify_receiver(world: World, population: Population, entry: RequestEntry) -> None:
    """Flag the agent to which each emitter sends its event, if that agent is alive and within reach."""
    other = world.populations.get(entry.request.target_species or "")
    if other is None or not len(other) or entry.request.target not in other.raised_events:
        return
    rows, receivers = entry.rows, other.find_rows(entry.get_required_operand(1))
    is_reached = receivers >= 0
    if entry.args[0] is not None:
        at = np.where(is_reached, receivers, 0)
        theirs, mine = ([each.start[f"position.{a}"][of] for a in AXES] for each, of in ((other, at), (population, rows)))
        dx, dy, dz = measure_offsets(world, theirs, mine)
        is_reached &= np.sqrt((dx * dx + dy * dy) + dz * dz) <= entry.get_required_operand(0)
    other.raised_events[entry.request.target][receivers[is_reached]] = True


def _flag_agents_in_reach(
    world: World, population: Population, entry: RequestEntry, other: Population, flags: NDArray[np.bool_]
) -> None:
    """Set `flags` of all agents that were within the emitters' reach at the start of the step, including the emitters."""
    within = entry.get_required_operand(0)
    own = [population.start[f"position.{axis}"][entry.rows] for axis in AXES]
    theirs = [other.start[f"position.{axis}"] for axis in AXES]
    step = max(1, _PAIRS_PER_BLOCK // len(other))
    for a in range(0, len(entry.rows), step):
        dx, dy, dz = measure_offsets(world, [t[None, :] for t in theirs], [o[a : a + step, None] for o in own])
        flags |= (np.sqrt((dx * dx + dy * dy) + dz * dz) <= within[a : a + step, None]).any(axis=0)


def apply_deaths_and_births(world: World) -> None:
    """Remove dead agents, then add newborn agents.

    New ids are in the order of (parent's species, parent's id, position in the source)."""
    coming, bereft = _collect_birth_rows(world), False
    for population in world.populations.values():
        if dying := population.effects.pop_requests("die"):
            dead = np.zeros(len(population), np.bool_)
            for entry in dying:
                dead[entry.rows] = True
            retain_rows(population, np.flatnonzero(~dead))
            bereft = True
    generation = 0
    while coming and generation < limits.MAX_BIRTH_GENERATIONS:
        newborn = {name: _add_newborn(world, world.populations[name], births) for name, births in coming.items()}
        initialise_newborn(world, {name: rows for name, rows in newborn.items() if len(rows)})
        coming = _collect_birth_rows(world)
        generation += 1
    for population in world.populations.values() if bereft else ():
        clear_dead_references(world, population)


Arrays = dict[str, NDArray[Any]]
BirthRows = list[tuple[Population, NDArray[np.intp], NDArray[np.float64], Footing, Arrays, Arrays]]


def _collect_birth_rows(world: World) -> dict[str, BirthRows]:
    """Return the requested births, by species of the children, in the order in which children get their ids.

    Values that children inherit are copied here, before dead parents are removed."""
    births: dict[str, BirthRows] = {}
    for population in world.populations.values():
        entries = population.effects.pop_requests("spawn")
        for species in sorted({e.request.target for e in entries}):
            rows = np.concatenate([e.rows for e in entries if e.request.target == species])
            order = np.concatenate([np.full(len(e.rows), e.order) for e in entries if e.request.target == species])
            rows = rows[np.lexsort((order, population.ids[rows]))]
            registers = {name: population.now[name][rows] for name in MIGRATED_REGISTERS}
            columns = {name: population.columns[of][rows] for name, of in _INHERITED_COLUMNS.items()}
            births.setdefault(species, []).append(
                (population, rows, population.position[rows], population.footing.select_rows(rows), registers, columns)
            )
    return births


def _add_newborn(world: World, population: Population, births: BirthRows) -> NDArray[np.intp]:
    """Add newborn agents to the world. Return their rows."""
    old = len(population)
    for _, rows, position, footing, registers, columns in births:
        capacity = limits.MAX_AGENTS - len(world)
        count = min(len(rows), max(0, capacity))
        if count < len(rows):
            world.faults.rejected_births += len(rows) - count
        if not count:
            continue
        ids = np.arange(population.next_id, population.next_id + count)
        population.next_id += count
        new = add_rows(population, ids, world.frame + 1, position[:count], footing.select_rows(slice(count)))
        for arrays, inherited in ((population.now, registers), (population.columns, columns)):
            for name, value in inherited.items():
                arrays[name][new] = value[:count]
    if world.notes is not None:
        world.notes.remove_absent_agents(world, {population.name: old})
    return np.arange(old, len(population))


def initialise_newborn(world: World, newborn: Mapping[str, NDArray[np.intp]]) -> None:
    """Run the block `born`, which sets the registers of newborn agents. Position, up, heading and velocity must already be
    set.

    `newborn`: the rows of newborn agents, by species. Agents that are born together sense each other's position and movement.
    All other registers of each other read as 0 or none, in whatever order agents are computed."""
    world.grids.clear()  # rows have changed
    world.trees.clear()
    world.touching_agents = None
    for name, rows in newborn.items():
        population = world.populations[name]
        for k, axis in enumerate(AXES):
            population.now[f"position.{axis}"][rows] = population.position[rows, k]
        for register, array in population.now.items():
            if population.start[register] is array:
                population.start[register] = array.copy()
            else:
                population.start[register][rows] = array[rows]
        if _has_birth_fields(population):
            update_agent_cells(world, population)
    for name, rows in newborn.items():
        world.backend.run(world, world.populations[name], "born", rows)
    for name, rows in newborn.items():
        population = world.populations[name]
        stored = list_stored_registers(population.plan)
        for register, array in population.now.items():
            if is_start_array_shared(population.plan, register, stored):
                population.start[register] = array
            else:
                population.start[register][rows] = array[rows]


def _has_birth_fields(population: Population) -> bool:
    """Return whether the block `born` of the species reads a field."""
    nodes = collect_required_nodes(
        tuple(node for _, statement in iterate_with_positions(population.plan.born) for node in list_operands(statement))
    )
    return any(node.op.startswith("field.") for node in nodes)


def clear_dead_references(world: World, population: Population, *, clears_start: bool = False) -> None:
    """Replace references to dead agents by none, in all registers that contain ids of agents.

    With `clears_start`, also replace them in the values that agents sense in the next step."""
    for register in population.plan.registers.values():
        if register.kind is ir.ValueKind.I64 and register.referenced_species in world.populations and register.role != "temp":
            for holder in (population.now, population.start) if clears_start else (population.now,):
                held = holder[register.name]
                is_dead = (held >= 0) & (world.populations[register.referenced_species].find_rows(held) < 0)
                if is_dead.any():
                    held[is_dead] = -1


def list_event_names(world: World) -> tuple[str, ...]:
    """Return the names of all events that agents may handle or emit, sorted. The `event` column of emissions contains indices
    into this tuple."""
    plans = [population.plan for population in world.populations.values()]
    names = {name for plan in plans for name in plan.event_names}
    for plan in plans:
        for block in (plan.decide, plan.act, plan.blend, plan.born):
            names.update(
                each.target for _, each in iterate_with_positions(block) if isinstance(each, ir.Request) and each.op == "emit"
            )
    return tuple(sorted(names))


def record_emission(world: World, population: Population, rows: NDArray[np.intp], event: str) -> None:
    """Record that the agents `rows` emitted `event`, with their positions."""
    if world.emissions is None:
        return
    events, species = list_event_names(world), sorted(world.populations)
    numbers = {"species": species.index(population.name), "event": events.index(event)}
    agents: Arrays = {"id": population.ids, "P": population.position, "N": population.normal}
    emission = {name: array[rows] for name, array in agents.items()}
    world.emissions.append(emission | {name: np.full(len(rows), number, np.int16) for name, number in numbers.items()})


def collect_emissions(world: World) -> Arrays:
    """Return the events emitted since the last call, as the columns `EMIT_COLUMNS`. They are sorted by species, id and event;
    positions are in mm."""
    entries, world.emissions = world.emissions or [], None if world.emissions is None else []
    empty = {column.field: np.empty((0, *column.compute_dimensions()), column.type) for column in EMIT_COLUMNS}
    arrays = {name: np.concatenate([none, *(each[name] for each in entries)]) for name, none in empty.items()}
    order = np.lexsort((arrays["event"], arrays["id"], arrays["species"]))
    return {name: array[order] for name, array in arrays.items()}
