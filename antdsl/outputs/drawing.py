"""Draws frames of a cache. A picture does not depend on the frames drawn before it.

A still is written atomically, with a hash of everything from which it was drawn. If the folder already contains the same still,
it is not drawn again."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__, limits
from antdsl.atomic_write import write_atomically
from antdsl.outputs.agent_paths import PathWindow
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.cache.hashes import HashLine
from antdsl.outputs.cut_plane import CutPlane
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.camera import to_tuple
from antdsl.outputs.pictures.cameras import find_agent_view, make_fitted_camera, make_overview_camera, make_top_camera
from antdsl.outputs.pictures.following import CLOSE_FOCAL_MM, EYE_FOCAL_MM, SMOOTH_SECONDS, FollowingCamera
from antdsl.outputs.pictures.legend import add_legend, compute_legend_width
from antdsl.outputs.pictures.model import Camera, Picture
from antdsl.outputs.pictures.render import Renderer
from antdsl.outputs.scene_cameras import SceneCameras, choose_direction, compute_aperture, make_stable_track, read_track
from antdsl.safe_read import read_size_limited
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME
from antdsl.scene.setting import DEFAULT_FOCAL_MM

_PNG_HASH_KEYWORD = "antdsl"  # the key of the hash among the texts of a PNG file
MAX_STILL_BYTES = 512 * limits.MIB

Image = NDArray[np.uint8]
Point = tuple[float, float, float]
# Shorter agents are enlarged to this length (pixels), but by at most this factor
MIN_AGENT_PIXELS, MAX_AGENT_ENLARGEMENT = 7.0, 3.0


class AgentMissing(Exception):
    """Error if the agent that a camera follows is not in the frame."""


@dataclass(frozen=True, slots=True)
class DrawRequest:
    """The options of pictures.

    `camera`: one of `CAMERA_VIEWS`, or the name of a camera of the scene. `show`: the overlays. `agents`: the keys of the agents
    for which ids, paths and similar overlays are drawn. A camera at eye level follows the first. `cut`, `window`: the texts of
    the command-line options. `full`: by field, the strength that is drawn with the strongest colour. `least`: smaller bodies are
    enlarged to this length in pixels; None for the default. `marks`: if not 0, bodies are drawn as discs of this diameter in
    pixels. `blur`: the fraction of a frame for which the shutter is open. `at`, `look_at`: the position and the aim, in scene
    units, of a camera that replaces `camera`; both or none. `focal`, `f_stop`, `focus`: if set, they replace the camera's focal
    length (mm), f-number (0 for a pinhole), and distance in focus (scene units). `samples`: if not 0, Cycles renders the picture,
    with this many paths per pixel."""

    width: int
    height: int
    camera: str
    show: tuple[str, ...]
    agents: tuple[int, ...] = ()
    cut: str | None = None
    window: str = "1..2"
    full: tuple[tuple[str, float], ...] = ()
    least: float | None = None
    marks: float = 0.0
    blur: float = 0.0
    legend: bool = True
    at: Point | None = None
    look_at: Point | None = None
    focal: float | None = None
    f_stop: float | None = None
    focus: float | None = None
    samples: int = 0

    def gallery(self, cache: Cache) -> Gallery:
        """Return a gallery that builds the cache's pictures with these options. Raises PictureUnavailable if the cache cannot be
        drawn."""
        window = PathWindow.parse(self.window) if "paths" in self.show else None
        cut = CutPlane.parse(self.cut) if self.cut is not None else None
        states = "states" in self.show or self.marks > 0
        return Gallery(cache, cut, window, shows_states=states, has_motion_blur=self.blur > 0, full_strengths=dict(self.full))


class FrameDrawer:
    """Drawer of the pictures of `frames`, on several threads. A fixed camera is chosen for the first of these frames."""

    def __init__(self, gallery: Gallery, request: DrawRequest, frames: Sequence[int], threads: int) -> None:
        self.gallery, self.wanted, self.frames = gallery, request, list(frames)
        self._agents = frozenset(request.agents)
        first = gallery.make_picture(self.frames[0], agents=self._agents)
        self._legend_width = compute_legend_width(first, request.width, request.show) if request.legend else 0
        least, enlarged = (MIN_AGENT_PIXELS, MAX_AGENT_ENLARGEMENT) if request.least is None else (request.least, float("inf"))
        size = request.width - self._legend_width, request.height
        self._renderer = Renderer(
            *size, threads=threads, marks=request.marks, blur=request.blur, min_body_pixels=least, max_enlargement=enlarged
        )
        self._aspect = self._renderer.width / self._renderer.height
        self._cameras, self._up = SceneCameras(gallery), np.asarray(first.up, np.float64)
        self._name = DEFAULT_CAMERA_NAME if request.camera == "scene" else request.camera
        self._find_camera = self._choose_camera(first)

    def draw(self, frame: int) -> NDArray[np.uint8]:
        """Return the picture of one frame (height, width, 3).

        Raises CacheError if the frame is damaged, and PictureUnavailable if it cannot be drawn. Raises AgentMissing if the agent
        to follow is missing, and ValueError for an unknown word in `show`."""
        request, picture = self.wanted, self.gallery.make_picture(frame, agents=self._agents)
        following = self.make_camera(frame + 1) if request.blur > 0 else None
        image = self._renderer.draw(picture, self.make_camera(frame), show=request.show, next_camera=following)
        return add_legend(image, picture, self._legend_width, request.show)

    def make_camera(self, frame: int) -> Camera:
        """Return the camera for a frame, with the requested lens."""
        request, camera = self.wanted, self._find_camera(frame)
        if request.focal is not None:
            camera = replace(camera, focal=request.focal)
        if request.f_stop is not None:
            camera = replace(camera, aperture=compute_aperture(camera.focal, request.f_stop, self.gallery.manifest.units))
        return camera if request.focus is None else replace(camera, focus=request.focus)

    def _choose_camera(self, first: Picture) -> Callable[[int], Camera]:
        """Return a function that returns the requested camera for a frame. `first`: the picture of the first frame.

        Raises AgentMissing if no frame contains the agent to follow."""
        request, name = self.wanted, self._name
        if request.at is not None and request.look_at is not None:
            eye, aim = (to_tuple(np.array(point) - self.gallery.origin) for point in (request.at, request.look_at))
            return _make_constant_function(Camera(eye, aim))
        if name in ("eye", "close") and (following := self._follow_agent(first, is_close=name == "close")) is not None:
            return following.make_camera
        if name == "top":
            return _make_constant_function(make_top_camera(first, aspect=self._aspect))
        if name in ("fit", "eye", "close") or self._cameras.is_fitted(name):
            points, focal = self.gallery.find_outline_points(self.frames), request.focal or DEFAULT_FOCAL_MM
            return _make_constant_function(make_fitted_camera(points, self._up, aspect=self._aspect, focal=focal))
        own = self._cameras.make_camera(first.frame or 0, name)
        if own is None:
            return _make_constant_function(
                make_overview_camera(first, aspect=self._aspect, focal=request.focal or DEFAULT_FOCAL_MM)
            )
        return (
            (lambda frame: self._cameras.make_camera(frame, name) or own)
            if self._cameras.is_moving(name)
            else _make_constant_function(own)
        )

    def _follow_agent(self, first: Picture, *, is_close: bool) -> FollowingCamera | None:
        """Return the camera beside the requested agent. None if no frame contains agents.

        If no agent is requested, one with others nearby is chosen, in the first frame that contains agents. `first`: the picture
        of the first frame. Raises AgentMissing if no frame contains the requested agent."""
        focal = self.wanted.focal or (CLOSE_FOCAL_MM if is_close else EYE_FOCAL_MM)
        view, agents = None, self.wanted.agents
        names = [species.name for species in self.gallery.manifest.species]
        first_id = agents[0] // SPECIES_PER_KEY if agents else None  # an id without a species may be of several
        follow: list[tuple[int | None, str | None]]
        follow = [(first_id, names[key % SPECIES_PER_KEY]) for key in agents if key // SPECIES_PER_KEY == first_id]
        for picture in map(self.gallery.make_picture, self.frames):
            views = (
                find_agent_view(picture, agent, species=name, focal=focal, close=is_close)
                for agent, name in follow or [(None, None)]
            )
            view = next((each for each in views if each is not None), None)
            if view is not None:
                break
        if view is None and agents:
            raise AgentMissing(_describe_missing_agent(first, agents))
        if view is None or view.crowd.ids is None:  # as at the end of a hunt
            return None
        number = names.index(view.crowd.species)
        agent, reach = int(view.crowd.ids[view.row]), math.ceil(SMOOTH_SECONDS / self.gallery.dt)
        near = range(min(self.frames) - reach, max(self.frames) + reach + 1)
        track = read_track(self.gallery.cache, number, agent, [f for f in self.gallery.cache.frames() if f in near])
        stable = make_stable_track(self.gallery, track)
        return choose_direction(self.gallery, number, agent, stable, focal, is_close=is_close)


def _make_constant_function(camera: Camera) -> Callable[[int], Camera]:
    """Return a function that returns `camera` for every frame."""
    return lambda frame: camera


def _describe_missing_agent(picture: Picture, agents: Sequence[int]) -> str:
    """Return the message for an agent that a camera should follow but that is missing. It lists existing ids."""
    counts: dict[str, int] = {}
    for crowd in picture.crowds:
        counts[crowd.species] = counts.get(crowd.species, 0) + len(crowd.position)
    known = [f"{count} `{species}`" for species, count in counts.items() if count]
    agent = agents[0] // SPECIES_PER_KEY
    return f"there is no agent {agent} for the camera to follow; frame {picture.frame} has {', '.join(known) or 'no agents'}"


def make_still_path(folder: Path, frame: int) -> Path:
    """Return the path of the still of a frame."""
    return folder / f"picture.{frame:04d}.png"


@dataclass(frozen=True, slots=True)
class StillStore:
    """The stills of a cache in a folder, drawn with the options of one request."""

    folder: Path
    request: DrawRequest
    _hash_lines: Mapping[int, HashLine]
    _inputs_json: str

    @classmethod
    def build(cls, folder: Path, cache: Cache, request: DrawRequest, camera_frames: Sequence[int]) -> StillStore:
        """Return the store of the stills of a cache. The hash of a still covers the data that identifies the cache's frames.

        `camera_frames`: the frames that decide the camera, if it is common to all frames."""
        read = cache.manifest.model_copy(update={"made_with": None}).model_dump_json()  # pictures do not depend on provenance
        manifest = blake2b(read.encode(), digest_size=16).hexdigest()
        frames = cache.frames()
        inputs = {
            "antdsl": __version__,
            "manifest": manifest,
            "frames": [len(frames), *frames[:1], *frames[-1:]],
            "wanted": asdict(request),
            "together": list(camera_frames),
        }
        return cls(folder, request, cache.lines(), json.dumps(inputs, sort_keys=True))

    def write_still(self, frame: int, image: Image) -> Path:
        """Write the picture (h, w, 3) of a frame atomically, without flushing it to disk. Return its path."""
        from PIL import Image as PillowImage
        from PIL.PngImagePlugin import PngInfo

        words = PngInfo()
        words.add_text(_PNG_HASH_KEYWORD, self._compute_hash(frame))
        data = io.BytesIO()
        PillowImage.fromarray(image).save(data, "PNG", compress_level=4, pnginfo=words)
        write_atomically(make_still_path(self.folder, frame), data.getvalue(), sync=False)
        return make_still_path(self.folder, frame)

    def read_still(self, frame: int) -> Image | None:
        """Return the stored picture (h, w, 3) of a frame.

        None if it does not exist, is incomplete, or was drawn from other inputs."""
        from antdsl.reader.image_request import ImageError, read_image_file

        try:
            data = read_size_limited(make_still_path(self.folder, frame), MAX_STILL_BYTES)
            picture = read_image_file(data, "PNG", ("RGB",), self.request.width * self.request.height)
        except (OSError, ImageError):
            return None
        if (picture.columns, picture.rows) != (self.request.width, self.request.height):
            return None
        return picture.samples if picture.texts.get(_PNG_HASH_KEYWORD) == self._compute_hash(frame) else None

    def _compute_hash(self, frame: int) -> str:
        """Return the hash of everything from which the still of a frame is drawn."""
        line = self._hash_lines.get(frame)
        return blake2b(f"{frame} {line.file if line else ''} {self._inputs_json}".encode(), digest_size=16).hexdigest()
