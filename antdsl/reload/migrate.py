"""An edited program continues from the state of the running one. A new world gets the agents, amounts, scents and dug solids
of the old world.

A value with the same name and meaning in both programs is retained. An edited value takes its new value. All other values
start again. The old world is only read, so it can continue unchanged after any error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.float_environment import standard_floats
from antdsl.plan import ir
from antdsl.reload.agents import MigratedSpecies, fill_registers, migrate_agents, write_registers
from antdsl.reload.footing import is_same_solid
from antdsl.runtime.binding.bind_world import bind_empty
from antdsl.runtime.binding.placing import begin_agents, place_joining
from antdsl.runtime.binding.reuse import BindingCache, digest
from antdsl.runtime.faults import FaultLog
from antdsl.runtime.feet import walking
from antdsl.runtime.lifecycle import forget_the_dead
from antdsl.runtime.motion_measures import MotionMeasures
from antdsl.runtime.moving.moving_geometry import pose_world
from antdsl.runtime.world import World
from antdsl.scene.setting import CrowdData, WorldSetting


@dataclass(slots=True)
class Migration:
    """The result of a migration.

    `joined`, `removed`: by species, how many agents were added or removed because the scene's crowd has another size."""

    species: list[MigratedSpecies] = field(default_factory=list)
    joined: dict[str, int] = field(default_factory=dict)
    removed: dict[str, int] = field(default_factory=dict)
    items: list[str] = field(default_factory=list)  # restarted, or new
    fields: list[str] = field(default_factory=list)
    solids: list[str] = field(default_factory=list)

    @property
    def agents(self) -> int:
        """Return the number of agents that were retained."""
        return sum(migrated.agents for migrated in self.species)


@standard_floats()
def take_over(old: World, plan: ir.Plan, setting: WorldSetting, built: BindingCache | None = None) -> tuple[World, Migration]:
    """Return the world of an edited plan and setting at the frame of a running world, and the migration. Raises BindError as
    `bind` does.

    `built`: a cache that the caller passes to each call, so that unchanged meshes are not processed again."""
    world = bind_empty(plan, setting, old.options, built=built, origin=old.origin)
    world.frame = old.frame
    migration = Migration()
    with np.errstate(all="ignore"):
        _migrate_items(old, world, migration)
        _migrate_solids(old, world, migration)
        _migrate_fields(old, world, migration)
        pose_world(world, world.frame)
        _migrate_flows(old, world)
        begin_agents(world, place_joining(world, _migrate_agents(old, world, migration)))
        for population in world.populations.values():
            forget_the_dead(world, population, between_steps=True)
    walking.begin_feet(world)
    _migrate_feet(old, world)
    _migrate_counts(old, world)
    return world, migration


# --- agents ------------------------------------------------------------------------------------------------------------


def _migrate_agents(old: World, world: World, migration: Migration) -> list[tuple[CrowdData, NDArray[np.int64]]]:
    """Move all agents that stay; return the crowd lines to add, each with the ids of its new agents."""
    joining: list[tuple[CrowdData, NDArray[np.int64]]] = []
    values = {}
    for name in world.populations:
        if name in old.populations:
            migrated, values[name] = migrate_agents(old, world, name, _staying_rows(old, world.setting, name, migration))
            migration.species.append(migrated)
            _regroup(old.setting, world, name, values[name])
    for name, known in values.items():
        fill_registers(world, name, known)
    for name in old.populations:
        if name not in world.populations and len(old.populations[name]):
            migration.removed[name] = len(old.populations[name])
    for name, population in world.populations.items():
        old_lines = _crowd_lines(old.setting, name) if name in old.populations else []
        for number, crowd in enumerate(_crowd_lines(world.setting, name)):
            joining_count = crowd.count - (old_lines[number].count if number < len(old_lines) else 0)
            if joining_count > 0:
                ids = np.arange(population.next_id, population.next_id + joining_count)
                population.next_id += joining_count
                joining.append((crowd, ids))
                migration.joined[name] = migration.joined.get(name, 0) + joining_count
    return joining


def _crowd_lines(setting: WorldSetting, species: str) -> list[CrowdData]:
    return [crowd for crowd in setting.crowds if crowd.species == species]


