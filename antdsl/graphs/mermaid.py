"""Charts as Mermaid text, which GitHub, GitLab and many editors display as a picture inside Markdown. It needs no layout.

The text is a flow chart. Mermaid's own state diagram has neither thick lines for interrupts nor colours for lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from antdsl.graphs.drawing import THICK, darken, hex_colour, ink_on, line_colours
from antdsl.graphs.model import Arrow, Box, Chart

# What may stand in quotes as it is. Everything else is written as its number: quotes and brackets would end the text, and a
# star, a backtick or `<` would be taken for Markdown or HTML.
_PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 .,:()/+-=_%")
_SHAPES = {
    "state": ('["', '"]'),
    "start": ('(("', '"))'),
    "choice": ('{"', '"}'),
    "any": ('(["', '"])'),
    "previous": ('(["', '"])'),
}


def mermaid(charts: Sequence[Chart]) -> str:
    """Return the complete text, with one subgraph for each chart. The same charts give the same text."""
    lines = ["flowchart TB"]
    styles: list[str] = []
    links = 0
    for number, chart in enumerate(charts):
        keys = {box.key: f"m{number}b{k}" for k, box in enumerate(chart.boxes)}
        lines += [f'  subgraph m{number}["{_escape(chart.title)}"]', "    direction TB"]
        lines += [f"    {_box(keys[box.key], box)}" for box in chart.boxes]
        lines += [f"    {_link(keys, arrow)}" for arrow in chart.arrows]
        lines.append("  end")
        styles += [f"  style {keys[box.key]} {_style(box)}" for box in chart.boxes]
        styles += _link_styles(chart, links)
        links += len(chart.arrows)
    return "\n".join([*lines, *styles]) + "\n"


def _box(key: str, box: Box) -> str:
    """Return the line that declares a box."""
    prefix, suffix = _SHAPES[box.kind]
    words = [box.name, box.label] if box.kind in ("state", "any", "previous") else [" "]
    return key + prefix + "<br/>".join(_escape(word) for word in words if word) + suffix


def _link(keys: dict[str, str], arrow: Arrow) -> str:
    """Return the line that declares an arrow. `keys`: the boxes' keys in the text."""
    line = "==>" if arrow.interrupt else "-->"
    words = "<br/>".join(_escape(words) for words in arrow.lines)
    return f"{keys[arrow.source]} {line}" + (f'|"{words}"|' if words else "") + f" {keys[arrow.target]}"


def _style(box: Box) -> str:
    """Return the colours of a box as Mermaid styles."""
    if box.kind in ("state", "start"):
        fill, edge, ink = box.colour, darken(box.colour), ink_on(box.colour)
        return f"fill:{hex_colour(fill)},stroke:{hex_colour(edge)},color:{hex_colour(ink)}"
    dashes = "" if box.kind == "choice" else ",stroke-dasharray:4 3"
    return f"fill:#ffffff,stroke:{hex_colour(box.colour)},color:#212129{dashes}"


def _link_styles(chart: Chart, first: int) -> Iterator[str]:
    """Yield the style line of each arrow. `first`: the number of the chart's first arrow in the text."""
    for k, (arrow, colour) in enumerate(zip(chart.arrows, line_colours(chart), strict=True), first):
        thick = f",stroke-width:{THICK}px" if arrow.interrupt else ""
        yield f"  linkStyle {k} stroke:{hex_colour(colour)}{thick}"


def _escape(text: str) -> str:
    return "".join(sign if sign in _PLAIN else f"#{ord(sign)};" for sign in text)
