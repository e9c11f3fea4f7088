"""Stills of frames in a folder: each is put in its place whole, with a hash of all that it was drawn from, so that one that is
there already need not be drawn again."""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__, limits
from antdsl.bounded import read_bounded
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.cache.hashes import Line
from antdsl.outputs.drawing import Drawn
from antdsl.whole import write_whole

_WORD = "antdsl"  # of the text in a PNG file that holds the hash
STILL_BYTES = 512 * limits.MIB

Image = NDArray[np.uint8]


def still_path(folder: Path, frame: int) -> Path:
    """Where the picture of a frame is kept."""
    return folder / f"picture.{frame:04d}.png"


@dataclass(frozen=True, slots=True)
class Stills:
    """The stills of a cache in a folder, as they were asked for."""

    folder: Path
    wanted: Drawn
    _lines: Mapping[int, Line]
    _about: str

    @classmethod
    def of(cls, folder: Path, cache: Cache, wanted: Drawn, together: Sequence[int]) -> Stills:
        """Reads what tells the frames of the cache from those of another. `together`: the frames that the camera is chosen
        for."""
        read = cache.manifest.model_copy(update={"made_with": None}).model_dump_json()  # pictures do not depend on it
        manifest = blake2b(read.encode(), digest_size=16).hexdigest()
        frames = cache.frames()
        about = {
            "antdsl": __version__,
            "manifest": manifest,
            "frames": [len(frames), *frames[:1], *frames[-1:]],
            "wanted": wanted.document(),
            "together": list(together),
        }
        return cls(folder, wanted, cache.lines(), json.dumps(about, sort_keys=True))

    def put(self, frame: int, image: Image) -> Path:
        """Write the picture (h, w, 3) of a frame, whole or not at all. It is not synced."""
        from PIL import Image as PillowImage
        from PIL.PngImagePlugin import PngInfo

        words = PngInfo()
        words.add_text(_WORD, self._hash(frame))
        data = io.BytesIO()
        PillowImage.fromarray(image).save(data, "PNG", compress_level=4, pnginfo=words)
        write_whole(still_path(self.folder, frame), data.getvalue(), sync=False)
        return still_path(self.folder, frame)

    def kept(self, frame: int) -> Image | None:
        """The picture (h, w, 3) of a frame, where it is there, whole, and drawn from the same as it would be now."""
        from antdsl.reader.image_request import ImageError, read_image_file

        try:
            data = read_bounded(still_path(self.folder, frame), STILL_BYTES)
            picture = read_image_file(data, "PNG", ("RGB",), self.wanted.width * self.wanted.height)
        except (OSError, ImageError):
            return None
        if (picture.columns, picture.rows) != (self.wanted.width, self.wanted.height):
            return None
        return picture.samples if picture.texts.get(_WORD) == self._hash(frame) else None

    def _hash(self, frame: int) -> str:
        line = self._lines.get(frame)
        return blake2b(f"{frame} {line.file if line else ''} {self._about}".encode(), digest_size=16).hexdigest()
