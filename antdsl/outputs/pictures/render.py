"""Renders a `Picture` as seen by a `Camera`. Rays determine visibility, sunlight, and light from the open sky.

Samples of static surfaces are cached. Use one `Renderer` for all frames of a film, and `render_frame` for a single picture."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.blur.depth_of_field import blur_layers, compose_layers
from antdsl.outputs.pictures.blur.motion_blur import smear_bodies, smear_surfaces
from antdsl.outputs.pictures.blur.shutter import make_shutter
from antdsl.outputs.pictures.camera import CameraView
from antdsl.outputs.pictures.lamps import find_lamps
from antdsl.outputs.pictures.light import SunLight, encode_srgb, make_sun
from antdsl.outputs.pictures.model import Camera, Picture
from antdsl.outputs.pictures.moving_bodies import make_actors
from antdsl.outputs.pictures.overlay import draw_overlay
from antdsl.outputs.pictures.refining import refine_pixels, sample_centres
from antdsl.outputs.pictures.shading import PictureLighting
from antdsl.outputs.pictures.shading_rows import Floats
from antdsl.outputs.pictures.static_setting import StaticSetting, make_setting
from antdsl.outputs.pictures.static_stage import StaticStage, make_stage
from antdsl.outputs.pictures.surface_materials import PictureScales
from antdsl.outputs.pictures.trail_colours import FieldColours

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

DISPLAY_OPTIONS = ("trail", "flow", "feelers", "velocity", "paths", "ids", "states")


@dataclass(slots=True)
class _CameraCache:
    """The cached samples of static surfaces for one camera, and the colours that fields give them."""

    stage: StaticStage
    field_colours: FieldColours


class Renderer:
    """Renderer of pictures of one size. Rays to static surfaces are cast again only if the solids or the camera change.

    Each pixel is one ray through its centre. A pixel with an edge or motion is the mean of 2 · `samples`² or more rays.
    `threads`: the number of threads for rays; the result does not depend on it. `least`: smaller bodies are enlarged to this
    length in pixels, by a factor of at most `enlarged`. `marks`: if not 0, bodies are drawn as discs of this diameter in pixels.
    `blur`: the fraction of a frame for which the shutter is open."""

    def __init__(
        self,
        width: int = 960,
        height: int = 540,
        *,
        samples: int = 2,
        threads: int = 1,
        min_body_pixels: float = 7.0,
        max_enlargement: float = 3.0,
        marks: float = 0.0,
        blur: float = 0.0,
    ) -> None:
        if not (1 <= width <= 8192 and 1 <= height <= 8192 and 1 <= samples <= 4):
            raise ValueError("a picture must be 1 to 8192 pixels wide and high, with 1 to 4 samples along a pixel's edge")
        if not 0 <= blur <= 1:
            raise ValueError("the shutter must be open for 0 to 1 of a frame")
        self.width, self.height, self.samples = width, height, samples
        self.threads, self.least, self.enlarged, self.marks, self.blur = (
            max(1, threads),
            min_body_pixels,
            max_enlargement,
            marks,
            blur,
        )
        self._cached_settings: list[tuple[tuple[int, ...], StaticSetting, tuple[object, ...]]] = []
        self._cached_stages: dict[tuple[object, ...], _CameraCache] = {}

    def draw(
        self, picture: Picture, camera: Camera, *, show: Iterable[str] = ("trail",), next_camera: Camera | None = None
    ) -> Image:
        """Return the picture as sRGB bytes (height, width, 3).

        `show`: words of DISPLAY_OPTIONS. `next_camera`: the camera in the next frame, for motion blur; None if it does not move.
        Raises ValueError for any other word."""
        options = tuple(show)
        wrong = [word for word in options if word not in DISPLAY_OPTIONS]
        if wrong:
            raise ValueError(f"cannot show `{wrong[0]}`: there are {', '.join(DISPLAY_OPTIONS)}")
        light, stage = self._compute_image(picture, camera, next_camera, "trail" in options)
        distance = stage.centre_samples.distance.reshape(self.height, self.width)
        return draw_overlay(encode_srgb(light), picture, stage.view, distance, options, self.marks)

    def compute_light(self, picture: Picture, camera: Camera) -> Floats:
        """Return the display-linear light (height, width, 3) of a picture without overlays, float32."""
        return self._compute_image(picture, camera, None, True)[0]

    def _compute_image(
        self, picture: Picture, camera: Camera, next_camera: Camera | None, has_trails: bool
    ) -> tuple[Floats, StaticStage]:
        """Return the display-linear light (height, width, 3) of a picture, and the samples of its static surfaces.

        Each pixel gets one sample, then more samples at edges and moving bodies. Blur is applied last."""
        up = np.asarray(picture.up, np.float64) / np.linalg.norm(picture.up)
        sun = make_sun(up, picture.light)
        shutter = make_shutter(picture, camera, next_camera, (self.width, self.height), self.blur)
        view, still = shutter.middle, self._get_setting(picture, up)
        scales = PictureScales(still.extent, _choose_grain(picture, still.extent))
        camera_cache = self._get_camera_cache(picture, (camera, next_camera), still, view, sun, scales)
        bodied = picture if self.marks <= 0 else replace(picture, crowds=())
        actors = make_actors(bodied, shutter, self.least, still, self.enlarged)
        camera_cache.field_colours.set_trails(picture.trails if has_trails else ())
        lamps = find_lamps(picture.items, picture.up, picture.light.lamps)
        lighting = PictureLighting(actors, still.rays, sun, scales, view, self.threads, shutter, lamps)
        stage = camera_cache.stage
        first = sample_centres(stage, lighting, camera_cache.field_colours)
        static, bodies = refine_pixels(stage, lighting, camera_cache.field_colours, first, self.samples)
        if shutter.open_frames > 0:
            bodies = smear_bodies(lighting)
        if shutter.has_camera_motion:
            static = smear_surfaces(stage, lighting, static.light)
        has_lens = view.aperture > 0
        light = blur_layers(view, static, bodies, self.threads) if has_lens else compose_layers(static, bodies)
        return light.reshape(self.height, self.width, 3), stage

    def _get_setting(self, picture: Picture, up: Array) -> StaticSetting:
        """Return the ray scene of the picture's solids, from the cache if it was built before.

        The keys of the cache are ids of the solids. It also holds the solids themselves, so that their ids cannot be reused."""
        key = tuple(id(solid.vertices) for solid in picture.solids) + tuple(hash(float(v)) for v in up)
        for known, still_setting, _ in self._cached_settings:
            if known == key:
                return still_setting
        still_setting = make_setting(picture.solids, up)
        self._cached_settings = [*self._cached_settings[-1:], (key, still_setting, picture.solids)]
        return still_setting

    def _get_camera_cache(
        self,
        picture: Picture,
        cameras: tuple[Camera, Camera | None],
        setting: StaticSetting,
        camera_view: CameraView,
        sun: SunLight,
        scales: PictureScales,
    ) -> _CameraCache:
        """Return the cached samples for a camera. They are computed at first use. `cameras`: for the picture's frame and the next
        one."""
        key = (id(setting), cameras, picture.up, picture.light, scales)
        if key not in self._cached_stages:
            new_stage = make_stage(setting, camera_view, sun, scales, self.threads)
            # The samples of two cameras stay cached, for films that alternate between them.
            self._cached_stages = dict([*self._cached_stages.items()][-1:])
            self._cached_stages[key] = _CameraCache(new_stage, FieldColours(new_stage.centre_samples))
        else:
            self._cached_stages[key].stage.is_reused = True
        return self._cached_stages[key]


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
    """Return one picture as sRGB bytes (height, width, 3). For all frames of a film, one `Renderer` is faster."""
    return Renderer(width, height, samples=samples, threads=threads).draw(picture, camera, show=show)


def _choose_grain(picture: Picture, extent: float) -> float:
    """Return the reference length of grain and shade in world units, limited to values that suit the extent of the scene.

    It is the `grain` of the picture, or the body length of the first crowd. The body length is rounded, so that growth of agents
    does not invalidate the cached samples."""
    if picture.grain is not None and picture.grain > 0:
        return float(min(max(picture.grain, extent / 2000), extent / 20))
    lengths = [float(np.median(crowd.scale)) for crowd in picture.crowds if len(crowd.scale)]
    length = next((v for v in lengths if v > 0), extent / 250)
    return float(2.0 ** (round(2 * np.log2(min(max(length, extent / 2000), extent / 20))) / 2))
