"""Parts of a definition file that only antdsl has: legs with their gaits, variation, and metadata.

In: values of the JSON tree. Out: parts of a `Definition`. What needs the complete definition is checked after it was read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from antdsl import limits
from antdsl.bodies.agents.definition import Colour, Definition, Gait, Leg, Variation
from antdsl.bodies.files.checked_values import Values
from antdsl.bodies.files.json_text import Node
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.source import Span

VariationPlaces = dict[tuple[str, str], Span]
_LEAST_SCALE, _MOST_SCALE = 0.1, 10.0  # times as large as in the rest pose


_LEG = {"name": '"left"', "upper": '"…"', "lower": '"…"', "foot": '"…"'}
_GAIT = {"name": '"walk"', "speed": "10", "stride": "5", "duty": "0.6", "lift": "0.5", "phases": "[0, 0.5]"}


@dataclass(slots=True)
class Places:
    """The places of legs, gaits and their values in a file; those from a cache have no place."""

    spans: dict[tuple[str, ...], Span] = field(default_factory=dict)

    def of(self, *path: str) -> Span | None:
        """Return the span of `legs NAME KEY`, `gaits NAME KEY` or `idle`, or of the innermost known part that contains it."""
        while path and path not in self.spans:
            path = path[:-1]
        return self.spans.get(path)


def read_legs(values: Values, node: Node, locations: Places) -> tuple[Leg, ...]:
    """Read the list `legs`: each leg has a unique name and the joints `upper`, `lower` and `foot`."""
    legs: dict[str, Leg] = {}
    locations.spans["legs",] = values.start_span(node)
    for entries, each in _complete_objects(values, node, "legs", "a leg", _LEG, limits.LEGS):
        texts = {key: values.text(entries[key], f"the {'name' if key == 'name' else 'joint'} of a leg") for key in _LEG}
        name, upper, lower, foot = (texts[key] for key in _LEG)
        if name is None or upper is None or lower is None or foot is None:
            continue
        if name in legs:
            values.report_repeated(entries["name"], f"there are two legs `{name}`", locations.spans["legs", name, "name"])
            continue
        legs[name] = Leg(name, upper, lower, foot)
        _note(values, locations, ("legs", name), each, entries)
    return tuple(legs.values())


def read_gaits(values: Values, node: Node, locations: Places) -> tuple[Gait, ...]:
    """Read the list `gaits` and sort it from slow to fast."""
    gaits: dict[str, Gait] = {}
    locations.spans["gaits",] = values.start_span(node)
    for entries, each in _complete_objects(values, node, "gaits", "a gait", _GAIT, limits.GAITS):
        name = values.text(entries["name"], "the name of a gait")
        speed = values.number(entries["speed"], "a speed", 0.0)
        stride = values.number(entries["stride"], "a stride", limits.LEAST_STRIDE)
        duty = values.number(entries["duty"], "the share of the cycle that a foot stands", *limits.DUTY)
        lift = values.number(entries["lift"], "how high a foot swings", 0.0)
        phases = values.numbers(entries["phases"], "phases of the legs", least=0.0, most=1.0)
        if name is None or speed is None or stride is None or duty is None or lift is None or phases is None:
            continue
        if name in gaits:
            values.report_repeated(entries["name"], f"there are two gaits `{name}`", locations.spans["gaits", name, "name"])
            continue
        gaits[name] = Gait(name, speed, stride, duty, lift, tuple(phases.tolist()))
        _note(values, locations, ("gaits", name), each, entries)
    return tuple(sorted(gaits.values(), key=lambda gait: gait.speed))


def _complete_objects(
    values: Values, node: Node, what: str, one: str, needed: dict[str, str], most: int
) -> list[tuple[Mapping[str, Node], Node]]:
    """Return the objects of a list that have all required keys."""
    items = values.items(node, what)
    if len(items) > most:
        values.report.error("too-large", f"a body has at most {most:,} {what}", values.start_span(node), None)
        return []
    read = ((values.object(each, one, tuple(needed), needed), each) for each in items)
    return [(entries, each) for entries, each in read if entries is not None and all(key in entries for key in needed)]


def _note(values: Values, locations: Places, path: tuple[str, ...], node: Node, entries: Mapping[str, Node]) -> None:
    locations.spans[path] = values.start_span(node)
    for key, inner in entries.items():
        locations.spans[*path, key] = values.start_span(inner) if isinstance(inner.value, list) else values.span(inner)


# ---- checks


def check_legs(definition: Definition, locations: Places, report: Report) -> None:
    """Report legs with joints that are missing or not below each other, gaits that do not fit the legs, and a missing idle
    clip."""
    for leg in definition.legs:
        _check_leg(definition, leg, locations, report)
    for gait in definition.gaits:
        if len(gait.phases) != len(definition.legs):
            count = len(definition.legs)
            words = f"`{gait.name}` has {len(gait.phases)} phases, but the body has {count} leg{'' if count == 1 else 's'}"
            help = "give a phase for each leg, in the order of `legs`" if count else 'add `"legs": […]`'
            report.error("wrong-value", words, locations.of("gaits", gait.name, "phases"), help)
    for slow, fast in pairwise(definition.gaits):
        if not slow.speed < fast.speed:
            words = f"the gaits `{slow.name}` and `{fast.name}` have the same speed"
            labels = [Label(place, "here first") for place in (locations.of("gaits", slow.name, "speed"),) if place is not None]
            place = locations.of("gaits", fast.name, "speed")
            report.error("wrong-value", words, place, "give them different speeds, or delete one", labels=tuple(labels))
    if definition.legs and not definition.gaits:
        line = 'add `"gaits": [{"name": "walk", "speed": …, "stride": …, "duty": 0.6, "lift": …, "phases": […]}]`'
        report.warning("missing-key", "the body has legs but no gait, so only clips move the legs", locations.of("legs"), line)
    if definition.idle and definition.idle not in definition.clips:
        near = nearest_name(definition.idle, definition.clips)
        words = f"there is no clip `{definition.idle[:60]}`"
        report.error("unknown-name", words, locations.of("idle"), f'write `"{near}"`' if near else None)


def _check_leg(definition: Definition, leg: Leg, locations: Places, report: Report) -> None:
    names = definition.rig.names
    known = True
    for key, joint in (("upper", leg.upper), ("lower", leg.lower), ("foot", leg.foot)):
        if joint not in names:
            near = nearest_name(joint, names)
            words, help = f"there is no joint `{joint[:60]}`", f'write `"{near}"`' if near else None
            report.error("unknown-name", words, locations.of("legs", leg.name, key), help)
            known = False
    if not known:
        return
    for key, above, below in (("lower", leg.upper, leg.lower), ("foot", leg.lower, leg.foot)):
        if above not in ancestors_of(definition, below):
            words = f"`{below[:60]}` is not below `{above[:60]}` in the rig"
            report.error(
                "bad-rig", words, locations.of("legs", leg.name, key), "name joints from the hip down: upper, lower, foot"
            )


def ancestors_of(definition: Definition, joint: str) -> list[str]:
    """The joints above one, the nearest first."""
    names, parents = definition.rig.names, definition.rig.parents
    ancestors: list[str] = []
    number = int(parents[names.index(joint)])
    while number >= 0 and len(ancestors) < len(names):
        ancestors.append(names[number])
        number = int(parents[number])
    return ancestors


def read_variation(values: Values, node: Node, locations: VariationPlaces) -> Variation:
    """Read the variation of a definition file: `{"scale": {"head": [0.9, 1.2]}, "materials": {"fur": [[0.4, 0.3, 0.2], [0.1, 0.1,
    0.1]]}}`."""
    entries = values.object(node, "variation", ("scale", "materials")) or {}
    scales: dict[str, tuple[float, float]] = {}
    for name, each in _named(values, entries.get("scale"), "scales", '{"head": [0.9, 1.2]}'):
        ends = values.numbers(each, "the least and the greatest scale", 2, _LEAST_SCALE, _MOST_SCALE)
        if ends is not None:
            scales[name] = (float(min(ends)), float(max(ends)))
            locations["scale", name] = values.span(each)
    materials: dict[str, tuple[Colour, ...]] = {}
    for name, each in _named(values, entries.get("materials"), "colours", '{"fur": [[0.4, 0.3, 0.2], [0.1, 0.1, 0.1]]}'):
        arrays = [values.numbers(colour, "a colour", 3, 0.0, 1.0) for colour in values.items(each, "colours")]
        colours = [(float(c[0]), float(c[1]), float(c[2])) for c in arrays if c is not None]
        if len(colours) == len(arrays) and 2 <= len(colours) <= limits.BODY_PARTS:
            materials[name] = tuple(colours)
            locations["materials", name] = values.span(each)
        elif len(colours) == len(arrays):
            words = f"{len(colours)} colours for `{name}` are no way that a colour may lie on"
            values.report.error("wrong-count", words, values.start_span(each), "write two colours, or more")
    return Variation(scales, materials)


def find_misnamed(
    variation: Variation, groups: Iterable[str], materials: Iterable[str], locations: VariationPlaces
) -> list[tuple[str, str, Span | None, list[str]]]:
    """Return names in the variation that the definition lacks: kind, name, place, and the existing names."""
    problems = []
    for key, what, named, known in (
        ("scale", "transform group", variation.scales, sorted(groups)),
        ("materials", "material", variation.materials, sorted(materials)),
    ):
        problems += [(what, name, locations.get((key, name)), known) for name in named if name not in known]
    return problems


def _named(values: Values, node: Node | None, what: str, sample: str) -> Iterable[tuple[str, Node]]:
    if node is None:
        return ()
    if not isinstance(node.value, dict):
        values.report_wrong(node, f"an object of {what} by name", f"write `{sample}`")
        return ()
    return node.value.items()


@dataclass(frozen=True, slots=True)
class TypedValue:
    """A value with its type beside it: an object with the keys `type` and `value`, and no other."""

    type: str
    value: Any


# Types with the number of numbers that a value has; 0: one that is no list of numbers.
_TYPES = {
    "int": 0, "float": 0, "string": 0, "dict": 0, "array": 0, "vector2": 2, "vector": 3, "vector3": 3, "vector4": 4,
    "quaternion": 4, "matrix2": 4, "matrix3": 9, "matrix": 16, "matrix4": 16,
}  # fmt: skip


def read_metadata(values: Values, node: Node) -> dict[str, Any]:
    """Return the entries of a metadata document. Wrong entries are reported and left out."""
    if not isinstance(node.value, dict):
        values.report_wrong(node, "metadata, which is an object `{ … }`,", None)
        return {}
    return _plain_entries(values, node.value)


def _plain_entries(values: Values, entries: Mapping[str, Node]) -> dict[str, Any]:
    return {key: _value(values, each) for key, each in entries.items()}


def _value(values: Values, node: Node) -> Any:
    if isinstance(node.value, bool) or node.value is None:
        help = f"write `{int(node.value)}`" if node.value is not None else "leave the key out"
        values.report_wrong(node, "a text, a number, a list or an object", help)
        return 0
    if isinstance(node.value, list):
        return list(node.value) if node.numbers else [_value(values, each) for each in values.nodes(node)]
    if isinstance(node.value, dict):
        if set(node.value) == {"type", "value"}:
            return _typed(values, node.value)
        return _plain_entries(values, node.value)
    return node.value


def _typed(values: Values, entries: Mapping[str, Node]) -> TypedValue | None:
    kind, inner = entries["type"], entries["value"]
    name = values.text(kind, "the name of a type")
    value = _value(values, inner)
    if name is None:
        return None
    if name not in _TYPES:
        values.report_unknown(values.span(kind), "type of metadata", name, _TYPES, warn=True)
    elif not _fits(name, value):
        count = _TYPES[name]
        if count and isinstance(value, list):
            words = f"a value of the type `{name}` is a list of {count} numbers"
            values.report.error("wrong-value", words, values.start_span(inner), None)
            return TypedValue(name, value)
        expectation = f"a list of {count} numbers" if count else f"a value of the type `{name}`"
        needs_rounding = isinstance(value, float) and name == "int"
        values.report_wrong(inner, expectation, f"write `{round(value)}`, or the type `float`" if needs_rounding else None)
    return TypedValue(name, value)


def _fits(name: str, value: Any) -> bool:
    count = _TYPES[name]
    if count:
        numbers = isinstance(value, list) and all(isinstance(each, int | float) for each in value)
        return numbers and len(value) == count
    expected_type = {"int": int, "float": int | float, "string": str, "dict": dict, "array": list}[name]
    return isinstance(value, expected_type)


def plain_metadata(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata as JSON has it: typed values as objects with their type."""
    return {key: _plain(value) for key, value in metadata.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, TypedValue):
        return {"type": value.type, "value": _plain(value.value)}
    if isinstance(value, Mapping):
        return plain_metadata(value)
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
