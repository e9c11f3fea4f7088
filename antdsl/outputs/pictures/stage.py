"""Samples of static surfaces for one camera, cached from frame to frame while neither surfaces nor camera move.

There is one sample at the centre of each pixel, and several samples for pixels in which one surface ends before another."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureHits
from antdsl.outputs.pictures import looks
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.light import SunLight
from antdsl.outputs.pictures.looks import PictureScales, surface_look
from antdsl.outputs.pictures.setting import StaticSetting, with_pebbles
from antdsl.outputs.pictures.shading_rows import Floats, dots, each, interpolate_vertices, pieces, units
from antdsl.outputs.pictures.softness import PixelGrid, open_share, sun_share

SHADE_RAYS_PER_PIXEL = 6  # of every fourth pixel, each of 16 of which asks in other directions
_SHADE_REACH_PER_BODY = 11  # body lengths within which things shade each other
_EDGE_NORMAL_COSINE = 0.86  # cosine between normals from which on they are of two sides of an edge
_EDGE_STEP_PIXELS = 4.0  # pixels' widths off its plane from which on a neighbour lies behind


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceSamples:
    """n samples of static surfaces, one per ray.

    `pixel` int64: the pixel of the ray.
    `direction` (n, 3), `far`: unit direction and length of the ray (inf: sky).
    `point`, `normal`, `albedo` (n, 3): position, smooth normal and colour.
    `sun`: cosine of the angle between the sun and the normal; 0 in shadow.
    `upness`, `facing`: cosines of the normal with up, and with the direction back to the camera.
    `kind`: index in SURFACE_KINDS.
    `glow` (n, 3): emitted and reflected light."""

    pixel: NDArray[np.int64]
    direction: Floats
    far: Floats
    point: Floats
    normal: Floats
    albedo: Floats
    sun: Floats
    upness: Floats
    facing: Floats
    kind: NDArray[np.uint8]
    glow: Floats

    def __len__(self) -> int:
        return len(self.pixel)

    @property
    def trail_rows(self) -> NDArray[np.int64]:
        """Return the samples on which a field's colour may lie."""
        return np.flatnonzero(np.isfinite(self.far) & np.isin(self.kind, looks.TRAIL_KINDS))


@dataclass(slots=True, eq=False)
class StaticStage:
    """Samples of static surfaces for one camera.

    `middle`: one sample per pixel.
    `edges` (e,): pixels with several surfaces.
    `fine`: by sample number and count, the samples of all edges.
    `shade` (h · w,): the unoccluded share of each pixel's surroundings.
    `stays`: whether the stage is used for several frames; then samples are cached."""

    setting: StaticSetting
    view: CameraView
    middle: SurfaceSamples
    grid: PixelGrid
    shade: Floats
    edges: NDArray[np.int64]
    sun: SunLight
    scales: PictureScales
    fine: dict[tuple[int, int], SurfaceSamples] = field(default_factory=dict)
    stays: bool = False

    def edge_samples(self, number: int, count: int, threads: int) -> SurfaceSamples:
        """Return sample `number` of `count` of all pixels at edges."""
        key = (number, count)
        sample_set = self.fine.get(key) or self.sample_pixels(self.edges, number, count, threads)
        if self.stays and key not in self.fine:
            self.fine = {known: samples for known, samples in self.fine.items() if known[1] == count} | {key: sample_set}
        return sample_set

    def sample_pixels(self, pixels: NDArray[np.int64], number: int, count: int, threads: int) -> SurfaceSamples:
        """Return sample `number` of `count` of some pixels, each with its own ray to the sun."""
        across, down = pixel_offset(number, count)
        samples = _sample_at(self.setting, self.view, pixels, (across, down), self.sun, self.scales, threads)
        lit = np.flatnonzero(samples.sun > 0)
        start = samples.point[lit] + samples.normal[lit] * np.float32(self.grid.hair)
        aim = np.broadcast_to(self.sun.spots(count)[number], start.shape)
        samples.sun[lit[self.setting.rays.occluded(start, aim, threads=threads)]] = 0
        return samples


def pixel_offset(number: int, count: int) -> tuple[float, float]:
    """Return the position of sample `number` of `count` in a pixel.

    The positions are the lattice of Roberts' sequence R2, which is even for any count."""
    return (0.5 + (number + 1) * 0.7548776662466927) % 1.0, (0.5 + (number + 1) * 0.5698402909980532) % 1.0


