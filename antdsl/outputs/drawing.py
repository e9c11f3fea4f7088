"""Draws the requested frames of a cache. A picture does not depend on the frames drawn before it.

A still is written atomically, with a hash of everything it was drawn from. A still that exists in the folder is not drawn
again."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
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
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.cameras import make_eye_level_camera, make_fitted_camera, make_overview_camera, make_top_camera
from antdsl.outputs.pictures.legend import add_legend, compute_legend_width
from antdsl.outputs.pictures.model import Camera, Picture
from antdsl.outputs.pictures.render import Renderer
from antdsl.safe_read import read_size_limited

_PNG_HASH_KEYWORD = "antdsl"  # the key of the hash among the texts of a PNG file
MAX_STILL_BYTES = 512 * limits.MIB

Image = NDArray[np.uint8]
# Shorter agents are enlarged to this length (pixels), but by at most this factor
MIN_AGENT_PIXELS, MAX_AGENT_ENLARGEMENT = 7.0, 3.0


class AgentMissing(Exception):
    """Error if the agent that a camera follows is not in the frame."""


@dataclass(frozen=True, slots=True)
class DrawRequest:
    """The options of pictures.

    `camera`: `scene`, `fit`, `above`, `top`, `eye` or `close`.
    `agents`: ids of the agents with ids, paths and similar overlays; a camera at eye level follows the first.
    `cut`, `window`: the texts of the command-line options.
    `least`: bodies are enlarged to this length in pixels; None for the default.
    `rest`: a camera at eye level stays where the first frame placed it, as films need."""

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
    rest: bool = False

    def gallery(self, cache: Cache) -> Gallery:
        """Return a gallery that builds the cache's pictures. Raises PictureUnavailable as `Gallery` does."""
        window = PathWindow.parse(self.window) if "paths" in self.show else None
        cut = CutPlane.parse(self.cut) if self.cut is not None else None
        return Gallery(cache, cut, window, blurred=self.blur > 0, full=dict(self.full))


class FrameDrawer:
    """Drawer of some `frames` of a gallery, on several threads. A fixed camera is chosen from the first of these frames."""

    def __init__(self, gallery: Gallery, request: DrawRequest, frames: Sequence[int], threads: int) -> None:
        self.gallery, self.wanted, self.frames = gallery, request, list(frames)
        self._agents = frozenset(request.agents)
        first = gallery.make_picture(self.frames[0], agents=self._agents)
        self._legend_width = compute_legend_width(first, request.width, request.show) if request.legend else 0
        least, enlarged = (MIN_AGENT_PIXELS, MAX_AGENT_ENLARGEMENT) if request.least is None else (request.least, float("inf"))
        size = request.width - self._legend_width, request.height
        self._renderer = Renderer(*size, threads=threads, marks=request.marks, blur=request.blur, least=least, enlarged=enlarged)
        self._fixed_camera = self._choose_camera(first)

    def draw(self, frame: int) -> NDArray[np.uint8]:
        """Return the picture of one frame (height, width, 3).

        Raises CacheError if the frame is damaged, PictureUnavailable if it cannot be drawn. Raises AgentMissing if a camera
        finds no agent, ValueError for an unknown word in `show`."""
        request, picture = self.wanted, self.gallery.make_picture(frame, agents=self._agents)
        follows = request.camera in ("eye", "close") and not request.rest
        moves = request.camera == "scene" and self.gallery.has_moving_camera
        camera = self._choose_camera(picture) if follows or moves else self._fixed_camera
        return add_legend(self._renderer.draw(picture, camera, show=request.show), picture, self._legend_width, request.show)

    def _choose_camera(self, picture: Picture) -> Camera:
        """Return the requested camera for a picture. Raises AgentMissing if the followed agent is not in it."""
        which, agents = self.wanted.camera, self.wanted.agents
        aspect = self._renderer.width / self._renderer.height
        if which in ("eye", "close"):
            close = which == "close"
            camera = make_eye_level_camera(picture, agents[0] if agents else None, focal=35.0 if close else 26.0, close=close)
            if camera is not None:
                return camera
            if agents or any(len(crowd.position) for crowd in picture.crowds):
                raise AgentMissing(_describe_missing_agent(picture, agents))
            which = "fit"  # a frame without agents, such as the end of a hunt; the other frames of a film still show agents
        if which == "top":
            return make_top_camera(picture, aspect=aspect)
        if which == "fit" or (which == "scene" and self.gallery.has_fitted_camera):
            return make_fitted_camera(
                self.gallery.find_outline_points(self.frames), np.asarray(picture.up, np.float64), aspect=aspect
            )
        own = self.gallery.make_camera(picture.frame or 0) if which == "scene" else None
        return own if own is not None else make_overview_camera(picture, aspect=aspect)


def _describe_missing_agent(picture: Picture, agents: Sequence[int]) -> str:
    """Return a message that the camera's agent is missing, with the numbers of agents that exist."""
    counts: dict[str, int] = {}
    for crowd in picture.crowds:
        counts[crowd.species] = counts.get(crowd.species, 0) + len(crowd.position)
    known = [f"{count} `{species}`" for species, count in counts.items() if count]
    who = f" {agents[0]}" if agents else ""
    return f"there is no agent{who} for the camera to follow; this frame has {', '.join(known) or 'nobody'}"


def make_still_path(folder: Path, frame: int) -> Path:
    """Return the path of a frame's still."""
    return folder / f"picture.{frame:04d}.png"


@dataclass(frozen=True, slots=True)
class StillStore:
    """The stills of a cache in a folder, drawn as requested."""

    folder: Path
    request: DrawRequest
    _hash_lines: Mapping[int, HashLine]
    _inputs_json: str

    @classmethod
    def build(cls, folder: Path, cache: Cache, request: DrawRequest, camera_frames: Sequence[int]) -> StillStore:
        """Return the store for the stills of a cache. A still's hash covers data that identifies the cache's frames.

        `camera_frames`: the frames that a common camera is chosen for."""
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
        """Write the picture (h, w, 3) of a frame atomically, without syncing it to the disk. Return its path."""
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

        Return None if it does not exist, is incomplete, or was drawn from other inputs."""
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
        line = self._hash_lines.get(frame)
        return blake2b(f"{frame} {line.file if line else ''} {self._inputs_json}".encode(), digest_size=16).hexdigest()
