"""Charts → places: states in layers, arrows with right angles, no words on top of anything.

The layout is made by the library graphlay, a layered one (Sugiyama, Tagawa, Toda 1981) that leaves room for words and gives the
same places on every machine. Where the words go in that room is decided in `wording`."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

from antdsl.diagnostics import Report
from antdsl.graphs.letters import width
from antdsl.graphs.model import Arrow, Box, Chart, Placed, PlacedArrow, PlacedChart
from antdsl.graphs.wording import Found, place_words

NAME_SIZE, WORD_SIZE = 14, 11  # letters, px
LINE = 14.0  # from line to line of words, px
FOLD = 30  # letters in a line of words
LINES = 6  # lines that one condition may have; the pointer shows all of it
PADDING = 12.0
# Against the flow go the changes that lead back to where the start has come by, not those that make the fewest lines turn.
_OPTIONS: dict[str, Any] = {"routing": {"style": "orthogonal"}, "cycles": {"strategy": "follow_flow"}, "effort": "thorough"}
# Room between lines out of one box, between lines that pass, between boxes, between layers, px: ever more of it.
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
_WIDE = 4  # from here on they are made only where words would stand on words or boxes


def lay_out(charts: Sequence[Chart]) -> tuple[tuple[PlacedChart, ...], Report]:
    """Places for each chart by itself. Complains when the library is not installed."""
    report = Report()
    try:
        import graphlay  # noqa: F401
    except ImportError:
        report.error(
            "missing-extra",
            "pictures of state machines need the package graphlay",
            None,
            'run `pip install "antdsl[graph]"`, or write `--format mermaid` or `--format dot`',
        )
        return (), report
    return tuple(_placed(chart) for chart in charts), report


def _placed(chart: Chart) -> PlacedChart:
    """The narrowest in which no words hide a line; else, of those not too wide, the one in which they hide the fewest."""
    best: tuple[int, int, int] | None = None
    kept: PlacedChart | None = None
    for number, spacing in enumerate(_SPACINGS):
        if best is not None and (best[:2] == (0, 0) or (best[0] == 0 and number >= _WIDE)):
            break
        placed, found = _tried(chart, spacing)
        value = (found.touching, found.crossed, number)
        if best is None or value < best:
            best, kept = value, placed
    assert kept is not None
    return kept


def _tried(chart: Chart, spacing: dict[str, float]) -> tuple[PlacedChart, Found]:
    import graphlay

    graph = graphlay.Graph()
    for box in chart.boxes:
        wide, high = size(box)
        graph.node(box.key, width=wide, height=high, shape="ellipse" if box.kind in ("start", "choice") else "box")
    folded = [fold(arrow) for arrow in chart.arrows]
    extents = [_extent(lines) if lines else None for lines in folded]
    for arrow, extent in zip(chart.arrows, extents, strict=True):
        room: dict[str, Any] = {"label_size": {"width": extent[0], "height": extent[1]}} if extent else {}
        graph.edge(arrow.source, arrow.target, **room)
    laid = graphlay.layout(graph, preset="process_map", options={**_OPTIONS, "spacing": spacing})
    places = [
        Placed((node["center"]["x"], node["center"]["y"]), *size(box)) for box, node in zip(chart.boxes, laid.nodes, strict=True)
    ]
    ways = [tuple((point["x"], point["y"]) for point in edge["points"]) for edge in laid.edges]
    found = place_words(places, ways, extents)
    arrows = [PlacedArrow(*all_of_it) for all_of_it in zip(chart.arrows, ways, found.places, folded, strict=True)]
    return _from_zero(chart, list(zip(chart.boxes, places, strict=True)), arrows), found


def size(box: Box) -> tuple[float, float]:
    """Width and height of a box, px."""
    if box.kind in ("start", "choice"):
        return 14.0, 14.0
    if box.kind != "state":
        return width(box.name, WORD_SIZE) + 20, 22.0
    label = width(box.label, WORD_SIZE) if box.label else 0.0
    return max(width(box.name, NAME_SIZE), label) + 24, 44.0 if box.label else 30.0


def fold(arrow: Arrow) -> tuple[str, ...]:
    """The words of an arrow in short lines."""
    found: list[str] = []
    for line in arrow.lines:
        lines = textwrap.wrap(line, FOLD, break_on_hyphens=False) or [""]
        found += lines if len(lines) <= LINES else [*lines[: LINES - 1], lines[LINES - 1][: FOLD - 2] + " …"]
    return tuple(found)


def _extent(lines: tuple[str, ...]) -> tuple[float, float]:
    return max(width(line, WORD_SIZE) for line in lines) + 8, LINE * len(lines) + 2


def _from_zero(chart: Chart, boxes: list[tuple[Box, Placed]], arrows: list[PlacedArrow]) -> PlacedChart:
    """Moved so that all of it, with a rim, begins at (0, 0)."""
    places = [place for _, place in boxes] + [arrow.words for arrow in arrows if arrow.words is not None]
    xs = [x for a in arrows for x, _ in a.points] + [p.left for p in places] + [p.left + p.width for p in places]
    ys = [y for a in arrows for _, y in a.points] + [p.top for p in places] + [p.top + p.height for p in places]
    wide, high = max(xs) - min(xs) + 2 * PADDING, max(ys) - min(ys) + 2 * PADDING
    return PlacedChart(chart, wide, high, tuple(boxes), tuple(arrows)).moved(PADDING - min(xs), PADDING - min(ys))
