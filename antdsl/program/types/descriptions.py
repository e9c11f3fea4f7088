"""The names of types for artists, and errors about types and units that several parts of the checker report."""

from __future__ import annotations

import re

from antdsl.diagnostics import Diagnostic, Fix, Label, Report
from antdsl.program.model import Dimension, Expr, OperationExpr, TypeKind, ValueType
from antdsl.program.names.scope import make_bad_expression
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.things import KIND_BY_WORD, list_replacements
from antdsl.program.tables.units import add_article, describe_dimension, format_with_unit
from antdsl.source import Span
from antdsl.syntax import nodes

_KIND_PHRASES: dict[TypeKind, str] = {
    TypeKind.BOOL: "a yes or no",
    TypeKind.STATE: "a state",
    TypeKind.HIT: "what a ray hit",
    TypeKind.PLACE: "a place",
    TypeKind.SET: "a set",
    TypeKind.RANGE: "a range",
    **{TypeKind(row.word): row.label for row in KIND_BY_WORD.values() if row.label},
    TypeKind.FIELD: "a field",
}
# Kinds of things with a name that alone is not a value; an expression must read a value of them.
_THING_KINDS = frozenset(TypeKind(word) for word in KIND_BY_WORD) - {TypeKind(each.args[0].type) for each in find_words("value")}
KINDS_WITH_POSITION = {
    TypeKind.ITEM,
    TypeKind.AGENT,
    TypeKind.HIT,
    TypeKind.PLACE,
    *(TypeKind(row.word) for row in KIND_BY_WORD.values() if row.nearest_op),
}
FLOW_KIND = TypeKind("flow")
_VECTOR_PHRASES: dict[Dimension, str] = {
    Dimension(): "a push or direction",
    Dimension(length=1): "a position",
    Dimension(length=1, time=-1): "a velocity",
}


def describe_type(type: ValueType) -> str:
    """Return words that describe a type, such as `a length`, `a push or direction`, `an item of food` or `an agent of rabbit`."""
    if type.kind is TypeKind.NUMBER:
        return describe_dimension(type.dimension)
    if type.kind is TypeKind.VECTOR:
        return (
            _VECTOR_PHRASES.get(type.dimension)
            or f"a vector of {describe_dimension(type.dimension).removeprefix('a ').removeprefix('an ')}"
        )
    if type.kind in (TypeKind.ITEM, TypeKind.AGENT):
        word = "item" if type.kind is TypeKind.ITEM else "agent"
        return f"an {word}" if type.referent is None else f"an {word} of `{type.referent}`"
    if type.kind in (TypeKind.ITEMS, TypeKind.SPECIES):
        return "all items of a name" if type.kind is TypeKind.ITEMS else "a species"
    return _KIND_PHRASES.get(type.kind, add_article(type.kind.value))


def quote_source(span: Span, max_characters: int = 40) -> str:
    """Return the source text of a span in backquotes, on one line, shortened to at most `max_characters` characters."""
    text = " ".join(span.text.split())
    if len(text) > max_characters:
        text = text[: max_characters - 1].rstrip() + "…"
    return f"`{text}`"


def is_compatible(actual: ValueType, expected_type: ValueType) -> bool:
    """Return whether a value of type `actual` is allowed where `expected_type` is needed. The result is True for a value with an
    error, because the error has already been reported."""
    if TypeKind.BAD in (actual.kind, expected_type.kind):
        return True
    if actual.kind is TypeKind.VECTOR_FIELD:
        return expected_type.kind in (actual.kind, FLOW_KIND)
    if actual.kind is not expected_type.kind:
        return actual.kind.value in list_replacements(expected_type.kind.value)
    if actual.kind in (TypeKind.NUMBER, TypeKind.VECTOR) and actual.dimension != expected_type.dimension:
        return False
    return actual.referent is None or expected_type.referent is None or actual.referent == expected_type.referent


