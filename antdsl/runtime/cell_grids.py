"""Cell grids of the agents of a species in a step: one for radii that are alike."""

from __future__ import annotations

import numpy as np

from antdsl.runtime.world import AXES, Population, World
from antdsl.senses.neighbours import CellGrid

_COARSER = 4  # quarters of an octave


def grid_for(world: World, other: Population, widest: float) -> CellGrid:
    """Where the others are, in cells that suit a radius: finding them in wider ones costs less than sorting them again."""
    size = float(np.ceil(4 * np.log2(widest)))
    known = [(k, grid) for (name, k), grid in list(world.grids.items()) if name == other.name and size <= k <= size + _COARSER]
    if known:
        return min(known, key=lambda each: each[0])[1]
    x, y, z = (other.start[f"position.{axis}"] for axis in AXES)
    grid = world.grids[other.name, size] = CellGrid(x, y, z, other.ids, widest, world.options.threads)
    return grid
