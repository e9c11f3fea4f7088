"""The feelers of one agent, as they are felt where it stands now."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.feelers import feelers_of, rays
from antdsl.program.model import Program
from antdsl.runtime import World


def felt(world: World, program: Program, species: str, agent: int) -> dict[str, NDArray[Any]]:
    """`feelers` float32 (k, 2, 3), from the agent to where each ends or hits first, and `feelers/hit` uint8 (k). Nothing of an
    agent that is not there."""
    population = world.populations.get(species)
    row = int(population.rows_of(np.array([agent]))[0]) if population is not None else -1
    if population is None or row < 0:
        return {}
    scale = 1 / world.setting.unit_mm
    here = population.position[row : row + 1] * scale
    ahead, up = (population.vector(name)[row : row + 1] for name in ("heading", "up"))
    size = population.now["size"][row : row + 1].astype(np.float64) * scale
    found = feelers_of(program, species, world.params, world.setting.unit_mm, world.dt)
    if not found:
        return {}
    lines = np.concatenate([rays(entry, here, ahead, up, size) for entry in found]) / scale
    way = lines[:, 1] - lines[:, 0]
    reach = np.sqrt((way * way).sum(axis=1))
    unit = (way / np.maximum(reach, 1e-12)[:, None]).astype(np.float32)
    start = lines[:, 0].astype(np.float32)
    nearest = np.full(len(lines), np.inf, np.float32)
    (x, y, z), (dx, dy, dz) = start.T, unit.T
    for name in world.plan.of_kind("obstacle", "solid"):
        met = world.obstacles[name].feelers(x, y, z, dx, dy, dz, reach.astype(np.float32))
        nearest = np.minimum(nearest, np.where(met.hit, met.t, np.inf))
    hit = np.isfinite(nearest)
    lines[hit, 1] = start[hit] + unit[hit] * nearest[hit, None]
    return {"feelers": lines.astype(np.float32), "feelers/hit": hit.astype(np.uint8)}