def _staying_rows(old: World, setting: WorldSetting, name: str, migration: Migration) -> NDArray[np.intp]:
    """Return the rows of a species that stay. If a crowd line of the scene has fewer agents than before, the latest agents are
    removed."""
    population = old.populations[name]
    stays = np.ones(len(population), np.bool_)
    new_lines = _crowd_lines(setting, name)
    for number, crowd in enumerate(_crowd_lines(old.setting, name)):
        rows = np.flatnonzero(population.now["group"] == crowd.group)
        fewer = crowd.count - new_lines[number].count if number < len(new_lines) else len(rows)
        if fewer > 0:
            rows = rows[np.argsort(population.ids[rows])]
            stays[rows[max(0, len(rows) - fewer) :]] = False
    if not stays.all():
        migration.removed[name] = int(np.count_nonzero(~stays))
    return np.flatnonzero(stays)


def _regroup(old_setting: WorldSetting, world: World, name: str, values: dict[str, NDArray[np.generic]]) -> None:
    """Update the number of each agent's crowd line, because the lines of the scene may have changed."""
    population = world.populations[name]
    group, values["group"] = population.now["group"], population.now["group"].copy()
    for was, is_now in zip(_crowd_lines(old_setting, name), _crowd_lines(world.setting, name), strict=False):
        values["group"][group == was.group] = is_now.group
    write_registers(population, {"group": values["group"]})


# --- everything else ---------------------------------------------------------------------------------------------------


def _migrate_items(old: World, world: World, migration: Migration) -> None:
    """Transfer amounts by item name. An amount that the scene changed starts with the new value."""
    for name, items in world.items.items():
        known = old.items.get(name)
        rows = {} if known is None else {item: k for k, item in enumerate(known.names)}
        old_items, new_items = ({i.name: i for i in s.items.get(name, ())} for s in (old.setting, world.setting))
        for k, item in enumerate(items.names):
            for attribute, amounts in items.amounts.items():
                same = (
                    known is not None
                    and item in rows
                    and attribute in known.amounts
                    and old_items[item].attributes.get(attribute, old.plan.items[name].attributes[attribute])
                    == new_items[item].attributes.get(attribute, world.plan.items[name].attributes[attribute])
                )
                if same and known is not None:
                    amounts[k] = known.amounts[attribute][rows[item]]
                else:
                    migration.items.append(f"{item}.{attribute}")
        items.show()


def _migrate_solids(old: World, world: World, migration: Migration) -> None:
    for name, volume in world.solids.items():
        if name in old.solids and is_same_solid(old, world, name):
            volume.restore({key: array.copy() for key, array in old.solids[name].state().items()})
        else:
            migration.solids.append(name)


def _migrate_fields(old: World, world: World, migration: Migration) -> None:
    """Transfer the amounts of fields with equal cells, unless a field has another start value now."""
    for name, now in world.fields.items():
        old_field = old.fields.get(name)
        starts = [setting.field_start.get(name) for setting in (old.setting, world.setting)]
        if old_field is None or not _is_same_grid(old, world, name) or digest(starts[0]) != digest(starts[1]):
            migration.fields.append(name)
            continue
        if now.added:
            now.grow_again(old_field.added["keys"], old_field.added["places"])
        now.values[:] = np.minimum(old_field.values, now.limit)


def _is_same_grid(old: World, world: World, name: str) -> bool:
    one, other = old.plan.fields[name], world.plan.fields[name]
    if one.surfaces != other.surfaces or old.fields[name].cells.cell != world.fields[name].cells.cell:
        return False
    old_surfaces, new_surfaces = (
        [s.surfaces.get(surface) or s.solids.get(surface) for surface in one.surfaces] for s in (old.setting, world.setting)
    )
    return old.fields[name].cells is world.fields[name].cells or digest(old_surfaces) == digest(new_surfaces)


def _migrate_flows(old: World, world: World) -> None:
    """Transfer the state of flows that are computed over time, if the flows are equal."""
    for name, flow in world.flows.items():
        state = flow.state()
        old_state = old.flows[name].state() if state and name in old.flows else {}
        same = state.keys() == old_state.keys() and all(old_state[key].shape == array.shape for key, array in state.items())
        if state and same and digest(old.setting.flows[name]) == digest(world.setting.flows[name]):
            flow.restore({key: array.copy() for key, array in old_state.items()})


