"""Placed charts → shapes: rectangles, lines and words in px, in the order in which they are painted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot

from antdsl.graphs.layout import LINE, NAME_SIZE, WORD_SIZE
from antdsl.graphs.letters import width
from antdsl.graphs.model import RGB, Box, Chart, PlacedArrow, PlacedBox, PlacedChart, Point

WHITE: RGB = (1.0, 1.0, 1.0)
INK: RGB = (0.13, 0.13, 0.16)
FRAME: RGB = (0.84, 0.84, 0.82)
INTERRUPT: RGB = (0.78, 0.05, 0.16)
THICK, THIN = 2.6, 1.4  # lines of interrupts and of others, px
TITLE_SIZE, TITLE_ROOM = 16, 34.0
GAP = 28.0  # between charts, px
ROW = 1500.0  # a row of charts is not wider, unless one chart is
CORNER = 7.0  # radius where an arrow turns
HEAD = 8.0  # length of an arrow's head


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle. `radius`: the radius of its corners. `fill`, `edge`: colours; None for no fill or no edge."""

    left: float
    top: float
    width: float
    height: float
    radius: float
    fill: RGB | None
    edge: RGB | None
    thick: float = 1.0
    dashed: bool = False
    details: str = ""


@dataclass(frozen=True, slots=True)
class Line:
    """A line through points, with corners already rounded. If it is closed, it is the filled head of an arrow."""

    points: tuple[Point, ...]
    colour: RGB
    thick: float
    closed: bool = False
    details: str = ""


@dataclass(frozen=True, slots=True)
class Words:
    """One line of words with its middle at `centre`; always `width` px wide."""

    text: str
    centre: Point
    size: int
    colour: RGB
    width: float


Shape = Rectangle | Line | Words


@dataclass(frozen=True, slots=True)
class Drawing:
    """All shapes, on a white ground of `width` × `height` px."""

    width: float
    height: float
    shapes: tuple[Shape, ...]


def draw(charts: Sequence[PlacedChart]) -> Drawing:
    """Draw charts in rows, each in a frame under its title."""
    shapes: list[Shape] = []
    right = down = high = broadest = 0.0
    for chart in charts:
        wide = max(chart.width, width(chart.chart.title, TITLE_SIZE) + 24)
        if right > 0 and right + wide > ROW:
            right, down, high = 0.0, down + high + GAP, 0.0
        left, top = GAP + right, GAP + down
        shapes.append(Rectangle(left, top, wide, chart.height + TITLE_ROOM, 10, WHITE, FRAME))
        shapes.append(_centred_words(chart.chart.title, (left + wide / 2, top + 18), TITLE_SIZE, INK))
        shapes += _chart_shapes(chart.shifted_by(left + (wide - chart.width) / 2, top + TITLE_ROOM))
        right, high = right + wide + GAP, max(high, chart.height + TITLE_ROOM)
        broadest = max(broadest, right)
    return Drawing(broadest + GAP, down + high + 2 * GAP, tuple(shapes))


def _chart_shapes(chart: PlacedChart) -> Iterator[Shape]:
    colours = line_colours(chart.chart)
    lines = list(zip(chart.arrows, colours, strict=True))
    for arrow, colour in lines:
        yield from _line_shapes(arrow, colour)
    for box, place in chart.boxes:
        yield from _box_shapes(box, place)
    for arrow, colour in lines:
        yield from _word_shapes(arrow, colour)


def line_colours(chart: Chart) -> tuple[RGB, ...]:
    """Return the colour of each arrow. It is the colour of the source state, dark enough to be visible; interrupts have a
    separate colour."""
    colours = {box.key: darken(box.colour) for box in chart.boxes}
    return tuple(INTERRUPT if arrow.interrupt else colours[arrow.source] for arrow in chart.arrows)


def hex_colour(colour: RGB) -> str:
    """Return a colour as `#rrggbb`."""
    return "#" + "".join(f"{round(part * 255):02x}" for part in colour)


