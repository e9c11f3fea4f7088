"""Migration of a running world to an edited program. A new world gets the agents, amounts, field values and dug solids of the
old world.

A value with the same name and meaning in both programs is retained. An edited value takes its new value. All other values start
again. The old world is only read, so it can continue unchanged after any error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.processor.float_environment import use_standard_floats
from antdsl.plan import ir
from antdsl.reload.agents import SpeciesMigration, fill_registers, migrate_agents, write_registers
from antdsl.reload.footing import is_same_solid
from antdsl.runtime.binding.agent_placement import initialise_agents, place_new_agents
from antdsl.runtime.binding.bind_world import bind_world_without_agents
from antdsl.runtime.binding.binding_cache import BindingCache, compute_digest
from antdsl.runtime.faults import FaultLog
from antdsl.runtime.feet import feet_step
from antdsl.runtime.lifecycle import clear_dead_references
from antdsl.runtime.line_tables import count_released_agents, list_line_names, match_crowd_lines
from antdsl.runtime.motion_measures import MotionMeasures
from antdsl.runtime.moving.moving_geometry import pose_geometry
from antdsl.runtime.world import World
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.setting import CrowdData, WorldSetting

_NO_IDS = np.empty(0, np.int64)


@dataclass(slots=True)
class Migration:
    """The result of a migration.

    `added_counts`, `removed_counts`: for each species, the number of agents that were added or removed because crowds of the
    scene changed size.
    `restarted_items`: amounts that start again from the scene's value, as `item.attribute`."""

    species: list[SpeciesMigration] = field(default_factory=list)
    added_counts: dict[str, int] = field(default_factory=dict)
    removed_counts: dict[str, int] = field(default_factory=dict)
    restarted_items: list[str] = field(default_factory=list)  # also new items
    reset_fields: list[str] = field(default_factory=list)
    reset_solids: list[str] = field(default_factory=list)

    @property
    def agents(self) -> int:
        """Return the number of agents that were retained."""
        return sum(migrated.agent_count for migrated in self.species)


@use_standard_floats()
def migrate_world(
    old_world: World, plan: ir.Plan, setting: WorldSetting, binding_cache: BindingCache | None = None
) -> tuple[World, Migration]:
    """Return a new world that runs the edited plan and setting at the frame of the old world, and the result of the migration.

    Raises BindError like `bind`. `binding_cache`: a cache that the caller passes to every call, so that unchanged meshes are not
    processed again."""
    world = bind_world_without_agents(plan, setting, old_world.options, binding_cache=binding_cache, origin=old_world.origin)
    world.frame = old_world.frame
    migration = Migration()
    with np.errstate(all="ignore"):
        _migrate_items(old_world, world, migration)
        _migrate_solids(old_world, world, migration)
        _migrate_fields(old_world, world, migration)
        pose_geometry(world, world.frame)
        _migrate_flows(old_world, world)
        initialise_agents(world, place_new_agents(world, _migrate_agents(old_world, world, migration)))
        for population in world.populations.values():
            clear_dead_references(world, population, clears_start=True)
    feet_step.place_initial_feet(world)
    _migrate_feet(old_world, world)
    _migrate_counts(old_world, world)
    return world, migration


# --- agents ------------------------------------------------------------------------------------------------------------


