"""Many pictures on one: rows of equal tiles, each with a line of text below."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw

from antdsl.outputs.pictures.overlay import font

Image = NDArray[np.uint8]

_PAPER, _INK = (28, 30, 34), (236, 236, 232)


def contact_sheet(images: Sequence[Image], labels: Sequence[str], *, columns: int | None = None, width: int = 1920) -> Image:
    """A sheet `width` pixels wide of pictures (h, w, 3), with a label each. Raises ValueError when there is no picture,
    or not one label for each."""
    if not images or len(images) != len(labels):
        raise ValueError("a contact sheet takes at least one picture and one label for each")
    across = max(1, min(columns or round(len(images) ** 0.5 + 0.3), len(images)))
    down = -(-len(images) // across)
    gap = max(2, width // 160)
    tile = max(8, (width - gap * (across + 1)) // across)
    high = max(max(1, round(tile * image.shape[0] / image.shape[1])) for image in images)
    text = max(10, min(26, tile // 22))
    line = int(text * 1.7)
    sheet = PillowImage.new("RGB", (width, gap + down * (high + line + gap)), _PAPER)
    draw = ImageDraw.Draw(sheet)
    for k, (image, label) in enumerate(zip(images, labels, strict=True)):
        left, top = gap + (k % across) * (tile + gap), gap + (k // across) * (high + line + gap)
        own = max(1, round(tile * image.shape[0] / image.shape[1]))
        small = PillowImage.fromarray(np.ascontiguousarray(image)).resize((tile, own), PillowImage.Resampling.LANCZOS)
        sheet.paste(small, (left, top + (high - own) // 2))
        draw.text((left + 2, top + high + text * 0.25), label, font=font(text), fill=_INK)
    return np.asarray(sheet)
