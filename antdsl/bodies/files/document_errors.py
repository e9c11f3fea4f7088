"""Reads a JSON tree into a model of `document_model`. Each mistake becomes a finding with its location and a correction."""

from __future__ import annotations

from collections.abc import Sequence
from types import NoneType, UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import Tag, ValidationError
from pydantic.fields import FieldInfo

from antdsl import limits
from antdsl.bodies.files.document_model import DocumentedForm, Form, list_keys
from antdsl.bodies.files.json_text import JsonNode, find_node, find_span
from antdsl.diagnostics import Diagnostic, Label, Report
from antdsl.diagnostics.model import Severity
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.document import PathKey
from antdsl.scene.load import drop_cascading_errors
from antdsl.source import Span

FormType = TypeVar("FormType", bound=Form)
Path = tuple[PathKey, ...]
_MAX_ERRORS = 200  # findings per check; further ones are reported after these are corrected
_NULL_PLACEHOLDER = object()  # replaces null, which is not allowed in documents
_EXPECTED_BY_ERROR_TYPE: dict[str, tuple[str, str | None]] = {
    "string_type": ("a text", 'write `"…"`'),
    "float_type": ("a number", None),
    "bool_type": ("true or false", "write `true` or `false`"),
    "list_type": ("a list", "write `[ … ]`"),
    "tuple_type": ("a list", "write `[ … ]`"),
    "dict_type": ("names with values", "write `{ … }`"),
    "model_type": ("names with values", "write `{ … }`"),
}


_CONTAINER_ERROR_TYPES = ("list_type", "tuple_type", "dict_type", "model_type")


def read_form(form: type[FormType], root: JsonNode, report: Report) -> FormType | None:
    """Return the model of a document, or None if it has errors, which are then in the report.

    At most `_MAX_ERRORS` findings are reported, errors before warnings."""
    tree = _to_plain_values(root)
    while True:
        try:
            return form.model_validate(tree)
        except ValidationError as problem:
            errors = problem.errors(include_url=False, include_input=False)
        errors.sort(key=lambda error: _is_ignorable(form, error))  # so that each pass ends with an error, or removes all warnings
        diagnostics = [_convert_error(form, root, error) for error in drop_cascading_errors(errors[:_MAX_ERRORS])]
        report.extend(diagnostics)
        if any(diagnostic.severity == "error" for diagnostic in diagnostics):
            return None
        for error in errors:
            _delete_entry(tree, error["loc"])


def _is_ignorable(form: type[Form], error: Any) -> bool:
    """Return whether an error is only about an unknown key in a form that may have unknown keys (`DocumentedForm`)."""
    return error["type"] == "extra_forbidden" and issubclass(_find_innermost_form(form, error["loc"])[0], DocumentedForm)


def _to_plain_values(node: JsonNode) -> Any:
    """Return a tree as plain dicts, lists and values, without locations."""
    if isinstance(node.value, dict):
        return {key: _to_plain_values(value) for key, value in node.value.items()}
    if isinstance(node.value, list) and not node.has_plain_numbers:
        return [_to_plain_values(item) for item in node.value if isinstance(item, JsonNode)]
    return _NULL_PLACEHOLDER if node.value is None else node.value


def _delete_entry(tree: Any, path: Path) -> None:
    """Delete the entry of a tree at `path`. The path may contain tags of unions."""
    for key in path[:-1]:
        if isinstance(key, int) or key in tree:
            tree = tree[key]
    del tree[path[-1]]


def _convert_error(form: type[Form], root: JsonNode, error: Any) -> Diagnostic:
    """Return the finding for an error that pydantic raised."""
    kind, path, context = error["type"], tuple(error["loc"]), error.get("ctx", {})
    owner, field = _find_innermost_form(form, path)
    last, example = path[-1] if path else "", _find_example(field)
    help: str | None
    if kind == "worded":
        return _diagnose_model_error(root, path, context)
    if kind == "extra_forbidden":
        return _diagnose_unknown_key(owner, find_span(root, path, key=True), str(last), error.get("meant"))
    if kind == "missing" and isinstance(last, str):
        words, help = f"{owner.noun} has no `{last}`", f'add `"{last}": {example}`'
        return Diagnostic("missing-key", words, find_span(root, path), help=help)
    if kind in ("greater_than_equal", "less_than_equal"):
        most, bound = ("least", context["ge"]) if "ge" in context else ("most", context["le"])
        help = f"write `{bound:g}`" if abs(bound) < limits.MAX_NUMBER else None
        words = f"{_describe_subject(path, owner)} must be at {most} {bound:g}"
        return Diagnostic("out-of-range", words, find_span(root, path), help=help)
    node = find_node(root, path)
    if kind in _EXPECTED_BY_ERROR_TYPE:
        expectation, help = _EXPECTED_BY_ERROR_TYPE[kind]
        if node.value is None:
            help = "delete it" if isinstance(last, int) else "delete the key"
        elif kind in _CONTAINER_ERROR_TYPES and example:
            help = f"write `{example}`"
        actual = "a number" if path and find_node(root, path[:-1]).has_plain_numbers else node.kind
        words = f"{_describe_subject(path, owner)} must be {expectation}, not {actual}"
        return Diagnostic("wrong-value", words, find_span(root, path), help=help)
    path = path[:-1] if kind == "missing" else path
    node = find_node(root, path)
    count = len(node.value) if isinstance(node.value, list) else 0
    amount = "few" if kind == "missing" else "many"
    words = f"{_describe_subject(path, owner)} has {count} value{'' if count == 1 else 's'}, which is too {amount}"
    return Diagnostic("wrong-value", words, node.span if node.has_plain_numbers else node.marked_span)


