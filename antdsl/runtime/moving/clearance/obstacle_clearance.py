"""A lower bound of each agent's distance from an obstacle at the start of the step. With it, most agents need no ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.tolerances import ROUNDING_BOUND
from antdsl.numerics import vectors as vec
from antdsl.runtime.world import Population, World

_ROUNDING_SLACK = np.float32(ROUNDING_BOUND)


def get_clearance(world: World, population: Population, obstacle: str) -> NDArray[np.float32]:
    """Return a distance (mm, float32[n]) within which no face of the obstacle lies; 0 for agents near it. Cached for the step."""
    key = (population.name, obstacle, population.version)
    distances = world.clearances.get(key)
    if distances is None:
        place = vec.get_vector_registers(population.start, "position")
        distances = world.obstacles[obstacle].measure_clearance(*place, world.options.threads)
        world.clearances[key] = distances
    return distances


def may_touch(clearance: NDArray[np.float32], reach: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which agents may have a face within `reach` (mm). `clearance`: the result of `get_clearance`."""
    return clearance <= reach * (1 + _ROUNDING_SLACK) + _ROUNDING_SLACK
