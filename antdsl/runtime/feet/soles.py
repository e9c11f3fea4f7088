"""Orients flat soles. On the ground, a sole is aligned with the ground's normal. During a swing, its direction changes from
the normal at one foothold to that at the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.ground.solid_feelers import SolidProximityQueries
from antdsl.numerics import vectors as vec
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER, PLANE_GROUND_NUMBER, SWING_PHASE_OF_STANDING_FOOT, FeetState
from antdsl.runtime.feet.foothold_search import FootGround
from antdsl.runtime.moving.moving_geometry import compute_vertices
from antdsl.runtime.world import World

_MIN_SOLE_COSINE = np.float32(np.sqrt(0.5))  # of the angle between a sole and its body; ankles bend by 45 degrees
_NORMAL_SEARCH_MM = 1.0  # mm; a foothold is on its face, apart from rounding
Rows = NDArray[np.int64]
Vectors = NDArray[np.float64]  # (3, k)


def measure_tread_slopes(
    world: World, foot_ground: FootGround, feet: FeetState, selected_feet: tuple[Rows, Rows], up: Vectors
) -> None:
    """Write to `feet.tread` the normals of the ground at footholds, on the side of the bodies.

    `selected_feet`: two arrays [k], the rows of agents and the numbers of legs. `up` [3, k]: the up directions of their bodies.
    For feet without ground, the result is the up direction of the body."""
    things, place, threads = feet.on[selected_feet], feet.place[:, selected_feet[0], selected_feet[1]], world.options.threads
    normals = np.array(up)
    normals[:, things == PLANE_GROUND_NUMBER] = np.asarray(world.up, np.float64)[:, None]
    for k, name in enumerate(foot_ground.names):
        rows = np.flatnonzero(things == k)
        obstacle, points = world.obstacles.get(name), np.ascontiguousarray(place[:, rows].T)
        if rows.size and isinstance(obstacle, SolidProximityQueries):
            normals[:, rows] = obstacle.volume.compute_upright_normals(points, up[:, rows].T).T
        elif rows.size and isinstance(obstacle, RayScene):
            is_moving = k in foot_ground.moving_numbers
            faces = feet.face[selected_feet][rows] if is_moving else obstacle.find_closest(points, threads, _NORMAL_SEARCH_MM)[1]
            vertices = compute_vertices(world, name, world.display_frame)
            a, b, c = (vertices[foot_ground.meshes[name].faces[faces, corner]].T for corner in range(3))
            normal = vec.compute_stacked_cross(b - a, c - a)
            normals[:, rows] = normal / np.maximum(vec.length(normal), 1e-300)
    feet.tread[:, selected_feet[0], selected_feet[1]] = normals * np.where(vec.dot(normals, up) < 0, -1.0, 1.0)


def rotate_soles_to_ground(
    world: World, foot_ground: FootGround, feet: FeetState, up: Vectors, frames_left: NDArray[np.float32]
) -> None:
    """Turn the soles of n agents. The sole of a standing foot is aligned with its ground. Any other sole turns towards the ground
    on which its foot will land. `up`: float64[3, n], the up directions of bodies. `frames_left` [n, L]: the number of frames
    until a foot lands."""
    stale = (feet.on == NO_GROUND_NUMBER) | np.isin(feet.on, foot_ground.moving_numbers)
    if stale.any():
        rows, legs = np.nonzero(stale)
        measure_tread_slopes(world, foot_ground, feet, (rows, legs), up[:, rows])
    share = np.where(feet.swing == SWING_PHASE_OF_STANDING_FOOT, np.float32(1), 1 / (np.maximum(frames_left, 0) + np.float32(1)))
    turned = feet.sole + (feet.tread - feet.sole) * share
    size = vec.length(turned)
    feet.sole[:] = np.where(size > 0, turned / np.where(size > 0, size, 1), feet.tread)


def compute_local_soles(feet: FeetState) -> NDArray[np.float32]:
    """Return the normals of soles in the axes of the bodies (ahead, up, right), float32[n, L, 3].

    They are at most 45 degrees from the body's up direction."""
    ahead, up = feet.heading[:, :, None], feet.up[:, :, None]
    x, y, z = (vec.dot(feet.sole, axis) for axis in (ahead, up, vec.compute_stacked_cross(ahead, up)))
    level = np.sqrt(x * x + z * z)
    is_steep = y < _MIN_SOLE_COSINE
    by = np.where(is_steep, _MIN_SOLE_COSINE / np.maximum(level, np.float32(1e-12)), np.float32(1))
    return np.stack([x * by, np.where(is_steep, _MIN_SOLE_COSINE, y), z * by], axis=-1).astype(np.float32)
