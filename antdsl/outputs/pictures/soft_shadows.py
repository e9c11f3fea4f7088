"""Soft edges of shadows and of ambient shade, without noise.

Neighbouring pixels cast rays in different directions, and pixels on the same surface share their results. This is interleaved
sampling (Keller and Heidrich, Eurographics Workshop on Rendering, 2001). The weights of the filters cancel the sampling
pattern."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.picture_rays import PictureRays
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.shading_rows import Floats, compute_dot_products, run_each, split_rows

_RAYS_PER_EDGE_PIXEL = 4  # rays to the light per pixel at the edge of a shadow
_PIXEL_ORDER = np.array([0, 8, 2, 10, 12, 4, 14, 6, 3, 11, 1, 9, 15, 7, 13, 5])  # order in 4 × 4 pixels: neighbours differ most
_SHADOW_EDGE_PIXELS = 2  # pixels around a shadow's edge; all sixteen directions occur among them
_SAME_SURFACE_COSINE = 0.8  # cosine between normals; above it, two pixels are on one surface
_WIDE_TAPS, _NARROW_TAPS = np.array([1, 2, 2, 2, 1], np.float32) / 8, np.array([1, 2, 1], np.float32) / 4


@dataclass(frozen=True, slots=True, eq=False)
class PixelGrid:
    """The samples of static surfaces at pixel centres.

    `point`, `normal` float32 (h · w, 3). `hits_surface` bool (h · w,): whether the pixel's ray hits a surface. `is_edge` bool
    (h · w,): whether the surface ends next to the pixel. `ray_offset`: the distance of ray origins from the surface, in world
    units."""

    view: CameraView
    point: Floats
    normal: Floats
    hits_surface: NDArray[np.bool_]
    is_edge: NDArray[np.bool_]
    ray_offset: float

    def make_half_grid(self) -> "PixelGrid":
        """Return the grid of every second pixel in every second row."""
        high, wide = self.view.height, self.view.width
        taken = (np.arange(0, high, 2)[:, None] * wide + np.arange(0, wide, 2)).reshape(-1)
        edge = self._find_near_edges(1)[::2, ::2].reshape(-1)
        return PixelGrid(
            _make_half_view(self.view), self.point[taken], self.normal[taken], self.hits_surface[taken], edge, self.ray_offset
        )

    def _find_near_edges(self, reach: int) -> NDArray[np.bool_]:
        """Return a mask of the pixels (h, w) that have an edge or the sky within `reach` pixels."""
        from scipy.ndimage import maximum_filter

        broken = (self.is_edge | ~self.hits_surface).reshape(self.view.height, self.view.width)
        return np.asarray(maximum_filter(broken, 2 * reach + 1))

    def is_near_edge(self, pixels: NDArray[np.int64], reach: int) -> NDArray[np.bool_]:
        """Return a mask of those `pixels` (n,) that have an edge or the sky within `reach` pixels."""
        return np.asarray(self._find_near_edges(reach).reshape(-1)[pixels])


def _make_half_view(view: CameraView) -> CameraView:
    """Return the same camera for a picture with half the width and half the height in pixels."""
    high, wide = (view.height + 1) // 2, (view.width + 1) // 2
    return CameraView(view.eye, view.right_axis, view.up_axis, view.forward_axis, view.half_extent, wide, high, view.is_parallel)


class LightSource(Protocol):
    """A light with a size, so that its shadows have soft edges."""

    def aim_rays(self, points: Floats, numbers: NDArray[np.integer], count: int) -> Floats:
        """Return vectors (n, 3) from `points` to points of the light. `numbers` (n,): the indices of these among `count`
        points."""
        ...


def compute_visible_share(
    grid: PixelGrid,
    facing: Floats,
    source: LightSource,
    occluders: Sequence[PictureRays],
    max_distance: float,
    threads: int,
    candidates: NDArray[np.bool_] | None = None,
) -> Floats:
    """Return the fraction (h · w,) of a light that is visible from the surface in each pixel. 1 for surfaces that face away.

    `facing` (h · w,): the cosine of the angle to the light; surfaces with a value ≤ 0 face away. `occluders`: ray scenes of
    the occluders at several times; pixels are distributed over them. `max_distance`: the greatest distance of occluders, as a
    multiple of the vectors that `source.aim_rays` returns. `candidates` (h · w,): the pixels that may be occluded; None for
    all."""
    high, wide = grid.view.height, grid.view.width
    lit = grid.hits_surface & (facing > 0)
    pixels = np.flatnonzero(lit if candidates is None else lit & candidates)
    share = np.ones(high * wide, np.float32)
    if not len(pixels):
        return share
    row, column = np.divmod(pixels, wide)
    hidden = np.zeros(high * wide, np.bool_)
    number = (row % 4) * 4 + column % 4
    for turn, cast in enumerate(occluders):
        own = slice(None) if len(occluders) == 1 else np.flatnonzero(_PIXEL_ORDER[number] % len(occluders) == turn)
        aim = source.aim_rays(grid.point[pixels[own]], _PIXEL_ORDER[number[own]], 16)
        hidden[pixels[own]] = _find_occluded(grid, pixels[own], aim, cast, max_distance, threads)
    share[hidden] = 0
    mixed = pixels[_find_partly_hidden(hidden.reshape(high, wide)).reshape(-1)[pixels]]
    if not len(mixed):
        return share
    row, column = np.divmod(mixed, wide)
    block = (row % 2) * 2 + column % 2
    total = 4 * _RAYS_PER_EDGE_PIXEL
    occlusion = np.zeros(len(mixed), np.float32)
    for k in range(_RAYS_PER_EDGE_PIXEL):
        aim = source.aim_rays(grid.point[mixed], 4 * k + (block + k) % 4, total)
        occlusion += _find_occluded(grid, mixed, aim, occluders[k % len(occluders)], max_distance, threads)
    share[mixed] = 1 - occlusion / _RAYS_PER_EDGE_PIXEL
    share[mixed] = _filter_values(share.reshape(high, wide), mixed, grid, _NARROW_TAPS, facing > 0)
    return share


def _find_occluded(
    grid: PixelGrid, pixels: NDArray[np.int64], directions: Floats, occluder: PictureRays, max_distance: float, threads: int
) -> NDArray[np.bool_]:
    """Return a mask of the `pixels` from which a ray in `directions` hits something before the light."""
    occluded = np.zeros(len(pixels), np.bool_)

    def fill_pixels(chunk: slice) -> None:
        own_pixels = pixels[chunk]
        start = grid.point[own_pixels] + grid.normal[own_pixels] * np.float32(grid.ray_offset)
        occluded[chunk] = occluder.find_occluded_rays(start, directions[chunk], max_distance, threads)

    run_each(fill_pixels, split_rows(len(pixels)), threads)
    return occluded


def _find_partly_hidden(is_hidden: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask of the pixels (h, w) that have both hidden and visible pixels nearby."""
    from scipy.ndimage import maximum_filter, minimum_filter

    values = is_hidden.astype(np.uint8)
    size = 2 * _SHADOW_EDGE_PIXELS + 1
    return np.asarray(maximum_filter(values, size) != minimum_filter(values, size))


