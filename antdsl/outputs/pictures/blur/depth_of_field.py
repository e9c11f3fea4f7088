"""Depth of field: the light of pixels spread over discs, layer by layer from front to back.

The disc of a point is its image through a thin lens. Each layer covers a range of the signed disc radius. It contains bodies, and
static surfaces that are also known behind bodies. So sharp objects have no seams where the background is blurred."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import parallel
from antdsl.numerics.imaging.spreading import (
    CHANNEL_COUNT,
    RADIUS_STEPS_PER_PIXEL,
    DiscTable,
    add_disc_averages,
    add_layer_behind,
)
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.shading_rows import Floats

_MAX_RADIUS_PIXELS = 80.0
_LAYER_BOUNDS = (-np.inf, -16.0, -5.0, -1.5, 1.5, 5.0, 16.0, np.inf)  # signed radii in pixels, near to far
_ROWS_PER_PART = 64


@dataclass(frozen=True, slots=True, eq=False)
class PictureLayer:
    """One layer of a picture. `light` (h · w, 3): already multiplied by `cover`. `cover` (h · w,): the fraction of each pixel
    that the layer covers. `distance` (h · w,): the distance along the ray, infinite for the sky."""

    light: Floats
    cover: Floats
    distance: Floats


def compose_layers(static: PictureLayer, bodies: PictureLayer) -> Floats:
    """Return the light (h · w, 3) of a picture with bodies in front of static surfaces."""
    return np.asarray(static.light * (1 - bodies.cover)[:, None] + bodies.light)


def blur_layers(view: CameraView, static: PictureLayer, bodies: PictureLayer, threads: int) -> Floats:
    """Return the light (h · w, 3) of a picture with the depth of field of `view`."""
    high, wide = view.height, view.width
    total = np.zeros((high, wide, CHANNEL_COUNT), np.float32)
    sums = np.zeros((high, wide + 2, CHANNEL_COUNT), np.float32)
    radii = [_compute_radii(view, layer) for layer in (static, bodies)]
    for low, high_bound in pairwise(_LAYER_BOUNDS):
        for layer, radius in ((bodies, radii[1]), (static, radii[0])):
            pixels = np.flatnonzero((radius >= low) & (radius < high_bound) & (layer.cover > 0))
            if not len(pixels):
                continue
            values = np.concatenate([layer.light[pixels], layer.cover[pixels, None]], axis=1)
            steps = np.rint(np.abs(radius[pixels]) * RADIUS_STEPS_PER_PIXEL).astype(np.int64)
            table = _make_disc_table(int(steps.max()))
            work = partial(add_disc_averages, pixels, values, steps, table, wide, sums)
            parallel.run_in_parts(work, high, threads, _ROWS_PER_PART)
            parallel.run_in_parts(partial(add_layer_behind, sums, total), high, threads, _ROWS_PER_PART)
    flat = total.reshape(-1, CHANNEL_COUNT)
    return np.asarray(flat[:, :3] / np.maximum(flat[:, 3:], np.float32(1e-6)))


def _compute_radii(view: CameraView, layer: PictureLayer) -> Floats:
    """Return the signed radius (h · w,), in pixels, of the disc of each pixel. It is negative in front of the plane in focus."""
    depth = view.compute_depths(layer.distance)
    pixels_per_unit = view.width / (2 * view.half_extent[0])
    radius = view.aperture / 2 * pixels_per_unit * (1 / view.focus - 1 / np.maximum(depth, 1e-9))
    return np.clip(radius, -_MAX_RADIUS_PIXELS, _MAX_RADIUS_PIXELS).astype(np.float32)


@cache
def _make_disc_table(max_steps: int) -> DiscTable:
    """Return the rows of pixels of discs with radii up to `max_steps`. A disc is at least as wide as a pixel."""
    radius = np.maximum(np.arange(max_steps + 1) / RADIUS_STEPS_PER_PIXEL, 0.5)[:, None]
    row = np.arange(int(np.ceil(radius.max())) + 1)[None]
    half: NDArray[np.float64] = np.sqrt(np.maximum(radius * radius - row * row, 0.0))
    area = 2 * half[:, 0] + 4 * half[:, 1:].sum(axis=1)
    return DiscTable(half.astype(np.float32), (1 / area).astype(np.float32))
