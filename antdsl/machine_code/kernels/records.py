"""Records of kernels: NamedTuple classes with fields of kernel types."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterable
from functools import cache
from types import GenericAlias
from typing import Any


def is_record(candidate: Any) -> bool:
    """Return whether an object is a record class, that is, a NamedTuple class."""
    return isinstance(candidate, type) and issubclass(candidate, tuple) and hasattr(candidate, "_fields")


def rebuild_like(model: Any, parts: Iterable[Any]) -> Any:
    """Return `parts` as a record of the same class as `model`, or as a tuple if `model` is not a record."""
    kind = type(model)
    return tuple(parts) if kind is tuple else kind._make(parts)


@cache
def get_field_types(record: Any) -> Any:
    """Return a record of the given class in which each field holds that field's type. Raises TypeError for a field without a
    kernel type."""
    world = vars(sys.modules[record.__module__])
    return record._make(resolve_annotation(_annotation_text(record.__annotations__[name]), world) for name in record._fields)


def _annotation_text(annotation: Any) -> Any:
    """Return the text of an annotation. `NamedTuple` wraps text annotations in another object."""
    return getattr(annotation, "__forward_arg__", annotation)


def resolve_annotation(annotation: Any, module_names: dict[str, Any]) -> Any:
    """Return the type that an annotation means: a ScalarType, an ArrayType, a tuple or record of these, or Any.
    `module_names`: the global names of the annotation's module."""
    return (
        _resolve_type_node(_parse_annotation(annotation), module_names)
        if isinstance(annotation, str)
        else _expand_records(annotation)
    )


@cache
def _parse_annotation(text: str) -> ast.expr:
    return ast.parse(text, mode="eval").body


def _resolve_type_node(node: ast.expr | None, module_names: dict[str, Any]) -> Any:
    """Return the type that an annotation means, given its syntax tree."""
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
    """Return an annotation with each record class replaced by a record of its field types. This includes classes within
    `tuple[..]`."""
    if isinstance(annotation, GenericAlias):
        return tuple(_expand_records(each) for each in annotation.__args__)
    return get_field_types(annotation) if is_record(annotation) else annotation