def _diagnose_model_error(root: JsonNode, path: Path, context: Any) -> Diagnostic:
    """Return the finding for an error that a model of `document_model` raised. The entries of `context`:

    `words`, `help`: the message and the correction of the finding.
    `code`: the finding's code, by default `wrong-value`.
    `at`: the location, as a path relative to the error's path.
    `key`: if present, the finding marks the key instead of its value.
    `complete`: if present, the finding marks the complete value.
    `first`: another location, relative to the error's path, which gets a label."""
    is_key = "key" in context or path[-1:] == ("[key]",)
    labels = (Label(find_span(root, (*path, *context["first"])), "here first"),) if "first" in context else ()
    path = (*(path[:-1] if path[-1:] == ("[key]",) else path), *context.get("at", ()))
    span = find_node(root, path).span if "complete" in context else find_span(root, path, key=is_key)
    code = context.get("code", "wrong-value")
    return Diagnostic(code, context["words"], span, help=context["help"] or None, labels=labels)


def _diagnose_unknown_key(owner: type[Form], span: Span, key: str, suggestion: str | None) -> Diagnostic:
    """Return the finding for a key that the form `owner` does not have."""
    near = suggestion or find_nearest_name(key, list_keys(owner))
    known = ", ".join(f"`{each}`" for each in list_keys(owner))
    help = f'write `"{near}"`' if near else f"known here: {known}"
    severity: Severity = "error" if suggestion or not issubclass(owner, DocumentedForm) else "warning"
    return Diagnostic("unknown-key", f"`{key[:60]}` is not a key of {owner.noun}", span, severity, help)


def _describe_subject(path: Path, owner: type[Form]) -> str:
    """Return the part of a document that an error is about, as the subject of a message."""
    names = [key for key in path if isinstance(key, str) and not key.startswith("clip-")]
    if not names:
        return owner.noun
    return f"`{names[-1][:60]}`" if path[-1] == names[-1] else f"a value of `{names[-1][:60]}`"


def _find_example(field: FieldInfo | None) -> str:
    """Return an example of a field's value as JSON; an empty text if there is none."""
    if field is None:
        return ""
    return str(field.examples[0]) if field.examples else '"…"' if field.annotation is str else ""


def _find_innermost_form(form: type[Form], path: Sequence[PathKey]) -> tuple[type[Form], FieldInfo | None]:
    """Return the innermost form that contains the value at `path`, and the field of this form that the path goes through."""
    kind: Any = form
    field: FieldInfo | None = None
    for key in path:
        kind = _strip_annotations(kind)
        field = None
        if isinstance(kind, type) and issubclass(kind, Form):
            form = kind
            field = next((each for name, each in kind.model_fields.items() if key == (each.alias or name)), None)
            kind = None if field is None else field.annotation
        else:
            kind = _find_inner_type(kind, key)
    return form, field


def _strip_annotations(kind: Any) -> Any:
    """Return a type without `Annotated`, and without None if it is optional."""
    while True:
        arms = [arm for arm in get_args(kind) if arm is not NoneType]
        if get_origin(kind) is Annotated or (get_origin(kind) in (Union, UnionType) and len(arms) == 1):
            kind = arms[0]
        else:
            return kind


def _find_inner_type(kind: Any, key: PathKey) -> Any:
    """Return the type of an object's values or an array's items. For a union, `key` is the tag of the alternative to return."""
    arms = get_args(kind)
    if get_origin(kind) in (Union, UnionType):
        return next((arm for arm in arms if Tag(str(key)) in getattr(arm, "__metadata__", ())), None)
    return arms[1] if get_origin(kind) is dict else arms[0] if arms else None
