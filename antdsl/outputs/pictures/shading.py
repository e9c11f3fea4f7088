"""The light of samples: static surfaces with the shadows of moving bodies, the moving bodies themselves, sky and haze."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureHits, PictureRays
from antdsl.outputs.pictures import surface_materials
from antdsl.outputs.pictures.blur.shutter import Shutter
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.lamps import Lamp, compute_lamp_light
from antdsl.outputs.pictures.light import HEADLAMP_LIGHT, SunLight, apply_haze, compute_ambient_light, compute_sky_light
from antdsl.outputs.pictures.moving_bodies import SceneActors
from antdsl.outputs.pictures.shading_rows import Floats, compute_dot_products, interpolate_vertices, normalise_rows
from antdsl.outputs.pictures.static_stage import SurfaceSamples
from antdsl.outputs.pictures.surface_materials import PictureScales

Rows = NDArray[np.int64]

_HAZE_EXTENTS = 2.2  # extents of the set; haze hides most things beyond this distance
_TABLE_FADE_EXTENTS = 3.2  # extents; beyond them, the table has the colour of the sky
_RAY_OFFSET_EXTENTS = 2e-5  # extents; distance of ray origins from a surface


@dataclass(frozen=True, slots=True, eq=False)
class PictureLighting:
    """Everything that determines the light in a frame.

    `actors`: the moving bodies. `ground`: the rays to static surfaces. `view`: the camera halfway through the exposure by the
    `shutter`. `lamps`: items that emit light."""

    actors: SceneActors
    ground: PictureRays
    sun: SunLight
    scales: PictureScales
    view: CameraView
    threads: int
    shutter: Shutter
    lamps: tuple[Lamp, ...] = ()

    @property
    def ray_offset(self) -> float:
        """Return the distance between a surface and the origins of rays from it, in world units."""
        return _RAY_OFFSET_EXTENTS * self.scales.extent


def compute_static_light(
    lighting: PictureLighting,
    samples: SurfaceSamples,
    rows: slice,
    albedo: Floats,
    sun_share: Floats,
    open_share: Floats,
    lamp_light: Floats | None = None,
) -> Floats:
    """Return the light (n, 3) of the samples `rows` of static surfaces.

    `albedo` (n, 3): their colours. `sun_share`, `open_share` (n,): the fractions of sunlight and skylight that reach the samples.
    `lamp_light` (n, 3): the light of lamps at the samples; None if there are none."""
    sun, extent = lighting.sun, lighting.scales.extent
    far, direction = samples.distance[rows], samples.direction[rows]
    direct = samples.sun_cosine[rows] * sun_share
    light = compute_ambient_light(samples.up_cosine[rows], sun) * open_share[:, None] + direct[:, None] * sun.sunlight
    light += compute_headlamp_light(samples.view_cosine[rows], direct, open_share)
    if lamp_light is not None:
        light += lamp_light
    light *= albedo
    light += samples.extra_light[rows] * (0.25 + 0.75 * open_share)[:, None]
    light = apply_haze(light, far, direction, sun, _HAZE_EXTENTS * extent)
    table = np.flatnonzero(samples.kind[rows] == surface_materials.TABLE_KIND)
    if len(table):  # the table fades sooner, so that its edge is never visible
        fade = 1 - np.exp(-np.square(far[table] / np.float32(_TABLE_FADE_EXTENTS * extent)))
        level = direction[table] - (direction[table] @ sun.up)[:, None] * sun.up
        light[table] += (compute_sky_light(level, sun) - light[table]) * fade[:, None]
    empty = np.flatnonzero(~np.isfinite(far))
    light[empty] = compute_sky_light(direction[empty], sun)
    return light


def compute_headlamp_light(facing: Floats, direct_light: Floats, open_share: Floats) -> Floats:
    """Return the light (n, 3) of a lamp next to the camera, at points that get no light from the sun or the sky.

    It makes tunnels and chambers visible."""
    dark = np.clip(1.15 - 1.5 * open_share, 0, 1) * np.clip(1 - 3 * direct_light, 0, 1)
    return np.asarray(HEADLAMP_LIGHT * (dark * (0.25 + 0.75 * np.clip(facing, 0, 1)))[:, None])


def compute_sun_visibility(lighting: PictureLighting, samples: SurfaceSamples, time_index: int, sun_point: Floats) -> Floats:
    """Return 1 for samples (n,) in sunlight, 0 for samples in the shadow of a moving body.

    `sun_point`: the point of the sun's disc. `time_index`: the index of the shutter time."""
    visible = np.ones(len(samples), np.float32)
    if lighting.actors.contact_reach > 0:
        lit = np.flatnonzero(samples.sun_cosine > 0)
        start = samples.point[lit] + samples.normal[lit] * np.float32(_RAY_OFFSET_EXTENTS * lighting.scales.extent)
        aim = np.broadcast_to(sun_point, start.shape)
        cast = lighting.actors.rays[time_index]
        visible[lit[cast.find_occluded_rays(start, aim, lighting.actors.shadow_reach, lighting.threads)]] = 0
    return visible


