"""Lamps, which are spheres that emit light. Computes how much light reaches a surface, and target points for rays towards a lamp.

Pictures and the sense `light` use the same lamps. Light decreases with the square of the distance to the centre and with the
cosine of the angle to the surface's normal."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary
from antdsl.numerics.vector_rows import dot

MAX_LAMPS = 16  # of a picture or of one name; the largest count
UNIT_DISTANCE_IN_RADII = 10.0  # radii at which a lamp of strength 1 gives the light 1
_RAY_END_DISTANCE_IN_RADII = 1.06  # rays end just outside the lamp's own surface
_BULB_BY_SHAPE = {
    "lamp": (1.75, 0.92),
    "sphere": (0.85, 1.0),
    "globe": (0.0, 1.0),
}  # height of the centre and radius, in radii of the item
_DEFAULT_BULB = (0.5, 1.0)
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
AnyFloats = NDArray[Any]


@dataclass(frozen=True, slots=True, eq=False)
class LightSphere:
    """A sphere that emits light.

    - `centre` (3,), `radius`: in world units
    - `strength`: the intensity of its light at a distance of UNIT_DISTANCE_IN_RADII radii"""

    centre: NDArray[np.float64]
    radius: float
    strength: float

    def aim_rays(self, points: AnyFloats, numbers: NDArray[np.integer], count: int) -> AnyFloats:
        """Return vectors (n, 3) from `points` (n, 3) to target points on the sphere. If they are used as ray directions, the ray
        reaches the target at the ray parameter 1.

        There are `count` target points, spread evenly over the hemisphere that faces a point. `numbers` (n,): which of them each
        point uses."""
        towards = points - self.centre.astype(points.dtype)
        height = 1 - (np.arange(count) + 0.5) / count
        turn, flat = np.arange(count) * _GOLDEN_ANGLE, np.sqrt(1 - height * height)
        half_sphere = np.stack([flat * elementary.cos(turn), height, flat * elementary.sin(turn)], axis=-1).astype(points.dtype)
        spots = half_sphere[numbers] * points.dtype.type(_RAY_END_DISTANCE_IN_RADII * self.radius)
        spots = np.where(dot(spots, towards)[:, None] < 0, -spots, spots)
        return np.asarray(spots - towards, points.dtype)

    def compute_intensity(self, points: AnyFloats, normal: AnyFloats, flat_normal: AnyFloats | None = None) -> AnyFloats:
        """Return the intensity (n,) of the lamp's light at `points` (n, 3) with normals `normal` (n, 3), ignoring occlusion.

        `flat_normal` (n, 3): the normals of the triangles. Light fades out on triangles that face away from the lamp, so that
        coarse bodies have no jagged shadow edges."""
        number = points.dtype.type
        towards = self.centre.astype(points.dtype) - points
        square = dot(towards, towards)
        direction = towards / np.maximum(np.sqrt(square), number(1e-12))[:, None]
        share = np.clip(dot(normal, direction), 0, 1) / np.maximum(square, number(self.radius**2))
        if flat_normal is not None:
            share *= np.clip(dot(flat_normal, direction) * 6 + number(0.6), 0, 1)
        return np.asarray(share * number(self.strength * (UNIT_DISTANCE_IN_RADII * self.radius) ** 2))


LightSphereType = TypeVar("LightSphereType", bound=LightSphere)


def place_bulb(
    shape: str, position: NDArray[np.float64], size: float, up: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Return the centre (3,) and the radius of the light-emitting part of an item.

    `shape`: the name of the item's shape. `position` (3,), `size`: the item's position and radius. `up` (3,): a unit vector."""
    height, bulb = _BULB_BY_SHAPE.get(shape, _DEFAULT_BULB)
    return position + up * (height * size), bulb * size


def select_brightest_lamps(lamps: Iterable[LightSphereType]) -> tuple[LightSphereType, ...]:
    """Return the MAX_LAMPS lamps with the greatest radius, in descending order."""
    return tuple(sorted(lamps, key=lambda lamp: -lamp.radius)[:MAX_LAMPS])
