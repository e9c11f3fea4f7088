"""How well agents stand on what they stand on, as a frame has them."""

from __future__ import annotations

import numpy as np

from antdsl.runtime import World


def surface_error(world: World) -> float:
    """The greatest distance of an agent, as it is written (float32), from the triangle or the solid that it stands on, in body
    lengths."""
    worst = 0.0
    for population in world.populations.values():
        if len(population):
            away = population.position.astype(np.float32) - world.ground.position(population.footing)
            x, y, z = away.T
            distance = np.sqrt((x * x + y * y) + z * z)
            for number, volume in enumerate(world.solids.values(), len(world.setting.surfaces)):
                rows = np.flatnonzero(population.footing.mesh == number)
                off = np.abs(volume.sample(population.position[rows].astype(np.float32).astype(np.float64)))
                distance[rows] = np.maximum(distance[rows], off)
            if "clearance" in population.now:
                distance = np.abs(distance - population.now["clearance"])
            size = np.maximum(population.now["size"].astype(np.float64), 1e-9)
            worst = max(worst, float((distance / size).max()))
    return worst
