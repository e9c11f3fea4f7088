"""Metadata of an agent definition: texts, numbers, arrays and dictionaries by name, any of them with a type that is stated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from antdsl.bodies.agents.checked_values import Values
from antdsl.bodies.agents.json_text import Node


@dataclass(frozen=True, slots=True)
class Typed:
    """A value whose type is written beside it: an object with the keys `type` and `value`, and no other."""

    type: str
    value: Any


# Types with the number of numbers that a value has; 0: one that is no list of numbers.
_TYPES = {
    "int": 0, "float": 0, "string": 0, "dict": 0, "array": 0, "vector2": 2, "vector": 3, "vector3": 3, "vector4": 4,
    "quaternion": 4, "matrix2": 4, "matrix3": 9, "matrix": 16, "matrix4": 16,
}  # fmt: skip


def read_metadata(values: Values, node: Node) -> dict[str, Any]:
    """The entries of a metadata document; what is wrong is told of and left out."""
    if not isinstance(node.value, dict):
        values.wrong(node, "metadata, which is an object `{ … }`,", None)
        return {}
    return _entries(values, node.value)


def _entries(values: Values, entries: Mapping[str, Node]) -> dict[str, Any]:
    return {key: _value(values, each) for key, each in entries.items()}


def _value(values: Values, node: Node) -> Any:
    if isinstance(node.value, bool) or node.value is None:
        help = f"write `{int(node.value)}`" if node.value is not None else "leave the key out"
        values.wrong(node, "a text, a number, a list or an object", help)
        return 0
    if isinstance(node.value, list):
        return list(node.value) if node.numbers else [_value(values, each) for each in values.nodes(node)]
    if isinstance(node.value, dict):
        if set(node.value) == {"type", "value"}:
            return _typed(values, node.value)
        return _entries(values, node.value)
    return node.value


def _typed(values: Values, entries: Mapping[str, Node]) -> Typed | None:
    kind, inner = entries["type"], entries["value"]
    name = values.text(kind, "the name of a type")
    value = _value(values, inner)
    if name is None:
        return None
    if name not in _TYPES:
        values.unknown(values.span(kind), "type of metadata", name, _TYPES, warn=True)
    elif not _fits(name, value):
        count = _TYPES[name]
        if count and isinstance(value, list):
            words = f"a value of the type `{name}` is a list of {count} numbers"
            values.report.error("wrong-value", words, values.head(inner), None)
            return Typed(name, value)
        wanted = f"a list of {count} numbers" if count else f"a value of the type `{name}`"
        whole = isinstance(value, float) and name == "int"
        values.wrong(inner, wanted, f"write `{round(value)}`, or the type `float`" if whole else None)
    return Typed(name, value)


def _fits(name: str, value: Any) -> bool:
    count = _TYPES[name]
    if count:
        numbers = isinstance(value, list) and all(isinstance(each, int | float) for each in value)
        return numbers and len(value) == count
    wanted = {"int": int, "float": int | float, "string": str, "dict": dict, "array": list}[name]
    return isinstance(value, wanted)


def plain_metadata(metadata: Mapping[str, Any]) -> dict[str, Any]:
    """Metadata as JSON has it: typed values as objects with their type."""
    return {key: _plain(value) for key, value in metadata.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, Typed):
        return {"type": value.type, "value": _plain(value.value)}
    if isinstance(value, Mapping):
        return plain_metadata(value)
    return [_plain(each) for each in value] if isinstance(value, list | tuple) else value
