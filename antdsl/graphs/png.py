"""A drawing as a PNG file with two pixels per px, for viewers without SVG. The library resvg renders the SVG of the drawing."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory

from antdsl.graphs.drawing import Drawing, TextLine
from antdsl.graphs.svg import format_svg
from antdsl.graphs.text_width import has_built_in_glyphs, load_built_in_font

PIXELS_PER_PX = 2.0  # pixels per px
MAX_PIXELS = 15_000_000  # maximum number of pixels; a larger drawing gets fewer pixels per px


def render_png(drawing: Drawing) -> bytes:
    """Return the bytes of a PNG file. Raises ImportError if resvg is not installed.

    Equal drawings give equal bytes with the same versions of Pillow and resvg. Non-ASCII characters also depend on the machine's
    fonts."""
    from resvg_py import svg_to_bytes

    font = load_built_in_font(16)
    family, _ = font.getname()
    texts = [shape.text for shape in drawing.shapes if isinstance(shape, TextLine)]
    scale = min(PIXELS_PER_PX, sqrt(MAX_PIXELS / (drawing.width * drawing.height)))
    with TemporaryDirectory(prefix="antdsl-font-") as folder:
        file = Path(folder, "built_in.ttf")
        file.write_bytes(font.font_bytes)
        data: bytes = svg_to_bytes(
            svg_string=format_svg(drawing, str(family)),
            width=round(drawing.width * scale),
            font_files=[str(file)],
            skip_system_fonts=all(map(has_built_in_glyphs, texts)),
        )
    return data
