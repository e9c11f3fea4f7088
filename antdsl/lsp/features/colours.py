"""The colours of states in a program, with their locations, and the names of similar colours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from antdsl.lsp.workspace import OpenDocument
from antdsl.program.tables.colours import COLOUR_BY_NAME, RgbTriple, find_rgb
from antdsl.program.traverse import iterate_nodes
from antdsl.source import Span
from antdsl.syntax import nodes


class ColourName(NamedTuple):
    """A colour name in a program, with its location. `rgb`: sRGB values, 0 to 255."""

    span: Span
    rgb: RgbTriple


def find_colours(document: OpenDocument) -> Iterator[ColourName]:
    """Yield the colours of all states in a program."""
    for item in document.parsed[0].items:
        for node, _ in iterate_nodes(item):
            if isinstance(node, nodes.State) and node.colour is not None and (rgb := find_rgb(node.colour.text)) is not None:
                yield ColourName(node.colour.span, rgb)


def find_nearest_colour_names(rgb: RgbTriple, count: int = 5) -> list[str]:
    """Return the names of the `count` colours that are nearest to an sRGB colour (0 to 255), nearest first."""

    def squared_distance(name: str) -> int:
        return sum((a - b) ** 2 for a, b in zip(COLOUR_BY_NAME[name], rgb, strict=True))

    return sorted(COLOUR_BY_NAME, key=squared_distance)[:count]
