"""Measures how far agents are from where they should be relative to their ground, in a frame."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import parallel
from antdsl.outputs.cache.frame_loops import find_greatest_error
from antdsl.runtime import Population, World


def measure_surface_error(world: World) -> float:
    """Return the greatest error of an agent's distance from its ground, compared with its clearance, in body lengths.

    The ground is the triangle or the solid on which the agent stands. Positions are rounded to float32 first, as in the cache."""
    worst = 0.0
    for population in world.populations.values():
        if len(population):
            ground = world.ground.position(population.footing)
            worst = max(worst, _find_greatest_error(world, population, ground))
    return worst


def _find_greatest_error(world: World, population: Population, ground: NDArray[np.float64]) -> float:
    """Return the greatest error for the agents of one species. `ground`: the nearest ground position of each agent."""
    clearance, size = population.now.get("clearance", np.zeros(len(population), np.float32)), population.now["size"]
    if not world.solids:
        work = partial(find_greatest_error, population.position, ground, clearance, size)
        return float(
            np.max(parallel.run_in_parts(work, len(population), world.options.threads, parallel.MIN_LIGHT_ITEMS_PER_THREAD))
        )
    x, y, z = (population.position.astype(np.float32) - ground).T
    distance = np.sqrt((x * x + y * y) + z * z)
    for number, volume in enumerate(world.solids.values(), len(world.setting.surfaces)):
        rows = np.flatnonzero(population.footing.mesh == number)
        off = np.abs(volume.sample_distances(population.position[rows].astype(np.float32).astype(np.float64)))
        distance[rows] = np.maximum(distance[rows], off)
    return float((np.abs(distance - clearance) / np.maximum(size.astype(np.float64), 1e-9)).max())