def _migrate_agents(old_world: World, world: World, migration: Migration) -> list[tuple[CrowdData, NDArray[np.int64]]]:
    """Move all agents that stay. Return the crowd lines that need new agents, each with the ids of these agents."""
    values = {}
    for name in world.populations:
        if name in old_world.populations:
            migrated, values[name] = migrate_agents(
                old_world, world, name, _find_staying_rows(old_world, world.setting, name, migration)
            )
            migration.species.append(migrated)
            _update_crowd_groups(old_world.setting, world, name, values[name])
    lines, created_ids = [], []
    for crowd, old in _match_crowds(old_world, world.setting):
        population = world.populations[crowd.species]
        line = CrowdLineIds(crowd.species) if old is None else old[1]
        released = 0 if old is None else count_released_agents(*old, world.frame)
        due = crowd.count_created(world.frame)
        joining_count = due - (0 if old is None else old[0].count_created(world.frame))
        if joining_count < 0:  # ids of removed agents are not used again
            line = line.resize(released + joining_count, population.next_id)
        total = released + joining_count + crowd.count - due
        lines.append(line.resize(total, population.next_id))
        population.next_id += max(0, total - len(line))
        created_ids.append(lines[-1].list_ids_between(released, released + joining_count - 1) if joining_count > 0 else _NO_IDS)
    world.crowd_lines = tuple(lines)
    for name, known in values.items():
        fill_registers(world, name, known)
    for name in old_world.populations:
        if name not in world.populations and len(old_world.populations[name]):
            migration.removed_counts[name] = len(old_world.populations[name])
    joining = [(crowd, ids) for crowd, ids in zip(world.setting.crowds, created_ids, strict=True) if len(ids)]
    for crowd, ids in joining:
        migration.added_counts[crowd.species] = migration.added_counts.get(crowd.species, 0) + len(ids)
    return joining


def _match_crowds(old_world: World, setting: WorldSetting) -> list[tuple[CrowdData, tuple[CrowdData, CrowdLineIds] | None]]:
    """Return the crowd lines of the new setting, each paired with its old line and the ids of that line's agents, or with
    None."""
    matches = match_crowd_lines(list_line_names(old_world.setting), list_line_names(setting))
    old = list(zip(old_world.setting.crowds, old_world.crowd_lines, strict=True))
    return [(crowd, old[k] if k >= 0 else None) for crowd, k in zip(setting.crowds, matches, strict=True)]


def _find_staying_rows(old_world: World, setting: WorldSetting, name: str, migration: Migration) -> NDArray[np.intp]:
    """Return the rows of the agents of a species that stay. If a crowd line of the scene has fewer agents than before, its last
    agents are removed."""
    population = old_world.populations[name]
    stays = np.ones(len(population), np.bool_)
    new_by_old = _number_new_lines(old_world.setting, setting)
    frame = old_world.frame
    for crowd in old_world.setting.crowds:
        if crowd.species == name:
            rows = np.flatnonzero(population.now["group"] == crowd.line_index)
            new = new_by_old.get(crowd.line_index)
            fewer = len(rows) if new is None else crowd.count_created(frame) - setting.crowds[new].count_created(frame)
            if fewer > 0:
                rows = rows[np.argsort(population.ids[rows])]
                stays[rows[max(0, len(rows) - fewer) :]] = False
    if not stays.all():
        migration.removed_counts[name] = int(np.count_nonzero(~stays))
    return np.flatnonzero(stays)


def _number_new_lines(old_setting: WorldSetting, setting: WorldSetting) -> dict[int, int]:
    """Return the index of the new crowd line for each old one, by old index."""
    matches = match_crowd_lines(list_line_names(old_setting), list_line_names(setting))
    return {old: new for new, old in enumerate(matches) if old >= 0}


def _update_crowd_groups(old_setting: WorldSetting, world: World, name: str, values: dict[str, NDArray[np.generic]]) -> None:
    """Update the crowd line number of each agent, because the lines of the scene may have changed."""
    population = world.populations[name]
    group, values["group"] = population.now["group"], population.now["group"].copy()
    for old, new in _number_new_lines(old_setting, world.setting).items():
        values["group"][group == old] = new
    write_registers(population, {"group": values["group"]})


# --- everything else ---------------------------------------------------------------------------------------------------


