"""Draws a `Picture` from a `Camera`: rays for what is seen, sun and open sky for its light; keeps what stands still.

One `Renderer` for a film; `render_frame` for a single picture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures import looks
from antdsl.outputs.pictures.actors import Actors, actors
from antdsl.outputs.pictures.camera import View, view
from antdsl.outputs.pictures.light import Sun, encoded, sun_over
from antdsl.outputs.pictures.looks import Scales
from antdsl.outputs.pictures.model import Camera, Picture
from antdsl.outputs.pictures.overlay import draw_overlay
from antdsl.outputs.pictures.samples import Stage, each, open_share, stage
from antdsl.outputs.pictures.setting import Setting, setting
from antdsl.outputs.pictures.shading import Frame, lit_strip
from antdsl.outputs.pictures.shading_rows import Floats
from antdsl.outputs.pictures.trails import TrailCloth, dyed

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

SHOWN = ("trail", "flow", "feelers", "velocity", "paths", "ids")
_CONTACT_RAYS = 4


@dataclass(slots=True)
class _Kept:
    """What one camera saw of what stands still."""

    stage: Stage
    ground: NDArray[np.int64]
    cloths: dict[tuple[str, float], TrailCloth]


class Renderer:
    """Draws pictures of one size; while solids and camera stay the same objects and values, their rays are not cast again.

    `samples`: every pixel is the mean of samples × samples rays. `threads`: for the rays (the bits do not depend on it).
    `least`: bodies that would be shorter than so many pixels are drawn that long, up to three times their size."""

    def __init__(self, width: int = 960, height: int = 540, *, samples: int = 2, threads: int = 1, least: float = 7.0) -> None:
        if not (1 <= width <= 8192 and 1 <= height <= 8192 and 1 <= samples <= 4):
            raise ValueError("a picture is 1 to 8192 pixels wide and high, with 1 to 4 samples along a pixel's edge")
        self.width, self.height, self.samples = width, height, samples
        self.threads, self.least = max(1, threads), least
        self._settings: list[tuple[tuple[int, ...], Setting, tuple[object, ...]]] = []
        self._kept: dict[tuple[object, ...], _Kept] = {}

    def draw(self, picture: Picture, camera: Camera, *, show: Iterable[str] = ("trail",)) -> Image:
        """The picture as bytes (height, width, 3), sRGB. `show`: any of SHOWN. Raises ValueError for another word."""
        wanted = tuple(show)
        wrong = [word for word in wanted if word not in SHOWN]
        if wrong:
            raise ValueError(f"cannot show `{wrong[0]}`: there are {', '.join(SHOWN)}")
        up = np.asarray(picture.up, np.float64) / np.linalg.norm(picture.up)
        sun = sun_over(up)
        seen = view(camera, self.width, self.height, picture.up)
        still = self._setting(picture, up)
        scales = Scales(still.extent, _grain(picture, still.extent))
        kept = self._stage(picture, camera, still, seen, sun, scales)
        cast = actors(picture, seen, self.least, still.rays)
        image = self._light(picture, kept, cast, still, sun, scales, "trail" in wanted)
        return draw_overlay(image, picture, seen, kept.stage.far, self.samples, wanted)

    def _setting(self, picture: Picture, up: Array) -> Setting:
        """The ray scene of the solids; kept with the solids themselves, so that an id is not given to others."""
        key = tuple(id(solid.vertices) for solid in picture.solids) + tuple(hash(float(v)) for v in up)
        for known, made, _ in self._settings:
            if known == key:
                return made
        made = setting(picture.solids, up)
        self._settings = [*self._settings[-1:], (key, made, picture.solids)]
        return made

    def _stage(self, picture: Picture, camera: Camera, still: Setting, seen: View, sun: Sun, scales: Scales) -> _Kept:
        key = (id(still), camera, picture.up, scales)
        if key not in self._kept:
            made = stage(still, seen, self.samples, sun, scales, self.threads)
            ground = np.flatnonzero(np.isfinite(made.far) & (np.isin(made.kind, looks.TRAILED)))
            # Two cameras in turn (from above, at eye level) keep what they saw.
            self._kept = dict([*self._kept.items()][-1:])
            self._kept[key] = _Kept(made, ground, {})
        return self._kept[key]

    def _light(
        self, picture: Picture, kept: _Kept, cast: Actors, ground: Setting, sun: Sun, scales: Scales, trail: bool
    ) -> Image:
        still = kept.stage
        shade = still.shade
        if cast.size > 0:
            shade = shade.copy()
            open_share(still, cast.rays, 1.1 * cast.size, _CONTACT_RAYS, shade, scales, self.threads)
        frame = Frame(
            still, self._dyed(picture, kept) if trail else still.albedo, shade, cast, ground.rays, sun, scales, self.threads
        )
        image = np.empty((self.height, self.width, 3), np.uint8)
        parts = [(a, b) for a in range(self.samples) for b in range(self.samples)]

        def fill(rows: tuple[int, int]) -> None:
            blocks = lit_strip(frame, rows).reshape(rows[1] - rows[0], self.samples, self.width, self.samples, 3)
            mean = sum((blocks[:, a, :, b] for a, b in parts[1:]), blocks[:, 0, :, 0]) / np.float32(len(parts))
            image[rows[0] : rows[1]] = encoded(mean)

        each(fill, still.strips(), self.threads)
        return image

    def _dyed(self, picture: Picture, kept: _Kept) -> Floats:
        albedo = kept.stage.albedo
        trails = [trail for trail in picture.trails if len(trail.position) and (trail.strength > 0).any()]
        if not trails or not len(kept.ground):
            return albedo
        colours = albedo[kept.ground]
        for trail in trails:
            own = (trail.name, trail.cell)
            if own not in kept.cloths:
                kept.cloths[own] = TrailCloth(_places(kept.stage)[kept.ground], trail.cell)
            colours = dyed(colours, kept.cloths[own].share(trail), trail)
        albedo = albedo.copy()
        albedo[kept.ground] = colours
        return albedo


def render_frame(
    picture: Picture,
    camera: Camera,
    width: int = 960,
    height: int = 540,
    *,
    samples: int = 2,
    show: Iterable[str] = ("trail",),
    threads: int = 1,
) -> Image:
    """One picture, bytes (height, width, 3) in sRGB; a film of many is drawn faster by one `Renderer`."""
    return Renderer(width, height, samples=samples, threads=threads).draw(picture, camera, show=show)


def _grain(picture: Picture, extent: float) -> float:
    """The length that grain and shade go by: the picture's own, else the body length of the first crowd, rounded so that growth
    keeps the stage; within what suits the extent."""
    if picture.grain is not None and picture.grain > 0:
        return float(min(max(picture.grain, extent / 2000), extent / 20))
    lengths = [float(np.median(crowd.scale)) for crowd in picture.crowds if len(crowd.scale)]
    length = next((v for v in lengths if v > 0), extent / 250)
    return float(2.0 ** (round(2 * np.log2(min(max(length, extent / 2000), extent / 20))) / 2))


def _places(still: Stage) -> Floats:
    """World places (n, 3) of all samples; sky samples lie at the eye."""
    parts = []
    wide = still.view.width * still.samples**2
    for rows in still.strips():
        far = still.far[rows[0] * wide : rows[1] * wide]
        reach = np.where(np.isfinite(far), far, 0)[:, None].astype(np.float64)
        parts.append((still.view.eye + reach * still.view.rays(*rows, still.samples)).astype(np.float32))
    return np.concatenate(parts)
