"""Samples of static surfaces for one camera, cached from frame to frame as long as neither surfaces nor camera move.

Each pixel has one sample at its centre. Pixels in which one surface ends in front of another have several samples."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureHits
from antdsl.outputs.pictures import surface_materials
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.light import SunLight
from antdsl.outputs.pictures.shading_rows import (
    Floats,
    compute_dot_products,
    interpolate_vertices,
    normalise_rows,
    run_each,
    split_rows,
)
from antdsl.outputs.pictures.soft_shadows import PixelGrid, compute_open_share, compute_visible_share
from antdsl.outputs.pictures.static_setting import StaticSetting, add_pebbles
from antdsl.outputs.pictures.surface_materials import PictureScales, make_surface_material

SHADE_RAYS_PER_PIXEL = 6  # rays for every fourth pixel; 16 neighbouring such pixels use different directions
_SHADE_REACH_PER_BODY = 11  # body lengths; within this distance, things shade each other
_EDGE_NORMAL_COSINE = 0.86  # cosine between normals; below it, two pixels are on two sides of an edge
_EDGE_STEP_PIXELS = 4.0  # pixel widths; a neighbour farther off the plane is on a surface behind


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples:
    """n samples of static surfaces, one per ray.

    `pixel` int64: the pixel of the ray. `direction` (n, 3), `distance`: the unit direction and the length of the ray (inf for the
    sky). `point`, `normal`, `albedo` (n, 3): position, smooth normal and colour of the surface. `sun_cosine`: cosine of the angle
    between the sun and the normal; 0 in shadow. `up_cosine`, `view_cosine`: cosines of the normal with up, and with the direction
    back to the camera. `kind`: an index in KIND_NAMES. `extra_light` (n, 3): emitted and reflected light."""

    pixel: NDArray[np.int64]
    direction: Floats
    distance: Floats
    point: Floats
    normal: Floats
    albedo: Floats
    sun_cosine: Floats
    up_cosine: Floats
    view_cosine: Floats
    kind: NDArray[np.uint8]
    extra_light: Floats

    def __len__(self) -> int:
        return len(self.pixel)

    @property
    def colourable_rows(self) -> NDArray[np.int64]:
        """Return the rows of the samples on surfaces that show colours of fields."""
        return np.flatnonzero(np.isfinite(self.distance) & np.isin(self.kind, surface_materials.TRAIL_KINDS))


@dataclass(slots=True, eq=False)
class StaticStage:
    """The samples of static surfaces for one camera.

    `centre_samples`: one sample per pixel. `edge_pixels` (e,): the pixels with several surfaces. `edge_sample_cache`: the samples
    of all edges, by sample number and count. `open_share` (h · w,): the unoccluded fraction of the hemisphere above each pixel's
    surface. `is_reused`: whether samples are cached, because the stage is used for several frames."""

    setting: StaticSetting
    view: CameraView
    centre_samples: SurfaceSamples
    grid: PixelGrid
    open_share: Floats
    edge_pixels: NDArray[np.int64]
    sun: SunLight
    scales: PictureScales
    edge_sample_cache: dict[tuple[int, int], SurfaceSamples] = field(default_factory=dict)
    is_reused: bool = False

    def sample_edges(self, number: int, count: int, threads: int) -> SurfaceSamples:
        """Return sample `number` of `count` for all pixels with edges."""
        key = (number, count)
        sample_set = self.edge_sample_cache.get(key) or self.sample_pixels(self.edge_pixels, number, count, threads)
        if self.is_reused and key not in self.edge_sample_cache:
            self.edge_sample_cache = {
                known: samples for known, samples in self.edge_sample_cache.items() if known[1] == count
            } | {key: sample_set}
        return sample_set

    def sample_pixels(self, pixels: NDArray[np.int64], number: int, count: int, threads: int) -> SurfaceSamples:
        """Return sample `number` of `count` for the given pixels. Each has a different ray to the sun."""
        across, down = compute_pixel_offset(number, count)
        samples = _sample_position(self.setting, self.view, pixels, (across, down), self.sun, self.scales, threads)
        lit = np.flatnonzero(samples.sun_cosine > 0)
        start = samples.point[lit] + samples.normal[lit] * np.float32(self.grid.ray_offset)
        aim = np.broadcast_to(self.sun.sample_disc(count)[number], start.shape)
        samples.sun_cosine[lit[self.setting.rays.find_occluded_rays(start, aim, threads=threads)]] = 0
        return samples


def compute_pixel_offset(number: int, count: int) -> tuple[float, float]:
    """Return the position of sample `number` of `count` in its pixel, as fractions from the upper left corner.

    The positions form the lattice of Roberts' sequence R2, which is even for any count."""
    return (0.5 + (number + 1) * 0.7548776662466927) % 1.0, (0.5 + (number + 1) * 0.5698402909980532) % 1.0


