"""Iterates over typed expressions or syntax trees. Each part is visited once. The traversal is not recursive."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass

from antdsl.program import model
from antdsl.program.kinds import ChangeRate, Dimension, ValueType
from antdsl.source import Source, Span
from antdsl.syntax import nodes

_CHILD_FIELDS: dict[type, tuple[str, ...]] = {}  # by type, the fields to descend into, last first


def iterate_parts(root: object) -> Iterator[object]:
    """Yield every value of the checked program below `root`. This includes the bindings to which names refer."""
    visited: set[int] = set()
    stack: list[object] = [root]
    while stack:
        part = stack.pop()
        kind = type(part)
        if kind is tuple or kind is list:
            stack += reversed(part)  # type: ignore[call-overload]
            continue
        if kind is dict:
            stack += reversed(list(part.values()))  # type: ignore[attr-defined]
            continue
        names = _CHILD_FIELDS.get(kind)
        if names is None:
            names = _CHILD_FIELDS[kind] = _list_child_fields(kind)
        if names and id(part) not in visited:
            visited.add(id(part))
            yield part
            stack += [value for name in names if type(value := getattr(part, name)) not in _LEAF_TYPES]


_LEAF_TYPES = frozenset((Span, str, int, float, bool, type(None), ValueType, ChangeRate, Dimension))


def _list_child_fields(kind: type) -> tuple[str, ...]:
    """Return the names of the fields that contain further parts. The result is empty for types that are not part of programs."""
    if not is_dataclass(kind) or issubclass(kind, (Span, nodes.File)):
        return ()
    return tuple(field.name for field in reversed(fields(kind)))


def find_bindings(expr: model.Expr) -> set[model.Binding]:
    """Return every binding that an expression uses, at any depth."""
    return {part.binding for part in iterate_parts(expr) if isinstance(part, model.BindingRef)}


_NODE_FIELDS: dict[type, tuple[str, ...]] = {}


def iterate_nodes(root: object) -> Iterator[tuple[object, int]]:
    """Yield every node of a syntax tree in text order, each with its depth below `root`."""
    stack: list[tuple[object, int]] = [(root, 0)]
    while stack:
        part, depth = stack.pop()
        if isinstance(part, tuple):
            stack += [(each, depth) for each in reversed(part)]
            continue
        names = _NODE_FIELDS.get(type(part))
        if names is None:
            if not is_dataclass(part) or isinstance(part, (Span, Source)):
                continue
            names = _NODE_FIELDS[type(part)] = tuple(
                f.name for f in fields(part) if f.name not in ("span", "op_span", "unit_span", "comments")
            )
        yield part, depth
        stack += [(getattr(part, name), depth + 1) for name in reversed(names)]


def iterate_names(root: object) -> Iterator[nodes.Name]:
    """Yield every bare name below `root` that is used as a value."""
    for part, _ in iterate_nodes(root):
        if isinstance(part, nodes.NameRef):
            yield part.name


def iterate_expressions(expr: model.Expr) -> Iterator[object]:
    """Yield an expression, then all expressions and bindings inside it, without duplicates."""
    stack: list[object] = [expr]
    visited_ids: set[int] = set()
    while stack:
        each = stack.pop()
        if each is None or id(each) in visited_ids:
            continue
        visited_ids.add(id(each))
        yield each
        stack += reversed(_list_direct_parts(each))


def _list_direct_parts(part: object) -> list[object]:
    """Return the parts that an expression or binding contains directly."""
    if isinstance(part, tuple):
        return list(part)
    if isinstance(part, model.BindingRef):
        return [part.binding]
    if isinstance(part, model.Binding):
        return [part.value, part.next_value]
    if isinstance(part, model.AttributeRef):
        return [part.owner]
    if isinstance(part, model.OperationExpr):
        return [part.args]
    if isinstance(part, model.SetExpr):
        return [part.args, part.condition]
    if isinstance(part, model.ReduceExpr):
        return [part.elements, part.body]
    if isinstance(part, model.InlinedBehaviour):
        return [part.arguments, part.body, part.result]
    return []
