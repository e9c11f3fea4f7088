"""Places agents of a world as in a cache: in each frame, they get the positions of the cache, whatever their program did."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.transforms import Floats, normalise_quaternion, quaternion_to_matrix
from antdsl.numerics.vector_rows import length
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import get_agent_ids, get_species_numbers
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.edits.frame_rows import match_rows
from antdsl.runtime.world import AXES, Population, World, add_rows, retain_rows
from antdsl.scene.thing_models import UNIT_MM

if TYPE_CHECKING:
    from collections.abc import Iterator

_SIZE_ROUNDING_TOLERANCE = 1e-5  # the greatest relative difference by rounding
_HOLDING_MASS_FACTOR = np.float32(1e6)  # times their mass: contacts push the other agent
Ids = NDArray[np.int64]


def place_scripted_agents(
    world: World,
    arrays: Arrays,
    next_arrays: Arrays,
    manifest: Manifest,
    free_ids: Mapping[str, Ids],
    next_ids: Mapping[str, int],
) -> None:
    """Copy all agents of a frame into a world, except the free ones, which keep their state.

    - `next_arrays`: the next frame; copied agents get velocities that lead to their positions there
    - `free_ids`: the free agents by species
    - `next_ids`: by species, the first id of copies that edits made

    Agents that the frame lacks are removed. Agents that the world lacks are added. An added copy made by an edit gets the
    registers of its original. Other added agents get those of the agent with the nearest lower id."""
    numbers, ids = get_species_numbers(arrays), get_agent_ids(arrays)
    for number, entry in enumerate(manifest.species):
        population = world.populations.get(entry.name)
        if population is None:
            continue
        own = np.flatnonzero((numbers == number) & ~np.isin(ids, free_ids[entry.name]))
        known_rows = np.flatnonzero(np.isin(population.ids, ids[own]) | np.isin(population.ids, free_ids[entry.name]))
        rows = _place_agents(world, population, arrays, own, manifest, known_rows, next_ids.get(entry.name, 0))
        _aim_velocities(world, population, rows, next_arrays, number, UNIT_MM[manifest.units])


def _place_agents(
    world: World,
    population: Population,
    arrays: Arrays,
    own_rows: NDArray[np.intp],
    manifest: Manifest,
    known_rows: NDArray[np.intp],
    period: int,
) -> NDArray[np.intp]:
    """Place the agents at `own_rows` of a frame, all of one species, in a world, and return their rows in the world."""
    unit_mm, ids = UNIT_MM[manifest.units], get_agent_ids(arrays)[own_rows]
    position = np.asarray(arrays["P"], np.float64)[own_rows] * unit_mm
    footing = world.ground.find_nearest(position)[0]
    missing = np.flatnonzero(population.find_rows(ids) < 0)
    if len(missing) and len(population):
        known, rows = population.get_sorted_ids()
        originals = population.find_rows(ids[missing] % max(period, 1))
        nearest = rows[np.maximum(np.searchsorted(known, ids[missing], side="right") - 1, 0)]
        templates = np.where(originals >= 0, originals, nearest)
        added = add_rows(population, ids[missing], world.frame, position[missing], footing.select_rows(missing))
        for registers in {id(table): table for table in (population.now, population.start)}.values():
            for array in registers.values():
                array[added] = array[templates]
        population.normal[added] = population.normal[templates]
        known_rows = np.concatenate([known_rows, np.arange(added.start, added.stop)])
    if len(known_rows) < len(population):
        retain_rows(population, known_rows)
    rows = population.find_rows(ids)
    at = np.flatnonzero(rows >= 0)
    rows = rows[at]
    population.position[rows] = world.ground.position(footing)[at]
    population.footing.write_rows(rows, footing.select_rows(at))
    heading, up, _ = np.moveaxis(
        quaternion_to_matrix(normalise_quaternion(np.asarray(arrays["orient"], np.float64)[own_rows[at]])), 2, 0
    )
    population.normal[rows] = up
    _write_vector(population, "position", rows, population.position[rows])
    _write_vector(population, "heading", rows, heading)
    _write_vector(population, "up", rows, up)
    size = np.asarray(arrays["pscale"], np.float32)[own_rows[at]] * np.float32(unit_mm)
    factor = size / np.where(population.now["size"][rows] > 0, population.now["size"][rows], np.float32(1))
    factor = np.where(np.abs(factor - 1) < _SIZE_ROUNDING_TOLERANCE, np.float32(1), factor)
    for name in ("size", "radius"):
        _write_register(population, name, rows, population.now[name][rows] * factor)
    population.cells.clear()
    population.version += 1
    return rows


def _aim_velocities(
    world: World, population: Population, rows: NDArray[np.intp], next_arrays: Arrays, number: int, unit_mm: float
) -> None:
    """Give agents the velocities that lead to their positions in the next frame. Agents that are not in the next frame get the
    velocity 0."""
    own = np.flatnonzero(get_species_numbers(next_arrays) == number)
    at, is_there = match_rows(population.ids[rows], get_agent_ids(next_arrays)[own])
    goal = np.asarray(next_arrays["P"], np.float64)[own][at] * unit_mm if len(own) else np.zeros((len(rows), 3))
    offset = np.where(is_there[:, None], goal - population.position[rows], 0.0)
    _write_vector(population, "velocity", rows, offset / world.dt)


def _write_vector(population: Population, name: str, rows: NDArray[np.intp], values: Floats) -> None:
    for k, axis in enumerate(AXES):
        _write_register(population, f"{name}.{axis}", rows, values[:, k])


def _write_register(population: Population, name: str, rows: NDArray[np.intp], values: NDArray[np.floating]) -> None:
    """Write both copies of a register: its current values, and its values at the start of the step."""
    for registers in (population.now, population.start):
        registers[name][rows] = values


@contextmanager
def increase_mass_of_scripted_agents(world: World, free_ids: Mapping[str, Ids]) -> Iterator[None]:
    """Within the `with` block, make all agents except `free_ids` so heavy that contacts push only the free agents.

    Also raise the speed limits of the heavy agents, so that these can follow their paths."""
    limits = {}
    for name, population in world.populations.items():
        own = population.ids[~np.isin(population.ids, free_ids[name])]
        rows = population.find_rows(own)
        limits[name] = own, {key: population.now[key][rows] for key in ("mass", "max_speed")}
        _write_register(population, "mass", rows, limits[name][1]["mass"] * _HOLDING_MASS_FACTOR)
        speed = length(population.read_vector("velocity")[rows]).astype(np.float32)
        _write_register(population, "max_speed", rows, np.maximum(limits[name][1]["max_speed"], speed * np.float32(1.01)))
    try:
        yield
    finally:
        for name, (own, values) in limits.items():
            population = world.populations[name]
            rows = population.find_rows(own)
            for key, array in values.items():
                _write_register(population, key, rows[rows >= 0], array[rows >= 0])
