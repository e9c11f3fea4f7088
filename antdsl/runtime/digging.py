"""Digging: what all agents carve in one step is taken out of the solids at once, before anybody moves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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


def handed_over(world: World) -> dict[str, NDArray[np.float64]]:
    """The balls (k, 4: middle and radius) that were dug since this was asked last, by `solid.NAME.carved`."""
    found: dict[str, NDArray[np.float64]] = {}
    for name in world.solids:
        balls = (world.carved or {}).pop(name, [])
        found[f"solid.{name}.carved"] = np.concatenate([np.empty((0, 4)), *balls])
    return found


def dig_again(world: World, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Dig what `handed_over` tells of in another copy of the solids; twice is as once."""
    world.carved = {}
    for name, volume in world.solids.items():
        balls = arrays.get(f"solid.{name}.carved")
        if balls is not None and len(balls):
            world.carved[name] = [balls]
            volume.carve(balls[:, :3], balls[:, 3], np.zeros(len(balls), np.int64))
