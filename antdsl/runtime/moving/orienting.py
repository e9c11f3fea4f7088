"""Orients bodies by two methods that do not use the smooth normal of the ground. Both come from the same source (row R15 of
docs/parity.md).

If a method fails, the normal is used. `turns` (method 1 in the source) does not query the ground: on flat ground, the cross
product of two successive directions of motion is the normal. `probes` (method 2) finds two points on the surface, ahead of the
agent and to its left. The body's up is perpendicular to the directions to these points."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vectors import VectorArrays, compute_stacked_cross, dot
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]

_MIN_TURN_SINE = 0.0087  # sine of half a degree; a smaller turn of the direction does not define a plane
_MAX_NORMAL_TURN_SHARE = 0.1  # share of that turn; largest turn of the ground's normal in the same step
# cosine of 10 degrees: greatest angle between the ground's normal and an up computed from turns or retained
_MAX_TILT_COSINE = 0.984807753012208
# cosine of 45 degrees: greatest angle between the ground's normal and an up computed from probes
_MAX_PROBE_TILT_COSINE = 0.7071067811865476


def orient_bodies(
    world: World, population: Population, previous_velocity: VectorArrays, previous_up: VectorArrays, normal: NDArray[np.float32]
) -> None:
    """Change up and heading of bodies as the scene requests. Before the call, bodies are oriented by the normal of the ground.

    `previous_velocity`, `previous_up`: velocity and up of the body before the step. `normal` (n, 3): normal of the ground
    below the feet before the step."""
    ground = population.normal.T.astype(np.float64)
    up = _UP_ESTIMATORS[world.setting.orient](
        world, population, np.stack(previous_velocity).astype(np.float64), np.stack(previous_up), normal, ground
    )
    heading = population.read_vector("heading").T
    # rotate the heading as the up direction rotates, by the shortest rotation (O. Rodrigues, 1840)
    axis, cosine = compute_stacked_cross(ground, up), dot(ground, up)
    turned = heading * cosine + compute_stacked_cross(axis, heading) + axis * (dot(axis, heading) / (1.0 + cosine))
    turned = _normalise_or_default(turned - up * dot(turned, up), heading)
    for name, value in (("up", up), ("heading", turned)):
        for component, register in zip(value, AXES, strict=True):
            population.now[f"{name}.{register}"][:] = component


def _estimate_up_from_turns(
    world: World,
    population: Population,
    previous_velocity: Floats,
    previous_up: NDArray[np.float32],
    normal: NDArray[np.float32],
    ground: Floats,
) -> Floats:
    """Return up vectors (3, n) perpendicular to the last two directions of motion, at most 10 degrees from the ground's
    normal.

    The previous up is retained if both directions are almost equal, or if the agent stands. It is also retained if the ground
    curves by more than a tenth of the angle between the directions."""
    zero = np.zeros_like(previous_velocity)
    one, other = _normalise_or_default(previous_velocity, zero), _normalise_or_default(population.read_vector("velocity").T, zero)
    across = compute_stacked_cross(one, other)
    sine = np.sqrt(dot(across, across))
    bend = normal.T.astype(np.float64) - ground
    plain = (sine >= _MIN_TURN_SINE) & (np.sqrt(dot(bend, bend)) <= _MAX_NORMAL_TURN_SHARE * sine)
    up = _normalise_or_default(across, ground)
    up = np.where(dot(up, ground) < 0, -up, up)  # the sign of a turn does not show on which side the agent stands
    up = np.where(plain & (dot(up, ground) >= _MAX_TILT_COSINE), up, previous_up.astype(np.float64))
    return _limit_tilt(up, ground)


def _limit_tilt(up: Floats, ground: Floats) -> Floats:
    """Return the up vectors (3, n), each rotated towards the ground's normal as far as necessary. Afterwards they differ from the
    normals by at most 10 degrees."""
    aside = _normalise_or_default(up - ground * dot(up, ground), np.zeros_like(up))
    most = ground * _MAX_TILT_COSINE + aside * np.sqrt(1.0 - _MAX_TILT_COSINE * _MAX_TILT_COSINE)
    return np.where(dot(up, ground) < _MAX_TILT_COSINE, _normalise_or_default(most, ground), up)


def _estimate_up_from_probes(
    world: World,
    population: Population,
    previous_velocity: Floats,
    previous_up: NDArray[np.float32],
    normal: NDArray[np.float32],
    ground: Floats,
) -> Floats:
    """Return up vectors (3, n) perpendicular to the directions to two ground points.

    These are the ground points nearest to the positions half a body length ahead and half a body length to the left. If this
    gives no direction, or a direction more than 45 degrees from the ground's normal, the normal is returned instead."""
    heading = population.read_vector("heading").T
    reach = np.maximum(population.now["size"], np.float32(0)).astype(np.float64) / 2
    place = population.position.T
    displacements = []
    for direction in (heading, compute_stacked_cross(ground, heading)):
        footing, _ = world.ground.find_nearest((place + direction * reach).T)
        displacements.append(world.ground.position(footing).T - place)
    up = compute_stacked_cross(displacements[0], displacements[1])
    size = np.sqrt(dot(up, up))
    sound = (size > 0.1 * reach * reach) & (reach > 0)
    up = np.where(sound, _normalise_or_default(up, ground), ground)
    return np.where(dot(up, ground) < _MAX_PROBE_TILT_COSINE, ground, up)


def _normalise_or_default(v: Floats, default_vectors: Floats) -> Floats:
    """Return unit vectors (3, n) in the directions of `v`, or `default_vectors` where `v` is zero."""
    size = np.sqrt(dot(v, v))
    good = size > 1e-12
    return np.where(good, v / np.where(good, size, 1.0), default_vectors)


_UP_ESTIMATORS: dict[str, Callable[..., Floats]] = {"turns": _estimate_up_from_turns, "probes": _estimate_up_from_probes}
