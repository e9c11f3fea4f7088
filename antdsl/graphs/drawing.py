"""Conversion of charts with positions to shapes: rectangles, lines and words in px, in the order in which they are painted."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import hypot

from antdsl.graphs.layout import LINE_HEIGHT, NAME_FONT_SIZE, WORD_FONT_SIZE
from antdsl.graphs.model import RGB, Box, Chart, PlacedArrow, PlacedBox, PlacedChart, Point
from antdsl.graphs.text_width import measure_text_width

WHITE: RGB = (1.0, 1.0, 1.0)
TEXT_COLOUR: RGB = (0.13, 0.13, 0.16)
FRAME_COLOUR: RGB = (0.84, 0.84, 0.82)
INTERRUPT_COLOUR: RGB = (0.78, 0.05, 0.16)
INTERRUPT_LINE_WIDTH, PLAIN_LINE_WIDTH = 2.6, 1.4  # px; lines of interrupts and of other transitions
TITLE_SIZE, TITLE_HEIGHT = 16, 34.0
CHART_GAP = 28.0  # px between charts
MAX_ROW_WIDTH = 1500.0  # maximum width of a row of charts, unless one chart is wider
CORNER_RADIUS = 7.0  # radius where an arrow turns
ARROW_HEAD_LENGTH = 8.0  # length of an arrow's head


@dataclass(frozen=True, slots=True)
class Rectangle:
    """A rectangle. `corner_radius`: the radius of its corners, px. `fill_colour`, `edge_colour`: its colours; None for no fill
    or no edge."""

    left: float
    top: float
    width: float
    height: float
    corner_radius: float
    fill_colour: RGB | None
    edge_colour: RGB | None
    edge_width: float = 1.0
    is_dashed: bool = False
    details: str = ""


@dataclass(frozen=True, slots=True)
class Line:
    """A line through points. Its corners are already rounded. A closed line is the filled head of an arrow."""

    points: tuple[Point, ...]
    colour: RGB
    line_width: float
    is_closed: bool = False
    details: str = ""


@dataclass(frozen=True, slots=True)
class TextLine:
    """One line of text. `centre`: its centre, px. `size`: its font size, px. `width`: the width into which viewers must fit the
    text, px."""

    text: str
    centre: Point
    size: int
    colour: RGB
    width: float


Shape = Rectangle | Line | TextLine


@dataclass(frozen=True, slots=True)
class Drawing:
    """A drawing: shapes in the order in which they are painted, on a white background of `width` × `height` px."""

    width: float
    height: float
    shapes: tuple[Shape, ...]


def draw_charts(charts: Sequence[PlacedChart]) -> Drawing:
    """Return a drawing of charts in rows, each chart in a frame below its title."""
    shapes: list[Shape] = []
    right = down = high = broadest = 0.0
    for chart in charts:
        wide = max(chart.width, measure_text_width(chart.chart.title, TITLE_SIZE) + 24)
        if right > 0 and right + wide > MAX_ROW_WIDTH:
            right, down, high = 0.0, down + high + CHART_GAP, 0.0
        left, top = CHART_GAP + right, CHART_GAP + down
        shapes.append(Rectangle(left, top, wide, chart.height + TITLE_HEIGHT, 10, WHITE, FRAME_COLOUR))
        shapes.append(_make_centred_line(chart.chart.title, (left + wide / 2, top + 18), TITLE_SIZE, TEXT_COLOUR))
        shapes += _draw_chart(chart.shift(left + (wide - chart.width) / 2, top + TITLE_HEIGHT))
        right, high = right + wide + CHART_GAP, max(high, chart.height + TITLE_HEIGHT)
        broadest = max(broadest, right)
    return Drawing(broadest + CHART_GAP, down + high + 2 * CHART_GAP, tuple(shapes))


def _draw_chart(chart: PlacedChart) -> Iterator[Shape]:
    colours = choose_line_colours(chart.chart)
    lines = list(zip(chart.arrows, colours, strict=True))
    for arrow, colour in lines:
        yield from _draw_line(arrow, colour)
    for box, place in chart.boxes:
        yield from _draw_box(box, place)
    for arrow, colour in lines:
        yield from _draw_words(arrow, colour)


def choose_line_colours(chart: Chart) -> tuple[RGB, ...]:
    """Return the colour of each arrow: that of its source state, darkened until it is visible. Interrupts have a separate
    colour."""
    colours = {box.key: darken_colour(box.colour) for box in chart.boxes}
    return tuple(INTERRUPT_COLOUR if arrow.interrupt else colours[arrow.source] for arrow in chart.arrows)


def format_hex_colour(colour: RGB) -> str:
    """Return a colour as `#rrggbb`."""
    return "#" + "".join(f"{round(part * 255):02x}" for part in colour)


def _draw_line(arrow: PlacedArrow, colour: RGB) -> Iterator[Shape]:
    """Yield the shapes of an arrow's line. A slightly wider white line below it separates it from lines that it crosses."""
    thick = INTERRUPT_LINE_WIDTH if arrow.arrow.interrupt else PLAIN_LINE_WIDTH
    head, end = _compute_arrow_head(arrow.points[-2], arrow.points[-1], ARROW_HEAD_LENGTH + thick)
    path = _round_corners((*arrow.points[:-1], end))
    yield Line(path, WHITE, thick + 4)
    yield Line(path, colour, thick, details=arrow.arrow.details)
    yield Line(head, colour, 0.0, is_closed=True)


