"""Charts as DOT, the text format of Graphviz and many other programs. It has no layout: the program that reads the text makes
one."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.graphs.drawing import THICK, THIN, darken, hex_colour, ink_on, line_colours
from antdsl.graphs.model import RGB, Arrow, Box, Chart


def dot(charts: Sequence[Chart]) -> str:
    """Return the complete text, with one cluster for each chart. The same charts give the same text."""
    lines = [
        "digraph antdsl {",
        '  graph [rankdir=TB, fontname="Helvetica", nodesep=0.4, ranksep=0.5];',
        '  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=12];',
        '  edge [fontname="Helvetica", fontsize=10];',
    ]
    for number, chart in enumerate(charts):
        keys = {box.key: f"m{number}b{k}" for k, box in enumerate(chart.boxes)}
        lines += [f"  subgraph cluster_{number} {{", f"    label={_text(chart.title)};", '    color="#d6d6d1";']
        lines += [f"    {keys[box.key]} [{_box(box)}];" for box in chart.boxes]
        for arrow, colour in zip(chart.arrows, line_colours(chart), strict=True):
            lines.append(f"    {keys[arrow.source]} -> {keys[arrow.target]} [{_arrow(arrow, colour)}];")
        lines.append("  }")
    return "\n".join([*lines, "}"]) + "\n"


def _box(box: Box) -> str:
    """Return the attributes of a box."""
    tip = f"tooltip={_text(box.details or box.name)}"
    if box.kind == "start":
        return f'shape=circle, width=0.18, label="", fillcolor="{hex_colour(box.colour)}", {tip}'
    if box.kind == "choice":
        return f'shape=circle, width=0.18, label="", fillcolor="#ffffff", color="{hex_colour(box.colour)}", {tip}'
    words = _text("\n".join(word for word in (box.name, box.label) if word))
    if box.kind != "state":
        return f'style="rounded,dashed", label={words}, color="{hex_colour(box.colour)}", {tip}'
    fill, edge, ink = box.colour, darken(box.colour), ink_on(box.colour)
    return f'label={words}, fillcolor="{hex_colour(fill)}", color="{hex_colour(edge)}", fontcolor="{hex_colour(ink)}", {tip}'


def _arrow(arrow: Arrow, colour: RGB) -> str:
    """Return the attributes of an arrow."""
    words = f"label={_text(chr(10).join(arrow.lines))}, " if arrow.lines else ""
    ink, thick = hex_colour(darken(colour, 0.1)), THICK if arrow.interrupt else THIN
    tip = f", tooltip={_text(arrow.details)}" if arrow.details else ""
    return f'{words}color="{hex_colour(colour)}", fontcolor="{ink}", penwidth={thick}{tip}'


def _text(text: str) -> str:
    """Return the text in quotes. Within quotes, Graphviz gives a special meaning to backslashes only."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n") + '"'
