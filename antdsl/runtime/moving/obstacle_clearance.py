"""How far each agent is from an obstacle at least, as it stood when the step began: most need not ask with a ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.tolerances import FAR_OFF
from antdsl.numerics import vectors as vec
from antdsl.runtime.world import Population, World

_SLACK = np.float32(FAR_OFF)


def clearance(world: World, population: Population, obstacle: str) -> NDArray[np.float32]:
    """A distance (mm, float32[n]) within which an agent has no face of the obstacle; 0 when near. Kept for the step."""
    key = (population.name, obstacle, population.version)
    found = world.clearances.get(key)
    if found is None:
        place = vec.named(population.start, "position")
        found = world.obstacles[obstacle].clearance(*place, world.options.threads)
        world.clearances[key] = found
    return found


def may_touch(clear: NDArray[np.float32], reach: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Who may have a face within `reach` (mm) of where they stand."""
    return clear <= reach * (1 + _SLACK) + _SLACK
