"""A drawing as SVG text. Its words can be searched, and the tooltip of a line gives the location in the source."""

from __future__ import annotations

from xml.sax.saxutils import escape

from antdsl.graphs.drawing import Drawing, Line, Rectangle, Shape, TextLine, format_hex_colour
from antdsl.graphs.model import RGB


def format_svg(drawing: Drawing, fonts: str = "Helvetica, Arial, sans-serif") -> str:
    """Return the text of an SVG file. `fonts`: the font families for its words. Equal drawings give equal texts."""
    wide, high = _format_number(drawing.width), _format_number(drawing.height)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide}" height="{high}" viewBox="0 0 {wide} {high}"'
        f' font-family="{fonts}">',
        f'<rect width="{wide}" height="{high}" fill="#ffffff"/>',
        *(_format_shape(shape) for shape in drawing.shapes),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _format_shape(shape: Shape) -> str:
    if isinstance(shape, TextLine):
        x, y = _format_number(shape.centre[0]), _format_number(shape.centre[1] + shape.size * 0.35)
        return (
            f'<text x="{x}" y="{y}" font-size="{shape.size}" text-anchor="middle" fill="{_format_colour(shape.colour)}"'
            f' textLength="{_format_number(shape.width)}" lengthAdjust="spacingAndGlyphs">'
            f"{escape(_remove_illegal_characters(shape.text))}</text>"
        )
    if isinstance(shape, Rectangle):
        return _close_element(
            f'<rect x="{_format_number(shape.left)}" y="{_format_number(shape.top)}" width="{_format_number(shape.width)}"'
            f' height="{_format_number(shape.height)}" rx="{_format_number(shape.corner_radius)}"'
            f' fill="{_format_colour(shape.fill_colour)}"'
            f' stroke="{_format_colour(shape.edge_colour)}" stroke-width="{_format_number(shape.edge_width)}"'
            + (' stroke-dasharray="4 3"' if shape.is_dashed else ""),
            shape.details,
            "rect",
        )
    return _format_line(shape)


def _format_line(line: Line) -> str:
    point_list = " ".join(f"{_format_number(x)},{_format_number(y)}" for x, y in line.points)
    if line.is_closed:
        return f'<polygon points="{point_list}" fill="{_format_colour(line.colour)}"/>'
    stroke = f'stroke="{_format_colour(line.colour)}" stroke-width="{_format_number(line.line_width)}"'
    start = f'<polyline points="{point_list}" fill="none" {stroke}'
    return _close_element(start, line.details, "polyline")


def _close_element(start: str, details: str, name: str) -> str:
    return f"{start}><title>{escape(_remove_illegal_characters(details))}</title></{name}>" if details else f"{start}/>"


def _remove_illegal_characters(text: str) -> str:
    """Return the text without characters that XML 1.0 forbids even when escaped."""
    return "".join(
        sign for sign in text if sign in "\n\t" or " " <= sign <= "\ud7ff" or "\ue000" <= sign <= "\ufffd" or sign > "\uffff"
    )


def _format_number(value: float) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _format_colour(colour: RGB | None) -> str:
    return "none" if colour is None else format_hex_colour(colour)
