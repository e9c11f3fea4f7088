"""Variation in a definition file: a form of our own, and what can be told of it once the whole definition is there."""

from __future__ import annotations

from collections.abc import Iterable

from antdsl import limits
from antdsl.bodies.agents.checked_values import Values
from antdsl.bodies.agents.definition import Colour, Variation
from antdsl.bodies.agents.json_text import Node
from antdsl.source import Span

Places = dict[tuple[str, str], Span]
LEAST, MOST = 0.1, 10.0  # times as large as in the rest pose


def read_variation(values: Values, node: Node, places: Places) -> Variation:
    """`{"scale": {"head": [0.9, 1.2]}, "materials": {"fur": [[0.4, 0.3, 0.2], [0.1, 0.1, 0.1]]}}` of a definition file."""
    entries = values.object(node, "variation", ("scale", "materials")) or {}
    scales: dict[str, tuple[float, float]] = {}
    for name, each in _named(values, entries.get("scale"), "scales", '{"head": [0.9, 1.2]}'):
        ends = values.numbers(each, "the least and the greatest scale", 2, LEAST, MOST)
        if ends is not None:
            scales[name] = (float(min(ends)), float(max(ends)))
            places["scale", name] = values.span(each)
    materials: dict[str, tuple[Colour, ...]] = {}
    for name, each in _named(values, entries.get("materials"), "colours", '{"fur": [[0.4, 0.3, 0.2], [0.1, 0.1, 0.1]]}'):
        found = [values.numbers(colour, "a colour", 3, 0.0, 1.0) for colour in values.items(each, "colours")]
        given = [(float(c[0]), float(c[1]), float(c[2])) for c in found if c is not None]
        if len(given) == len(found) and 2 <= len(given) <= limits.BODY_PARTS:
            materials[name] = tuple(given)
            places["materials", name] = values.span(each)
        elif len(given) == len(found):
            words = f"{len(given)} colours for `{name}` are no way that a colour may lie on"
            values.report.error("wrong-count", words, values.head(each), "write two colours, or more")
    return Variation(scales, materials)


def misnamed(
    variation: Variation, groups: Iterable[str], materials: Iterable[str], places: Places
) -> list[tuple[str, str, Span | None, list[str]]]:
    """What it names that the definition does not have: what that is, its name, where it stands, and what there is."""
    found = []
    for key, what, named, known in (
        ("scale", "transform group", variation.scales, sorted(groups)),
        ("materials", "material", variation.materials, sorted(materials)),
    ):
        found += [(what, name, places.get((key, name)), known) for name in named if name not in known]
    return found


def _named(values: Values, node: Node | None, what: str, sample: str) -> Iterable[tuple[str, Node]]:
    if node is None:
        return ()
    if not isinstance(node.value, dict):
        values.wrong(node, f"an object of {what} by name", f"write `{sample}`")
        return ()
    return node.value.items()
