"""The samples of a picture: first one per pixel, then more in pixels with an edge or a moving body (Mitchell, SIGGRAPH 1987)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureHits
from antdsl.outputs.pictures.blur.depth_of_field import PictureLayer
from antdsl.outputs.pictures.lamps import compute_lamp_light
from antdsl.outputs.pictures.light import SUN_HALF_ANGLE_TANGENT, apply_tone_curve
from antdsl.outputs.pictures.shading import PictureLighting, compute_moving_light, compute_static_light, compute_sun_visibility
from antdsl.outputs.pictures.shading_rows import Floats, run_each, split_rows
from antdsl.outputs.pictures.soft_shadows import compute_open_share, compute_visible_share
from antdsl.outputs.pictures.static_stage import StaticStage, SurfaceSamples, compute_pixel_offset
from antdsl.outputs.pictures.trail_colours import FieldColours

Rows = NDArray[np.int64]

_CONTACT_RAYS_PER_PIXEL = 4  # for every fourth pixel
_VISIBLE_DIFFERENCE = 0.03  # difference of two pixels' display values that is visible
# Minimum number of samples of a refined pixel, and mean number of samples per pixel of the picture
_MIN_REFINED_SAMPLES, _MEAN_SAMPLES_PER_PIXEL = 4, 1.1


@dataclass(frozen=True, slots=True, eq=False)
class FirstPass:
    """The results of one sample at the centre of each pixel.

    `light` (h · w, 3): display-linear light. `background_light` (h · w, 3): the light without moving bodies. `open_share` (h ·
    w,): the fraction of the hemisphere above the surface that is not occluded. `body_distance` (h · w,): the distance of a moving
    body in front, infinite if there is none."""

    light: Floats
    background_light: Floats
    open_share: Floats
    body_distance: Floats


def sample_centres(static_stage: StaticStage, lighting: PictureLighting, dyes: FieldColours) -> FirstPass:
    """Return the first pass: the light of all pixels, sampled at their centres."""
    samples, cast, threads = static_stage.centre_samples, lighting.actors, lighting.threads
    visible, opened = np.ones(len(samples), np.float32), static_stage.open_share
    if cast.contact_reach > 0:
        reach = 1.1 * cast.contact_reach
        shadowed, around = cast.find_shadable_points(
            samples.point, lighting.sun, (SUN_HALF_ANGLE_TANGENT * cast.soft_edge_reach, reach)
        )
        visible = compute_visible_share(
            static_stage.grid,
            samples.sun_cosine,
            lighting.sun,
            cast.rays[:: 1 + (len(cast.rays) > 4)],
            cast.shadow_reach,
            threads,
            shadowed,
        )
        contact = compute_open_share(
            static_stage.grid, cast.rays[len(cast.rays) // 2], reach, _CONTACT_RAYS_PER_PIXEL, threads, around
        )
        opened = opened * contact
    albedo = dyes.colour_samples(samples)
    behind = np.empty_like(samples.direction)

    lamp_light = _compute_lamp_light(static_stage, lighting)

    def fill_pixels(chunk: slice) -> None:
        lamps = None if lamp_light is None else lamp_light[chunk]
        lit = compute_static_light(lighting, samples, chunk, albedo[chunk], visible[chunk], opened[chunk], lamps)
        behind[chunk] = apply_tone_curve(lit)

    run_each(fill_pixels, split_rows(len(samples)), threads)
    light = behind.copy()
    body_distance = np.full(len(samples), np.inf, np.float32)
    if lighting.shutter.open_frames <= 0:
        near = np.flatnonzero(cast.near_pixels)
        hit_rows, hits = find_moving_hits(static_stage, lighting, near, samples.distance[near], (0.5, 0.5))
        rows = near[hit_rows]
        body_distance[rows] = hits.t
        start, direction = static_stage.view.make_rays(rows)
        place = np.broadcast_to(start, direction.shape).astype(np.float32)
        for own in split_rows(len(rows)):
            lit = compute_moving_light(lighting, hits.select_rows(own), place[own], direction[own], 0, lighting.sun.direction)
            light[rows[own]] = apply_tone_curve(lit)
    return FirstPass(light, behind, opened, body_distance)


def _compute_lamp_light(static_stage: StaticStage, lighting: PictureLighting) -> Floats | None:
    """Return the light (h · w, 3) of lamps at the surface in each pixel, with soft shadows. None if there are no lamps."""
    if not lighting.lamps:
        return None
    samples, light = static_stage.centre_samples, np.zeros_like(static_stage.centre_samples.direction)
    middle = lighting.actors.lamp_occluders[len(lighting.actors.rays) // 2]
    for lamp in lighting.lamps:
        own = lamp.compute_light(samples.point, samples.normal)
        facing = own.max(axis=1, initial=0) - np.float32(1e-4)
        for rays in (lighting.ground, middle):
            own *= compute_visible_share(static_stage.grid, facing, lamp, [rays], 1.0, lighting.threads)[:, None]
        light += own
    light[~np.isfinite(samples.distance)] = 0
    return light


def find_moving_hits(
    static_stage: StaticStage,
    lighting: PictureLighting,
    pixels: Rows,
    max_distances: Floats,
    position_in_pixel: tuple[float, float],
) -> tuple[Rows, PictureHits]:
    """Return the rows of the rays that hit a moving body nearer than `max_distances`, and these hits.

    `position_in_pixel`: the position of the ray in its pixel, as fractions from the upper left corner."""
    start, direction = static_stage.view.make_rays(pixels, *position_in_pixel)
    hits = lighting.actors.rays[0].find_first_hits(start, direction, lighting.threads)
    rows = np.flatnonzero(hits.t < max_distances)
    return rows, hits.select_rows(rows)


def refine_pixels(
    static_stage: StaticStage, lighting: PictureLighting, dyes: FieldColours, first: FirstPass, samples: int
) -> tuple[PictureLayer, PictureLayer]:
    """Return the layers of static surfaces and of moving bodies. With an open shutter, there are no bodies.

    Pixels with edges get the mean of several samples, at most 2 · `samples`². All other pixels get the light in `first`."""
    is_body, max_samples = np.isfinite(first.body_distance), 2 * samples**2 if samples > 1 else 1
    static = PictureLayer(first.background_light.copy(), np.ones(len(is_body), np.float32), static_stage.centre_samples.distance)
    bodies = PictureLayer(np.where(is_body[:, None], first.light, np.float32(0)), is_body.astype(np.float32), first.body_distance)
    is_sharp = lighting.shutter.open_frames <= 0
    pixels = (
        _find_unsettled_pixels(static_stage, first, lighting.actors.tiny_body_pixels) if is_sharp else static_stage.edge_pixels
    )
    if max_samples == 1 or not len(pixels):
        return static, bodies
    if lighting.shutter.has_camera_motion:  # the edges are blurred anyway
        max_samples = _MIN_REFINED_SAMPLES
    count = int(np.clip(_MEAN_SAMPLES_PER_PIXEL * len(is_body) / len(pixels), _MIN_REFINED_SAMPLES, max_samples))
    spots = lighting.sun.sample_disc(count)
    at_edge = static_stage.grid.is_edge[pixels]
    edges, others = np.flatnonzero(at_edge), pixels[~at_edge]
    edge_light, body_sums = np.zeros((len(edges), 3), np.float32), np.zeros((len(is_body), 5), np.float32)
    times = len(lighting.actors.times)
    for number in range(count):
        one = _EdgeSample(
            static_stage, lighting, compute_pixel_offset(number, count), number * times // count, spots[number], number, count
        )
        at_edges = static_stage.sample_edges(number, count, lighting.threads)
        edge_light += one.compute_light(dyes, first, at_edges)
        if is_sharp:
            one.add_bodies(at_edges.pixel, at_edges.distance, body_sums)
            # Where the surface continues, the static light of the pixel's centre is used.
            one.add_bodies(others, static_stage.centre_samples.distance[others], body_sums)
    static.light[pixels[edges]] = edge_light / count
    own = body_sums[pixels]
    bodies.light[pixels], bodies.cover[pixels] = own[:, :3] / count, own[:, 3] / count
    bodies.distance[pixels] = own[:, 4] / np.maximum(own[:, 3], 1e-6)
    return static, bodies


@dataclass(frozen=True, slots=True, eq=False)
class _EdgeSample:
    """Sample `number` of `count` in all pixels that need several samples.

    `position_in_pixel`: the position of its rays in their pixels. `time_index`: the index of its shutter time. `sun_point`: its
    point on the sun's disc."""

    stage: StaticStage
    lighting: PictureLighting
    position_in_pixel: tuple[float, float]
    time_index: int
    sun_point: Floats
    number: int
    count: int

    def compute_light(self, dyes: FieldColours, first: FirstPass, samples: SurfaceSamples) -> Floats:
        """Return the display-linear light (n, 3) of samples of static surfaces."""
        visible = compute_sun_visibility(self.lighting, samples, self.time_index, self.sun_point)
        shot, lamps = self.lighting, None
        if shot.lamps:
            occluders = (shot.ground, shot.actors.lamp_occluders[self.time_index])
            lamps = compute_lamp_light(
                shot.lamps, samples.point, samples.normal, shot.ray_offset, occluders, self.number, self.count, shot.threads
            )
        return apply_tone_curve(
            compute_static_light(
                shot, samples, slice(None), dyes.colour_samples(samples), visible, first.open_share[samples.pixel], lamps
            )
        )

    def add_bodies(self, pixels: Rows, max_distances: Floats, sums: Floats) -> None:
        """Add the samples of moving bodies to `sums` (h · w, 5): light (3 columns), count, and distance.

        `max_distances` (n,): the distances of the static surfaces at `pixels`, which hide bodies behind them."""
        near = np.flatnonzero(self.lighting.actors.near_pixels[pixels])
        rows, hits = find_moving_hits(self.stage, self.lighting, pixels[near], max_distances[near], self.position_in_pixel)
        if len(rows):
            own = pixels[near[rows]]
            start, direction = self.stage.view.make_rays(own, *self.position_in_pixel)
            begin = np.broadcast_to(start, direction.shape).astype(np.float32)
            light = compute_moving_light(self.lighting, hits, begin, direction, 0, self.sun_point)
            ones = np.ones((len(own), 1), np.float32)
            sums[own] += np.concatenate([apply_tone_curve(light), ones, hits.t[:, None]], axis=1)


def _find_unsettled_pixels(static_stage: StaticStage, first: FirstPass, tiny_body_pixels: NDArray[np.bool_]) -> Rows:
    """Return the pixels that need more samples.

    These are pixels in which two surfaces meet or a tiny body may be, and pixels with a body that differ from their
    neighbours."""
    high, wide = static_stage.view.height, static_stage.view.width
    unsettled = tiny_body_pixels.copy().reshape(high, wide)
    front = np.isfinite(first.body_distance).reshape(high, wide)
    brightness = np.sqrt(first.light @ np.array([0.3, 0.6, 0.1], np.float32)).reshape(high, wide)
    for one_side, other_side in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        step = (front[one_side] | front[other_side]) & (
            np.abs(brightness[one_side] - brightness[other_side]) > _VISIBLE_DIFFERENCE
        )
        step |= front[one_side] != front[other_side]
        unsettled[one_side] |= step
        unsettled[other_side] |= step
    unsettled.reshape(-1)[static_stage.edge_pixels] = True
    return np.flatnonzero(unsettled)
