"""How agents' bodies stand among each other, in obstacles and solids, and over the surface: what a spec can bound of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.runtime.world import Population, World
from antdsl.senses.overlaps import worst_overlaps

Floats = NDArray[np.float32]


def measured(world: World, population: Population, name: str) -> Floats:
    """A measure of GEOMETRY for each agent, float32[n]; lengths in mm."""
    return _MEASURES[name](world, population)


def _overlap(world: World, population: Population) -> Floats:
    """How far each agent stands inside the worst of the others of all species: 0 apart, 1 in one place."""
    everybody = list(world.populations.values())
    known = [each for each in everybody if "radius" in each.start and "position.x" in each.start and each.footing is not None]
    x, y, z, radius = (
        np.concatenate([each.start[name] for each in known]) for name in ("position.x", "position.y", "position.z", "radius")
    )
    own = next(k for k, each in enumerate(known) if each.name == population.name)
    first = sum(len(each) for each in known[:own])
    worst = worst_overlaps(x, y, z, radius)
    return worst[first : first + len(population)]


def _penetration(world: World, population: Population) -> Floats:
    """How deep each agent's middle is inside an obstacle that is a closed mesh, or inside a solid; 0 outside of all."""
    deep = np.zeros(len(population))
    for name in world.plan.of_kind("obstacle"):
        scene = world.obstacles.get(name)
        if isinstance(scene, RayScene):
            deep = np.maximum(deep, scene.depth(population.position))
    for volume in world.solids.values():
        deep = np.maximum(deep, -volume.sample(population.position))
    return deep.astype(np.float32)


def _off_surface(world: World, population: Population) -> Floats:
    """How far each agent is from where it ought to stand: its clearance over its place on a triangle or a solid."""
    away: NDArray[np.float64] = np.linalg.norm(population.position - world.ground.position(population.footing), axis=1)
    for number, volume in enumerate(world.solids.values(), len(world.setting.surfaces)):
        rows = np.flatnonzero(population.footing.mesh == number)
        away[rows] = np.maximum(away[rows], np.abs(volume.sample(population.position[rows])))
    clearance = population.start.get("clearance", np.zeros(len(population)))
    off: Floats = np.abs(away - clearance).astype(np.float32)
    return off


_MEASURES: Mapping[str, Callable[[World, Population], Floats]] = {
    "overlap": _overlap,
    "penetration": _penetration,
    "off_surface": _off_surface,
}
