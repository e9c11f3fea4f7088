"""A drawing as a PNG at two pixels per px, for viewers without SVG."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from antdsl.graphs.drawing import Drawing, Line, Rectangle, Words
from antdsl.graphs.letters import find_font
from antdsl.graphs.model import RGB, Point

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

SCALE = 2  # pixels for a px
SMOOTH = 2  # lines are painted so many times larger, and then made smaller
MOST = 60_000_000  # pixels painted at once; a larger drawing gets fewer for a px


def png(drawing: Drawing) -> bytes:
    """The whole file. The same drawing gives the same bytes with the same Pillow and, for letters beyond ASCII, fonts."""
    from PIL import Image, ImageDraw

    scale: float = SCALE
    while drawing.width * drawing.height * (scale * SMOOTH) ** 2 > MOST:
        scale *= 0.9
    fine = scale * SMOOTH
    wide, high = round(drawing.width * scale), round(drawing.height * scale)
    image = Image.new("RGB", (wide * SMOOTH, high * SMOOTH), (255, 255, 255))
    brush = ImageDraw.Draw(image)
    for shape in drawing.shapes:
        if isinstance(shape, Rectangle):
            _rectangle(brush, shape, fine)
        elif isinstance(shape, Line):
            _line(brush, shape, fine)
    image = image.resize((wide, high), Image.Resampling.BOX)
    for shape in drawing.shapes:
        if isinstance(shape, Words):
            _words(image, shape, scale)
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def _rectangle(brush: ImageDraw, shape: Rectangle, scale: float) -> None:
    corners = [(shape.left * scale, shape.top * scale), ((shape.left + shape.width) * scale, (shape.top + shape.height) * scale)]
    thick = max(1, round(shape.thick * scale))
    edge = _pixel_colour(shape.edge) if shape.edge is not None else None
    fill = _pixel_colour(shape.fill) if shape.fill is not None else None
    brush.rounded_rectangle(corners, shape.radius * scale, fill, None if shape.dashed else edge, thick)
    if shape.dashed and edge is not None:
        _dashes(brush, shape, scale, edge, thick)


def _dashes(brush: ImageDraw, shape: Rectangle, scale: float, ink: tuple[int, int, int], thick: int) -> None:
    """Draw a dashed edge of a box with half-round ends: dashes along both sides, the ends solid."""
    left, right, top, bottom = shape.left, shape.left + shape.width, shape.top, shape.top + shape.height
    radius = shape.radius
    x = left + radius
    while x < right - radius:
        to = min(x + 4, right - radius)
        for y in (top, bottom):
            brush.line([(x * scale, y * scale), (to * scale, y * scale)], ink, thick)
        x += 7
    for begin, start in ((left, 90), (right - 2 * radius, 270)):
        box = [(begin * scale, top * scale), ((begin + 2 * radius) * scale, bottom * scale)]
        brush.arc(box, start, start + 180, ink, thick)


def _line(brush: ImageDraw, line: Line, scale: float) -> None:
    points = [(x * scale, y * scale) for x, y in line.points]
    if line.closed:
        brush.polygon(points, _pixel_colour(line.colour))
    else:
        brush.line(points, _pixel_colour(line.colour), max(1, round(line.thick * scale)), joint="curve")


def _words(image: Image, words: Words, scale: float) -> None:
    """Draw words, narrowed if the font is wider than the space left for them."""
    from PIL import Image, ImageDraw

    letters = find_font(words.text, max(1, round(words.size * scale)))
    available_width = words.width * scale
    needs = letters.getlength(words.text)
    centre: Point = (words.centre[0] * scale, words.centre[1] * scale)
    if needs <= available_width * 1.02:
        ImageDraw.Draw(image).text(centre, words.text, _pixel_colour(words.colour), letters, anchor="mm")
        return
    mask = Image.new("L", (round(needs) + 2, round(words.size * scale * 1.6)))
    ImageDraw.Draw(mask).text((mask.width / 2, mask.height / 2), words.text, 255, letters, anchor="mm")
    mask = mask.resize((max(1, round(available_width)), mask.height), Image.Resampling.BILINEAR)
    corner = (round(centre[0] - mask.width / 2), round(centre[1] - mask.height / 2))
    image.paste(_pixel_colour(words.colour), (*corner, corner[0] + mask.width, corner[1] + mask.height), mask)


def _pixel_colour(colour: RGB) -> tuple[int, int, int]:
    red, green, blue = (round(part * 255) for part in colour)
    return red, green, blue
