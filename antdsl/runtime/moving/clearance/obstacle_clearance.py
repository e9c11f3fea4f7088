"""Computes a lower bound of each agent's distance from an obstacle at the start of the step, and collects the faces of all
obstacles. Thanks to the bound, most agents need no ray."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.casting.tolerances import ROUNDING_BOUND
from antdsl.ground.mesh.boxes import FaceBoxes, FaceBoxTree
from antdsl.ground.mesh.face_table import CORNER_OFFSET, EDGE1_OFFSET, EDGE2_OFFSET, FLOATS_PER_FACE_ROW, NORMAL_OFFSET
from antdsl.numerics import vectors as vec
from antdsl.runtime.world import Population, World

_ROUNDING_SLACK = np.float32(ROUNDING_BOUND)


def get_obstacle_clearance(world: World, population: Population, obstacle: str) -> NDArray[np.float32]:
    """Return a lower bound of each agent's distance from an obstacle at the start of the step (mm, float32[n]). It is 0 for
    agents near the obstacle. The result is cached for the step."""
    key = (population.name, obstacle, population.version)
    distances = world.clearances.get(key)
    if distances is None:
        place = vec.get_vector_registers(population.start, "position")
        distances = world.obstacles[obstacle].measure_clearance(*place, world.options.threads)
        world.clearances[key] = distances
    return distances


def is_contact_possible(clearance: NDArray[np.float32], reach: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return which agents may have a face within `reach` (mm). `clearance`: a lower bound (mm) of the distance from faces."""
    return clearance <= reach * (1 + _ROUNDING_SLACK) + _ROUNDING_SLACK


def mark_near_obstacles(
    world: World, population: Population, reach: NDArray[np.float64], levels: NDArray[np.uint8], level: int
) -> None:
    """Set `levels` to `level` for agents that may have a face of an obstacle within `reach` (mm)."""
    names = _list_obstacles(world)
    if names:
        now, start = (vec.get_vector_registers(registers, "position") for registers in (population.now, population.start))
        drift = vec.length(vec.subtract(now, start))
        for name in names:
            levels[is_contact_possible(get_obstacle_clearance(world, population, name) - drift, reach.astype(np.float32))] = level


def find_obstacle_faces(world: World) -> tuple[NDArray[np.float64], NDArray[np.int32], FaceBoxTree]:
    """Return the faces of all obstacles, packed for kernels. They are packed again after an obstacle has moved."""
    scenes = tuple(world.obstacles[name] for name in _list_obstacles(world))
    if world.obstacle_faces is None or world.obstacle_faces[0] != scenes:
        corners = np.concatenate([np.empty((0, 3, 3)), *(each.corners for each in scenes if isinstance(each, RayScene))])
        world.obstacle_faces = scenes, _pack_faces(corners)
    faces: tuple[NDArray[np.float64], NDArray[np.int32], FaceBoxTree] = world.obstacle_faces[1]
    return faces


def _list_obstacles(world: World) -> list[str]:
    return [name for name in world.plan.obstacles if name in world.obstacles]


def _pack_faces(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int32], FaceBoxTree]:
    edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = vec.compute_stacked_cross(edge1.T, edge2.T)
    area = np.sqrt(vec.dot(normal, normal))
    live = np.flatnonzero(area > 0)
    table = np.zeros((len(corners), FLOATS_PER_FACE_ROW))
    unit = (normal / np.where(area > 0, area, 1.0)).T
    for offset, values in ((CORNER_OFFSET, corners[:, 0]), (EDGE1_OFFSET, edge1), (EDGE2_OFFSET, edge2), (NORMAL_OFFSET, unit)):
        table[:, offset : offset + 3] = values
    pieces, faces = np.zeros(len(corners), np.int32), np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    if not live.size:
        return table.ravel(), pieces, FaceBoxTree(live, np.zeros(2, np.int64), np.empty((0, 6)))
    return table.ravel(), pieces, FaceBoxes.build(corners.reshape(-1, 3), faces, live, pieces).to_box_tree()