def _compute_arrow_head(previous_point: Point, tip: Point, head_length: float) -> tuple[tuple[Point, ...], Point]:
    """Return the three corners of an arrow's head, and the point at which its line must end. `head_length`: its length, px."""
    far = hypot(tip[0] - previous_point[0], tip[1] - previous_point[1]) or 1.0
    x, y = (tip[0] - previous_point[0]) / far, (tip[1] - previous_point[1]) / far
    back = (tip[0] - x * head_length, tip[1] - y * head_length)
    half = head_length * 0.42
    return (tip, (back[0] - y * half, back[1] + x * half), (back[0] + y * half, back[1] - x * half)), back


def _round_corners(points: Sequence[Point]) -> tuple[Point, ...]:
    """Return the path with each corner replaced by an arc of six points."""
    curve = [points[0]]
    for previous_point, corner, next_point in zip(points, points[1:], points[2:], strict=False):
        curve_start, curve_end = _move_towards(corner, previous_point), _move_towards(corner, next_point)
        for k in range(7):
            t = k / 6
            a, b, c = (1 - t) ** 2, 2 * t * (1 - t), t * t
            curve.append(
                (a * curve_start[0] + b * corner[0] + c * curve_end[0], a * curve_start[1] + b * corner[1] + c * curve_end[1])
            )
    return (*curve, points[-1])


def _move_towards(corner: Point, other: Point) -> Point:
    """Return the point at which the rounding of a corner begins, on the line from the corner to `other`."""
    far = hypot(other[0] - corner[0], other[1] - corner[1])
    share = min(CORNER_RADIUS, far / 2) / far if far else 0.0
    return corner[0] + (other[0] - corner[0]) * share, corner[1] + (other[1] - corner[1]) * share


def _draw_box(box: Box, place: PlacedBox) -> Iterator[Shape]:
    frame = Rectangle(
        place.left, place.top, place.width, place.height, 7, box.colour, darken_colour(box.colour), 1.2, details=box.details
    )
    x, y = place.centre
    if box.kind in ("start", "choice"):
        yield replace(
            frame, corner_radius=place.height / 2, fill_colour=box.colour if box.kind == "start" else WHITE, edge_width=1.6
        )
    elif box.kind != "state":
        yield replace(frame, corner_radius=place.height / 2, fill_colour=WHITE, is_dashed=True)
        yield _make_centred_line(box.name, (x, y), WORD_FONT_SIZE, TEXT_COLOUR)
    else:
        ink = choose_text_colour(box.colour)
        yield frame
        yield _make_centred_line(box.name, (x, y - 8 if box.label else y), NAME_FONT_SIZE, ink)
        if box.label:
            yield _make_centred_line(box.label, (x, y + 10), WORD_FONT_SIZE, ink)


def _draw_words(arrow: PlacedArrow, colour: RGB) -> Iterator[Shape]:
    """Yield the shapes of an arrow's words: a white background, then one shape for each line of text."""
    if arrow.words is None:
        return
    x, y = arrow.words.centre
    box = arrow.words
    yield Rectangle(box.left, box.top, box.width, box.height, 3, WHITE, None)
    first = y - LINE_HEIGHT * (len(arrow.lines) - 1) / 2
    ink = darken_colour(colour, 0.1)
    for number, line in enumerate(arrow.lines):
        yield _make_centred_line(line, (x, first + LINE_HEIGHT * number), WORD_FONT_SIZE, ink)


def _make_centred_line(text: str, centre: Point, size: int, colour: RGB) -> TextLine:
    return TextLine(text, centre, size, colour, measure_text_width(text, size))


def choose_text_colour(colour: RGB) -> RGB:
    """Return black or white, whichever is easier to read on a background of this colour."""
    return TEXT_COLOUR if _compute_luminance(colour) > 0.3 else WHITE


def _compute_luminance(colour: RGB) -> float:
    """Return the relative luminance of a colour as defined by WCAG 2, from 0 to 1."""
    red, green, blue = ((c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4) for c in colour)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def darken_colour(colour: RGB, max_luminance: float = 0.22) -> RGB:
    """Return the colour, darkened until its luminance is at most `max_luminance`. The default makes a thin line visible on
    white. Words need 0.1, which gives a contrast of 7 : 1."""
    while _compute_luminance(colour) > max_luminance:
        colour = (colour[0] * 0.92, colour[1] * 0.92, colour[2] * 0.92)
    return colour
