"""Tests which bodies are inside the ground or inside a solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.runtime.body_positions import LIFT_REGISTERS
from antdsl.runtime.moving.clearance.body_tables import make_unlimited_bodies
from antdsl.runtime.moving.clearance.mesh_clearance import shift_rows_outside_meshes
from antdsl.runtime.moving.crouching import compute_lowering
from antdsl.runtime.world import Population, World

_F = np.float32
_MAX_BODIES_MEASURED_AT_ONCE = 250  # a larger species is sampled: only every k-th agent is measured
_VISIBLE_DEPTH = _F(0.01)  # body lengths; a shallower overlap counts as contact


def find_sampled_bodies_inside(world: World, population: Population) -> NDArray[np.bool_]:
    """Return which bodies in a sample are inside the ground or a solid, bool[k].

    The sample has up to about 250 agents: those with ids that are multiples of a certain number."""
    rows = np.flatnonzero(population.ids % (1 + len(population) // _MAX_BODIES_MEASURED_AT_ONCE) == 0)
    return find_bodies_inside(world, population, rows)


def find_bodies_inside(world: World, population: Population, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which bodies of the agents at `rows` are inside the ground, an obstacle or a solid in the current state, bool[k].

    A body is the capsule of its trunk, with head and abdomen. It is inside a ground or an obstacle if a face crosses its axis.
    It is also inside if the distance of a face from the axis is less than the radius minus 1 % of the body length. It is
    inside a solid if the solid is that near to the middle or an end of the axis."""
    now = population.now
    bodies = make_unlimited_bodies(world, population)
    poses, shapes, body = bodies[0].pose, bodies[1].unit_shapes, bodies[1].body_numbers
    size = now["size"].take(rows).astype(np.float64)
    zero = np.zeros(len(population), np.float32)
    lift = vec.get_vector_registers(now, "~lift") if LIFT_REGISTERS[0] in now else (zero, zero.copy(), zero.copy())
    lowering = np.minimum(compute_lowering(population), _measure_room_below(shapes)[body] * now["size"])
    x, y, z = (along - above * lowering for along, above in zip(lift, poses.up, strict=True))
    lift = x, y, z
    depths = shift_rows_outside_meshes(world, bodies, rows, lift, 0, 1)
    is_inside: NDArray[np.bool_] = depths > _VISIBLE_DEPTH
    up, heading = (np.stack(vec.take_rows(each, rows)).astype(np.float64) for each in poses)
    place = population.position[rows].T + np.stack(vec.take_rows(lift, rows))
    half, radius, height, ahead = shapes[body[rows]].T
    for volume in world.solids.values():
        clear = (radius - _VISIBLE_DEPTH) * size - volume.voxel / 2
        for end in (-half, 0.0, half):
            point = place + up * (height * size) + heading * ((ahead + end) * size)
            is_inside |= volume.sample_distances(point.T) < clear
    return is_inside


def _measure_room_below(shapes: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return how high (body lengths) the trunks of body shapes (k, 4) are above level ground. A crouching body is lowered by at
    most this height."""
    return np.maximum(shapes[:, 2] - shapes[:, 1], 0).astype(np.float32)
