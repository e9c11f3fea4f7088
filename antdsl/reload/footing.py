"""Footings of agents after a migration.

Agents stay on their face if a mesh has the same faces in both worlds. Otherwise they move to the nearest position."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.plane import PlaneGround
from antdsl.ground.protocol import Footing
from antdsl.numerics.vector_rows import compute_unit_tangents, length
from antdsl.runtime.binding.binding_cache import compute_digest
from antdsl.runtime.world import AXES, Population, World

_SAME_POSITION_DISTANCE = 1e-6  # mm; an agent placed this near to its previous position keeps that position exactly
MIN_REPORTED_DISTANCE = 0.05  # mm; smaller distances are rounding of the nearest point and not reported


def is_same_solid(old_world: World, world: World, name: str) -> bool:
    """Return whether a solid has the same mesh and voxels in both worlds, so that its dug volume can be copied."""
    one, other = old_world.setting.solids.get(name), world.setting.solids.get(name)
    return one is not None and other is not None and compute_digest(one) == compute_digest(other)


def find_footings_after_reload(
    old_world: World, world: World, old_population: Population
) -> tuple[Footing, NDArray[np.float64], NDArray[np.bool_]]:
    """Return the footings of all agents of `old_population` in `world`, their positions (n, 3) in mm, and which agents moved.

    If only the vertices of a mesh have moved, agents move with their face. Agents on changed faces, or on a changed solid, move
    to the nearest position on any ground."""
    footing = _migrate_footing(old_world, world, old_population)
    place = world.ground.position(footing)
    moved = length(place - old_population.position) > _SAME_POSITION_DISTANCE
    return footing, np.where(moved[:, None], place, old_population.position), moved


def align_bodies_with_ground(world: World, population: Population, moved_mask: NDArray[np.bool_]) -> None:
    """Rotate the up direction, heading and velocity of agents to match the new ground. `moved_mask`: the agents that moved."""
    rows = np.flatnonzero(moved_mask)
    if not len(rows):
        return
    up = world.ground.compute_upright_normals(population.footing, population.normal.astype(np.float64))
    population.normal[rows] = up[rows]
    heading, velocity = population.read_vector("heading"), population.read_vector("velocity")
    heading[rows] = compute_unit_tangents(heading[rows], up[rows])
    velocity[rows] -= (velocity[rows] * up[rows]).sum(axis=1)[:, None] * up[rows]
    for name, value in (("up", up), ("heading", heading), ("velocity", velocity), ("position", population.position)):
        for k, axis in enumerate(AXES):
            population.now[f"{name}.{axis}"][rows] = value[rows, k]


def _migrate_footing(old_world: World, world: World, old_population: Population) -> Footing:
    """Return the footings on the new ground: on the same face if the mesh has the same faces, otherwise on the nearest one."""
    ground, place = world.ground, old_population.position
    if isinstance(ground, PlaneGround):
        return old_population.footing if isinstance(old_world.ground, PlaneGround) else ground.place_points(place, world.up)[0]
    if isinstance(old_world.ground, PlaneGround):
        return ground.find_nearest(place)[0]
    number = _map_ground_numbers(old_world, world)
    was = old_population.footing.mesh
    mesh = np.where(was >= 0, number.take(np.maximum(was, 0)), -1).astype(np.int32)
    footing = ground.create_unplaced(len(mesh))
    footing.write_rows(np.arange(len(mesh)), old_population.footing)
    footing.mesh[:] = mesh
    lost = np.flatnonzero(mesh < 0)
    if len(lost):
        footing.write_rows(lost, ground.find_nearest(place[lost])[0])
    return footing


def _map_ground_numbers(old_world: World, world: World) -> NDArray[np.int32]:
    """Return the new number of each surface and solid of the old ground; -1 if it has changed."""
    numbers = {name: k for k, name in enumerate(world.ground.names)}
    mapping = np.full(max(1, len(old_world.ground.names)), -1, np.int32)
    for k, name in enumerate(old_world.ground.names):
        if name in numbers and (_is_same_mesh(old_world, world, name) or is_same_solid(old_world, world, name)):
            mapping[k] = numbers[name]
    return mapping


def _is_same_mesh(old_world: World, world: World, name: str) -> bool:
    one, other = old_world.setting.surfaces.get(name), world.setting.surfaces.get(name)
    return one is not None and other is not None and (one is other or np.array_equal(one.faces, other.faces))
