"""Lamps: items that emit light. Each is a sphere; its light decreases with the square of the distance and casts soft shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureRays
from antdsl.outputs.pictures.model import Item
from antdsl.outputs.pictures.shading_rows import Floats, compute_dot_products, normalise_rows
from antdsl.scene.looks import KIND_BY_LOOK

MAX_LAMPS = 16  # per picture; the largest count
LAMP_COLOUR = np.array([2.65, 2.20, 1.62], np.float32)  # light at UNIT_DISTANCE radii, about that of the sun
UNIT_DISTANCE = 10.0  # radii
_TARGET_RADII = 1.06  # shadow rays end just outside the lamp's own surface
_BULB_BY_SHAPE = {"lamp": (1.75, 0.92), "sphere": (0.85, 1.0)}  # height of the centre and radius, in radii of the item
_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A sphere that emits light. `centre` (3,), `radius`: world units. `strength`: 1 is LAMP_COLOUR at UNIT_DISTANCE radii."""

    centre: NDArray[np.float64]
    radius: float
    strength: float

    def aim(self, points: Floats, numbers: NDArray[np.integer], count: int) -> Floats:
        """Return vectors (n, 3) from `points` (n, 3) to points of the lamp, which shadow rays reach at the parameter 1.

        `numbers` (n,): which of `count` evenly spread points of the half sphere that faces each point."""
        towards = points - self.centre.astype(np.float32)
        height = 1 - (np.asarray(numbers) + 0.5) / count
        turn, flat = np.asarray(numbers) * _GOLDEN_ANGLE, np.sqrt(1 - height * height)
        spots = np.stack([flat * np.cos(turn), height, flat * np.sin(turn)], axis=-1).astype(np.float32)
        spots = np.broadcast_to(spots, towards.shape) * np.float32(_TARGET_RADII * self.radius)
        spots = np.where(compute_dot_products(spots, towards)[:, None] < 0, -spots, spots)
        return np.asarray(spots - towards, np.float32)

    def compute_light(self, points: Floats, normal: Floats, flat_normal: Floats | None = None) -> Floats:
        """Return the light (n, 3) at points with a normal (n, 3) that nothing hides from the lamp.

        `flat_normal` (n, 3): of the triangles; light fades where they face away, so that coarse bodies have no jagged shade."""
        towards = self.centre.astype(np.float32) - points
        square = np.maximum(compute_dot_products(towards, towards), np.float32(self.radius**2))
        direction = normalise_rows(towards)
        share = np.clip(compute_dot_products(normal, direction), 0, 1) / square
        if flat_normal is not None:
            share *= np.clip(compute_dot_products(flat_normal, direction) * 6 + np.float32(0.6), 0, 1)
        return np.asarray((share * np.float32(self.strength * (UNIT_DISTANCE * self.radius) ** 2))[:, None] * LAMP_COLOUR)

    def find_hidden(
        self,
        points: Floats,
        normal: Floats,
        offset: float,
        occluders: Sequence[PictureRays],
        number: int,
        count: int,
        threads: int,
    ) -> NDArray[np.bool_]:
        """Return whether something hides one of `count` points of the lamp from each point (n,)."""
        start = points + normal * np.float32(offset)
        aim = self.aim(start, np.full(len(start), number), count)
        hidden = np.zeros(len(start), np.bool_)
        for rays in occluders:
            left = np.flatnonzero(~hidden)
            hidden[left] = rays.find_occluded(start[left], aim[left], 1.0, threads)
        return hidden


def find_lamps(items: Sequence[Item], up: tuple[float, float, float], strength: float) -> tuple[Lamp, ...]:
    """Return the lamps among items: those that emit light and have something left."""
    lamps = []
    for item in items:
        size = item.drawn_radius
        if KIND_BY_LOOK.get(item.look or "") == "light" and size > 0 and strength > 0 and item.shape != "none":
            height, bulb = _BULB_BY_SHAPE.get(item.shape, (0.5, 1.0))
            centre = np.asarray(item.position, np.float64) + np.asarray(up, np.float64) * height * size
            lamps.append(Lamp(centre, bulb * size, strength))
    return tuple(sorted(lamps, key=lambda lamp: -lamp.radius)[:MAX_LAMPS])


def compute_lamp_light(
    lamps: Sequence[Lamp],
    points: Floats,
    normal: Floats,
    offset: float,
    occluders: Sequence[PictureRays],
    number: int,
    count: int,
    threads: int,
    flat_normal: Floats | None = None,
) -> Floats:
    """Return the light (n, 3) of all lamps at points with a normal (n, 3), with hard shadows of one of `count` points of each
    lamp. The mean over the points has soft shadows."""
    light = np.zeros(points.shape, np.float32)
    for lamp in lamps:
        own = lamp.compute_light(points, normal, flat_normal)
        lit = np.flatnonzero(own.max(axis=1, initial=0) > 1e-4)
        if len(lit):
            hidden = lamp.find_hidden(points[lit], normal[lit], offset, occluders, number, count, threads)
            own[lit[hidden]] = 0
        light += own
    return light