def compute_moving_light(
    lighting: PictureLighting, hits: PictureHits, start: Floats, direction: Floats, time_index: int, sun_point: Floats
) -> Floats:
    """Return the light (n, 3) along rays from `start` in `direction` (n, 3) that hit a moving body, at one shutter time.

    A material is one of three kinds: matt with a coat that reflects sky, ground and sun; metal, which reflects more; a light
    source."""
    mesh, sun = lighting.actors.mesh, lighting.sun
    corners = mesh.faces[hits.face]
    normal = normalise_rows(interpolate_vertices(mesh.normal, corners, hits.u, hits.v))
    normal *= np.where(compute_dot_products(normal, hits.normal) < 0, np.float32(-1), np.float32(1))[:, None]
    colour = interpolate_vertices(mesh.colour, corners, hits.u, hits.v)
    gloss = mesh.gloss[corners[:, 0]]
    where: Floats = start + hits.t[:, None] * direction
    where += hits.normal * np.float32(_RAY_OFFSET_EXTENTS * lighting.scales.extent)
    soil = np.flatnonzero(gloss == 0)
    if len(soil):
        wide = np.asarray(lighting.view.compute_pixel_size(hits.t[soil]), np.float32) * np.float32(0.6)
        look = surface_materials.make_soil_material(colour[soil], normal[soil], where[soil], wide, lighting.scales)
        colour[soil], normal[soil] = look.albedo, look.normal
    facing = np.clip(normal @ sun.direction, 0, 1)
    facing *= np.clip((hits.normal @ sun.direction) * 6 + 0.6, 0, 1)
    _apply_shadow(lighting, facing, where, time_index, sun_point)
    upness = normal @ sun.up
    half = normalise_rows(sun_point - direction)
    shine = (
        gloss
        * (
            0.5 * np.clip(compute_dot_products(normal, half), 0, 1) ** 60
            + 0.12 * np.clip(compute_dot_products(normal, half), 0, 1) ** 12
        )
        * (facing > 0)
    )
    # Undersides mostly reflect the ground nearby, which the body shades.
    near = 0.42 + 0.58 * np.clip(0.55 + 0.75 * upness, 0, 1)
    metal = gloss > 1
    arriving = facing[:, None] * sun.sunlight + compute_ambient_light(upness, sun) * near[:, None]
    if lighting.lamps:
        occluders = lighting.actors.lamp_occluders[time_index], lighting.ground
        arriving += compute_lamp_light(
            lighting.lamps, where, normal, lighting.ray_offset, occluders, 0, 1, lighting.threads, hits.normal
        )
    light: Floats = colour * arriving
    coat = surface_materials.compute_reflected_share(normal, direction, 0.04) * gloss
    coat[metal] = surface_materials.compute_reflected_share(normal[metal], direction[metal], 0.8)
    tint = np.where(metal[:, None], surface_materials.STEEL_COLOUR, np.float32(1))
    light *= np.where(metal, np.float32(0.3), np.float32(1))[:, None]
    light += surface_materials.compute_reflection(normal, direction, sun) * (coat * near)[:, None] * tint
    light += shine[:, None] * sun.sunlight
    light[gloss < 0] = surface_materials.LIGHT_COLOUR * surface_materials.LIGHT_BRIGHTNESS
    return apply_haze(light, hits.t, direction, sun, _HAZE_EXTENTS * lighting.scales.extent)


def _apply_shadow(lighting: PictureLighting, facing: Floats, points: Floats, time_index: int, sun_point: Floats) -> None:
    """Set the sunlight `facing` (n,) to 0 at points (n, 3) from which the sun is hidden by a body or a surface."""
    cast, threads = lighting.actors, lighting.threads
    lit = np.flatnonzero(facing > 0)
    aim = np.broadcast_to(sun_point, (len(lit), 3))
    hidden = cast.rays[time_index].find_occluded_rays(points[lit], aim, cast.shadow_reach, threads)
    open_to = np.flatnonzero(~hidden)
    hidden[open_to] = lighting.ground.find_occluded_rays(points[lit[open_to]], aim[open_to], threads=threads)
    facing[lit[hidden]] = 0
