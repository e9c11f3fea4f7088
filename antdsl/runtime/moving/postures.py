"""The postures of bodies: their up direction can be anywhere between the normal of their ground and the up of the world.

Species that set `upright` have a register of this name. At 0, bodies stand along the normal of the ground; at 1, along the
world's up direction. A value in between rotates a body by this fraction of the angle."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, inlined, kernel_helper
from antdsl.numerics.elementary_loops import atan2, compute_cos_and_sin
from antdsl.numerics.kernel_vectors import (
    Vec3,
    VectorColumns,
    cross,
    divide_vector,
    dot,
    minus,
    normalise_vector,
    plus,
    rotate_about_axis,
    times,
)  # fmt: skip
from antdsl.runtime.world import Population, World

UPRIGHT_REGISTER = "upright"  # for species that set it in `SpeciesPlan.settings`; others may have an attribute of this name

_F = np.float32
# Sine of an angle near half a turn. Below it, rounding hides the rotation axis, and the body turns over its head.
_MIN_AXIS_SINE = 0.05
_STEEP_COSINE = 0.9  # as in `vectors.find_perpendicular`
_MIN_OPPOSITE_AXIS_SINE = 1e-6  # sine of an angle near half a turn, without a rotation axis: such bodies keep their up


class Posture(NamedTuple):
    """How upright the bodies of a species stand.

    `has_posture`: whether the species sets `upright`. `upright`: for each agent, the fraction of the angle from the normal of
    the ground to `world_up`. `world_up`: the up direction of the world, a unit vector."""

    has_posture: BOOL
    upright: Array1[F32]
    world_up: Array1[F64]


def has_posture(population: Population) -> bool:
    """Return whether a species sets `upright`, which defines how its bodies stand."""
    return UPRIGHT_REGISTER in population.plan.settings


def read_posture(world: World, population: Population) -> Posture:
    """Return how upright the bodies of a population stand."""
    is_set = has_posture(population)
    upright = population.now[UPRIGHT_REGISTER if is_set else "size"]
    return Posture(is_set, upright, np.asarray(world.up, np.float64))


@kernel_helper
def set_upright_share(up: Vec3, posture: Posture, row: I64) -> Vec3:
    """Return `up` rotated towards the world's up by the fraction `upright` of the body at `row`."""
    share = posture.upright[row]
    if not share > 0:
        return up
    world_up = (posture.world_up[0], posture.world_up[1], posture.world_up[2])
    if share >= 1:
        return world_up
    axis, cosine = cross(up, world_up), dot(up, world_up)
    sine = np.sqrt(dot(axis, axis))
    if not sine > _MIN_OPPOSITE_AXIS_SINE:
        return up
    c, s = compute_cos_and_sin(atan2(_F(sine), _F(cosine)) * share)
    return normalise_vector(rotate_about_axis(up, divide_vector(axis, max(sine, 1e-300)), np.float64(c), np.float64(s)))


@inlined
def read_vector(vectors: VectorColumns, i: I64) -> Vec3:
    """Return vector `i` of vectors (3, n), in float64."""
    return np.float64(vectors[0][i]), np.float64(vectors[1][i]), np.float64(vectors[2][i])


@inlined
def compute_perpendicular_direction(v: Vec3, up: Vec3) -> Vec3:
    """Return the unit vector that is perpendicular to `up` and nearest to `v`. If no such vector is nearest, return an arbitrary
    perpendicular one."""
    flat = minus(v, times(up, dot(v, up)))
    size = np.sqrt(dot(flat, flat))
    if size > 1e-6:
        return divide_vector(flat, size)
    axis = (0.0, 1.0, 0.0) if abs(up[0]) > _STEEP_COSINE else (1.0, 0.0, 0.0)
    side = minus(axis, times(up, dot(axis, up)))
    return times(side, 1 / np.sqrt(dot(side, side)))


@kernel_helper
def find_rotation_axis(first: Vec3, second: Vec3, ahead: Vec3) -> tuple[Vec3, F64, F64]:
    """Return the axis, the cosine and the sine of the smallest rotation from the unit vector `first` to `second`.

    Near 180 degrees, where the axis is undefined, the rotation passes through `ahead`."""
    axis, cosine = cross(first, second), min(max(dot(first, second), -1.0), 1.0)
    sine = np.sqrt(dot(axis, axis))
    if sine > _MIN_AXIS_SINE or cosine > 0:
        return divide_vector(axis, max(sine, 1e-300)), cosine, sine
    return normalise_vector(cross(first, ahead)), cosine, sine


@kernel_helper
def turn_heading(heading: Vec3, first_normal: Vec3, second_normal: Vec3) -> Vec3:
    """Return `heading` after the smallest rotation that takes `first_normal` to `second_normal`. It is perpendicular to
    `second_normal`."""
    axis, cosine, sine = find_rotation_axis(first_normal, second_normal, heading)
    return compute_perpendicular_direction(rotate_about_axis(heading, axis, cosine, sine), second_normal)


@kernel_helper
def tilt_body_towards(body_up: Vec3, heading: Vec3, goal_up: Vec3, max_angle: F32) -> tuple[Vec3, Vec3, tuple[F32, F32]]:
    """Rotate a body towards the up direction `goal_up`, by at most `max_angle` radians. Return its new up direction, its new
    heading, and two angles (radians): the angle of this rotation, and the total angle to `goal_up`."""
    axis, cosine, sine = find_rotation_axis(body_up, goal_up, heading)
    full_tilt = atan2(_F(sine), _F(cosine))
    tilt, c, s, up = full_tilt, cosine, sine, goal_up
    if not full_tilt <= max_angle:
        c32, s32 = compute_cos_and_sin(max_angle)
        tilt, c, s = max_angle, np.float64(c32), np.float64(s32)
        up = normalise_vector(rotate_about_axis(body_up, axis, c, s))
    return up, compute_perpendicular_direction(rotate_about_axis(heading, axis, c, s), up), (tilt, full_tilt)


@kernel_helper
def turn_heading_towards(heading: Vec3, goal_heading: Vec3, up: Vec3, max_angle: F64) -> Vec3:
    """Return `heading` rotated towards `goal_heading` by at most `max_angle` radians. Both are perpendicular to `up`."""
    left = cross(up, heading)
    yaw, most_yaw, result = atan2(_F(dot(left, goal_heading)), _F(dot(heading, goal_heading))), _F(max_angle), goal_heading
    if not abs(yaw) <= most_yaw:
        c, s = compute_cos_and_sin(most_yaw if yaw > 0 else -most_yaw)
        result = normalise_vector(plus(times(heading, np.float64(c)), times(left, np.float64(s))))
    return result
