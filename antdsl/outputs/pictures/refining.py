"""One sample per pixel, then more samples for pixels with an edge or a moving thing (Mitchell, SIGGRAPH 1987)."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureHits
from antdsl.outputs.pictures.light import SUN_HALF_ANGLE_TANGENT, tone_map
from antdsl.outputs.pictures.shading import PictureLighting, moving_light, still_light, sun_visibility
from antdsl.outputs.pictures.shading_rows import Floats, each, pieces
from antdsl.outputs.pictures.softness import open_share, sun_share
from antdsl.outputs.pictures.stage import StaticStage, SurfaceSamples, pixel_offset
from antdsl.outputs.pictures.trails import FieldDyes

Rows = NDArray[np.int64]

_CONTACT_RAYS_PER_PIXEL = 4  # of every fourth pixel
_VISIBLE_DIFFERENCE = 0.03  # difference of two pixels' display values that an eye sees
# Samples of a refined pixel at least, and of all of them for each pixel of the picture
_MIN_REFINED_SAMPLES, _MEAN_SAMPLES_PER_PIXEL = 4, 1.1


@dataclass(frozen=True, slots=True, eq=False)
class FirstPass:
    """Samples at pixel centres.

    `light` (h · w, 3): display-linear light.
    `behind` (h · w, 3): the same without moving bodies.
    `opened` (h · w,): the unoccluded share of the hemisphere above the surface.
    `front` (h · w,): whether a moving body is in front.
    `swept` (h · w,): whether a moving body is in front at any shutter time, or a tiny one may be there."""

    light: Floats
    behind: Floats
    opened: Floats
    front: NDArray[np.bool_]
    swept: NDArray[np.bool_]


def sample_middles(still: StaticStage, lighting: PictureLighting, dyes: FieldDyes) -> FirstPass:
    """Return the first pass: the light of all pixels, sampled at their centres."""
    samples, cast, threads = still.middle, lighting.cast, lighting.threads
    visible, opened = np.ones(len(samples), np.float32), still.shade
    if cast.size > 0:
        reach = 1.1 * cast.size
        shadowed, around = cast.may_be_shaded(samples.point, lighting.sun, (SUN_HALF_ANGLE_TANGENT * cast.throw, reach))
        visible = sun_share(
            still.grid, samples.sun, lighting.sun, cast.rays[:: 1 + (len(cast.rays) > 4)], cast.tall, threads, shadowed
        )
        contact = open_share(still.grid, cast.rays[len(cast.rays) // 2], reach, _CONTACT_RAYS_PER_PIXEL, threads, around)
        opened = opened * contact
    albedo = dyes.colour_samples(samples)
    behind = np.empty_like(samples.direction)

    def fill(own: slice) -> None:
        behind[own] = tone_map(still_light(lighting, samples, own, albedo[own], visible[own], opened[own]))

    each(fill, pieces(len(samples)), threads)
    light = behind.copy()
    front, swept = np.zeros(len(samples), np.bool_), cast.tiny.copy()
    near = np.flatnonzero(cast.near)
    every = [
        find_moving(still, lighting, near, samples.far[near], (0.5, 0.5), time_index) for time_index in range(len(cast.rays))
    ]
    hit_rows, hits = every[len(every) // 2]
    rows = near[hit_rows]
    front[rows] = True
    if len(every) > 1:
        for other, _ in every:
            swept[near[other]] = True
    start, direction = still.view.rays(rows)
    place = np.broadcast_to(start, direction.shape).astype(np.float32)
    for own in pieces(len(rows)):
        part = _select_hits(hits, own)
        lit = moving_light(lighting, part, place[own], direction[own], len(every) // 2, lighting.sun.towards)
        light[rows[own]] = tone_map(lit)
    return FirstPass(light, behind, opened, front, swept)


def find_moving(
    still: StaticStage, lighting: PictureLighting, pixels: Rows, far: Floats, place: tuple[float, float], time_index: int
) -> tuple[Rows, PictureHits]:
    """Return the rows of the rays that hit a moving body nearer than `far` at one shutter time, and these hits.

    `place`: the position of the rays in their pixels."""
    start, direction = still.view.rays(pixels, *place)
    hits = lighting.cast.rays[time_index].cast(start, direction, lighting.threads)
    rows = np.flatnonzero(hits.t < far)
    return rows, _select_hits(hits, rows)


def _select_hits(hits: PictureHits, rows: Rows | slice) -> PictureHits:
    return PictureHits(*(getattr(hits, each.name)[rows] for each in fields(PictureHits)))


def refine(still: StaticStage, lighting: PictureLighting, dyes: FieldDyes, first: FirstPass, most: int) -> Floats:
    """Return display-linear light (h · w, 3). Pixels with edges or motion are means of several samples, at most `most`."""
    light = first.light.copy()
    pixels = _unsettled_pixels(still, first)
    if most == 1 or not len(pixels):
        return light
    moments = len(lighting.cast.rays)
    count = int(np.clip(_MEAN_SAMPLES_PER_PIXEL * len(light) / len(pixels), _MIN_REFINED_SAMPLES if moments == 1 else 8, most))
    count = max(count, min(moments, most))
    spots = lighting.sun.spots(count)
    at_edge = still.grid.edge[pixels]
    edges, others = np.flatnonzero(at_edge), np.flatnonzero(~at_edge)
    total = np.zeros((len(pixels), 3), np.float32)
    # Shutter times are in another order than positions in the pixel.
    order = np.argsort(np.arange(count) * 0.6180339887498949 % 1.0, kind="stable") * moments // count
    for number, time_index in enumerate(order.tolist()):
        one = _EdgeSample(still, lighting, pixel_offset(number, count), time_index, spots[number])
        total[edges] += one.light_samples(dyes, first, still.edge_samples(number, count, lighting.threads))
        # Where the surface continues, the static light is that of the pixel's centre.
        total[others] += one.add_moving(pixels[others], still.middle.far[pixels[others]], first.behind[pixels[others]])
    light[pixels] = total / count
    return light


@dataclass(frozen=True, slots=True, eq=False)
class _EdgeSample:
    """One sample of several pixels: its position in the pixel, its shutter time, and its point on the sun's disc."""

    still: StaticStage
    lighting: PictureLighting
    place: tuple[float, float]
    time_index: int
    sunspot: Floats

    def light_samples(self, dyes: FieldDyes, first: FirstPass, samples: SurfaceSamples) -> Floats:
        """Return display-linear light (n, 3) of samples of static surfaces, and of moving bodies in front of them."""
        visible = sun_visibility(self.lighting, samples, self.time_index, self.sunspot)
        light = still_light(
            self.lighting, samples, slice(None), dyes.colour_samples(samples), visible, first.opened[samples.pixel]
        )
        return self.add_moving(samples.pixel, samples.far, tone_map(light))

    def add_moving(self, pixels: Rows, far: Floats, light: Floats) -> Floats:
        """Return `light` of pixels, replaced where a moving body is nearer than the static distance `far`."""
        near = np.flatnonzero(self.lighting.cast.near[pixels])
        rows, hits = find_moving(self.still, self.lighting, pixels[near], far[near], self.place, self.time_index)
        if len(rows):
            start, direction = self.still.view.rays(pixels[near[rows]], *self.place)
            begin = np.broadcast_to(start, direction.shape).astype(np.float32)
            light = light.copy()
            light[near[rows]] = tone_map(moving_light(self.lighting, hits, begin, direction, self.time_index, self.sunspot))
        return light


def _unsettled_pixels(still: StaticStage, first: FirstPass) -> Rows:
    """Return the pixels that need more samples: where surfaces meet or a body moves, and where a body differs from its
    neighbours."""
    high, wide = still.view.height, still.view.width
    unsettled = first.swept.copy().reshape(high, wide)
    front = first.front.reshape(high, wide)
    brightness = np.sqrt(first.light @ np.array([0.3, 0.6, 0.1], np.float32)).reshape(high, wide)
    for one_side, other_side in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = (front[one_side] | front[other_side]) & (
            np.abs(brightness[one_side] - brightness[other_side]) > _VISIBLE_DIFFERENCE
        )
        step |= front[one_side] != front[other_side]
        unsettled[one_side] |= step
        unsettled[other_side] |= step
    unsettled.reshape(-1)[still.edges] = True
    return np.flatnonzero(unsettled)