def stage(setting: StaticSetting, view: CameraView, sun: SunLight, scales: PictureScales, threads: int) -> StaticStage:
    """Return the samples of everything static, with colours."""
    setting = with_pebbles(setting, view, scales)
    middle = _sample_at(setting, view, np.arange(view.width * view.height), (0.5, 0.5), sun, scales, threads)
    solid = np.isfinite(middle.far)
    edge = _edges(view, middle, solid)
    grid = PixelGrid(view, middle.point, middle.normal, solid, edge, 3e-5 * scales.extent)
    middle.sun[:] *= sun_share(grid, middle.sun, sun, [setting.rays], np.inf, threads)
    shade = open_share(grid, setting.rays, _SHADE_REACH_PER_BODY * scales.grain, SHADE_RAYS_PER_PIXEL, threads)
    return StaticStage(setting, view, middle, grid, shade, np.flatnonzero(edge), sun, scales)


def _sample_at(
    setting: StaticSetting,
    view: CameraView,
    pixels: NDArray[np.int64],
    place: tuple[float, float],
    sun: SunLight,
    scales: PictureScales,
    threads: int,
) -> SurfaceSamples:
    """Return samples of `pixels` at the position `place` in each, before shadows."""
    n = len(pixels)
    three = [np.zeros((n, 3), np.float32) for _ in range(5)]
    direction, point, normal, albedo, glow = three
    far, light, upness, facing = (np.zeros(n, np.float32) for _ in range(4))
    kind = np.zeros(n, np.uint8)

    def fill(own: slice) -> None:
        start, towards = view.rays(pixels[own], *place)
        hits = setting.rays.cast(start, towards, threads)
        direction[own], far[own] = towards, hits.t
        hit_rows = np.flatnonzero(hits.face >= 0)
        first = own.start + hit_rows
        begin = start if start.ndim == 1 else start[hit_rows]
        where: Floats = begin.astype(np.float32) + hits.t[hit_rows, None] * towards[hit_rows]
        look, smooth = _surfaces(setting, view, hits, towards[hit_rows], where, hit_rows, scales)
        point[first], normal[first], albedo[first] = where, smooth, look.albedo
        upness[first], facing[first] = look.normal @ sun.up, -dots(look.normal, towards[hit_rows])
        kind[first] = setting.kind[hits.face[hit_rows]]
        glow[first] = looks.glow(kind[first], look, towards[hit_rows], sun)
        # A coarse mesh shades its own smooth slopes in steps just where the light grazes: faded out there.
        grazing = np.clip((smooth @ sun.towards) * 7, 0, 1)
        light[first] = np.clip(look.normal @ sun.towards, 0, 1) * grazing

    each(fill, pieces(n), threads)
    return SurfaceSamples(pixels, direction, far, point, normal, albedo, light, upness, facing, kind, glow)


def _surfaces(
    setting: StaticSetting,
    view: CameraView,
    hits: PictureHits,
    direction: Floats,
    where: Floats,
    hit_rows: NDArray[np.int64],
    scales: PictureScales,
) -> tuple[looks.SurfaceMaterial, Floats]:
    """Return the material of the samples that hit a surface, and the smooth normals without grain."""
    face = hits.face[hit_rows]
    corners = setting.faces[face]
    flat, u, v = hits.normal[hit_rows], hits.u[hit_rows], hits.v[hit_rows]
    smooth = units(interpolate_vertices(setting.normal, corners, u, v))
    smooth *= np.where(dots(smooth, flat) < 0, np.float32(-1), np.float32(1))[:, None]
    pixel = np.asarray(view.pixel_size(hits.t[hit_rows]), np.float32) * np.float32(0.6)
    # Seen along the ground a pixel covers more of it.
    pixel /= np.sqrt(np.clip(-dots(flat, direction), 0.04, 1.0))
    painted = interpolate_vertices(setting.painted, corners, u, v)
    look = surface_look(setting.kind[face], where, smooth.copy(), setting.up, pixel, scales, painted)
    return look, np.where((dots(smooth, flat) > 0.1)[:, None], smooth, flat)


def _edges(view: CameraView, middle: SurfaceSamples, solid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return whether another surface begins next to each pixel (h · w,), on either side."""
    high, wide = view.height, view.width
    edges = np.zeros((high, wide), np.bool_)
    normal, point = middle.normal.reshape(high, wide, 3), middle.point.reshape(high, wide, 3)
    kind = np.where(solid, middle.kind, 255).reshape(high, wide)
    width = np.asarray(view.pixel_size(np.where(solid, middle.far, 0)), np.float32).reshape(high, wide) * _EDGE_STEP_PIXELS
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