def _filter_values(
    values: Floats, pixels: NDArray[np.int64], grid: PixelGrid, taps: Floats, is_counted: NDArray[np.bool_] | None = None
) -> Floats:
    """Return weighted means (n,) of `values` (h, w) around `pixels` (n,), over neighbours on the same surface.

    `taps`: the weights along a row or column of neighbours. `is_counted`: a mask of the pixels that enter the means; None for
    all."""
    from scipy.ndimage import convolve1d

    even = convolve1d(convolve1d(values, taps, axis=0, mode="nearest"), taps, axis=1, mode="nearest")
    means = np.asarray(even.reshape(-1)[pixels], np.float32)
    careful = np.flatnonzero(grid.is_near_edge(pixels, len(taps) // 2))
    means[careful] = _filter_at_edges(values, pixels[careful], grid, taps, is_counted)
    return means


def _filter_at_edges(
    values: Floats, pixels: NDArray[np.int64], grid: PixelGrid, taps: Floats, is_counted: NDArray[np.bool_] | None
) -> Floats:
    """Return the same means as `_filter_values`, for pixels near which the surface may end."""
    high, wide = values.shape
    row, column = np.divmod(pixels, wide)
    normal, point = grid.normal[pixels], grid.point[pixels]
    allowed = _compute_plane_tolerance(grid, point)
    total, weight = np.zeros(len(pixels), np.float32), np.full(len(pixels), 1e-9, np.float32)
    reach = len(taps) // 2
    for down in range(-reach, reach + 1):
        for right in range(-reach, reach + 1):
            there_row, there_column = row + down, column + right
            inside = (there_row >= 0) & (there_row < high) & (there_column >= 0) & (there_column < wide)
            neighbour = np.where(inside, there_row * wide + there_column, pixels)
            share = np.float32(taps[down + reach] * taps[right + reach]) * (inside & grid.hits_surface[neighbour])
            if down or right:
                share *= _is_same_surface(grid, neighbour, point, normal, allowed)
                if is_counted is not None:
                    share *= is_counted[neighbour]
            total += share * values.reshape(-1)[neighbour]
            weight += share
    return total / weight


def _compute_plane_tolerance(grid: PixelGrid, point: Floats) -> Floats:
    """Return how far a neighbour may be from the plane through each point: the width of a few pixels, in world units."""
    depth = np.maximum((point - grid.view.eye.astype(np.float32)) @ grid.view.forward_axis.astype(np.float32), 0)
    return np.asarray(6 * grid.view.compute_pixel_size(depth), np.float32)


def _is_same_surface(
    grid: PixelGrid, neighbour: NDArray[np.int64], point: Floats, normal: Floats, tolerance: Floats
) -> NDArray[np.bool_]:
    """Return a mask of the `neighbour` pixels where the surface continues the one at `point` with `normal`."""
    alike = compute_dot_products(normal, grid.normal[neighbour]) > _SAME_SURFACE_COSINE
    alike &= np.abs(compute_dot_products(grid.point[neighbour] - point, normal)) < tolerance
    return np.asarray(alike)


def compute_open_share(
    grid: PixelGrid, rays: PictureRays, reach: float, count: int, threads: int, candidates: NDArray[np.bool_] | None = None
) -> Floats:
    """Return the fraction (h · w,) of directions above the surface in each pixel that hit nothing within `reach` (world units).

    `count` rays are cast at every second pixel in every second row. Values between them are interpolated along surfaces.
    `candidates` (h · w,): a mask of the pixels that may have an obstacle nearby; None for all."""
    high, wide = grid.view.height, grid.view.width
    small = grid.make_half_grid()
    small_mask = None if candidates is None else candidates.reshape(high, wide)[::2, ::2].reshape(-1)
    pixels = np.flatnonzero(small.hits_surface if small_mask is None else small.hits_surface & small_mask)
    shade = np.ones(len(small.hits_surface), np.float32)
    if not len(pixels):
        return np.ones(high * wide, np.float32)
    row, column = np.divmod(pixels, small.view.width)
    shade[pixels] = _sample_open_share(small, pixels, _PIXEL_ORDER[(row % 4) * 4 + column % 4], rays, reach, count, threads)
    shade[pixels] = _filter_values(shade.reshape(small.view.height, small.view.width), pixels, small, _WIDE_TAPS)
    return _fill_open_share(grid, small, shade, rays, reach, threads, candidates)


def _sample_open_share(
    grid: PixelGrid,
    pixels: NDArray[np.int64],
    ray_picks: NDArray[np.int64],
    rays: PictureRays,
    reach: float,
    count: int,
    threads: int,
) -> Floats:
    """Return the unoccluded fraction of the hemisphere above each of `pixels`, sampled by `count` rays. `ray_picks`: which
    directions."""
    directions = _make_hemisphere_directions(count)
    opened = np.empty(len(pixels), np.float32)

    def fill_pixels(chunk: slice) -> None:
        own_pixels = pixels[chunk]
        normal = grid.normal[own_pixels]
        start = grid.point[own_pixels] + normal * np.float32(grid.ray_offset)
        side, other = _make_tangent_axes(normal)
        occlusion = np.zeros(len(own_pixels), np.float32)
        for ray in range(count):
            aim = directions[ray * 16 + ray_picks[chunk]]
            towards = side * aim[:, :1] + other * aim[:, 1:2] + normal * aim[:, 2:3]
            length = reach * ((ray + 0.6) / count) ** 1.5  # near objects shade more than distant ones
            occlusion += rays.find_occluded_rays(start, towards, length, threads)
        opened[chunk] = 1 - occlusion / count

    run_each(fill_pixels, split_rows(len(pixels)), threads)
    return opened


def _fill_open_share(
    grid: PixelGrid,
    half_grid: PixelGrid,
    shade: Floats,
    rays: PictureRays,
    reach: float,
    threads: int,
    candidates: NDArray[np.bool_] | None = None,
) -> Floats:
    """Return the unoccluded fraction for all pixels. `shade`: this fraction at every second pixel in every second row.

    Where no such pixel nearby is on the same surface, rays are cast."""
    high, wide = grid.view.height, grid.view.width
    full = _upsample_values(shade.reshape(half_grid.view.height, half_grid.view.width), high, wide)
    full[~grid.hits_surface] = 1
    targets = np.flatnonzero(grid.hits_surface if candidates is None else grid.hits_surface & candidates)
    targets = targets[grid.is_near_edge(targets, 2)]
    lonely: list[NDArray[np.int64]] = []

    def fill_pixels(chunk: slice) -> None:
        pixels = targets[chunk]
        row, column = np.divmod(pixels, wide)
        point, normal = grid.point[pixels], grid.normal[pixels]
        allowed = 2 * _compute_plane_tolerance(grid, point)
        total, weight = np.zeros(len(pixels), np.float32), np.zeros(len(pixels), np.float32)
        for down in (0, 1):
            for right in (0, 1):
                there_row = np.minimum(row // 2 + down * (row % 2), half_grid.view.height - 1)
                there_column = np.minimum(column // 2 + right * (column % 2), half_grid.view.width - 1)
                neighbour = there_row * half_grid.view.width + there_column
                share = (
                    half_grid.hits_surface[neighbour] & _is_same_surface(half_grid, neighbour, point, normal, allowed)
                ).astype(np.float32)
                total += share * shade[neighbour]
                weight += share
        full[pixels] = total / np.maximum(weight, 1e-9)
        lonely.append(pixels[weight == 0])

    run_each(fill_pixels, split_rows(len(targets)), threads)
    alone = np.sort(np.concatenate(lonely)) if lonely else np.zeros(0, np.int64)
    if len(alone):
        full[alone] = _sample_open_share(grid, alone, np.zeros(len(alone), np.int64), rays, reach, 16, threads)
    return full


def _upsample_values(coarse_values: Floats, row_count: int, column_count: int) -> Floats:
    """Return values (h · w,) for all pixels, interpolated linearly from `coarse_values` at every second pixel."""
    rows = np.empty((2 * coarse_values.shape[0], coarse_values.shape[1]), np.float32)
    rows[::2] = coarse_values
    rows[1::2] = (coarse_values + np.concatenate([coarse_values[1:], coarse_values[-1:]])) / 2
    full = np.empty((len(rows), 2 * coarse_values.shape[1]), np.float32)
    full[:, ::2] = rows
    full[:, 1::2] = (rows + np.concatenate([rows[:, 1:], rows[:, -1:]], axis=1)) / 2
    return np.ascontiguousarray(full[:row_count, :column_count]).reshape(-1)


def _make_hemisphere_directions(count: int) -> Floats:
    """Return directions (count · 16, 3) over the upper hemisphere, denser towards the pole.

    Any 16 consecutive directions are as different as possible."""
    k = np.arange(count * 16)
    order = (k % 16) * count + k // 16
    turn = 2 * np.pi * np.mod(k * 0.6180339887498949, 1.0)
    height = np.sqrt(1 - (order + 0.5) / len(k) * 0.98)
    flat = np.sqrt(1 - height * height)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1).astype(np.float32)


def _make_tangent_axes(normal: Floats) -> tuple[Floats, Floats]:
    """Return two unit vectors perpendicular to each normal and to each other (Duff et al., Building an Orthonormal Basis,
    Revisited, JCGT 6(1), 2017)."""
    x, y, z = normal.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return first, np.stack([b, sign + y * y * a, -y], axis=1)