def _migrate_feet(old: World, world: World) -> None:
    """Transfer footholds and swings if bodies have the same legs and the ground is the same."""
    if old.floor is None or world.floor is None or old.floor.names != world.floor.names:
        return
    if digest((old.floor.meshes, old.setting.moves)) != digest((world.floor.meshes, world.setting.moves)):
        return
    for name, feet in world.feet.items():
        old_feet = old.feet.get(name)
        if old_feet is not None and digest(old.setting.legs[name]) == digest(world.setting.legs[name]):
            feet.copy_common(old_feet)


def _migrate_counts(old: World, world: World) -> None:
    """Transfer counts, measurements and watchers."""
    world.transitions = dict(old.transitions)
    world.motion = MotionMeasures.of(old.motion.arrays())
    world.faults = FaultLog(old.faults.count, old.faults.refused_births, list(old.faults.reported))
    world.watchers = list(old.watchers)
    world.carved = None if old.carved is None else {}
    world.emitted = None if old.emitted is None else []
    if world.detail is not None and old.detail is not None:
        world.detail.counts = old.detail.counts.copy()


def migration_line(migration: Migration) -> str:
    """Return the changes as one line that begins with the number of agents, such as "… · 12 `forager` added · `load` is new"."""
    parts = [f"kept {migration.agents:,} {_agent_word(migration.agents)}"]
    several = len(migration.species) > 1
    for migrated in migration.species:
        parts += _species(migrated, f"{migrated.species}." if several else "")
    parts += [f"{count:,} `{name}` added" for name, count in migration.joined.items()]
    parts += [f"{count:,} `{name}` removed" for name, count in migration.removed.items()]
    parts += _names_phrase(migration.items, "has its amount from the scene", "have their amounts from the scene")
    parts += _names_phrase([f"field {name}" for name in migration.fields], "starts again", "start again")
    parts += _names_phrase([f"solid {name}" for name in migration.solids], "is whole", "are whole")
    return " · ".join(parts)


def _species(migrated: MigratedSpecies, of: str) -> list[str]:
    """Return the changes of one species as phrases. `of`: text in front of names, empty for a single species."""
    parts = [
        f"{count:,} of removed state `{of}{_state_text(removed_state)}` "
        f"{'starts' if count == 1 else 'start'} again in `{of}{_state_text(start)}`"
        for (removed_state, start), count in sorted(migrated.restarts.items())
    ]
    parts += _names_phrase([of + _state_text(name) for name in migrated.states], "is a new state", "are new states")
    parts += _names_phrase([of + _state_text(name) for name in migrated.lost], "is a state no more", "are no longer states")
    if migrated.moved:
        parts.append(
            f"{migrated.moved:,} {_agent_word(migrated.moved)} moved with the ground"
            + (f" of `{migrated.species}`" if of else "")
        )
    parts += _names_phrase([of + name for name in migrated.new], "is new", "are new")
    parts += _names_phrase(
        [of + name for name in migrated.other], "has another type and starts again", "have other types and start again"
    )
    parts += _names_phrase(
        [of + name for name in _primary_names(migrated.rewritten)], "is as written now", "have their new values"
    )
    parts += _names_phrase([of + name for name in migrated.removed_attributes], "is gone", "are gone")
    if migrated.forgotten:
        parts.append(f"{migrated.forgotten} {'memory' if migrated.forgotten == 1 else 'memories'} forgotten")
    return parts


def _primary_names(names: list[str]) -> list[str]:
    """Return names without those of derived attributes, which programs seldom set: strength follows from speed, radius from
    size."""
    follow = {"max_force": {"mass", "max_speed", "response"}, "radius": {"size"}}
    return [name for name in names if not follow.get(name, set()) & set(names)]


def _state_text(state: str) -> str:
    """Return a state's name without the name of the default machine, because most species have one unnamed machine."""
    return state.removeprefix("main.")


def _agent_word(count: int) -> str:
    return "agent" if count == 1 else "agents"


def _names_phrase(names: list[str], one: str, several: str) -> list[str]:
    """Return a phrase about names, in the singular or plural; [] without names."""
    if not names:
        return []
    name_list = ", ".join(f"`{name}`" for name in names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    return [f"{name_list} {one if len(names) == 1 else several}"]
