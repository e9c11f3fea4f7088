"""The legend next to a picture, and sheets of several pictures.

The legend shows the frame number, the states of each species with colours and counts, and fields with a scale of numbers. A sheet
consists of tiles of equal size, each with a line of text below it."""

from collections.abc import Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageDraw

from antdsl.outputs.pictures.light import encode_srgb
from antdsl.outputs.pictures.model import Picture, Trail
from antdsl.outputs.pictures.overlay import load_font
from antdsl.outputs.pictures.surface_materials import SOIL_COLOUR
from antdsl.outputs.pictures.trail_colours import choose_full_strength, colour_ground, compute_cover

_SHEET_COLOUR, _LABEL_COLOUR = (28, 30, 34), (236, 236, 232)
Image = NDArray[np.uint8]

_PAPER_COLOUR, _INK_COLOUR, _SOFT_COLOUR = (28, 30, 34), (238, 238, 234), (164, 166, 168)
_LEGEND_WIDTH_SHARE = 0.22  # share of the picture's width
_TICK_SHARES = (1.0, 0.1, 0.01, 0.001)  # shares of the strongest value


def compute_legend_width(picture: Picture, width: int, show: tuple[str, ...]) -> int:
    """Return the width of the legend in pixels, for an image that is `width` pixels wide. 0 if there is nothing to show."""
    has_content = picture.legend or (picture.trails and "trail" in show)
    return min(max(round(_LEGEND_WIDTH_SHARE * width), 120), width // 2) if has_content else 0


def add_legend(image: Image, picture: Picture, legend_width: int, show: tuple[str, ...]) -> Image:
    """Return `image` (h, w, 3) with a legend of `legend_width` pixels at its right side."""
    if legend_width <= 0:
        return image
    high = image.shape[0]
    strip_image = PillowImage.new("RGB", (legend_width, high), _PAPER_COLOUR)
    draw = ImageDraw.Draw(strip_image)
    trails = [trail for trail in picture.trails if "trail" in show]
    species = [(name, list(rows)) for name, rows in groupby(picture.legend, key=lambda row: row.species)]
    lines = 1.6 + sum(1.7 + len(rows) for _, rows in species) + 4.2 * len(trails)
    size = max(8, min(high // 40, legend_width // 13, int(high / (1.4 * max(lines, 1)))))
    edge, line = size, round(size * 1.4)
    small = _choose_font_size(draw, picture, legend_width - 2 * edge - round(2.2 * size), size)
    top = edge
    if picture.frame is not None:
        draw.text((edge, top), f"frame {picture.frame}", font=load_font(size), fill=_SOFT_COLOUR)
        top += round(1.6 * line)
    for name, rows in species:
        if name:
            count = f"{sum(row.count for row in rows):,}"
            _draw_line(draw, name, count, (edge, top), legend_width - edge, size)
            draw.line((edge, top + line, legend_width - edge, top + line), fill=(78, 80, 84))
            top += round(1.25 * line)
        for row in rows:
            if row.colour is not None:
                draw.ellipse((edge, top + size * 0.15, edge + size * 0.9, top + size * 1.05), fill=row.colour)
            indent = round(1.4 * size) if row.colour is not None else 0
            _draw_line(draw, row.name, f"{row.count:,}", (edge + indent, top), legend_width - edge, small)
            top += line
        top += round(0.45 * line)
    for trail in trails:
        _draw_scale(strip_image, draw, trail, (edge, top), legend_width - edge, size)
        top += round(4.2 * line)
    return np.concatenate([image, np.asarray(strip_image)], axis=1)


def _choose_font_size(draw: ImageDraw.ImageDraw, picture: Picture, available_width: int, size: int) -> int:
    """Return the font size for which every state name fits next to its count, at least 70 % of `size`."""
    small = size
    while small > max(8, round(0.7 * size)) and any(
        draw.textlength(row.name, font=load_font(small)) + draw.textlength(f"{row.count:,}", font=load_font(small))
        > available_width
        for row in picture.legend
    ):
        small -= 1
    return small


def _draw_line(draw: ImageDraw.ImageDraw, name: str, count: str, position: tuple[int, int], right: int, size: int) -> None:
    """Draw a name at the left, truncated if necessary, and a number at the right."""
    left, top = position
    number = draw.textlength(count, font=load_font(size))
    available_width = right - left - number - size * 0.5
    while len(name) > 2 and draw.textlength(name, font=load_font(size)) > available_width:
        name = name[:-2].rstrip() + "…"
    draw.text((left, top), name, font=load_font(size), fill=_INK_COLOUR)
    draw.text((right - number, top), count, font=load_font(size), fill=_INK_COLOUR)


def _draw_scale(
    strip_image: PillowImage.Image, draw: ImageDraw.ImageDraw, trail: Trail, position: tuple[int, int], right: int, size: int
) -> None:
    """Draw a bar in the colours that the field has on level soil, labelled with the corresponding strengths."""
    left, top = position
    full = choose_full_strength(trail)
    draw.text((left, top), trail.name, font=load_font(size), fill=_INK_COLOUR)
    top += round(1.5 * size)
    wide, high = right - left, round(size * 0.8)
    share = np.linspace(0, 1, wide).astype(np.float32)
    row = encode_srgb(colour_ground(np.tile(SOIL_COLOUR, (wide, 1)).astype(np.float32), share, trail))
    strip_image.paste(PillowImage.fromarray(np.tile(row[None], (high, 1, 1))), (left, top))
    top += high
    small = max(7, round(size * 0.8))
    taken = float(right + size)
    for tick in _TICK_SHARES:
        x = left + float(compute_cover(np.array([tick]), 1.0)[0]) * (wide - 1)
        text = f"{full * tick:.3g}"
        long = draw.textlength(text, font=load_font(small))
        begin = min(max(x - long / 2, left), right - long)
        if begin + long + size * 0.4 > taken or full <= 0:
            continue
        draw.line((x, top, x, top + size * 0.25), fill=_SOFT_COLOUR)
        draw.text((begin, top + size * 0.3), text, font=load_font(small), fill=_SOFT_COLOUR)
        taken = begin
    if taken - left > size * 1.2:
        draw.text((left, top + size * 0.3), "0", font=load_font(small), fill=_SOFT_COLOUR)


def make_contact_sheet(images: Sequence[Image], labels: Sequence[str], *, columns: int | None = None, width: int = 1920) -> Image:
    """Return a sheet of pictures (h, w, 3), each with a label. `width`: the width of the sheet in pixels.

    Raises ValueError if there are no pictures, or if the numbers of pictures and labels differ."""
    if not images or len(images) != len(labels):
        raise ValueError("a contact sheet needs at least one picture and one label for each")
    across = max(1, min(columns or round(len(images) ** 0.5 + 0.3), len(images)))
    down = -(-len(images) // across)
    gap = max(2, width // 160)
    tile = max(8, (width - gap * (across + 1)) // across)
    high = max(max(1, round(tile * image.shape[0] / image.shape[1])) for image in images)
    text = max(10, min(26, tile // 22))
    line = int(text * 1.7)
    sheet = PillowImage.new("RGB", (width, gap + down * (high + line + gap)), _SHEET_COLOUR)
    draw = ImageDraw.Draw(sheet)
    for k, (image, label) in enumerate(zip(images, labels, strict=True)):
        left, top = gap + (k % across) * (tile + gap), gap + (k // across) * (high + line + gap)
        own = max(1, round(tile * image.shape[0] / image.shape[1]))
        small = PillowImage.fromarray(np.ascontiguousarray(image)).resize((tile, own), PillowImage.Resampling.LANCZOS)
        sheet.paste(small, (left, top + (high - own) // 2))
        draw.text((left + 2, top + high + text * 0.25), label, font=load_font(text), fill=_LABEL_COLOUR)
    return np.asarray(sheet)
