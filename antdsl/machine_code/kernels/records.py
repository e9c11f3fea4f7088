"""Records of kernels: NamedTuple classes with fields of kernel types."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable
from functools import cache
from types import GenericAlias
from typing import Any


def is_record(candidate: Any) -> bool:
    """Return whether an object is the class of a record."""
    return isinstance(candidate, type) and issubclass(candidate, tuple) and hasattr(candidate, "_fields")


def rebuild_like(model: Any, parts: Iterable[Any]) -> Any:
    """Return `parts` as a tuple; if `model` is a record, as a record of its class."""
    kind = type(model)
    return tuple(parts) if kind is tuple else kind._make(parts)


@cache
def get_field_types(record: Any) -> Any:
    """Return the types of a record class's fields, as a record of this class. Raises TypeError for a field without a kernel
    type."""
    world = vars(sys.modules[record.__module__])
    return record._make(resolve_annotation(_annotation_text(record.__annotations__[name]), world) for name in record._fields)


def _annotation_text(annotation: Any) -> Any:
    """Return the text of an annotation, which `NamedTuple` wraps."""
    return getattr(annotation, "__forward_arg__", annotation)


def resolve_annotation(annotation: Any, module_names: dict[str, Any]) -> Any:
    """Return the type of an annotation in a module with the names `module_names`: a ScalarType, an ArrayType, a tuple or record
    of these, or Any."""
    return (
        _resolve_type_node(_parse_annotation(annotation), module_names)
        if isinstance(annotation, str)
        else _expand_records(annotation)
    )


@cache
def _parse_annotation(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _resolve_type_node(node: ast.expr | None, module_names: dict[str, Any]) -> Any:
    """Return the type of an annotation's syntax tree."""
    if isinstance(node, ast.Name):
        if node.id in ("tuple", "Any"):
            return tuple if node.id == "tuple" else Any
        if node.id in module_names:
            return _expand_records(module_names[node.id])
    if isinstance(node, ast.Subscript):
        inner = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        of = [_resolve_type_node(each, module_names) for each in inner]
        base = _resolve_type_node(node.value, module_names)
        return tuple(of) if base is tuple else base[of[0]]
    raise TypeError(f"`{'nothing' if node is None else ast.unparse(node)}` is not a type of `kernels`")


def _expand_records(annotation: Any) -> Any:
    """Return the type of an annotation, with each record class replaced by the record of its fields' types, also within
    `tuple[..]`."""
    if isinstance(annotation, GenericAlias):
        return tuple(_expand_records(each) for each in annotation.__args__)
    return get_field_types(annotation) if is_record(annotation) else annotation