def _line_shapes(arrow: PlacedArrow, colour: RGB) -> Iterator[Shape]:
    """Yield the shapes of a line. A white rim below it separates it from lines that it crosses."""
    thick = THICK if arrow.arrow.interrupt else THIN
    head, end = _arrow_head(arrow.points[-2], arrow.points[-1], HEAD + thick)
    path = _round_corners((*arrow.points[:-1], end))
    yield Line(path, WHITE, thick + 4)
    yield Line(path, colour, thick, details=arrow.arrow.details)
    yield Line(head, colour, 0.0, closed=True)


def _arrow_head(previous_point: Point, tip: Point, long: float) -> tuple[tuple[Point, ...], Point]:
    """Return the three corners of an arrow's head, and the point at which the line ends. `long`: the length of the head, px."""
    far = hypot(tip[0] - previous_point[0], tip[1] - previous_point[1]) or 1.0
    x, y = (tip[0] - previous_point[0]) / far, (tip[1] - previous_point[1]) / far
    back = (tip[0] - x * long, tip[1] - y * long)
    half = long * 0.42
    return (tip, (back[0] - y * half, back[1] + x * half), (back[0] + y * half, back[1] - x * half)), back


def _round_corners(points: Sequence[Point]) -> tuple[Point, ...]:
    """Return the path with rounded corners of six points each."""
    curve = [points[0]]
    for previous_point, corner, next_point in zip(points, points[1:], points[2:], strict=False):
        into, out = _step_toward(corner, previous_point), _step_toward(corner, next_point)
        for k in range(7):
            t = k / 6
            a, b, c = (1 - t) ** 2, 2 * t * (1 - t), t * t
            curve.append((a * into[0] + b * corner[0] + c * out[0], a * into[1] + b * corner[1] + c * out[1]))
    return (*curve, points[-1])


def _step_toward(corner: Point, other: Point) -> Point:
    far = hypot(other[0] - corner[0], other[1] - corner[1])
    share = min(CORNER, far / 2) / far if far else 0.0
    return corner[0] + (other[0] - corner[0]) * share, corner[1] + (other[1] - corner[1]) * share


def _box_shapes(box: Box, place: PlacedBox) -> Iterator[Shape]:
    frame = Rectangle(
        place.left, place.top, place.width, place.height, 7, box.colour, darken(box.colour), 1.2, details=box.details
    )
    x, y = place.centre
    if box.kind in ("start", "choice"):
        yield replace(frame, radius=place.height / 2, fill=box.colour if box.kind == "start" else WHITE, thick=1.6)
    elif box.kind != "state":
        yield replace(frame, radius=place.height / 2, fill=WHITE, dashed=True)
        yield _centred_words(box.name, (x, y), WORD_SIZE, INK)
    else:
        ink = ink_on(box.colour)
        yield frame
        yield _centred_words(box.name, (x, y - 8 if box.label else y), NAME_SIZE, ink)
        if box.label:
            yield _centred_words(box.label, (x, y + 10), WORD_SIZE, ink)


def _word_shapes(arrow: PlacedArrow, colour: RGB) -> Iterator[Shape]:
    if arrow.words is None:
        return
    x, y = arrow.words.centre
    box = arrow.words
    yield Rectangle(box.left, box.top, box.width, box.height, 3, WHITE, None)
    first = y - LINE * (len(arrow.lines) - 1) / 2
    ink = darken(colour, 0.1)
    for number, line in enumerate(arrow.lines):
        yield _centred_words(line, (x, first + LINE * number), WORD_SIZE, ink)


def _centred_words(text: str, centre: Point, size: int, colour: RGB) -> Words:
    return Words(text, centre, size, colour, width(text, size))


def ink_on(colour: RGB) -> RGB:
    """Return black or white, whichever is easier to read on the colour."""
    return INK if _luminance(colour) > 0.3 else WHITE


def _luminance(colour: RGB) -> float:
    """Return the relative luminance as defined by WCAG 2, from 0 to 1."""
    red, green, blue = ((c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4) for c in colour)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def darken(colour: RGB, most: float = 0.22) -> RGB:
    """Return the colour, darkened to a luminance of at most `most`. The default makes a thin line visible on white. For words,
    0.1 gives a contrast of 7 : 1."""
    while _luminance(colour) > most:
        colour = (colour[0] * 0.92, colour[1] * 0.92, colour[2] * 0.92)
    return colour
