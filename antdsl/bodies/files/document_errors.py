"""Reads a tree of JSON into a model of `document_model`, and reports each mistake at its place with what to write instead."""

from __future__ import annotations

from collections.abc import Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import Tag, ValidationError
from pydantic.fields import FieldInfo

from antdsl import limits
from antdsl.bodies.files.document_model import DocumentedForm, Form, keys_of
from antdsl.bodies.files.json_text import Node, find_node, find_span
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.scene.document import Key
from antdsl.scene.load import drop_consequences

F = TypeVar("F", bound=Form)
Path = tuple[Key, ...]
_MOST_ERRORS = 200  # of one document; the others are reported once these are corrected
_NULL = object()  # stands for a null, which no value of a document may be
_TYPES: dict[str, tuple[str, str | None]] = {
    "string_type": ("a text", 'write `"…"`'),
    "float_type": ("a number", None),
    "bool_type": ("true or false", "write `true` or `false`"),
    "list_type": ("a list", "write `[ … ]`"),
    "tuple_type": ("a list", "write `[ … ]`"),
    "dict_type": ("an object", None),
    "model_type": ("an object", None),
}


def read_form(form: type[F], root: Node, report: Report) -> F | None:
    """Return the model of a document, or None if one of its mistakes is an error."""
    tree = _plain(root)
    while True:
        try:
            return form.model_validate(tree)
        except ValidationError as problem:
            errors = drop_consequences(problem.errors(include_url=False, include_input=False)[:_MOST_ERRORS])
        ignored = [error for error in errors if _is_ignored(form, error)]
        seen: set[tuple[int, int]] = set()
        for error in errors:
            _report_error(form, root, report, error, seen)
        if len(ignored) < len(errors):
            return None
        for error in ignored:
            _delete(tree, error["loc"])


def _plain(node: Node) -> Any:
    if isinstance(node.value, dict):
        return {key: _plain(value) for key, value in node.value.items()}
    if isinstance(node.value, list) and not node.numbers:
        return [_plain(item) for item in node.value if isinstance(item, Node)]
    return _NULL if node.value is None else node.value


def _is_ignored(form: type[Form], error: Any) -> bool:
    """Return whether an error is only a warning: an unknown key of a documented form."""
    return (
        error["type"] == "extra_forbidden"
        and "meant" not in error
        and issubclass(_form_at(form, error["loc"])[0], DocumentedForm)
    )


def _delete(tree: Any, path: Path) -> None:
    for key in path[:-1]:
        if (isinstance(tree, dict) and key in tree) or (isinstance(tree, list) and isinstance(key, int)):
            tree = tree[key]
    del tree[path[-1]]


def _report_error(form: type[Form], root: Node, report: Report, error: Any, seen: set[tuple[int, int]]) -> None:
    """Report an error of pydantic, the first one of each place."""
    kind, path, context = error["type"], tuple(error["loc"]), error.get("ctx", {})
    owner, field = _form_at(form, path)
    code, help, labels, is_key = "wrong-value", None, (), False
    node = find_node(root, path)
    is_short = kind == "missing" and isinstance(path[-1], int)
    if kind == "worded":
        code, words, help = context.get("code", code), context["words"], context["help"] or None
        path, is_key = (*path, *context.get("at", ())), "key" in context
        if "first" in context:
            labels = (Label(find_span(root, (*error["loc"], *context["first"])), "here first"),)
    elif kind == "extra_forbidden":
        near = error.get("meant") or nearest_name(str(path[-1]), keys_of(owner))
        known = ", ".join(f"`{key}`" for key in keys_of(owner))
        words = f"`{str(path[-1])[:60]}` is not a key of {owner.noun}"
        code, help, is_key = "unknown-key", f'write `"{near}"`' if near else f"known here: {known}", True
    elif kind == "missing" and not is_short:
        code, words = "missing-key", f"{owner.noun} has no `{path[-1]}`"
        help = f'add `"{path[-1]}": {_example(field)}`'
    elif kind in ("greater_than_equal", "less_than_equal"):
        bound = context["ge" if kind == "greater_than_equal" else "le"]
        code, words = "out-of-range", f"{_subject(path, owner)} must be at {'least' if 'ge' in context else 'most'} {bound:g}"
        help = f"write `{bound:g}`" if abs(bound) < limits.LARGEST else None
    elif kind in _TYPES:
        what, help = _TYPES[kind]
        words = f"{_subject(path, owner)} must be {what}, not {'a number' if node.numbers and path[-1:] else node.kind}"
        help = "leave the key out" if node.value is None else f"write `{_example(field)}`" if _example(field) else help
    else:  # a list of another number of values
        path = path[:-1] if is_short else path
        node = find_node(root, path)
        words = f"{_subject(path, owner)} has {len(node.value) if isinstance(node.value, list) else 0} values, which is too "
        words += "few" if is_short else "many"
        help = f'write `"{field.alias}": {_example(field)}`' if field is not None and _example(field) else None
    is_key = is_key or path[-1:] == ("[key]",)
    path = path[:-1] if path[-1:] == ("[key]",) else path
    span = find_span(root, path, key=is_key)
    if "complete" in context or (kind in ("missing", "too_long") and node.numbers):
        span = find_node(root, path).span
    if (span.start, span.end) in seen:
        return
    seen.add((span.start, span.end))
    add = report.warning if _is_ignored(form, error) else report.error
    add(code, words, span, help, labels=labels)


def _subject(path: Path, owner: type[Form]) -> str:
    """Return what an error is about, in words."""
    names = [key for key in path if isinstance(key, str) and not key.startswith("clip-")]
    if not names:
        return owner.noun
    return f"`{names[-1][:60]}`" if path[-1] == names[-1] else f"a value of `{names[-1][:60]}`"


def _example(field: FieldInfo | None) -> str:
    if field is None:
        return ""
    return str(field.examples[0]) if field.examples else '"…"' if field.annotation is str else ""


def _form_at(form: type[Form], path: Sequence[Key]) -> tuple[type[Form], FieldInfo | None]:
    """Return the innermost form that contains what a path leads to, and the field of it that the path ends at."""
    kind: Any = form
    field: FieldInfo | None = None
    for key in path:
        kind = _without_marks(kind)
        field = None
        if isinstance(kind, type) and issubclass(kind, Form):
            form = kind
            field = next((each for name, each in kind.model_fields.items() if key == (each.alias or name)), None)
            kind = None if field is None else field.annotation
        else:
            kind = _inner_type(kind, key)
    return form, field


def _without_marks(kind: Any) -> Any:
    """Return a type without annotations and without None."""
    while True:
        arms = [arm for arm in get_args(kind) if arm is not NoneType]
        if get_origin(kind) is Annotated or (get_origin(kind) in (Union, UnionType) and len(arms) == 1):
            kind = arms[0]
        else:
            return kind


def _inner_type(kind: Any, key: Key) -> Any:
    """Return the type of an entry, of an item, or of the choice that a tag names."""
    arms = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        return next((arm for arm in arms if Tag(str(key)) in getattr(arm, "__metadata__", ())), None)
    return arms[1] if get_origin(kind) is dict else arms[0] if arms else None
