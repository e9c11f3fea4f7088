"""A walk that keeps agents on surfaces by two rays per step. A scene with `stick: rays` uses it instead of walking over
triangles. The agent moves straight ahead, and is then placed at the nearer hit of two rays: one goes down, the other ahead and
up. Without a hit, the agent stays where it was."""

from __future__ import annotations

import numpy as np

from antdsl.ground.protocol import Floats, Footing, GroundMove, MeshSurfaces
from antdsl.numerics.vectors import compute_stacked_cross, dot

RAY_START_HEIGHT_BODY_LENGTHS = 0.5  # in body lengths: height of the ray origin above the feet
RAY_LENGTH_BODY_LENGTHS = 1.5  # length of both rays, in body lengths
RAY_FORWARD_SHARE, RAY_UPWARD_SHARE = np.sqrt(0.75), 0.5  # direction of the second ray: ahead and 30 degrees up
_MIN_VECTOR_LENGTH = 1e-9  # a shorter vector has no direction


def move_agents_by_rays(
    ground: MeshSurfaces, footing: Footing, wish: Floats, heading: Floats, up: Floats, body: Floats, threads: int
) -> GroundMove:
    """Move n agents from their footings by the displacements `wish`, as `Ground.move` does. Vectors are (3, n) in mm; `body` is
    (n,).

    Ray 1 goes down, against the agent's up, from above its intended position. Ray 2 goes ahead, rotated 30 degrees upward about
    side = heading x up. The nearer hit is the new position, and the new heading is normal x side (T. Kewlani, Art Directed Ant
    Crowd Simulation in Houdini, section 4.3.8). The text of that section uses the longer ray, but its pseudo-code the nearer hit.
    If the longer ray were used, agents would pass through every wall that ray 2 hits.

    `position` of the result is the ray's hit in float32, so it is slightly off its face. An agent without a hit does not move and
    is blocked (`is_blocked`)."""
    known = footing.face >= 0
    wish = np.where(np.isfinite(wish).all(axis=0) & known, wish, 0.0)
    place, length = ground.position(footing).T, np.sqrt(dot(wish, wish))
    going = length > _MIN_VECTOR_LENGTH
    ahead = np.where(going, wish / np.where(going, length, 1.0), heading)
    eye, reach = place + up * (RAY_START_HEIGHT_BODY_LENGTHS * body), RAY_LENGTH_BODY_LENGTHS * body
    down, slant = -up * reach, (ahead * RAY_FORWARD_SHARE + up * RAY_UPWARD_SHARE) * reach
    found1, part1, footing1 = ground.find_path_hits((eye + wish).T, down.T, threads)
    found2, part2, footing2 = ground.find_path_hits(eye.T, slant.T, threads)
    second = found2 & ~(found1 & (part1 <= part2))
    is_hit = known & going & (found1 | found2)
    towards = np.where(second, slant, down)
    hit = np.where(second, eye, eye + wish) + towards * np.where(second, part2, part1)
    onto = Footing.choose_rows(is_hit, Footing.choose_rows(second, footing2, footing1), footing)
    normal = ground.compute_upright_normals(onto, np.where(is_hit, -towards, up).T).T
    turned, new_direction = (np.where(is_hit, _project_heading(vector, up, normal), vector) for vector in (heading, ahead))
    hit = np.where(is_hit, hit, place)
    distance = np.sqrt(dot(hit - place, hit - place))
    position, above, ahead, direction = (
        np.ascontiguousarray(v).T for v in (hit, np.where(is_hit, normal, up), turned, new_direction)
    )
    return GroundMove(onto, position, above, ahead, direction, distance, going & ~is_hit, ~known)


def _project_heading(vector: Floats, up: Floats, normal: Floats) -> Floats:
    """Return the new heading: the unit direction of normal x side, where side = vector x up.

    If a wall is at the side or in front of the agent, normal x side is zero. Then return the projection of `vector`, or of `up`,
    onto the wall."""
    flat = compute_stacked_cross(normal, compute_stacked_cross(vector, up))
    for other in (vector, up):
        flat = np.where(dot(flat, flat) > _MIN_VECTOR_LENGTH, flat, other - dot(other, normal) * normal)
    flat = flat - dot(flat, normal) * normal
    return flat / np.sqrt(np.maximum(dot(flat, flat), 1e-300))
