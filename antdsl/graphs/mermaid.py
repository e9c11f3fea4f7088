"""Charts as Mermaid text, which GitHub, GitLab and many editors display as a picture inside Markdown. No layout is needed.

The text is a flow chart, because Mermaid's state diagrams have no thick lines for interrupts and no coloured lines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from antdsl.graphs.drawing import INTERRUPT_LINE_WIDTH, choose_line_colours, choose_text_colour, darken_colour, format_hex_colour
from antdsl.graphs.model import Arrow, Box, Chart

# Characters that are allowed in quotes. All others are written as their number: quotes and brackets would end the text, and a
# star, a backtick or `<` would be read as Markdown or HTML.
_UNESCAPED_CHARACTERS = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789 .,:()/+-=_%")
_BRACKETS_BY_KIND = {
    "state": ('["', '"]'),
    "start": ('(("', '"))'),
    "choice": ('{"', '"}'),
    "any": ('(["', '"])'),
    "previous": ('(["', '"])'),
}


def format_mermaid(charts: Sequence[Chart]) -> str:
    """Return the Mermaid text of charts, with one subgraph for each chart. Equal charts give equal texts."""
    lines = ["flowchart TB"]
    styles: list[str] = []
    links = 0
    for number, chart in enumerate(charts):
        keys = {box.key: f"m{number}b{k}" for k, box in enumerate(chart.boxes)}
        lines += [f'  subgraph m{number}["{_escape_text(chart.title)}"]', "    direction TB"]
        lines += [f"    {_format_box(keys[box.key], box)}" for box in chart.boxes]
        lines += [f"    {_format_link(keys, arrow)}" for arrow in chart.arrows]
        lines.append("  end")
        styles += [f"  style {keys[box.key]} {_format_style(box)}" for box in chart.boxes]
        styles += _format_link_styles(chart, links)
        links += len(chart.arrows)
    return "\n".join([*lines, *styles]) + "\n"


def _format_box(key: str, box: Box) -> str:
    """Return the line of text that declares a box."""
    prefix, suffix = _BRACKETS_BY_KIND[box.kind]
    words = [box.name, box.label] if box.kind in ("state", "any", "previous") else [" "]
    return key + prefix + "<br/>".join(_escape_text(word) for word in words if word) + suffix


def _format_link(keys: dict[str, str], arrow: Arrow) -> str:
    """Return the line of text that declares an arrow. `keys`: the key of each box in the text."""
    line = "==>" if arrow.interrupt else "-->"
    words = "<br/>".join(_escape_text(words) for words in arrow.lines)
    return f"{keys[arrow.source]} {line}" + (f'|"{words}"|' if words else "") + f" {keys[arrow.target]}"


def _format_style(box: Box) -> str:
    """Return the colours of a box as a Mermaid style."""
    if box.kind in ("state", "start"):
        fill, edge, ink = box.colour, darken_colour(box.colour), choose_text_colour(box.colour)
        return f"fill:{format_hex_colour(fill)},stroke:{format_hex_colour(edge)},color:{format_hex_colour(ink)}"
    dashes = "" if box.kind == "choice" else ",stroke-dasharray:4 3"
    return f"fill:#ffffff,stroke:{format_hex_colour(box.colour)},color:#212129{dashes}"


def _format_link_styles(chart: Chart, first_link_number: int) -> Iterator[str]:
    """Yield one line of text per arrow, with its style. `first_link_number`: the position of the chart's first arrow among all
    arrows of the text."""
    for k, (arrow, colour) in enumerate(zip(chart.arrows, choose_line_colours(chart), strict=True), first_link_number):
        thick = f",stroke-width:{INTERRUPT_LINE_WIDTH}px" if arrow.interrupt else ""
        yield f"  linkStyle {k} stroke:{format_hex_colour(colour)}{thick}"


def _escape_text(text: str) -> str:
    return "".join(sign if sign in _UNESCAPED_CHARACTERS else f"#{ord(sign)};" for sign in text)
