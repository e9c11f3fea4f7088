"""Tests whether heads are inside the ground: behind a surface that agents walk on, or in a solid."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import vectors as vec
from antdsl.runtime.body_positions import LIFT_REGISTERS
from antdsl.runtime.world import AXES, Population, World

MIN_BODY_HEIGHT_SHARE = 0.1  # body lengths of the middle above the feet, unless the body's clearance is larger
HEAD_DEPTH_TOLERANCE = 0.1  # body lengths; a shallower overlap counts as contact


def find_heads_inside(world: World, population: Population) -> NDArray[np.bool_]:
    """Return which heads are inside the ground or a solid in the current state, bool[n].

    A head is half a body length ahead of the body's middle. The middle is above the feet, along the mean of the ground's normal
    and the body's up. A head is inside if a surface separates it from the middle, or if it is in a solid. The head must be deeper
    inside than a tenth of a body length."""
    now = population.now
    size = now["size"].astype(np.float64)
    high = np.maximum(MIN_BODY_HEIGHT_SHARE * size, now["clearance"])
    middle, ahead = np.empty((2, 3, len(population)))
    for k, axis in enumerate(AXES):
        upright = now[f"up.{axis}"].astype(np.float64) + population.normal[:, k]
        middle[k] = population.position[:, k] + upright * (high / 2)
        ahead[k] = now[f"heading.{axis}"] * (size / 2)
        if LIFT_REGISTERS[0] in now:
            middle[k] += now[LIFT_REGISTERS[k]]
    is_inside = np.zeros(len(population), np.bool_)
    meshes = world.ground.meshes
    if meshes is not None:
        which, part, normal = meshes.find_hit_normals(middle.T, ahead.T, world.options.threads)
        beyond = np.abs(vec.dot(ahead.take(which, axis=1), normal)) * (1 - part)
        is_inside[which] = beyond > HEAD_DEPTH_TOLERANCE * size.take(which)
    for volume in world.solids.values():
        is_inside |= volume.sample_distances((middle + ahead).T) < -HEAD_DEPTH_TOLERANCE * size
    return is_inside
