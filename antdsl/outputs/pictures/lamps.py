"""Lamps in pictures: items that emit light, as spheres that cast soft shadows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.lamps import LightSphere, place_bulb, select_brightest_lamps
from antdsl.casting.picture_rays import PictureRays
from antdsl.outputs.pictures.light import LUMINANCE_WEIGHTS, decode_srgb
from antdsl.outputs.pictures.model import Item
from antdsl.outputs.pictures.shading_rows import Floats
from antdsl.scene.looks import is_lamp_look

LAMP_COLOUR = np.array([2.65, 2.20, 1.62], np.float32)  # of the light 1, about that of the sun


@dataclass(frozen=True, slots=True, eq=False)
class Lamp(LightSphere):
    """A lamp of a picture. `light` (3,): its light at an intensity of 1."""

    light: Floats = field(default_factory=LAMP_COLOUR.copy)

    def compute_light(self, points: Floats, normal: Floats, flat_normal: Floats | None = None) -> Floats:
        """Return the light (n, 3) of the lamp at points with normals (n, 3), without occlusion. For the arguments see
        `compute_intensity`."""
        return np.asarray(self.compute_intensity(points, normal, flat_normal)[:, None] * self.light, np.float32)

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
        """Return a mask of the points (n,) from which one point of the lamp is hidden. `number`: which of `count` points of the
        lamp."""
        start = points + normal * np.float32(offset)
        aim = self.aim_rays(start, np.full(len(start), number), count)
        hidden = np.zeros(len(start), np.bool_)
        for rays in occluders:
            left = np.flatnonzero(~hidden)
            hidden[left] = rays.find_occluded_rays(start[left], aim[left], 1.0, threads)
        return hidden


def compute_lamp_colour(colour: tuple[float, float, float] | None) -> Floats:
    """Return the light (3,) at an intensity of 1 for a colour in display values, as bright as LAMP_COLOUR. None means
    LAMP_COLOUR."""
    if colour is None or not max(colour) > 0:
        return LAMP_COLOUR
    tint = decode_srgb(colour)
    return np.asarray(tint * (LAMP_COLOUR @ LUMINANCE_WEIGHTS) / (tint @ LUMINANCE_WEIGHTS), np.float32)


def find_lamps(items: Sequence[Item], up: tuple[float, float, float], strength: float) -> tuple[Lamp, ...]:
    """Return the lamps among items: those that emit light, and have some amount left. `strength`: the intensity of each lamp."""
    lamps = []
    for item in items:
        size = item.drawn_radius
        if is_lamp_look(item.look) and size > 0 and strength > 0 and item.shape != "none":
            place = place_bulb(item.shape, np.asarray(item.position, np.float64), size, np.asarray(up, np.float64))
            power = strength if item.power is None else strength * item.power
            if power > 0:
                lamps.append(Lamp(*place, power, compute_lamp_colour(item.colour)))
    return select_brightest_lamps(lamps)


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
    """Return the light (n, 3) of all lamps at points with normals (n, 3), with hard shadows.

    The shadows are those of a single point of each lamp, with the index `number` of `count` points. The mean over all points has
    soft shadows."""
    light = np.zeros(points.shape, np.float32)
    for lamp in lamps:
        own = lamp.compute_light(points, normal, flat_normal)
        lit = np.flatnonzero(own.max(axis=1, initial=0) > 1e-4)
        if len(lit):
            hidden = lamp.find_hidden(points[lit], normal[lit], offset, occluders, number, count, threads)
            own[lit[hidden]] = 0
        light += own
    return light