def _migrate_items(old_world: World, world: World, migration: Migration) -> None:
    """Copy the amounts of items, matched by name. An amount that was changed in the scene starts with the new value."""
    for name, items in world.items.items():
        known = old_world.items.get(name)
        rows = {} if known is None else {item: k for k, item in enumerate(known.names)}
        old_items, new_items = ({i.name: i for i in s.items.get(name, ())} for s in (old_world.setting, world.setting))
        for k, item in enumerate(items.names):
            for attribute, amounts in items.amounts.items():
                same = (
                    known is not None
                    and item in rows
                    and attribute in known.amounts
                    and old_items[item].attributes.get(attribute, old_world.plan.items[name].attributes[attribute])
                    == new_items[item].attributes.get(attribute, world.plan.items[name].attributes[attribute])
                )
                if same and known is not None:
                    amounts[k] = known.amounts[attribute][rows[item]]
                else:
                    migration.restarted_items.append(f"{item}.{attribute}")
        items.publish_amounts()


def _migrate_solids(old_world: World, world: World, migration: Migration) -> None:
    for name, volume in world.solids.items():
        if name in old_world.solids and is_same_solid(old_world, world, name):
            volume.restore_changes({key: array.copy() for key, array in old_world.solids[name].get_changes().items()})
        else:
            migration.reset_solids.append(name)


def _migrate_fields(old_world: World, world: World, migration: Migration) -> None:
    """Copy the amounts of fields that have the same cells. A field of which the initial value was changed is not copied."""
    for name, now in world.fields.items():
        old_field = old_world.fields.get(name)
        program_name = world.plan.fields[name].vector_field or name
        starts = [setting.field_start.get(program_name) for setting in (old_world.setting, world.setting)]
        if (
            old_field is None
            or not _is_same_grid(old_world, world, name)
            or compute_digest(starts[0]) != compute_digest(starts[1])
        ):
            migration.reset_fields.append(name)
            continue
        if now.added_cells:
            now.restore_added_cells(old_field.added_cells["keys"], old_field.added_cells["places"])
        now.amounts[:] = np.minimum(old_field.amounts, now.limit)


def _is_same_grid(old_world: World, world: World, name: str) -> bool:
    one, other = old_world.plan.fields[name], world.plan.fields[name]
    if one.surfaces != other.surfaces or old_world.fields[name].cells.cell != world.fields[name].cells.cell:
        return False
    old_surfaces, new_surfaces = (
        [s.surfaces.get(surface) or s.solids.get(surface) for surface in one.surfaces] for s in (old_world.setting, world.setting)
    )
    return old_world.fields[name].cells is world.fields[name].cells or compute_digest(old_surfaces) == compute_digest(
        new_surfaces
    )


def _migrate_flows(old_world: World, world: World) -> None:
    """Copy the state of flows that are computed over several steps, if these flows are unchanged."""
    for name, flow in world.flows.items():
        state = flow.get_state()
        old_state = old_world.flows[name].get_state() if state and name in old_world.flows else {}
        same = state.keys() == old_state.keys() and all(old_state[key].shape == array.shape for key, array in state.items())
        if state and same and compute_digest(old_world.setting.flows[name]) == compute_digest(world.setting.flows[name]):
            flow.restore_state({key: array.copy() for key, array in old_state.items()})


def _migrate_feet(old_world: World, world: World) -> None:
    """Copy the footholds and swings of legs, if bodies have the same legs and the ground is the same."""
    if old_world.foot_ground is None or world.foot_ground is None or old_world.foot_ground.names != world.foot_ground.names:
        return
    if compute_digest((old_world.foot_ground.meshes, old_world.setting.motion)) != compute_digest(
        (world.foot_ground.meshes, world.setting.motion)
    ):
        return
    for name, feet in world.feet.items():
        old_feet = old_world.feet.get(name)
        if old_feet is not None and compute_digest(old_world.setting.legs[name]) == compute_digest(world.setting.legs[name]):
            feet.copy_common_agents(old_feet)


