"""Shifts bodies out of the faces of meshes and obstacles, from any ground that has meshes, and measures how deep they remain."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.surface import SHARP_EDGE_REACH_BODY_LENGTHS, MeshGround
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.moving.body_records import SHARP_BEND_LEVEL, BodyLimits, BodyStances
from antdsl.runtime.moving.clearance.body_tables import ROWS_PER_THREAD, Rows, compute_row_dots, make_contact_faces
from antdsl.runtime.moving.clearance.clearance_kernels import shift_bodies
from antdsl.runtime.moving.clearance.obstacle_clearance import mark_near_obstacles
from antdsl.runtime.world import Population, World

_F = np.float32
_MAX_LEAN_COSINE = _F(0.9998)  # cosine of the angle between a body and its ground; a body with a lesser one leans (1.1 degrees)


def shift_rows_outside_meshes(
    world: World, bodies: tuple[BodyStances, BodyLimits], rows: Rows, lift: VectorArrays, max_rounds: int, threads: int
) -> NDArray[np.float32]:
    """Shift the bodies of `rows` out of faces around them: change their `lift` (mm, float32[n] for each axis) in place.

    `bodies`: as `make_unlimited_bodies` returns them. Returns the remaining depths (body lengths). With 0 `max_rounds`, the
    depths are only measured."""
    depths, outs = np.zeros(len(rows), np.float32), np.zeros((3, len(rows)), np.float32)
    (stances, limits), meshes = bodies, world.ground.meshes
    largest = float(np.fmax.reduce(limits.size.take(rows), initial=0.0))
    walk = meshes.build_crowd_walk(0.0, largest) if isinstance(meshes, MeshGround) else None
    if walk is None or not len(rows):
        return depths
    previous = vec.take_rows(lift, rows)
    faces = make_contact_faces(world, walk, len(rows), threads)
    work = partial(shift_bodies, *faces, rows, stances, limits, lift, previous, depths, outs, max_rounds)
    parallel.run_in_parts(work, len(rows), threads, ROWS_PER_THREAD)
    return depths


def find_rows_near_faces(world: World, population: Population, size: NDArray[np.float64]) -> Rows:
    """Return the rows of agents with bodies that faces may touch: near sharp edges or obstacles, on a solid, or leaning.

    `size` (n): sizes of the bodies (mm)."""
    meshes, n, threads = world.ground.meshes, len(population), world.options.threads
    if not isinstance(meshes, MeshGround):
        return np.empty(0, np.int64)
    (levels,) = population.get_buffers("bends", 1, (n,), np.uint8)
    meshes.mark_bend_levels(population.footing, population.position, size, levels, threads)
    mark_near_obstacles(world, population, SHARP_EDGE_REACH_BODY_LENGTHS * size, levels, SHARP_BEND_LEVEL)
    up = vec.get_vector_registers(population.now, "up")
    leans = compute_row_dots(up, population.normal) < _MAX_LEAN_COSINE
    return np.flatnonzero((levels == SHARP_BEND_LEVEL) | leans | (population.footing.mesh >= len(meshes.names)))
