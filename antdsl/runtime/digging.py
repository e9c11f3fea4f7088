"""Digging: what all agents carve in one step is taken out of the solids at once, before anybody moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.walls import grow
from antdsl.runtime.requests import Asked
from antdsl.runtime.world import Population, World


def dig(world: World) -> None:
    """Carve the balls that were asked for, and give each agent what it dug out. Who stood there comes down as it moves."""
    asked: dict[str, list[tuple[Population, Asked]]] = {}
    for population in world.populations.values():
        for entry in population.effects.drained("carve"):
            if len(entry.rows):
                asked.setdefault(entry.request.of, []).append((population, entry))
    for name, entries in sorted(asked.items()):
        _carve(world, name, entries)


def _carve(world: World, solid: str, entries: list[tuple[Population, Asked]]) -> None:
    """Carve one solid. Who digs is known by (species, id, place in the text), whatever its row."""
    names = list(world.populations)
    species = np.concatenate([np.full(len(e.rows), names.index(p.name)) for p, e in entries])
    ids = np.concatenate([p.ids[e.rows] for p, e in entries])
    place = np.concatenate([np.full(len(e.rows), e.order) for _, e in entries])
    middle = np.concatenate([np.column_stack([e.arg(1 + k) for k in range(3)]) for _, e in entries]).astype(np.float64)
    radius = np.concatenate([e.arg(0) for _, e in entries]).astype(np.float64)
    order = np.lexsort((place, ids, species))
    owner = np.empty(len(order), np.int64)
    owner[order] = np.arange(len(order))
    removed = world.solids[solid].carve(middle, radius, owner)
    dug = order[removed[order] > 0]
    fields = [field for name, field in world.fields.items() if solid in world.plan.fields[name].surfaces]
    if fields:
        grow(fields, world.solids[solid], middle[dug], radius[dug])
    if world.carved is not None:
        world.carved.setdefault(solid, []).append(np.column_stack([middle, radius]))
    first = 0
    for population, entry in entries:
        _give(population, entry, removed[first : first + len(entry.rows)])
        first += len(entry.rows)


def _give(population: Population, entry: Asked, removed: NDArray[np.float64]) -> None:
    """Add what was dug out to the agents' own register."""
    if entry.request.own is not None:
        register = population.now[entry.request.own]
        register[entry.rows] = (register[entry.rows].astype(np.float64) + removed).astype(np.float32)


def dug_since(world: World) -> dict[str, NDArray[np.float64]]:
    """The balls float64[k, 4] (middle and radius) that were dug since this was asked last, by solid; no entry where none were."""
    found, world.carved = world.carved or {}, None if world.carved is None else {}
    return {name: np.concatenate(balls) for name, balls in found.items() if sum(map(len, balls))}
