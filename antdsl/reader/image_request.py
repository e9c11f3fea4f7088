"""Images that are decoded in the reader process and checked here."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.reader import client
from antdsl.reader.protocol import ProtocolError, ReaderMessage, RefusalError

# Modes of Pillow that can be requested: sample type, and channels (0: one, without a separate axis).
SAMPLE_TYPE_BY_MODE = {
    "F": ("f4", 0),
    "I;16": ("u2", 0),
    "I;16L": ("u2", 0),
    "I;16B": ("u2", 0),
    "I;16N": ("u2", 0),
    "L": ("u1", 0),
    "RGB": ("u1", 3),
}


class ImageError(Exception):
    """Error for a file that cannot be used as an image. The message is worded to follow the file's name; `help` says what to
    do."""

    def __init__(self, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.help = help


@dataclass(frozen=True, slots=True, eq=False)
class ImageFile:
    """The content of an image file.

    - `samples`: (rows, columns) or (rows, columns, channels); None if the image has several pages, too many pixels, or a mode
      that was not accepted
    - `texts`: the texts of a PNG file by name"""

    mode: str
    rows: int
    columns: int
    pages: int
    texts: dict[str, str]
    samples: NDArray[Any] | None


def read_image_file(data: bytes, format: str, modes: Collection[str], max_pixels: int, convert: str = "") -> ImageFile:
    """Return the image in the bytes of a file. Raises ImageError with the reason if this is not possible.

    - `format`: Pillow's name of the file format, such as `PNG`
    - `modes`: the accepted modes, keys of SAMPLE_TYPE_BY_MODE
    - `max_pixels`: the largest accepted number of pixels
    - `convert`: the mode, one of `modes`, to which the image is converted; "" to accept only images that already have one of
      `modes`"""
    request_document: dict[str, Any] = {
        "format": format,
        "modes": [mode for mode in modes if mode in SAMPLE_TYPE_BY_MODE],
        "pixels": max_pixels,
    }
    if convert:
        request_document["convert"] = convert
    digest = blake2b(repr(sorted(request_document.items())).encode() + data, digest_size=16).hexdigest()
    try:
        answer = client.send_request(
            "image",
            request_document,
            {"data": np.frombuffer(data, np.uint8)},
            file_bytes=len(data),
            request_digest=digest,
            files_digest=digest,
        )
        return _check_image_answer(answer, request_document["modes"], max_pixels)
    except RefusalError as error:
        if error.code == "missing-extra":
            raise ImageError(str(error), error.help) from None
        raise ImageError(f"cannot be read as {format} ({error})", "export the image again") from None
    except client.ReaderFailureError as error:
        raise ImageError(str(error), error.help) from None
    except ProtocolError as error:
        raise ImageError(
            f"cannot be read as {format}: the reader sent an invalid answer ({error})", "export the image again"
        ) from None


def _check_image_answer(answer: ReaderMessage, modes: Any, max_pixels: int) -> ImageFile:
    document = answer.document
    mode, texts = document.get("mode"), document.get("texts")
    rows, columns, pages = (int(answer.require_number(name)) for name in ("rows", "columns", "pages"))
    if not isinstance(mode, str) or not isinstance(texts, dict) or not all(isinstance(text, str) for text in texts.values()):
        raise ProtocolError("`mode` or `texts` is missing")
    samples = None
    if pages == 1 and mode in modes and rows * columns <= max_pixels:
        dtype, channels = SAMPLE_TYPE_BY_MODE[mode]
        samples = answer.require_array("samples", dtype, rows, columns, *([channels] if channels else []))
    return ImageFile(mode[:40], rows, columns, pages, texts, samples)
