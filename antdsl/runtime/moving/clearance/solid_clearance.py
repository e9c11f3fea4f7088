"""Shifts of bodies in worlds with solids: in narrow tunnels, at rims, and where the ground was just dug.

Bodies on a solid follow the smooth normal of its surface, so heads and abdomens enter walls where it curves. Here, each
capsule leaves the solid along the gradient of the distance to it. The result for an agent does not depend on other agents."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid.trilinear import BrickTables, interpolate_distance_and_gradient, make_brick_tables
from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, inlined, kernel, kernel_helper
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.kernel_vectors import Vec3, plus, times
from antdsl.numerics.kernel_vectors import dot as dot_of
from antdsl.numerics.vector_rows import dot
from antdsl.runtime.body_positions import LIFT_REGISTERS
from antdsl.runtime.moving.body_records import MAX_LIFT_BODY_LENGTHS, BodyLimits, BodyStances, compute_body_shape
from antdsl.runtime.moving.clearance.body_paths import BodyShape
from antdsl.runtime.moving.clearance.body_tables import ROWS_PER_THREAD, Rows, make_unlimited_bodies
from antdsl.runtime.moving.clearance.mesh_clearance import find_rows_near_faces, shift_rows_outside_meshes
from antdsl.runtime.moving.contacts.body_contacts import MAX_SHIFT_ROUNDS
from antdsl.runtime.moving.crouching import has_crouch
from antdsl.runtime.moving.postures import has_posture, read_vector
from antdsl.runtime.moving.slopes import has_slope_limit
from antdsl.runtime.world import Population, World

Floats = NDArray[np.float64]

_F = np.float32

_MAX_ROUNDS = 4  # shifts of a body, each out of the deepest contact
_MAX_MESH_ROUNDS = 3  # shifts of a body out of faces, each followed by shifts out of solids
_SLACK_BODY_LENGTHS = 0.004  # body lengths; a shallower contact needs no shift
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
    """Shift bodies out of solids, meshes and obstacles: change their shifts in place.

    `start` (n, 3): the positions before the walk (mm). Step and shift together are hardly longer than the longest step of the
    agent."""
    now = population.now
    previous, goal = population.read_vector("~lift"), _find_shifts(world, population)
    rows = np.flatnonzero(((previous != 0) | (goal != 0)).any(axis=1))
    previous, goal, size = previous[rows], goal[rows], now["size"][rows].astype(np.float64)
    change = goal - previous
    length = np.sqrt(dot(change, change))
    most = np.where(dot(goal, goal) > dot(previous, previous), _LEAVING_SPEED, _RETURN_SPEED) * dt * size
    change *= np.minimum(1.0, most / np.maximum(length, 1e-12))[:, None]
    walked = population.position[rows] - start[rows]
    longest = np.nan_to_num(now["max_speed"][rows].astype(np.float64), posinf=1e12) * (_MAX_STEP_SHARE * dt)
    lift = previous + change * _find_free_shares(walked, change, longest)[:, None]
    for name, values in zip(LIFT_REGISTERS, lift.T, strict=True):
        now[name][rows] = values


def _find_shifts(world: World, population: Population) -> Floats:
    """Return the shifts (n, 3) mm that bring capsules outside of all solids, meshes and obstacles."""
    shifts, now = np.zeros((len(population), 3)), population.now
    size = np.where(now["size"] > 0, now["size"], 0).astype(np.float64)
    bodies = make_unlimited_bodies(world, population)
    _leave_solids(world, bodies, shifts, np.arange(len(population)))
    rows = find_rows_near_faces(world, population, size)
    for _ in range(_MAX_MESH_ROUNDS):
        if not len(rows):
            break
        lift = vec.split_columns(shifts, _F)
        shift_rows_outside_meshes(world, bodies, rows, lift, MAX_SHIFT_ROUNDS, world.options.threads)
        new = np.stack(vec.take_rows(lift, rows), axis=1)
        has_moved = (new != shifts[rows].astype(_F)).any(axis=1)
        rows = rows[has_moved]
        shifts[rows] = new[has_moved]
        _leave_solids(world, bodies, shifts, rows)
    return shifts


def _leave_solids(world: World, bodies: tuple[BodyStances, BodyLimits], shifts: Floats, rows: Rows) -> None:
    """Bring the capsules of `rows` outside of all solids: change their `shifts` (n, 3) mm in place."""
    for volume in world.solids.values():
        work = partial(leave_solid, make_brick_tables(volume.bricks), rows, *bodies, shifts)
        parallel.run_in_parts(work, len(rows), world.options.threads, ROWS_PER_THREAD)


@kernel
def leave_solid(
    bricks: BrickTables, rows: Array1[I64], stances: BodyStances, limits: BodyLimits, shifts: Array2[F64], begin: I64, end: I64
) -> None:
    """Shift the capsules of `rows` from `begin` to before `end` out of a solid, each time out of its deepest contact."""
    positions, _, poses = stances
    grid = bricks[2:]
    for j in range(begin, end):
        i = rows[j]
        size = np.float64(limits.size[i])
        if not (size > 0 and size < np.inf):
            continue
        shape, heading = compute_body_shape(limits, i, size), read_vector(poses.heading, i)
        rest = plus((positions[i, 0], positions[i, 1], positions[i, 2]), times(heading, shape.middle_forward_offset))
        rest = plus(rest, times(read_vector(poses.up, i), shape.middle_height))
        shift, most = (shifts[i, 0], shifts[i, 1], shifts[i, 2]), MAX_LIFT_BODY_LENGTHS * size
        if not _is_near_grid(grid, plus(rest, shift), shape.axis_half_length + shape.radius):
            continue
        for _turn in range(_MAX_ROUNDS):
            depth, out = _find_deepest_contact(bricks, shape, plus(rest, shift), heading)
            if depth <= _SLACK_BODY_LENGTHS * size:
                break
            shift = plus(shift, times(out, depth))
            shift = times(shift, min(1.0, most / max(np.sqrt(dot_of(shift, shift)), 1e-12)))
        for k in range(3):
            shifts[i, k] = shift[k]


@inlined
def _is_near_grid(grid: tuple[F64, F64, F64, F64, I64, I64, I64], p: Vec3, reach: F64) -> BOOL:
    """Return whether a point is within `reach` (mm) of the box of a solid; False for NaN."""
    near = True
    for k in range(3):
        high = grid[k] + (16.0 * grid[4 + k] - 1.0) * grid[3]
        near = near and p[k] >= grid[k] - reach and p[k] <= high + reach
    return near


@kernel_helper
def _find_deepest_contact(bricks: BrickTables, shape: BodyShape, middle: Vec3, heading: Vec3) -> tuple[F64, Vec3]:
    """Return how deep (mm) a capsule is inside a solid, and the direction out.

    Five points are tested: the ends and the middle of the axis, around which the radius must be free, and both tips. Distances
    are those of voxels, so free balls at the ends do not tell that the tips are outside."""
    grid = bricks[2:]
    depth, out = 0.0, (0.0, 0.0, 0.0)
    _, inner = interpolate_distance_and_gradient(bricks[0], bricks[1], grid, middle)
    for point in range(5):
        is_tip = point > 2
        side = 2.0 * point - 7.0 if is_tip else point - 1.0
        needed = 0.0 if is_tip else shape.radius - grid[3] / 2
        reach = side * (shape.axis_half_length + shape.radius if is_tip else shape.axis_half_length)
        p = plus(middle, times(heading, reach))
        distance, gradient = interpolate_distance_and_gradient(bricks[0], bricks[1], grid, p)
        # The field is flat deep inside: a deep end follows the middle out.
        if dot_of(gradient, gradient) <= _MIN_GRADIENT * _MIN_GRADIENT and distance < 0:
            gradient = inner
        slope = np.sqrt(dot_of(gradient, gradient))
        if slope > _MIN_GRADIENT and needed - distance > depth:
            depth, out = needed - distance, times(gradient, 1.0 / slope)
    return depth, out


def _find_free_shares(walked: Floats, change: Floats, longest: Floats) -> Floats:
    """Return by which fraction (n), 0 to 1, of its shift `change` each body may shift.

    Together with the step `walked` (n, 3) mm, the body then moves by at most `longest` mm, or not farther than the step alone."""
    a, b, c = dot(change, change), dot(walked, change), dot(walked, walked) - longest * longest
    root = np.sqrt(np.maximum(b * b - a * np.minimum(c, 0.0), 0.0))
    share: Floats = np.where(a > 0, (root - b) / np.maximum(a, 1e-300), 0.0)
    return np.clip(share, 0.0, 1.0)
