"""How well agents stand on what they stand on, as a frame has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.runtime import Population, World


def surface_error(world: World) -> float:
    """The greatest distance of an agent, as it is written (float32), from the triangle or the solid that it stands on, in body
    lengths."""
    worst = 0.0
    for population in world.populations.values():
        if len(population):
            ground = world.ground.position(population.footing)
            fast = compiled.wanted(len(population)) and not world.solids and "clearance" in population.now
            worst = max(worst, _compiled(population, ground) if fast else _plain(world, population, ground))
    return worst


def _plain(world: World, population: Population, ground: NDArray[np.float64]) -> float:
    x, y, z = (population.position.astype(np.float32) - ground).T
    distance = np.sqrt((x * x + y * y) + z * z)
    for number, volume in enumerate(world.solids.values(), len(world.setting.surfaces)):
        rows = np.flatnonzero(population.footing.mesh == number)
        off = np.abs(volume.sample(population.position[rows].astype(np.float32).astype(np.float64)))
        distance[rows] = np.maximum(distance[rows], off)
    if "clearance" in population.now:
        distance = np.abs(distance - population.now["clearance"])
    return float((distance / np.maximum(population.now["size"].astype(np.float64), 1e-9)).max())


def _compiled(population: Population, ground: NDArray[np.float64]) -> float:
    from antdsl.outputs.cache.frames_compiled import farthest

    return float(farthest(population.position, ground, population.now["clearance"], population.now["size"]))
