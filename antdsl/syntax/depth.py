"""How deep a tree is, without recursion: whoever walks a tree afterwards may recurse."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from antdsl import limits
from antdsl.source import Source, Span


def deep_places(node: Any) -> Iterator[Span]:
    """The spans of the nodes that lie deeper than allowed."""
    stack: list[tuple[Any, int]] = [(node, 0)]
    while stack:
        part, depth = stack.pop()
        if isinstance(part, tuple):
            stack.extend((each, depth) for each in part)
        elif is_dataclass(part) and not isinstance(part, (Span, Source, type)):
            if depth > limits.EXPRESSION_DEPTH:
                yield getattr(part, "span")  # noqa: B009 - every node has one
                return
            stack.extend((getattr(part, each.name), depth + 1) for each in fields(part))