def report_mismatch(
    report: Report, node: nodes.Expr, actual: ValueType, expected_type: ValueType, place: str, expr: Expr | None = None
) -> Expr:
    """Report that the type of `node` is wrong at `place`: a unit is missing or wrong, or the expression is of another kind.

    `expr`: the typed expression of the node, if known. Returns a replacement for this expression."""
    if isinstance(expr, OperationExpr) and expr.name == "map_value" and expected_type.kind is TypeKind.VECTOR:
        text = " ".join(node.span.text.split())
        message = f"`{text}` is a map of numbers, but {place} needs {describe_type(expected_type)}"
        advice = f"for painted directions, use a flow: `world {{ flow {text} }}`"
        report.add(Diagnostic("wrong-kind", message, node.span, help=advice))
    else:
        report.add(_make_mismatch(node, actual, expected_type, place))
    return make_bad_expression(node.span)


def _make_mismatch(node: nodes.Expr, actual: ValueType, expected_type: ValueType, place: str) -> Diagnostic:
    text, want = quote_source(node.span), describe_type(expected_type)
    both_numbers = actual.kind is TypeKind.NUMBER and expected_type.kind is TypeKind.NUMBER
    if both_numbers and isinstance(node, nodes.Number):
        write = format_with_unit(node.value, expected_type.dimension)
        message = f"{text} has no unit, but {place} needs {want}"
        return Diagnostic("missing-unit", message, node.span, help=f"write `{write}`", fix=Fix(node.span, write))
    message = f"{text} is {describe_type(actual)}, but {place} needs {want}"
    if both_numbers:
        fix = None
        advice = f"write {want}"
        if isinstance(node, nodes.Quantity):
            write = format_with_unit(node.value, expected_type.dimension)
            advice, fix = f"write {want}, such as `{write}`", Fix(node.span, write)
        return Diagnostic("wrong-unit", message, node.span, help=advice, fix=fix)
    if actual.kind is expected_type.kind and actual.kind is TypeKind.VECTOR:
        advice = (
            "`direction(x)`, `unit(v)` and `match(velocity)` make pushes"
            if expected_type.dimension == Dimension()
            else f"write {want}"
        )
        return Diagnostic("wrong-unit", message, node.span, help=advice)
    advice = _choose_advice(node, actual, expected_type)
    fix = _make_vector_units_fix(node) if expected_type.kind is TypeKind.PLACE and actual == ValueType(TypeKind.VECTOR) else None
    if (
        fix is None
        and expected_type.kind is not FLOW_KIND
        and not (expected_type.kind is TypeKind.BOOL and actual.kind in _THING_KINDS)
    ):
        fix = _make_own_text_fix(node, advice)
    return Diagnostic("wrong-kind", message, node.span, help=advice, fix=fix)


def _make_vector_units_fix(node: nodes.Expr) -> Fix | None:
    """Return a fix that adds a length unit to the numbers of a call such as `vector(10, 0, 0)`, so that it becomes a point.
    Return None for other expressions."""
    if not isinstance(node, nodes.Call) or node.function.span.text != "vector":
        return None
    values = [each.value for each in node.arguments if isinstance(each, nodes.Argument)]
    if len(values) < 3 or not all(isinstance(each, nodes.Number) or _is_negation(each) for each in values):
        return None
    return Fix(node.span, f"vector({', '.join(f'{each.span.text} mm' for each in values)})")


def _is_negation(node: nodes.Expr) -> bool:
    return isinstance(node, nodes.Unary) and node.op == "-" and isinstance(node.operand, nodes.Number)


def _make_own_text_fix(node: nodes.Expr, advice: str) -> Fix | None:
    """Return a fix that replaces the node by the first text in backquotes in `advice`.

    Returns None if this text does not contain the source text of the node, because it is then about something else."""
    text, match = " ".join(node.span.text.split()), re.search("`([^`…]+)`", advice)
    return Fix(node.span, match[1]) if match and text in match[1] else None


