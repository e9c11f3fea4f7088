"""A drawing as SVG text. Words in it can be searched, and the tooltip of a line names its source."""

from __future__ import annotations

from xml.sax.saxutils import escape

from antdsl.graphs.drawing import Drawing, Line, Rectangle, Shape, Words, hex_colour
from antdsl.graphs.model import RGB


def svg(drawing: Drawing, fonts: str = "Helvetica, Arial, sans-serif") -> str:
    """Return the text of an SVG file. `fonts`: the font families of its words. The same drawing gives the same text."""
    wide, high = _number(drawing.width), _number(drawing.height)
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{wide}" height="{high}" viewBox="0 0 {wide} {high}"'
        f' font-family="{fonts}">',
        f'<rect width="{wide}" height="{high}" fill="#ffffff"/>',
        *(_shape(shape) for shape in drawing.shapes),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _shape(shape: Shape) -> str:
    if isinstance(shape, Words):
        x, y = _number(shape.centre[0]), _number(shape.centre[1] + shape.size * 0.35)
        return (
            f'<text x="{x}" y="{y}" font-size="{shape.size}" text-anchor="middle" fill="{_hex(shape.colour)}"'
            f' textLength="{_number(shape.width)}" lengthAdjust="spacingAndGlyphs">{escape(_remove_illegal(shape.text))}</text>'
        )
    if isinstance(shape, Rectangle):
        return _close_element(
            f'<rect x="{_number(shape.left)}" y="{_number(shape.top)}" width="{_number(shape.width)}"'
            f' height="{_number(shape.height)}" rx="{_number(shape.radius)}" fill="{_hex(shape.fill)}"'
            f' stroke="{_hex(shape.edge)}" stroke-width="{_number(shape.thick)}"'
            + (' stroke-dasharray="4 3"' if shape.dashed else ""),
            shape.details,
            "rect",
        )
    return _line(shape)


def _line(line: Line) -> str:
    point_list = " ".join(f"{_number(x)},{_number(y)}" for x, y in line.points)
    if line.closed:
        return f'<polygon points="{point_list}" fill="{_hex(line.colour)}"/>'
    start = f'<polyline points="{point_list}" fill="none" stroke="{_hex(line.colour)}" stroke-width="{_number(line.thick)}"'
    return _close_element(start, line.details, "polyline")


def _close_element(start: str, details: str, name: str) -> str:
    return f"{start}><title>{escape(_remove_illegal(details))}</title></{name}>" if details else f"{start}/>"


def _remove_illegal(text: str) -> str:
    """Return the text without characters that XML 1.0 forbids even when escaped."""
    return "".join(
        sign for sign in text if sign in "\n\t" or " " <= sign <= "\ud7ff" or "\ue000" <= sign <= "\ufffd" or sign > "\uffff"
    )


def _number(value: float) -> str:
    return f"{value:.2f}".rstrip("0").rstrip(".")


def _hex(colour: RGB | None) -> str:
    return "none" if colour is None else hex_colour(colour)