def _migrate_counts(old_world: World, world: World) -> None:
    """Copy counts, measurements and watchers."""
    world.transitions = dict(old_world.transitions)
    world.motion = MotionMeasures.from_arrays(old_world.motion.collect_checkpoint_arrays())
    world.faults = FaultLog(
        old_world.faults.fault_count, old_world.faults.rejected_births, list(old_world.faults.reported_faults)
    )
    world.watchers = list(old_world.watchers)
    if world.notes is not None and old_world.notes is not None:
        world.notes.restore_memory(old_world.notes.stored_arrays)
    world.dug_balls = None if old_world.dug_balls is None else {}
    world.emissions = None if old_world.emissions is None else []
    if world.detail_levels is not None and old_world.detail_levels is not None:
        world.detail_levels.counts = old_world.detail_levels.counts.copy()


def describe_migration(migration: Migration) -> str:
    """Return one line that describes what a migration changed, for example "… · 12 `forager` added · `load` is new"."""
    parts = [f"kept {migration.agents:,} {_pluralise_agents(migration.agents)}"]
    several = len(migration.species) > 1
    for migrated in migration.species:
        parts += _describe_species(migrated, f"{migrated.species}." if several else "")
    parts += [f"{count:,} `{name}` added" for name, count in migration.added_counts.items()]
    parts += [f"{count:,} `{name}` removed" for name, count in migration.removed_counts.items()]
    parts += _format_names(migration.restarted_items, "has its amount from the scene", "have their amounts from the scene")
    parts += _format_names([f"field {name}" for name in migration.reset_fields], "starts again", "start again")
    parts += _format_names([f"solid {name}" for name in migration.reset_solids], "is whole", "are whole")
    return " · ".join(parts)


def _describe_species(migrated: SpeciesMigration, name_prefix: str) -> list[str]:
    """Return the changes of one species as phrases. `name_prefix`: text to put before names; "" if there is only one species."""
    parts = [
        f"{count:,} of removed state `{name_prefix}{_shorten_state_name(removed_state)}` "
        f"{'starts' if count == 1 else 'start'} again in `{name_prefix}{_shorten_state_name(start)}`"
        for (removed_state, start), count in sorted(migrated.restart_counts.items())
    ]
    parts += _format_names(
        [name_prefix + _shorten_state_name(name) for name in migrated.states], "is a new state", "are new states"
    )
    parts += _format_names(
        [name_prefix + _shorten_state_name(name) for name in migrated.removed_states],
        "is no longer a state",
        "are no longer states",
    )
    if migrated.moved_count:
        parts.append(
            f"{migrated.moved_count:,} {_pluralise_agents(migrated.moved_count)} moved with the ground"
            + (f" of `{migrated.species}`" if name_prefix else "")
        )
    parts += _format_names([name_prefix + name for name in migrated.new_attributes], "is new", "are new")
    parts += _format_names(
        [name_prefix + name for name in migrated.retyped_attributes],
        "has a different type and starts again",
        "have different types and start again",
    )
    parts += _format_names(
        [name_prefix + name for name in _drop_derived_names(migrated.reset_attributes)],
        "has its new value",
        "have their new values",
    )
    parts += _format_names([name_prefix + name for name in migrated.removed_attributes], "is gone", "are gone")
    if migrated.forgotten_memories:
        parts.append(f"{migrated.forgotten_memories} {'memory' if migrated.forgotten_memories == 1 else 'memories'} forgotten")
    return parts


def _drop_derived_names(names: list[str]) -> list[str]:
    """Return names without derived attributes, which programs seldom set: strength follows from speed, and radius from size."""
    follow = {"max_force": {"mass", "max_speed", "response"}, "radius": {"size"}}
    return [name for name in names if not follow.get(name, set()) & set(names)]


def _shorten_state_name(state: str) -> str:
    """Return the name of a state without the default machine's name. Most species have only this machine."""
    return state.removeprefix("main.")


def _pluralise_agents(count: int) -> str:
    return "agent" if count == 1 else "agents"


def _format_names(names: list[str], singular: str, plural: str) -> list[str]:
    """Return a phrase about names, in the singular or plural, as a list; [] if there are no names."""
    if not names:
        return []
    name_list = ", ".join(f"`{name}`" for name in names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return [f"{name_list} {singular if len(names) == 1 else plural}"]
