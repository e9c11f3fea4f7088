"""What a camera sees of a setting, sample by sample, kept from frame to frame while neither moves."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import Hits, RayScene
from antdsl.outputs.pictures import looks
from antdsl.outputs.pictures.camera import View
from antdsl.outputs.pictures.light import Sun
from antdsl.outputs.pictures.looks import Scales, surface
from antdsl.outputs.pictures.setting import Setting, with_litter
from antdsl.outputs.pictures.shading_rows import Floats, blended, dots, units
from antdsl.outputs.pictures.texture_noise import dither

Array = NDArray[np.float64]

STRIP = 120_000  # samples worked on at once: what a core's cache holds
SHADE_RAYS = 6  # a pixel; its neighbours' rays go other ways and are shared with it
_TILE = 4  # edge of the block of pixels whose rays differ


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Per sample of the picture, row by row: distance `far` (inf = sky), `albedo` (n, 3), `sun` (its share of sunlight),
    `upness` of the normal, `kind`. Per pixel: `shade` (h, w) the open share of its surroundings, and of the pixel's
    middle sample `point` and `normal` (h · w, 3)."""

    view: View
    samples: int
    far: Floats
    albedo: Floats
    sun: Floats
    upness: Floats
    kind: NDArray[np.uint8]
    shade: Floats
    point: Floats
    normal: Floats

    def strips(self) -> list[tuple[int, int]]:
        """Pixel rows cut into pieces of about STRIP samples."""
        return strips(self.view, self.samples)


def strips(view: View, samples: int) -> list[tuple[int, int]]:
    rows = max(1, STRIP // (view.width * samples * samples))
    return [(first, min(first + rows, view.height)) for first in range(0, view.height, rows)]


def each(work: Callable[[Any], None], pieces: Iterable[Any], threads: int) -> None:
    """Does every piece of work, on several threads where there are; pieces write to places of their own."""
    if threads == 1:
        for piece in pieces:
            work(piece)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, pieces):
            pass


