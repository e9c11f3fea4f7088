"""Decoding of images with Pillow. This runs in the reader process, never in the requesting process."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.reader.protocol import RefusalError

if TYPE_CHECKING:
    from antdsl.reader.protocol import ReaderMessage

_MAX_TEXT_ENTRIES = 64  # maximum number of text entries of a PNG file
_MAX_TEXT_CHARACTERS = 1000


def read_image(request: ReaderMessage) -> tuple[dict[str, Any], Mapping[str, NDArray[Any]]]:
    """Return the image in the array `data` of a request.

    The result has its `mode`, `columns`, `rows`, number of `pages` and `texts`, and the array `samples` (rows, columns) or
    (rows, columns, channels). There are no samples if the image has several pages, more than `pixels` pixels, or a mode that is
    not one of `modes`. The request also has `format`, Pillow's name of the file format, and `convert`, the mode to which the
    image is converted."""
    from PIL import Image

    request_document = request.document
    data = io.BytesIO(request.require_array("data", "|u1", None).tobytes())
    arrays: dict[str, NDArray[Any]] = {}
    try:
        with Image.open(data, formats=(request_document["format"],)) as image:
            columns, rows = image.size
            pages = getattr(image, "n_frames", 1)
            mode, target = image.mode, str(request_document.get("convert", ""))
            if pages == 1 and columns * rows <= int(request_document["pixels"]) and (target or mode in request_document["modes"]):
                _require_complete_image(image)
                arrays["samples"] = np.asarray(image.convert(target) if target else image)
                mode = target or mode
            document = {"mode": mode, "columns": columns, "rows": rows, "pages": pages}
            return document | {"texts": _read_texts(image.info)}, arrays  # text entries may come after the samples
    except (MemoryError, RefusalError):
        raise
    except Exception as problem:  # a library may raise any error for an untrusted file
        raise RefusalError("bad-image", type(problem).__name__) from problem


def _require_complete_image(image: Any) -> None:
    """Reject a file of which the strips or tiles do not cover the image, because Pillow leaves the missing pixels black."""
    boxes = [part[1] for part in image.tile]
    if boxes and all(boxes):
        covered_pixels = sum((right - left) * (bottom - top) for left, top, right, bottom in boxes)
        if covered_pixels < image.width * image.height:
            raise RefusalError("bad-image", "parts of the image are missing")


def _read_texts(info: Mapping[Any, Any]) -> dict[str, str]:
    entries = [(name, text) for name, text in info.items() if isinstance(name, str) and isinstance(text, str)]
    return {name[:_MAX_TEXT_CHARACTERS]: text[:_MAX_TEXT_CHARACTERS] for name, text in entries[:_MAX_TEXT_ENTRIES]}
