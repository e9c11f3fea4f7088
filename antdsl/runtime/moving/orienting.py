"""How a body stands on the ground, other than by the ground's own smooth normal: from how its direction turned, or from two
probes. Both are those of the sources (R15), and take the normal of the ground where they do not hold.

`turns` (method 1 there) asks the ground for nothing: two directions of motion, one after the other, lie in one plane with the
ground as long as that is flat, and their cross product is its normal. `probes` (method 2) puts two points on the surface, ahead
and to the left, and stands across the ways to them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.vectors import Vector, dot, stacked_cross
from antdsl.runtime.world import AXES, Population, World

Floats = NDArray[np.float64]

_TURNED = 0.0087  # sine of the least turn of a direction, half a degree, that tells of a plane
_BENT = 0.1  # of that turn: how far the ground's normal may turn in the same step
_NEAR = 0.984807753012208  # cosine of 10 degrees: how far from the ground's normal what turns say may be, and what is kept
_FAR = 0.7071067811865476  # cosine of 45 degrees: the same of what two probes say


def orient(world: World, population: Population, before: Vector, stood: Vector, normal: NDArray[np.float32]) -> None:
    """Stand bodies as the scene asks, from how they stand on the ground's normal now; changes up and heading.

    `before`, `stood` and `normal` (n, 3) are the velocity, the up of the body and the normal below the feet before the step."""
    ground = population.normal.T.astype(np.float64)
    up = _METHODS[world.setting.orient](world, population, np.stack(before).astype(np.float64), np.stack(stood), normal, ground)
    heading = population.vector("heading").T
    # laid over as the way up is turned, by the least turn (O. Rodrigues, 1840)
    axis, cosine = stacked_cross(ground, up), dot(ground, up)
    turned = heading * cosine + stacked_cross(axis, heading) + axis * (dot(axis, heading) / (1.0 + cosine))
    turned = _unit(turned - up * dot(turned, up), heading)
    for name, value in (("up", up), ("heading", turned)):
        for component, register in zip(value, AXES, strict=True):
            population.now[f"{name}.{register}"][:] = component


def _by_turns(
    world: World, population: Population, before: Floats, stood: NDArray[np.float32], normal: NDArray[np.float32], ground: Floats
) -> Floats:
    """Ways up (3, n) across the last two directions of motion. Where these are one, where the ground bends between them by more
    than a tenth of their angle, or where an animal stands, the last way up is kept, but for what is more than 10 degrees off."""
    zero = np.zeros_like(before)
    one, other = _unit(before, zero), _unit(population.vector("velocity").T, zero)
    across = stacked_cross(one, other)
    sine = np.sqrt(dot(across, across))
    bent = normal.T.astype(np.float64) - ground
    plain = (sine >= _TURNED) & (np.sqrt(dot(bent, bent)) <= _BENT * sine)
    up = _unit(across, ground)
    up = np.where(dot(up, ground) < 0, -up, up)  # which way round it turned tells nothing of which side it stands on
    up = np.where(plain & (dot(up, ground) >= _NEAR), up, stood.astype(np.float64))
    return _within(up, ground)


def _within(up: Floats, ground: Floats) -> Floats:
    """Ways up (3, n) at most 10 degrees off the ground's normals, in the plane of both."""
    aside = _unit(up - ground * dot(up, ground), np.zeros_like(up))
    most = ground * _NEAR + aside * np.sqrt(1.0 - _NEAR * _NEAR)
    return np.where(dot(up, ground) < _NEAR, _unit(most, ground), up)


def _by_probes(
    world: World, population: Population, before: Floats, stood: NDArray[np.float32], normal: NDArray[np.float32], ground: Floats
) -> Floats:
    """Ways up (3, n) across the ways to the nearest places of the ground to two points, half a body ahead and half a body to the
    left. Where these lie in one line with the body, or stand more than 45 degrees off the ground, it is the ground's."""
    heading = population.vector("heading").T
    reach = np.maximum(population.now["size"], np.float32(0)).astype(np.float64) / 2
    place = population.position.T
    ways = []
    for way in (heading, stacked_cross(ground, heading)):
        footing, _ = world.ground.nearest((place + way * reach).T)
        ways.append(world.ground.position(footing).T - place)
    up = stacked_cross(ways[0], ways[1])
    size = np.sqrt(dot(up, up))
    sound = (size > 0.1 * reach * reach) & (reach > 0)
    up = np.where(sound, _unit(up, ground), ground)
    return np.where(dot(up, ground) < _FAR, ground, up)


def _unit(v: Floats, otherwise: Floats) -> Floats:
    """Vectors (3, n) of length 1, or others where there is no direction."""
    size = np.sqrt(dot(v, v))
    good = size > 1e-12
    return np.where(good, v / np.where(good, size, 1.0), otherwise)


_METHODS: dict[str, Callable[..., Floats]] = {"turns": _by_turns, "probes": _by_probes}
