"""The layout of charts: states in layers, arrows with right angles, and labels that cover no boxes.

The library graphlay computes a layered layout (Sugiyama, Tagawa, Toda 1981). It leaves space for labels and gives the same
positions on every machine. A label is on its own arrow or next to it. It does not touch boxes or other labels and, if possible,
no lines.

Every arrow has candidate positions for its label. The arrows with the fewest candidates choose first. Then all arrows choose
again in turn, until no arrow finds a better position. This is a local search in discrete label placement (Christensen, Marks,
Shieber 1995)."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist
from typing import Any

import numpy as np

from antdsl.diagnostics import Report
from antdsl.graphs.model import Arrow, Box, Chart, PlacedArrow, PlacedBox, PlacedChart, Point
from antdsl.graphs.text_width import measure_text_width

SizePx = tuple[float, float]
Route = tuple[Point, ...]
Array = np.ndarray[Any, np.dtype[Any]]

_POSITION_SPACING = 9.0  # px between two positions on one line
_FREE_END_LENGTH = 10.0  # px at the end of a line that stay free for the arrowhead
_WORD_CLEARANCE = 3.0  # px between words and other elements
_MAX_ROUNDS = 6
# Costs of a position of words: for each touched box or word, for each touched line or arrowhead, for hiding a turn, for being off
# the line, and for being off the middle.
_OVERLAP_COST, _CROSSING_COST, _HIDDEN_TURN_COST, _OFF_LINE_COST, _OFF_MIDDLE_COST = 1000.0, 25.0, 4.0, 2.0, 6.0
NAME_FONT_SIZE, WORD_FONT_SIZE = 14, 11  # font sizes, px
LINE_HEIGHT = 14.0  # px between lines of words
MAX_LINE_CHARACTERS = 30  # characters in a line of words
MAX_CONDITION_LINES = 6  # maximum number of lines of a condition; the tooltip shows the complete text
BOX_PADDING = 12.0
# Transitions that return to an earlier state from the start are reversed, not those that minimise the number of reversals.
_LAYOUT_OPTIONS: dict[str, Any] = {
    "routing": {"style": "orthogonal"},
    "cycles": {"strategy": "follow_flow"},
    "effort": "thorough",
}
# Distances between lines out of one box, between passing lines, between boxes, and between layers, px, increasing.
_SPACINGS: tuple[dict[str, float], ...] = tuple(
    {"port_gap": port, "dummy_gap": line, "node_gap": box, "layer_gap": layer}
    for port, line, box, layer in (
        (36, 48, 54, 64),
        (54, 60, 60, 68),
        (72, 72, 60, 74),
        (90, 90, 60, 80),
        (120, 120, 80, 110),
        (180, 180, 120, 160),
        (260, 260, 160, 240),
    )
)
_FIRST_WIDE_SPACING = 4  # wider spacings are tried only if words would overlap words or boxes


def lay_out_charts(charts: Sequence[Chart]) -> tuple[tuple[PlacedChart, ...], Report]:
    """Return the charts with positions, and a report. Each chart is laid out separately. The report has an error if the library
    is not installed."""
    report = Report()
    try:
        import graphlay  # noqa: F401
    except ImportError:
        report.error(
            "missing-extra",
            "diagrams of state machines need the package graphlay",
            None,
            'run `pip install "antdsl[graph]"`, or write `--format mermaid` or `--format dot`',
        )
        return (), report
    return tuple(_place_chart(chart) for chart in charts), report


def _place_chart(chart: Chart) -> PlacedChart:
    """Return the first layout of a chart in which no words touch or hide anything. Spacings are tried from narrow to wide.

    If there is none, return the layout with the fewest touching words and, of these, the fewest hidden lines. Wide spacings are
    tried only if words touch something in all narrower ones."""
    best: tuple[int, int, int] | None = None
    best_chart: PlacedChart | None = None
    for number, spacing in enumerate(_SPACINGS):
        if best is not None and (best[:2] == (0, 0) or (best[0] == 0 and number >= _FIRST_WIDE_SPACING)):
            break
        placed_chart, placement = _try_spacing(chart, spacing)
        value = (placement.touching_count, placement.hidden_line_count, number)
        if best is None or value < best:
            best, best_chart = value, placed_chart
    assert best_chart is not None
    return best_chart


def _try_spacing(chart: Chart, spacing: dict[str, float]) -> tuple[PlacedChart, WordPlacement]:
    """Return the layout of a chart with one spacing, and the positions of its words. `spacing`: an entry of `_SPACINGS`."""
    import graphlay

    graph = graphlay.Graph()
    for box in chart.boxes:
        wide, high = compute_box_size(box)
        graph.node(box.key, width=wide, height=high, shape="ellipse" if box.kind in ("start", "choice") else "box")
    folded = [wrap_words(arrow) for arrow in chart.arrows]
    extents = [_measure_text(lines) if lines else None for lines in folded]
    for arrow, extent in zip(chart.arrows, extents, strict=True):
        label_options: dict[str, Any] = {"label_size": {"width": extent[0], "height": extent[1]}} if extent else {}
        graph.edge(arrow.source, arrow.target, **label_options)
    layout = graphlay.layout(graph, preset="process_map", options={**_LAYOUT_OPTIONS, "spacing": spacing})
    node_boxes = [
        PlacedBox((node["center"]["x"], node["center"]["y"]), *compute_box_size(box))
        for box, node in zip(chart.boxes, layout.nodes, strict=True)
    ]
    routes = [tuple((point["x"], point["y"]) for point in edge["points"]) for edge in layout.edges]
    placement = place_words(node_boxes, routes, extents)
    arrows = [PlacedArrow(*all_of_it) for all_of_it in zip(chart.arrows, routes, placement.word_boxes, folded, strict=True)]
    return _shift_to_zero(chart, list(zip(chart.boxes, node_boxes, strict=True)), arrows), placement


def compute_box_size(box: Box) -> tuple[float, float]:
    """Return the width and height of a box, px."""
    if box.kind in ("start", "choice"):
        return 14.0, 14.0
    if box.kind != "state":
        return measure_text_width(box.name, WORD_FONT_SIZE) + 20, 22.0
    label = measure_text_width(box.label, WORD_FONT_SIZE) if box.label else 0.0
    return max(measure_text_width(box.name, NAME_FONT_SIZE), label) + 24, 44.0 if box.label else 30.0


def wrap_words(arrow: Arrow) -> tuple[str, ...]:
    """Return the words of an arrow, wrapped into short lines of text."""
    short_lines: list[str] = []
    for line in arrow.lines:
        lines = textwrap.wrap(line, MAX_LINE_CHARACTERS, break_on_hyphens=False) or [""]
        short_lines += (
            lines
            if len(lines) <= MAX_CONDITION_LINES
            else [*lines[: MAX_CONDITION_LINES - 1], lines[MAX_CONDITION_LINES - 1][: MAX_LINE_CHARACTERS - 2] + " …"]
        )
    return tuple(short_lines)


def _measure_text(lines: tuple[str, ...]) -> tuple[float, float]:
    return max(measure_text_width(line, WORD_FONT_SIZE) for line in lines) + 8, LINE_HEIGHT * len(lines) + 2


def _shift_to_zero(chart: Chart, boxes: list[tuple[Box, PlacedBox]], arrows: list[PlacedArrow]) -> PlacedChart:
    """Return the chart, moved so that its top left corner, including a margin, is at (0, 0)."""
    all_boxes = [place for _, place in boxes] + [arrow.words for arrow in arrows if arrow.words is not None]
    xs = [x for a in arrows for x, _ in a.points] + [p.left for p in all_boxes] + [p.left + p.width for p in all_boxes]
    ys = [y for a in arrows for _, y in a.points] + [p.top for p in all_boxes] + [p.top + p.height for p in all_boxes]
    wide, high = max(xs) - min(xs) + 2 * BOX_PADDING, max(ys) - min(ys) + 2 * BOX_PADDING
    return PlacedChart(chart, wide, high, tuple(boxes), tuple(arrows)).shift(BOX_PADDING - min(xs), BOX_PADDING - min(ys))


@dataclass(frozen=True, slots=True)
class WordPlacement:
    """The positions of the words of all arrows.
    - `word_boxes`: for each arrow, the box around its words; None for an arrow without words.
    - `touching_count`: the number of words that touch boxes or other words.
    - `hidden_line_count`: the number of lines and arrow heads that words hide."""

    word_boxes: tuple[PlacedBox | None, ...]
    touching_count: int
    hidden_line_count: int


@dataclass(frozen=True, slots=True, eq=False)
class _LabelPositions:
    """Candidate positions for words of one size.
    - `centres`: positions [n, 2], px.
    - `costs`: the cost of each position, without regard to other words [n].
    - `hidden_line_counts`: the number of lines that words at each position hide [n]."""

    size: SizePx
    centres: Array
    costs: Array
    hidden_line_counts: Array

    def make_box(self, number: int) -> PlacedBox:
        """Return the box around the words at the candidate position `number`."""
        x, y = self.centres[number].tolist()
        return PlacedBox((x, y), *self.size)


def place_words(boxes: Sequence[PlacedBox], routes: Sequence[Route], sizes: Sequence[SizePx | None]) -> WordPlacement:
    """Return positions for the words of all arrows.

    `boxes`: the boxes of the chart. `routes`: for each arrow, the corners of its path, mostly vertical and horizontal. `sizes`:
    for each arrow, the width and height of its words, px; None without words."""
    spots = {number: _find_label_positions(number, boxes, routes, size) for number, size in enumerate(sizes) if size}
    order = sorted(spots, key=lambda n: (int((spots[n].costs < _CROSSING_COST).sum()), n))
    chosen: dict[int, int] = {}
    for _ in range(_MAX_ROUNDS):
        previous_choice = dict(chosen)
        for number in order:
            others = [spots[n].make_box(k) for n, k in chosen.items() if n != number]
            costs = spots[number].costs + _OVERLAP_COST * _count_overlaps(spots[number].centres, spots[number].size, others)
            chosen[number] = int(np.argmin(costs))
        if chosen == previous_choice:
            break
    word_boxes = {n: spots[n].make_box(k) for n, k in chosen.items()}
    touching = sum(spots[n].costs[k] >= _OVERLAP_COST for n, k in chosen.items())
    for n, place in word_boxes.items():
        centre = np.array([place.centre])
        touching += _count_overlaps(centre, spots[n].size, [other for m, other in word_boxes.items() if m < n])[0]
    crossed = sum(int(spots[n].hidden_line_counts[k]) for n, k in chosen.items())
    return WordPlacement(tuple(word_boxes.get(n) for n in range(len(sizes))), int(touching), crossed)


def _find_label_positions(number: int, boxes: Sequence[PlacedBox], routes: Sequence[Route], size: SizePx) -> _LabelPositions:
    """Return candidate positions for the words of the arrow `number`: on its path and next to it."""
    route = routes[number]
    centres, costs = _list_route_positions(route, size)
    others = [part for n, other in enumerate(routes) if n != number for part in pairwise(other)]
    corners = np.abs(centres[:, None] - np.array(route)) < np.array(size) / 2 + _WORD_CLEARANCE
    turns = corners.all(axis=2)
    # the tip of its arrowhead is hidden in the same way as other lines
    hidden = _count_crossings(centres, size, others) + turns[:, -1]
    costs = (
        costs
        + _HIDDEN_TURN_COST * turns.sum(axis=1)
        + _CROSSING_COST * hidden
        + _OVERLAP_COST * _count_overlaps(centres, size, boxes)
    )
    return _LabelPositions(size, centres, costs, hidden)


def _list_route_positions(route: Route, size: SizePx) -> tuple[Array, Array]:
    """Return candidate positions along a path: their centres (n, 2) in px, and their costs (n,)."""
    centres: list[Point] = []
    costs: list[float] = []
    length = sum(dist(a, b) for a, b in pairwise(route)) or 1.0
    start_length = 0.0
    for begin, end in pairwise(route):
        long = dist(begin, end)
        upright = abs(begin[0] - end[0]) < 0.01
        for k in range(1 + max(0, int((long - 2 * _FREE_END_LENGTH) / _POSITION_SPACING))):
            share = min(1.0, (_FREE_END_LENGTH + k * _POSITION_SPACING) / long) if long > 2 * _FREE_END_LENGTH else 0.5
            x, y = begin[0] + (end[0] - begin[0]) * share, begin[1] + (end[1] - begin[1]) * share
            middle = abs((start_length + long * share) / length - 0.42)  # slightly nearer to the start of the arrow
            for side in (0.0, -1.0, 1.0):
                right, down = (side * (size[0] / 2 + 2), 0.0) if upright else (0.0, side * (size[1] / 2 + 2))
                centres.append((x + right, y + down))
                costs.append(_OFF_LINE_COST * abs(side) + _OFF_MIDDLE_COST * middle)
        start_length += long
    return np.array(centres), np.array(costs)


def _count_overlaps(centres: Array, size: SizePx, others: Sequence[PlacedBox]) -> Array:
    """Return, for each candidate centre (n, 2), the number of boxes in `others` that words at this position would touch, int
    (n,)."""
    if not others:
        return np.zeros(len(centres), int)
    middles = np.array([other.centre for other in others])
    clearance = (np.array([(other.width, other.height) for other in others]) + np.array(size)) / 2 + _WORD_CLEARANCE
    return np.asarray((np.abs(centres[:, None] - middles) < clearance).all(axis=2).sum(axis=1))


def _count_crossings(centres: Array, size: SizePx, line_segments: Sequence[tuple[Point, Point]]) -> Array:
    """Return, for each candidate centre (n, 2), the number of segments of other lines that cross words at this position, int
    (n,)."""
    if not line_segments:
        return np.zeros(len(centres), int)
    ends, half = np.array(line_segments), np.array(size) / 2 + 1
    low, high = ends.min(axis=1), ends.max(axis=1)
    overlaps = (low < (centres + half)[:, None]) & (high > (centres - half)[:, None])
    return np.asarray(overlaps.all(axis=2).sum(axis=1))
