"""Charts as DOT, the text format of Graphviz and many other programs. DOT contains no positions; the program that reads it
computes a layout."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.graphs.drawing import (
    INTERRUPT_LINE_WIDTH,
    PLAIN_LINE_WIDTH,
    choose_line_colours,
    choose_text_colour,
    darken_colour,
    format_hex_colour,
)
from antdsl.graphs.model import RGB, Arrow, Box, Chart


def format_dot(charts: Sequence[Chart]) -> str:
    """Return the DOT text of charts, with one cluster for each chart. Equal charts give equal texts."""
    lines = [
        "digraph antdsl {",
        '  graph [rankdir=TB, fontname="Helvetica", nodesep=0.4, ranksep=0.5];',
        '  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=12];',
        '  edge [fontname="Helvetica", fontsize=10];',
    ]
    for number, chart in enumerate(charts):
        keys = {box.key: f"m{number}b{k}" for k, box in enumerate(chart.boxes)}
        lines += [f"  subgraph cluster_{number} {{", f"    label={_quote_text(chart.title)};", '    color="#d6d6d1";']
        lines += [f"    {keys[box.key]} [{_format_box(box)}];" for box in chart.boxes]
        for arrow, colour in zip(chart.arrows, choose_line_colours(chart), strict=True):
            lines.append(f"    {keys[arrow.source]} -> {keys[arrow.target]} [{_format_arrow(arrow, colour)}];")
        lines.append("  }")
    return "\n".join([*lines, "}"]) + "\n"


def _format_box(box: Box) -> str:
    """Return the DOT attributes of a box."""
    tip = f"tooltip={_quote_text(box.details or box.name)}"
    if box.kind == "start":
        return f'shape=circle, width=0.18, label="", fillcolor="{format_hex_colour(box.colour)}", {tip}'
    if box.kind == "choice":
        return f'shape=circle, width=0.18, label="", fillcolor="#ffffff", color="{format_hex_colour(box.colour)}", {tip}'
    words = _quote_text("\n".join(word for word in (box.name, box.label) if word))
    if box.kind != "state":
        return f'style="rounded,dashed", label={words}, color="{format_hex_colour(box.colour)}", {tip}'
    fill, edge, ink = box.colour, darken_colour(box.colour), choose_text_colour(box.colour)
    colours = f'fillcolor="{format_hex_colour(fill)}", color="{format_hex_colour(edge)}", fontcolor="{format_hex_colour(ink)}"'
    return f"label={words}, {colours}, {tip}"


def _format_arrow(arrow: Arrow, colour: RGB) -> str:
    """Return the DOT attributes of an arrow."""
    words = f"label={_quote_text(chr(10).join(arrow.lines))}, " if arrow.lines else ""
    ink, thick = format_hex_colour(darken_colour(colour, 0.1)), INTERRUPT_LINE_WIDTH if arrow.interrupt else PLAIN_LINE_WIDTH
    tip = f", tooltip={_quote_text(arrow.details)}" if arrow.details else ""
    return f'{words}color="{format_hex_colour(colour)}", fontcolor="{ink}", penwidth={thick}{tip}'


def _quote_text(text: str) -> str:
    """Return the text in double quotes, with backslashes, double quotes and line ends escaped."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
