"""The arrays of a running world from which selectors choose agents."""

from __future__ import annotations

from antdsl.runtime.sensing.sensed_camera import CameraInFrame
from antdsl.runtime.world import Population, World
from antdsl.scene.notes.selection import SelectableAgents, SelectableFrame, StateColumn


def collect_selectable_frame(world: World) -> SelectableFrame:
    """Return the living agents, the crowd lines and the items of a world between two steps, for selectors."""
    points = {name: items.position + world.origin for name, items in world.items.items() if len(items)}
    single = {item: points[name][k : k + 1] for name, items in world.items.items() for k, item in enumerate(items.names)}
    return SelectableFrame(
        {name: _collect_agents_of_species(world, population) for name, population in world.populations.items()},
        {crowd.name: line for crowd, line in zip(world.setting.crowds, world.crowd_lines, strict=True) if crowd.name},
        single | points,
        world.setting.seed,
        world.setting.unit_mm,
        {name: CameraInFrame(data, world.frame) for name, data in world.setting.cameras.items()},
    )


def _collect_agents_of_species(world: World, population: Population) -> SelectableAgents:
    states = {
        machine.name: StateColumn(population.now[f"{machine.name}.state"], machine.states) for machine in population.plan.machines
    }
    return SelectableAgents(population.ids, population.position + world.origin, states)