def screen_places(view: View, samples: int, rows: tuple[int, int]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column of each sample of a strip."""
    row, column = np.indices(((rows[1] - rows[0]) * samples, view.width * samples))
    return (row + rows[0] * samples).reshape(-1), column.reshape(-1)


def stage(setting: Setting, view: View, samples: int, sun: Sun, scales: Scales, threads: int) -> Stage:
    """Casts and colours everything that stands still."""
    setting = with_litter(setting, view, scales)
    count = view.width * view.height
    total = count * samples * samples
    far, light, upness = (np.zeros(total, np.float32) for _ in range(3))
    albedo, kind = np.zeros((total, 3), np.float32), np.zeros(total, np.uint8)
    point, normal = np.zeros((count, 3), np.float32), np.zeros((count, 3), np.float32)

    def fill(rows: tuple[int, int]) -> None:
        direction = view.rays(*rows, samples)
        own = slice(rows[0] * view.width * samples**2, rows[1] * view.width * samples**2)
        hits = setting.rays.cast(np.broadcast_to(view.eye, direction.shape), direction, threads)
        far[own] = hits.t
        seen = np.flatnonzero(hits.face >= 0)
        look, flat, where = _surfaces(setting, view, hits, direction, seen, samples, scales)
        places = screen_places(view, samples, rows)
        lit = _sunlight(setting, sun, look.normal, flat, where, (places[0][seen], places[1][seen]), scales, threads)
        albedo[own][seen], light[own][seen], upness[own][seen] = look.albedo, lit, look.normal @ sun.up
        kind[own][seen] = setting.kind[hits.face[seen]]
        middle = _middles(view, samples, rows)
        slot = np.full(len(direction), -1, np.int64)
        slot[seen] = np.arange(len(seen))
        taken = slot[middle]
        pixels = np.arange(rows[0] * view.width, rows[1] * view.width)[taken >= 0]
        point[pixels], normal[pixels] = where[taken[taken >= 0]], flat[taken[taken >= 0]]

    each(fill, strips(view, samples), threads)
    made = Stage(view, samples, far, albedo, light, upness, kind, np.ones((view.height, view.width), np.float32), point, normal)
    open_share(made, setting.rays, 11 * scales.grain, SHADE_RAYS, made.shade, scales, threads)
    return made


def _middles(view: View, samples: int, rows: tuple[int, int]) -> NDArray[np.int64]:
    """Index within a strip of the sample nearest the middle of each pixel."""
    half = samples // 2
    row = np.arange(rows[1] - rows[0]) * samples + half
    column = np.arange(view.width) * samples + half
    return (row[:, None] * view.width * samples + column[None, :]).reshape(-1)


def _surfaces(
    setting: Setting, view: View, hits: Hits, direction: Floats, seen: NDArray[np.int64], samples: int, scales: Scales
) -> tuple[looks.Surface, Floats, Floats]:
    """The look of the samples that meet something, the smooth normal without grain, and the place."""
    corners = setting.faces[hits.face[seen]]
    flat, u, v = hits.normal[seen], hits.u[seen], hits.v[seen]
    far: Floats = hits.t[seen]
    smooth = units(blended(setting.normal, corners, u, v))
    smooth *= np.where(dots(smooth, flat) < 0, np.float32(-1), np.float32(1))[:, None]
    where = view.eye.astype(np.float32) + far[:, None] * direction[seen]
    pixel = far * np.float32(view.pixel_at(1.0) / samples)
    painted = blended(setting.painted, corners, u, v)
    look = surface(setting.kind[hits.face[seen]], where, smooth.copy(), setting.up, pixel, scales, painted)
    return look, np.where((dots(smooth, flat) > 0.1)[:, None], smooth, flat), where


def _sunlight(
    setting: Setting,
    sun: Sun,
    normal: Floats,
    flat: Floats,
    where: Floats,
    places: tuple[NDArray[np.int64], NDArray[np.int64]],
    scales: Scales,
    threads: int,
) -> Floats:
    """Share of sunlight (n,): the cosine at the surface, 0 in shadow."""
    facing = np.clip(normal @ sun.towards, 0, 1)
    # A coarse mesh shades its own smooth slopes in steps just where the light grazes: faded out there.
    facing *= np.clip((flat @ sun.towards) * 7, 0, 1)
    lit = np.flatnonzero(facing > 0)
    turn, reach = dither(*places), dither(*places, 1)
    start: Floats = where[lit] + flat[lit] * np.float32(2e-5 * scales.extent)
    facing[lit[setting.rays.occluded(start, sun.directions(turn[lit], reach[lit]), threads=threads)]] = 0
    return np.asarray(facing)


def open_share(stage: Stage, rays: RayScene, reach: float, count: int, into: Floats, scales: Scales, threads: int) -> None:
    """Multiplies `into` (h, w) by the share of `count` rays a pixel that meet nothing within `reach`, smoothed over blocks
    of pixels that lie on one surface: 16 pixels share their rays."""
    view = stage.view
    open_rays = np.ones((view.height, view.width), np.float32)
    pick = (np.arange(view.height)[:, None] % _TILE * _TILE + np.arange(view.width)[None, :] % _TILE).reshape(-1)
    solid = np.flatnonzero(dots(stage.normal, stage.normal) > 0.5)
    directions = _spread(count)
    flat_open = open_rays.reshape(-1)

    def fill(start: int) -> None:
        here = solid[start : start + STRIP]
        normal: Floats = stage.normal[here]
        origin: Floats = stage.point[here] + normal * np.float32(3e-5 * scales.extent)
        side, other = _across(normal)
        met = np.zeros(len(here), np.float32)
        for ray in range(count):
            aim = directions[ray * _TILE * _TILE + pick[here]]
            towards = side * aim[:, :1] + other * aim[:, 1:2] + normal * aim[:, 2:3]
            length = reach * ((ray + 0.6) / count) ** 1.5  # near things shade more than far ones
            met += rays.occluded(origin, towards, far=length, threads=threads)
        flat_open[here] = 1 - met / count

    each(fill, range(0, len(solid), STRIP), threads)
    into *= _smoothed(open_rays, stage)


def _spread(count: int) -> Floats:
    """Directions (count · 16, 3) over the upper half sphere, denser towards its pole; every 16 in a row differ most."""
    k = np.arange(count * _TILE * _TILE)
    order = (k % 16) * count + k // 16
    turn = 2 * np.pi * np.mod(k * 0.6180339887498949, 1.0)
    height = np.sqrt(1 - (order + 0.5) / len(k) * 0.98)
    flat = np.sqrt(1 - height * height)
    return np.stack([flat * np.cos(turn), flat * np.sin(turn), height], axis=1).astype(np.float32)


def _across(normal: Floats) -> tuple[Floats, Floats]:
    """Two unit axes across each normal (Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6(1), 2017)."""
    x, y, z = normal.T
    sign = np.where(z >= 0, np.float32(1), np.float32(-1))
    a = -1 / (sign + z)
    b = x * y * a
    first = np.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return first, np.stack([b, sign + y * y * a, -y], axis=1)


def _smoothed(values: Floats, stage: Stage) -> Floats:
    """Mean over the block of pixels around each, of those whose surface goes on there."""
    height, width = values.shape
    normal = stage.normal.reshape(height, width, 3)
    point = stage.point.reshape(height, width, 3)
    level = np.einsum("abc,abc->ab", point, normal)
    depth = ((point - stage.view.eye.astype(np.float32)) @ stage.view.ahead.astype(np.float32)).astype(np.float32)
    allowed = np.float32(8 * 2 * stage.view.half[0] / width) * depth
    total, weight = values.copy(), np.ones_like(values)
    for down in range(-2, 2):
        for right in range(-2, 2):
            if not (down or right):
                continue
            a, b = _shifted(height, down), _shifted(width, right)
            here, there = (a[0], b[0]), (a[1], b[1])
            alike = np.einsum("abc,abc->ab", normal[here], normal[there]) > 0.8
            alike &= np.abs(np.einsum("abc,abc->ab", point[there], normal[here]) - level[here]) < allowed[here]
            total[here] += np.where(alike, values[there], 0)
            weight[here] += alike
    return total / weight


def _shifted(length: int, by: int) -> tuple[slice, slice]:
    return slice(max(0, -by), length - max(0, by)), slice(max(0, by), length + min(0, by))
