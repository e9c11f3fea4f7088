"""Shifts bodies out of solids. Bodies would be inside in narrow tunnels, at rims, and where the ground was just dug. Bodies on
a solid follow the smooth normal of its surface, so heads and abdomens enter the walls where the surface curves. Here, each
capsule moves out of the solid along the gradient of the distance. The result for an agent does not depend on other agents."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vector_rows import dot
from antdsl.numerics.vectors import length as length_of
from antdsl.runtime.body_positions import LIFT_REGISTERS
from antdsl.runtime.moving.clearance.body_tables import compute_unit_shapes
from antdsl.runtime.moving.crouching import has_crouch
from antdsl.runtime.moving.postures import has_posture
from antdsl.runtime.moving.slopes import has_slope_limit
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]

# Points of a capsule: the side of the axis, and the share of the radius that must be free around it. Distances are those of
# voxels, so the free balls at the ends of the axis do not tell that the tips are outside.
_CAPSULE_POINTS = ((-1.0, 1.0), (0.0, 1.0), (1.0, 1.0), (-1.0, 0.0), (1.0, 0.0))
_MAX_ROUNDS = 4  # shifts of a body, each out of the deepest contact
_SLACK_BODY_LENGTHS = 0.004  # body lengths; a shallower contact needs no shift
_MAX_SHIFT_BODY_LENGTHS = 0.3  # body lengths; legs reach the ground from there
# body lengths per second; a body leaves a solid at the first speed, and returns to its feet at the second, as on meshes
_LEAVING_SPEED, _RETURN_SPEED = 8.4, 3.6
_MAX_STEP_SHARE = 1.03  # of the longest step; step and shift together move a body no farther, so it leaves walls at full speed
_MIN_GRADIENT = 0.1  # mm per mm; the distance to a solid is not known where its field is flatter


def has_solid_clearance(world: World, population: Population) -> bool:
    """Return whether the bodies of a species stay outside solids. The result is False for bodies that stand upright, limit their
    slope or crouch."""
    follows_ground = not (has_posture(population) or has_slope_limit(population) or has_crouch(population))
    return bool(world.solids) and population.plan.has_body_clearance and follows_ground


def shift_bodies_outside_solids(world: World, population: Population, start: Floats, dt: float) -> None:
    """Change the shifts of bodies, in place, so that the bodies leave solids. `start` (n, 3): the positions before the walk (mm).
    A shift is limited so that the sum of step and shift is hardly longer than the longest step that the agent could make."""
    now = population.now
    size = np.where(now["size"] > 0, now["size"], 0).astype(np.float64)
    previous = population.read_vector("~lift")
    goal = _find_shifts(world, population, size)
    change = goal - previous
    length = np.sqrt(dot(change, change))
    most = np.where(dot(goal, goal) > dot(previous, previous), _LEAVING_SPEED, _RETURN_SPEED) * dt * size
    change *= np.minimum(1.0, most / np.maximum(length, 1e-12))[:, None]
    walked = population.position - start
    longest = np.nan_to_num(now["max_speed"].astype(np.float64), posinf=1e12) * (_MAX_STEP_SHARE * dt)
    lift = previous + change * _find_free_shares(walked, change, longest)[:, None]
    for name, values in zip(LIFT_REGISTERS, lift.T, strict=True):
        now[name][:] = values


def _find_shifts(world: World, population: Population, size: Floats) -> Floats:
    """Return the shifts (n, 3) mm that move capsules out of all solids. `size` (n): sizes of the bodies (mm)."""
    shifts = np.zeros((len(population), 3))
    shapes, body = compute_unit_shapes(world, population, 0.0)
    up, heading = population.read_vector("up"), population.read_vector("heading")
    half, radius, height, ahead = (shapes[body] * size[:, None]).T
    middle = population.position + up * height[:, None] + heading * ahead[:, None]
    rows = np.arange(len(population))
    for _ in range(_MAX_ROUNDS):
        if not len(rows):
            break
        depth, out = np.zeros(len(rows)), np.zeros((len(rows), 3))
        for volume in world.solids.values():
            for end, share in _CAPSULE_POINTS:
                needed = share * (radius[rows] - volume.voxel / 2)
                reach = end * (half[rows] + (1.0 - share) * radius[rows])
                point = middle[rows] + shifts[rows] + heading[rows] * reach[:, None]
                distance, gradient = volume.sample_with_gradients(point)
                slope = length_of((gradient[:, 0], gradient[:, 1], gradient[:, 2]))
                over = np.where(slope > _MIN_GRADIENT, needed - distance, 0.0)
                is_deeper = over > depth
                depth[is_deeper] = over[is_deeper]
                out[is_deeper] = (gradient / np.maximum(slope, 1e-12)[:, None])[is_deeper]
        is_deep = depth > _SLACK_BODY_LENGTHS * size[rows]
        rows = rows[is_deep]
        shifts[rows] += out[is_deep] * depth[is_deep][:, None]
        length = np.sqrt(dot(shifts[rows], shifts[rows]))
        shifts[rows] *= np.minimum(1.0, _MAX_SHIFT_BODY_LENGTHS * size[rows] / np.maximum(length, 1e-12))[:, None]
    return shifts


def _find_free_shares(walked: Floats, change: Floats, longest: Floats) -> Floats:
    """Return the fraction (n), 0 to 1, of `change` by which each body may shift.

    Together with the step `walked` (n, 3) mm, the body then moves by at most `longest` mm, or not farther than the step alone."""
    a, b, c = dot(change, change), dot(walked, change), dot(walked, walked) - longest * longest
    root = np.sqrt(np.maximum(b * b - a * np.minimum(c, 0.0), 0.0))
    share: Floats = np.where(a > 0, (root - b) / np.maximum(a, 1e-300), 0.0)
    return np.clip(share, 0.0, 1.0)
