"""How bodies stand: between the normal of their ground and the up of the world.

A species with `upright` has the register. 0 stands along the normal of the ground, 1 along the up of the world, and bodies in
between turn by that share of the angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, kernel_helper
from antdsl.numerics.elementary_loops import atan2, compute_cos_and_sin
from antdsl.numerics.kernel_vectors import Vec3, cross, divide_vector, dot, normalise_vector, rotate_about_axis
from antdsl.runtime.world import Population, World

UPRIGHT_REGISTER = "upright"  # of species that set it, by `SpeciesPlan.settings`: others may have an attribute of that name

_F = np.float32
_OPPOSITE_SINE = 1e-6  # sine of an angle near half a turn, which has no axis: such bodies stay as they are


class Posture(NamedTuple):
    """How the bodies of a species stand. `is_set`: whether it says so. `upright`: share of the way from the normal of the
    ground to `world_up`, the unit vector up of the world."""

    is_set: BOOL
    upright: Array1[F32]
    world_up: Array1[F64]


def posture_of(world: World, population: Population) -> Posture:
    """Return the posture of a population."""
    is_set = UPRIGHT_REGISTER in population.plan.settings
    upright = population.now[UPRIGHT_REGISTER if is_set else "size"]
    return Posture(is_set, upright, np.asarray(world.up, np.float64))


@kernel_helper
def stand_up(up: Vec3, posture: Posture, i: I64) -> Vec3:
    """Return the up of body i, turned from `up` by its share of the way to the up of the world."""
    share = posture.upright[i]
    if not share > 0:
        return up
    world_up = (posture.world_up[0], posture.world_up[1], posture.world_up[2])
    if share >= 1:
        return world_up
    axis, cosine = cross(up, world_up), dot(up, world_up)
    sine = np.sqrt(dot(axis, axis))
    if not sine > _OPPOSITE_SINE:
        return up
    c, s = compute_cos_and_sin(atan2(_F(sine), _F(cosine)) * share)
    return normalise_vector(rotate_about_axis(up, divide_vector(axis, max(sine, 1e-300)), np.float64(c), np.float64(s)))