def make_stage(setting: StaticSetting, view: CameraView, sun: SunLight, scales: PictureScales, threads: int) -> StaticStage:
    """Return the samples of all static surfaces for a camera, with their colours."""
    setting = add_pebbles(setting, view, scales)
    middle = _sample_position(setting, view, np.arange(view.width * view.height), (0.5, 0.5), sun, scales, threads)
    solid = np.isfinite(middle.distance)
    edge = _find_edges(view, middle, solid)
    grid = PixelGrid(view, middle.point, middle.normal, solid, edge, 3e-5 * scales.extent)
    middle.sun_cosine[:] *= compute_visible_share(grid, middle.sun_cosine, sun, [setting.rays], np.inf, threads)
    shade = compute_open_share(grid, setting.rays, _SHADE_REACH_PER_BODY * scales.grain, SHADE_RAYS_PER_PIXEL, threads)
    return StaticStage(setting, view, middle, grid, shade, np.flatnonzero(edge), sun, scales)


def _sample_position(
    setting: StaticSetting,
    view: CameraView,
    pixels: NDArray[np.int64],
    pixel_position: tuple[float, float],
    sun: SunLight,
    scales: PictureScales,
    threads: int,
) -> SurfaceSamples:
    """Return samples of `pixels` at the same position in each pixel, `pixel_position`, before shadows are applied."""
    n = len(pixels)
    three = [np.zeros((n, 3), np.float32) for _ in range(5)]
    direction, point, normal, albedo, glow = three
    far, light, upness, facing = (np.zeros(n, np.float32) for _ in range(4))
    kind = np.zeros(n, np.uint8)

    def fill_pixels(chunk: slice) -> None:
        start, towards = view.make_rays(pixels[chunk], *pixel_position)
        hits = setting.rays.find_first_hits(start, towards, threads)
        direction[chunk], far[chunk] = towards, hits.t
        hit_rows = np.flatnonzero(hits.face >= 0)
        first = chunk.start + hit_rows
        begin = start if start.ndim == 1 else start[hit_rows]
        where: Floats = begin.astype(np.float32) + hits.t[hit_rows, None] * towards[hit_rows]
        look, smooth = _make_surface_materials(setting, view, hits, towards[hit_rows], where, hit_rows, scales)
        point[first], normal[first], albedo[first] = where, smooth, look.albedo
        upness[first], facing[first] = look.normal @ sun.up, -compute_dot_products(look.normal, towards[hit_rows])
        kind[first] = setting.kind[hits.face[hit_rows]]
        glow[first] = surface_materials.compute_glow(kind[first], look, towards[hit_rows], sun)
        # A coarse mesh shades its own smooth slopes in steps at grazing light, so the shadow is faded out there.
        grazing = np.clip((smooth @ sun.direction) * 7, 0, 1)
        light[first] = np.clip(look.normal @ sun.direction, 0, 1) * grazing

    run_each(fill_pixels, split_rows(n), threads)
    return SurfaceSamples(pixels, direction, far, point, normal, albedo, light, upness, facing, kind, glow)


def _make_surface_materials(
    setting: StaticSetting,
    view: CameraView,
    hits: PictureHits,
    direction: Floats,
    points: Floats,
    hit_rows: NDArray[np.int64],
    scales: PictureScales,
) -> tuple[surface_materials.SurfaceMaterial, Floats]:
    """Return the materials of the samples that hit a surface, and the smooth normals (n, 3) of these samples, without grain."""
    face = hits.face[hit_rows]
    corners = setting.faces[face]
    flat, u, v = hits.normal[hit_rows], hits.u[hit_rows], hits.v[hit_rows]
    smooth = normalise_rows(interpolate_vertices(setting.normal, corners, u, v))
    smooth *= np.where(compute_dot_products(smooth, flat) < 0, np.float32(-1), np.float32(1))[:, None]
    pixel = np.asarray(view.compute_pixel_size(hits.t[hit_rows]), np.float32) * np.float32(0.6)
    # At a flat angle, a pixel covers more of the ground.
    pixel /= np.sqrt(np.clip(-compute_dot_products(flat, direction), 0.04, 1.0))
    painted = interpolate_vertices(setting.vertex_colours, corners, u, v)
    look = make_surface_material(setting.kind[face], points, smooth.copy(), setting.up, pixel, scales, painted)
    return look, np.where((compute_dot_products(smooth, flat) > 0.1)[:, None], smooth, flat)


def _find_edges(view: CameraView, middle: SurfaceSamples, solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the pixels (h · w,) that have another surface next to them, on either side of the edge."""
    high, wide = view.height, view.width
    edges = np.zeros((high, wide), np.bool_)
    normal, point = middle.normal.reshape(high, wide, 3), middle.point.reshape(high, wide, 3)
    kind = np.where(solid, middle.kind, 255).reshape(high, wide)
    width = (
        np.asarray(view.compute_pixel_size(np.where(solid, middle.distance, 0)), np.float32).reshape(high, wide)
        * _EDGE_STEP_PIXELS
    )
    for one_side, other_side in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        is_edge = np.einsum("abc,abc->ab", normal[one_side], normal[other_side]) < _EDGE_NORMAL_COSINE
        gap = point[other_side] - point[one_side]
        off = [np.abs(np.einsum("abc,abc->ab", gap, normal[side])) for side in (one_side, other_side)]
        is_edge |= np.minimum(*off) > np.minimum(width[one_side], width[other_side])
        is_edge |= kind[one_side] != kind[other_side]
        is_edge &= (kind[one_side] != 255) | (kind[other_side] != 255)
        edges[one_side] |= is_edge
        edges[other_side] |= is_edge
    return edges.reshape(-1)
