"""A drawing as a PNG at two pixels per px, for viewers without SVG. The library resvg renders the drawing's SVG."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from tempfile import TemporaryDirectory

from antdsl.graphs.drawing import Drawing, Words
from antdsl.graphs.letters import built_in_font, is_built_in
from antdsl.graphs.svg import svg

SCALE = 2.0  # pixels for a px
MOST = 15_000_000  # pixels of a picture; a larger drawing gets fewer for a px


def png(drawing: Drawing) -> bytes:
    """Return the bytes of a PNG file. Raises ImportError without resvg.

    The same drawing gives the same bytes with the same versions of Pillow and resvg. Characters beyond ASCII also depend on the
    machine's fonts."""
    from resvg_py import svg_to_bytes

    font = built_in_font(16)
    family, _ = font.getname()
    texts = [shape.text for shape in drawing.shapes if isinstance(shape, Words)]
    scale = min(SCALE, sqrt(MOST / (drawing.width * drawing.height)))
    with TemporaryDirectory(prefix="antdsl-font-") as folder:
        file = Path(folder, "built_in.ttf")
        file.write_bytes(font.font_bytes)
        data: bytes = svg_to_bytes(
            svg_string=svg(drawing, str(family)),
            width=round(drawing.width * scale),
            font_files=[str(file)],
            skip_system_fonts=all(map(is_built_in, texts)),
        )
    return data