def _choose_advice(node: nodes.Expr, actual: ValueType, expected_type: ValueType) -> str:
    text = " ".join(node.span.text.split())
    short = text if len(text) <= 30 else "…"
    if expected_type.kind is TypeKind.BOOL and actual.kind in _THING_KINDS:
        any_there = (
            f", or `nearest({short})` to test whether there is one" if actual.kind in (TypeKind.ITEMS, TypeKind.SPECIES) else ""
        )
        return f"use a value of it: `touching({short})`, `distance({short}) < 20 mm`{any_there}"
    if expected_type.kind is TypeKind.PLACE:
        fix = _make_vector_units_fix(node) if actual.kind is TypeKind.VECTOR else None
        if fix is not None:
            return f"a place has lengths: `{fix.text}`"
        if actual.kind is TypeKind.VECTOR and actual.dimension == Dimension():
            ahead = f"{short} * 20 mm" if not isinstance(node, nodes.Binary) else f"({short}) * 20 mm"
            return (
                f"a direction is not a place: use it directly to steer, or name a place in that direction: `position + {ahead}`"
            )
        return "name an item, an agent or a position, such as `nearest(food)` or `vector(10 mm, 0 mm, 0 mm)`"
    if expected_type.kind is TypeKind.BOOL and actual.kind is TypeKind.NUMBER:
        if isinstance(node, (nodes.Number, nodes.Quantity)):
            return "a number alone is not a condition: compare something with it"
        if isinstance(node, nodes.Binary) and node.op in ("and", "or"):
            short = f"({short})"
        number = format_with_unit(0.5 if actual.dimension == Dimension() else 1, actual.dimension)
        return f"compare it with something: `{short} > {number}`"
    if expected_type.kind is TypeKind.VECTOR and expected_type.dimension == Dimension():
        if actual.kind in KINDS_WITH_POSITION:
            return f"`direction({short})` is the push toward it"
        if actual.kind is TypeKind.NUMBER:
            sample = f": `heading * {short}`" if actual.dimension == Dimension() else ", such as `heading`"
            return f"a push needs a direction{sample}"
    if actual.kind is TypeKind.VECTOR_FIELD:
        return f"`along({short})` follows it, `{short}` is its vector at the agent, `length({short})` its strength there"
    if expected_type.kind is TypeKind.NUMBER and actual.kind is TypeKind.VECTOR:
        return f"`length({short})` is a number"
    if expected_type.kind is TypeKind.NUMBER and actual.kind in (TypeKind.ITEM, TypeKind.AGENT, TypeKind.PLACE):
        return f"`distance({short})` is a length; `{short}.size` and the like are its values"
    if expected_type.kind is FLOW_KIND:
        if actual.kind is TypeKind.VECTOR:
            return f"`toward({short})` takes any direction; here the name of a flow is needed"
        return "name a flow: `world { flow drift }`, and in the scene `drift: {toward: nest}`"
    if expected_type.kind is TypeKind.ITEM and actual.kind is TypeKind.ITEMS:
        return f"`nearest({short})` is one of them"
    return f"write {describe_type(expected_type)}"


def report_operand_mismatch(
    report: Report, op: str, span: Span, left: tuple[nodes.Expr, Expr], right: tuple[nodes.Expr, Expr]
) -> None:
    """Report that the types of two operands do not match, and quote the source text of both."""
    (left_node, a), (right_node, b) = left, right
    both = (
        f"{quote_source(left_node.span)} is {describe_type(a.type)} "
        f"and {quote_source(right_node.span)} is {describe_type(b.type)}"
    )
    message = f"{both}: the operands of `{op}` must match"
    advice, fix = None, None
    for node, other in ((right_node, a), (left_node, b)):
        if isinstance(node, (nodes.Number, nodes.Quantity)) and other.type.kind is TypeKind.NUMBER:
            write = format_with_unit(node.value, other.type.dimension)
            advice, fix = f"write `{write}` for {quote_source(node.span)}", Fix(node.span, write)
            break
    for node, own, other in ((left_node, a, b), (right_node, b, a)):
        if own.type.kind is TypeKind.VECTOR and other.type.kind is TypeKind.NUMBER:
            advice = advice or f"write `length({' '.join(node.span.text.split())})` for {quote_source(node.span)}"
    labels = (Label(left_node.span, describe_type(a.type)), Label(right_node.span, describe_type(b.type)))
    missing = any(isinstance(n, nodes.Number) for n in (left_node, right_node)) and a.type.kind is b.type.kind
    code = "missing-unit" if missing and fix else "units-differ" if a.type.kind is b.type.kind else "kinds-differ"
    place = span if fix is None else fix.span
    report.add(Diagnostic(code, message, place, help=advice or "give both sides the same type", labels=labels, fix=fix))
