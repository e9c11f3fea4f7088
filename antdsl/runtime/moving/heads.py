"""Whose head is inside of what it walks on: behind a surface of the ground, or in a solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import Population, World

RAISED = 0.1  # of a body: how high its middle is over the feet, unless its clearance is more
DEEP = 0.1  # of a body: a head that is no deeper inside but touches


def heads_inside(world: World, population: Population) -> NDArray[np.bool_]:
    """Whose head bool[n] is inside of the ground or a solid, as they stand now.

    A head is half a body ahead of the middle, which is over the feet: half by the ground's way up, half by the body's. It is
    inside where a surface lies between the two, or where it is in a solid, and more than a tenth of a body behind that."""
    now = population.now
    size = now["size"].astype(np.float64)
    up, heading = population.vector("up"), population.vector("heading")
    high = np.maximum(RAISED * size, now["clearance"])[:, None]
    middle = population.position + (up + population.normal) * (high / 2)
    ahead = heading * (size / 2)[:, None]
    found = np.zeros(len(population), np.bool_)
    meshes = world.ground.meshes
    if meshes is not None:
        met, part, footing = meshes.met(middle, ahead, world.options.threads)
        beyond = np.abs((ahead * meshes.normal(footing)).sum(axis=1)) * (1 - part)
        found = met & (beyond > DEEP * size)
    for volume in world.solids.values():
        found |= volume.sample(middle + ahead) < -DEEP * size
    return found
