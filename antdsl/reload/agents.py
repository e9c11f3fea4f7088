"""Migration of agents to the world of an edited program. Values that have the same name and meaning in both programs are
retained."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import length
from antdsl.plan import ir
from antdsl.plan.registers import find_pair_values
from antdsl.plan.traverse import collect_required_nodes
from antdsl.program.tables.columns import FIXED_COLUMN_BY_NAME, MIGRATED_REGISTERS
from antdsl.reload.footing import MIN_REPORTED_DISTANCE, align_bodies_with_ground, find_footings_after_reload
from antdsl.runtime.binding.bind_world import compute_run_value
from antdsl.runtime.binding.binding_cache import compute_digest
from antdsl.runtime.binding.initial_attributes import write_initial_values
from antdsl.runtime.lifecycle import initialise_newborn
from antdsl.runtime.requests import EffectRequests
from antdsl.runtime.world import Population, World, add_rows, list_stored_registers
from antdsl.scene.setting import WorldSetting

_REGISTER_READS = frozenset(("snap", "load"))
RowIndices = NDArray[np.intp]
_MIGRATED_COLUMNS = [name for name, column in FIXED_COLUMN_BY_NAME.items() if column.survives_reload]


@dataclass(slots=True)
class SpeciesMigration:
    """The result of a migration for the agents of one species. Its lists name attributes, or states as `machine.state`.

    `agent_count`: the number of agents. `moved_count`: the number of agents that moved to other positions. `restart_counts`: for
    each pair of a removed state and a start state, how many agents changed from the first to the second."""

    species: str
    agent_count: int = 0
    moved_count: int = 0
    restart_counts: dict[tuple[str, str], int] = field(default_factory=dict)  # (removed state, start state) -> agents
    states: list[str] = field(default_factory=list)  # new states
    removed_states: list[str] = field(default_factory=list)  # removed states without agents
    new_attributes: list[str] = field(default_factory=list)
    retyped_attributes: list[str] = field(default_factory=list)  # attributes with another type now
    reset_attributes: list[str] = field(default_factory=list)  # attributes that are set only at birth, and have a new value now
    removed_attributes: list[str] = field(default_factory=list)
    forgotten_memories: int = 0  # memories that no longer exist, or have another meaning


def migrate_agents(
    old_world: World, world: World, name: str, rows: RowIndices
) -> tuple[SpeciesMigration, dict[str, NDArray[Any]]]:
    """Add the agents of a species to a world that does not have any yet.

    `rows`: the rows of the agents in `old_world`. Return the result of the migration, and the registers with retained values.
    `fill_registers` adds the other registers once all species are migrated."""
    old_population, new_population = old_world.populations[name], world.populations[name]
    migrated = SpeciesMigration(name, len(rows))
    footing, place, moved = find_footings_after_reload(old_world, world, old_population)
    add_rows(new_population, old_population.ids[rows].copy(), old_world.frame, place[rows], footing.select_rows(rows))
    new_population.columns |= {name: old_population.columns[name][rows] for name in _MIGRATED_COLUMNS}
    new_population.next_id = old_population.next_id
    new_population.events |= {name: flags[rows] for name, flags in old_population.events.items() if name in new_population.events}
    values = {
        register: old_population.now[register][rows]
        for register in _find_matching_registers(old_world, world, old_population.plan, new_population.plan, migrated)
    }
    _migrate_states(old_population.plan, new_population.plan, values, migrated)
    _migrate_clips(old_population.plan, new_population.plan, values)
    _migrate_items(old_world, world, new_population.plan, values)
    _migrate_pairs(old_population, world, new_population.plan, rows, values)
    write_registers(new_population, values)
    align_bodies_with_ground(world, new_population, moved[rows])
    migrated.moved_count = int(
        np.count_nonzero(length(new_population.position - old_population.position[rows]) > MIN_REPORTED_DISTANCE)
    )
    return migrated, values | {register: new_population.now[register].copy() for register in MIGRATED_REGISTERS}


def fill_registers(world: World, name: str, values: dict[str, NDArray[Any]]) -> None:
    """Add the missing registers of a species to `values`, as if each agent were born at its position in this frame.

    Requests that agents make at birth have no effect."""
    population = world.populations[name]
    lasting = (register for register, each in population.plan.registers.items() if each.role != "temp")
    if not len(population) or all(register in values for register in lasting):
        return
    for crowd, line in zip(world.setting.crowds, world.crowd_lines, strict=True):
        if crowd.species == name and (crowd.place.values or crowd.initial_values):
            write_initial_values(world, population, np.flatnonzero(line.find_positions_in_line(population.ids) >= 0), crowd)
    initialise_newborn(world, {name: np.arange(len(population))})
    population.effects = EffectRequests()
    write_registers(population, values)


def write_registers(population: Population, values: Mapping[str, NDArray[Any]]) -> None:
    """Write the registers of all agents: the current values, and the values at the start of the next step."""
    for name, array in values.items():
        population.now[name][:] = array
        if population.start[name] is not population.now[name]:
            population.start[name][:] = array


# --- which registers ---------------------------------------------------------------------------------------------------


def _find_matching_registers(
    old_world: World, world: World, old_plan: ir.SpeciesPlan, new_plan: ir.SpeciesPlan, migrated: SpeciesMigration
) -> list[str]:
    """Return the names of the registers that retain their values. Add findings about the other registers to `migrated`."""
    matching = [
        name
        for name, register in new_plan.registers.items()
        if register.role != "temp"
        and name in old_plan.registers
        and _find_register_meaning(old_plan.registers[name]) == _find_register_meaning(register)
    ]
    lasting = {
        name for name in matching if not name.endswith(".on") or _is_memory_complete(name.removesuffix(".on"), new_plan, matching)
    }
    rewritten = _find_changed_defaults(old_world, world, old_plan, new_plan) & lasting
    for name, register in new_plan.registers.items():
        if register.role == "attribute" and name not in lasting:
            known = name in old_plan.registers and old_plan.registers[name].role == "attribute"
            _add_register_name(migrated.retyped_attributes if known else migrated.new_attributes, name)
    for name, slots in find_pair_values(new_plan.registers).items():
        known = slots[0][1] in old_plan.registers
        if not known or slots[0][1] not in lasting:
            _add_register_name(migrated.retyped_attributes if known else migrated.new_attributes, name)
    removed_names = find_pair_values(old_plan.registers).keys() - find_pair_values(new_plan.registers).keys()
    migrated.removed_attributes += sorted(removed_names)
    for name, register in old_plan.registers.items():
        if register.role == "attribute" and name not in new_plan.registers:
            _add_register_name(migrated.removed_attributes, name)
        migrated.forgotten_memories += register.role == "memory" and name not in lasting and not name.endswith(".on")
    for name in sorted(rewritten):
        _add_register_name(migrated.reset_attributes, name)
    return [name for name in matching if name in lasting and name not in rewritten]


def _find_register_meaning(register: ir.Register) -> tuple[object, ...]:
    """Return the properties of a register that must be equal in both programs if its values are to be retained."""
    return register.kind, register.role, register.referenced_species, register.language_type


def _is_memory_complete(memory: str, new_plan: ir.SpeciesPlan, matching_names: list[str]) -> bool:
    """Return whether the new plan still has all registers of the `keep` named `memory`.

    If not, the `keep` restarts from its initial value."""
    values = [name for name in (memory, *(f"{memory}.{axis}" for axis in "xyz")) if name in new_plan.registers]
    return all(name in matching_names for name in values)


def _find_changed_defaults(old_world: World, world: World, old_plan: ir.SpeciesPlan, new_plan: ir.SpeciesPlan) -> set[str]:
    """Return the attributes that both plans set only at birth, but to different values. Agents get the new values."""
    one, other = hash_birth_values(old_plan, find_birth_params(old_world)), hash_birth_values(new_plan, find_birth_params(world))
    stored = list_stored_registers(old_plan) | list_stored_registers(new_plan) | set(MIGRATED_REGISTERS)
    attributes = {name for name, register in new_plan.registers.items() if register.role == "attribute"}
    placed = {
        name
        for name in attributes
        if _compute_place_digests(old_world.setting, old_plan.name, name)
        != _compute_place_digests(world.setting, new_plan.name, name)
    }
    return {name for name in attributes - stored if one.get(name) != other.get(name) or name in placed}


def _compute_place_digests(setting: WorldSetting, species: str, attribute: str) -> list[str]:
    """Return, for each crowd line of the scene, a digest of the values that it gives to an attribute at birth."""
    crowds = (crowd for crowd in setting.crowds if crowd.species == species)
    return [compute_digest((crowd.place.values.get(attribute), crowd.initial_values.get(attribute))) for crowd in crowds]


def _add_register_name(names: list[str], register: str) -> None:
    """Add the name of a register, as the author knows it, to a list. The three registers of a vector share one name."""
    name = register[:-2] if register[-2:] in (".x", ".y", ".z") else register
    if name not in names:
        names.append(name)


# --- what registers point to ---------------------------------------------------------------------------------------------


def _migrate_states(
    old_plan: ir.SpeciesPlan, new_plan: ir.SpeciesPlan, values: dict[str, NDArray[Any]], migrated: SpeciesMigration
) -> None:
    """Convert the state numbers in `values` to those of the new plan. States are matched by name. Agents in a removed state
    start again in the initial state."""
    machines = {machine.name: machine for machine in old_plan.machines}
    for machine in new_plan.machines:
        known = machines.get(machine.name)
        if known is None or f"{machine.name}.state" not in values:
            continue
        number = _map_state_numbers(known, machine)
        now = values[f"{machine.name}.state"]
        state = number[now]
        lost = state < 0
        occupied = {known.states[index] for index in np.unique(now[lost])}
        migrated.states += [f"{machine.name}.{state}" for state in machine.states if state not in known.states]
        migrated.removed_states += [
            f"{machine.name}.{state}" for state in known.states if state not in (*machine.states, *occupied)
        ]
        for index in np.unique(now[lost]):
            key = (f"{machine.name}.{known.states[index]}", f"{machine.name}.{machine.states[machine.start]}")
            migrated.restart_counts[key] = int(np.count_nonzero(now == index))
        values[f"{machine.name}.state"] = state = np.where(lost, machine.start, state).astype(now.dtype)
        for part in ("previous", "next"):
            other = number[values[f"{machine.name}.{part}"]]
            values[f"{machine.name}.{part}"] = np.where(lost | (other < 0), state, other).astype(now.dtype)
        time = values[f"{machine.name}.time_in_state"]
        values[f"{machine.name}.time_in_state"] = np.where(lost, 0, time).astype(time.dtype)


def _migrate_clips(old_plan: ir.SpeciesPlan, new_plan: ir.SpeciesPlan, values: dict[str, NDArray[Any]]) -> None:
    """Convert the clip numbers in `values` to those of the new plan. A clip that was removed is replaced by no clip."""
    number = np.array([new_plan.clips.index(clip) if clip in new_plan.clips else -1 for clip in old_plan.clips] + [-1])
    for machine in new_plan.machines:
        for register in (f"{machine.name}.{part}" for part in ("clip", "clip_before", "clip_earlier")):
            if register in values:
                values[register] = number[values[register]].astype(values[register].dtype)


def _migrate_pairs(
    old_population: Population, world: World, new_plan: ir.SpeciesPlan, rows: RowIndices, values: dict[str, NDArray[Any]]
) -> None:
    """Remove values that are stored per pair of agents, if the new plan stores fewer for each agent.

    For each agent, the values farthest from the new plan's initial value remain, because values return to it over time. If two
    are equally far, the one with the smaller id remains."""
    old = find_pair_values(old_population.plan.registers)
    for name, slots in find_pair_values(new_plan.registers).items():
        if len(slots) >= len(old.get(name, ())) or slots[0][0] not in values:
            continue
        who, value = (np.stack([old_population.now[each[part]][rows] for each in old[name]], axis=1) for part in (0, 1))
        rest = np.float32(compute_run_value(world, new_plan.pair_rest_values[name]))
        strength = np.where(who < 0, np.float32(-1), np.abs(value - rest))
        order = np.lexsort((who, -strength), axis=1)[:, : len(slots)]
        for k, names in enumerate(slots):
            for register, array in zip(names, (who, value), strict=True):
                values[register] = np.take_along_axis(array, order, axis=1)[:, k].copy()


def _map_state_numbers(old_machine: ir.MachinePlan, new_machine: ir.MachinePlan) -> NDArray[np.int64]:
    """Return the new number of each state of the old machine, int64 (states); -1 for a removed state."""
    numbers = {state: k for k, state in enumerate(new_machine.states)}
    return np.array([numbers.get(state, -1) for state in old_machine.states], np.int64)


def _migrate_items(old_world: World, world: World, new_plan: ir.SpeciesPlan, values: dict[str, NDArray[Any]]) -> None:
    """Convert the item numbers in registers to those of the new world, matching items by name. An item that was removed is
    replaced by no item."""
    for name, register in new_plan.registers.items():
        if name in values and register.language_type and register.language_type[0] == "item":
            of = str(register.language_type[-1])
            rows = {item: k for k, item in enumerate(world.items[of].names)}
            number = np.array([*(rows.get(item, -1) for item in old_world.items[of].names), -1], np.int64)
            values[name] = number[values[name]].astype(values[name].dtype)


def hash_birth_values(plan: ir.SpeciesPlan, params: Mapping[str, float]) -> dict[str, int]:
    """Return a hash of the value of each register at birth, by register name.

    The hash covers the operations, the registers that they read, and the params that they use."""
    hashes: dict[str, int] = {}
    _hash_block(plan.born, (), hashes, params)
    return hashes


def find_birth_params(world: World) -> dict[str, float]:
    """Return the values of params that the scene and the program have set, without later changes."""
    scene_params = world.setting.params
    return {
        name: scene_params[name] if name in scene_params else compute_run_value(world, p.default)
        for name, p in world.plan.params.items()
    }


def _hash_block(block: ir.Block, condition_hashes: tuple[int, ...], hashes: dict[str, int], params: Mapping[str, float]) -> None:
    """Add to `hashes` a hash for each register that a block sets. `condition_hashes`: hashes of the conditions around the
    block."""
    for statement in block.statements:
        if isinstance(statement, ir.If):
            _hash_block(statement.body, (*condition_hashes, _hash_value(statement.condition, hashes, params)), hashes, params)
        elif isinstance(statement, ir.Store):
            value = _hash_value(statement.value, hashes, params)
            previous_hash = hashes.get(statement.register, 0) if condition_hashes else 0
            hashes[statement.register] = hash((condition_hashes, previous_hash, value))


def _hash_value(node: ir.PlanNode, hashes: Mapping[str, int], params: Mapping[str, float]) -> int:
    """Return a hash of the operations and inputs that compute a value."""
    node_hashes: dict[ir.PlanNode, int] = {}
    for each in collect_required_nodes([node]):
        attrs: tuple[object, ...] = each.attrs
        if each.op in _REGISTER_READS:
            attrs = (each.attrs[0], hashes.get(each.attrs[0], 0))
        elif each.op == "param":
            attrs = (each.attrs[0], params.get(each.attrs[0]))
        node_hashes[each] = hash((each.op, each.kind.value, repr(attrs), *(node_hashes[a] for a in each.args)))
    return node_hashes[node]
