"""Images in the reader: Pillow decodes them there, and never in the process that asks."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.reader.refusal import Refusal

if TYPE_CHECKING:
    from antdsl.reader.protocol import Message

FORMATS = ("PNG", "TIFF")
_TEXTS = 64  # text entries of a PNG file that are passed on
_CHARACTERS = 1000


def read_image(request: Message) -> tuple[dict[str, Any], Mapping[str, NDArray[Any]]]:
    """The samples of the image whose bytes are the array `data`, of the format `format`: `mode`, `texts` by name, and the array
    `samples` (rows, columns) or (rows, columns, channels). `pixels`: more are not decoded."""
    from PIL import Image

    said = request.document
    data = io.BytesIO(request.array("data", "|u1", None).tobytes())
    try:
        with Image.open(data, formats=(said["format"],)) as image:
            columns, rows = image.size
            pages = getattr(image, "n_frames", 1)
            document = {"mode": image.mode, "columns": columns, "rows": rows, "pages": pages, "texts": _texts(image.info)}
            if pages != 1 or columns * rows > int(said["pixels"]) or image.mode not in said["modes"]:
                return document, {}
            samples = np.asarray(image)
    except (MemoryError, Refusal):
        raise
    except Exception as problem:  # a library's reader meets a stranger's file
        raise Refusal("bad-image", type(problem).__name__) from problem
    return document, {"samples": samples}


def _texts(info: Mapping[Any, Any]) -> dict[str, str]:
    found = [(name, text) for name, text in info.items() if isinstance(name, str) and isinstance(text, str)]
    return {name[:_CHARACTERS]: text[:_CHARACTERS] for name, text in found[:_TEXTS]}
