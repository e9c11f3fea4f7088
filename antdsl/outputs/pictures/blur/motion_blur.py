"""Motion blur: samples of bodies and static surfaces, spread along their paths while the shutter is open.

Bodies are sampled at a few times. In the picture, a sample covers its path from halfway to the previous time until halfway to the
next. So the paths of all samples join, and no copies of the body are visible."""

from __future__ import annotations

import numpy as np

from antdsl.numerics.imaging.spreading import add_line_averages
from antdsl.outputs.pictures.blur.depth_of_field import PictureLayer
from antdsl.outputs.pictures.light import apply_tone_curve
from antdsl.outputs.pictures.shading import PictureLighting, compute_moving_light
from antdsl.outputs.pictures.shading_rows import Floats, interpolate_vertices, split_rows
from antdsl.outputs.pictures.static_stage import StaticStage, compute_pixel_offset

_MAX_LINE_STEPS = 256
_MIN_SAMPLES = 8  # of a pixel
_MAX_FAR_DISTANCE = 1e4  # in extents of the set; the sky moves with the camera as if it were there
_SOLID_COVER = 0.94  # a pixel that is covered for this share has no gap; samples of turning bodies diverge


def smear_bodies(lighting: PictureLighting) -> PictureLayer:
    """Return the layer of the moving bodies, each spread along its path."""
    actors, shutter, view = lighting.actors, lighting.shutter, lighting.view
    pixels = np.flatnonzero(actors.near_pixels)
    sums = np.zeros((view.height, view.width, 5), np.float32)
    times = len(actors.times)
    count = times * -(-_MIN_SAMPLES // times)
    half = shutter.open_frames / times / 2
    spots = lighting.sun.sample_disc(count)
    for number in range(count):
        time_index = number % times
        time = actors.times[time_index]
        views = shutter.find_view(time - half), shutter.find_view(time), shutter.find_view(time + half)
        start, direction = views[1].make_rays(pixels, *compute_pixel_offset(number, count))
        for own in split_rows(len(pixels)):
            begin = start if start.ndim == 1 else start[own]
            hits = actors.rays[time_index].find_first_hits(begin, direction[own], lighting.threads)
            rows = np.flatnonzero(np.isfinite(hits.t))
            if not len(rows):
                continue
            aim = direction[own][rows]
            origin = np.broadcast_to(begin, direction[own].shape)[rows].astype(np.float32)
            behind = lighting.ground.find_first_hits(origin, aim, lighting.threads).t
            is_visible = hits.t[rows] < behind
            aim, origin, part = aim[is_visible], origin[is_visible], hits.select_rows(rows[is_visible])
            light = apply_tone_curve(compute_moving_light(lighting, part, origin, aim, time_index, spots[number]))
            corners = actors.mesh.faces[part.face]
            path = interpolate_vertices(actors.mesh.motion, corners, part.u, part.v).astype(np.float64) * half
            point = origin + part.t[:, None].astype(np.float64) * aim
            lines = np.concatenate([views[0].project(point - path)[0], views[2].project(point + path)[0]], axis=1)
            weight = np.full((len(aim), 1), 1 / count, np.float32)
            values = np.concatenate([light * weight, weight, part.t[:, None] * weight], axis=1).astype(np.float32)
            add_line_averages(lines.astype(np.float32), values, _MAX_LINE_STEPS, sums, 0, len(lines))
    flat = sums.reshape(-1, 5)
    weight = flat[:, 3]
    cover = np.minimum(weight / _SOLID_COVER, 1)
    share = cover / np.maximum(weight, 1e-6)
    return PictureLayer(flat[:, :3] * share[:, None], cover, flat[:, 4] / np.maximum(weight, 1e-6))


def smear_surfaces(stage: StaticStage, lighting: PictureLighting, light: Floats) -> PictureLayer:
    """Return the layer of static surfaces, spread along the paths on which they pass a moving camera.

    `light` (h · w, 3): their light halfway through the exposure."""
    view, shutter, samples = lighting.view, lighting.shutter, stage.centre_samples
    far = np.minimum(samples.distance, _MAX_FAR_DISTANCE * lighting.scales.extent)
    start, _ = view.make_rays(samples.pixel)
    sums = np.zeros((view.height, view.width, 5), np.float32)
    for own in split_rows(len(samples)):
        begin = start if start.ndim == 1 else start[own]
        point = begin + far[own, None].astype(np.float64) * samples.direction[own]
        lines = np.concatenate([shutter.first.project(point)[0], shutter.last.project(point)[0]], axis=1)
        values = np.concatenate([light[own], np.ones((len(point), 1)), far[own, None]], axis=1).astype(np.float32)
        add_line_averages(lines.astype(np.float32), values, _MAX_LINE_STEPS, sums, 0, len(lines))
    flat = sums.reshape(-1, 5)
    weight = flat[:, 3]
    seen = weight > 1e-3
    mean = np.where(seen[:, None], flat[:, :3] / np.maximum(weight, 1e-3)[:, None], light)
    distance = np.where(seen, flat[:, 4] / np.maximum(weight, 1e-3), far)
    return PictureLayer(mean, np.ones(len(mean), np.float32), distance)
