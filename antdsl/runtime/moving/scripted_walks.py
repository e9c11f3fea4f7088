"""Walks agents that the scene guides. They walk straight ahead at a fixed speed for a given distance, without senses or
decisions (P18)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.world import AXES, Population, World
from antdsl.scene.setting import ScriptedWalkData

Rows = NDArray[np.intp]

_F = np.float32


def find_scripted_walks_by_line(world: World, population: Population) -> dict[int, ScriptedWalkData]:
    """Return the walks that the scene gives to agents of a species, by the number of their crowd line."""
    walks = {}
    for crowd in world.setting.crowds:  # called several times per step; most scenes guide no agents
        if crowd.walk is not None and crowd.species == population.name:
            walks[crowd.line_index] = crowd.walk
    return walks


def find_scripted_agents(world: World, population: Population) -> NDArray[np.bool_]:
    """Return a mask bool[n] of the agents that the scene guides."""
    is_walker: NDArray[np.bool_] = np.isin(population.now["group"], list(find_scripted_walks_by_line(world, population)))
    return is_walker


def find_deciding_rows(world: World, population: Population) -> Rows | None:
    """Return the rows of agents that sense and decide for themselves; None for all."""
    if not find_scripted_walks_by_line(world, population):
        return None
    return np.flatnonzero(~find_scripted_agents(world, population) & ~population.quarantined)


def start_scripted_walks(world: World, population: Population, rows: Rows) -> None:
    """Start the walks of the guided agents in `rows`.

    Each turns to its direction along the ground and gets the scene's speed, which may exceed its own speed limit."""
    now, start = population.now, population.start
    for group, walk in find_scripted_walks_by_line(world, population).items():
        own = rows[now["group"][rows] == group]
        up, heading = (vec.take_rows(vec.get_vector_registers(now, name), own) for name in ("up", "heading"))
        direction = np.broadcast_to(np.array(walk.direction, np.float32)[:, None], (3, len(own)))
        ahead = vec.normalise_or_fallback(
            vec.project_to_plane((direction[0], direction[1], direction[2]), up), heading, 1e-3
        )  # a direction off the ground is not used
        now["max_speed"][own] = start["max_speed"][own] = np.maximum(now["max_speed"][own], _F(walk.speed))
        for name, value in (("heading", ahead), ("velocity", vec.scale(ahead, _F(walk.speed)))):
            for axis, component in zip(AXES, value, strict=True):
                now[f"{name}.{axis}"][own] = start[f"{name}.{axis}"][own] = component


def compute_scripted_velocities(world: World, population: Population, velocity: VectorArrays, up: VectorArrays) -> VectorArrays:
    """Return the velocities `velocity` (mm/s), changed so that guided agents continue in their direction at the speed that the
    scene sets.

    They stop when they have walked the distance that the scene sets."""
    velocities = velocity
    for group, walk in find_scripted_walks_by_line(world, population).items():
        own = np.flatnonzero(population.now["group"] == group)
        distance = (world.frame - population.born[own]) * (world.dt * walk.speed)
        speed = np.clip((walk.length - distance) / world.dt, 0.0, walk.speed).astype(np.float32)
        previous_velocity, heading = (
            vec.take_rows(vec.get_vector_registers(population.now, name), own) for name in ("velocity", "heading")
        )
        above = vec.take_rows(up, own)
        ahead = vec.normalise_or_fallback(
            vec.project_to_plane(previous_velocity, above),
            vec.normalise_or_fallback(vec.project_to_plane(heading, above), vec.find_perpendicular(above)),
        )
        velocities = vec.copy(velocities)
        for component, value in zip(velocities, vec.scale(ahead, speed), strict=True):
            component[own] = value
    return velocities
