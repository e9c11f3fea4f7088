"""A world as it is now, to be looked at while the world goes on."""

from __future__ import annotations

from copy import copy, deepcopy

from antdsl.ground.combined import Terrain
from antdsl.runtime.moving.moving_geometry import moving
from antdsl.runtime.world import Population, World


def snapshot(world: World) -> World:
    """A world that shares what never changes and has copies of the rest: agents, items, fields and solids between two steps.

    It can be measured, hashed and written, not stepped."""
    found = copy(world)
    found.populations = {name: _population(population) for name, population in world.populations.items()}
    found.items = {}
    for name, items in world.items.items():
        found.items[name] = copy(items)
        found.items[name].amounts = {attribute: amounts.copy() for attribute, amounts in items.amounts.items()}
    found.solids = {name: deepcopy(volume) for name, volume in world.solids.items()}
    found.fields = {name: field.snapshot() for name, field in world.fields.items()}
    found.flows = {name: copy(flow) for name, flow in world.flows.items()}
    found.feet = {name: feet.snapshot() for name, feet in world.feet.items()}
    found.grids, found.trees, found.clearances, found.touching = {}, {}, {}, None
    ground = moving(world)
    if ground is not None:
        posed = ground.copy()
        found.ground = world.ground.with_meshes(posed) if isinstance(world.ground, Terrain) else posed
    return found


def _population(population: Population) -> Population:
    population.in_id_order()  # found once, for the world and for all that look at it
    found = copy(population)
    found.rooms = {}
    found.ids, found.born, found.quarantined = population.ids.copy(), population.born.copy(), population.quarantined.copy()
    found.position, found.normal = population.position.copy(), population.normal.copy()
    # What is no value of one step only and has one array for its start and now never changes.
    lasting = {name for name, register in population.plan.registers.items() if register.role != "temp"}
    found.now = {
        name: array if name in lasting and population.start[name] is array else array.copy()
        for name, array in population.now.items()
    }
    found.start = found.now
    found.events = {name: flags.copy() for name, flags in population.events.items()}
    found.raised = found.events
    return found
