"""Matches the arguments of a call with the parameters, by position or by name. Results are in the order of the parameters.

If a parameter is a point, the name of items or of a species stands for the nearest item or agent. Other values that have a
position are used directly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from antdsl.diagnostics import Fix, Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import Binding, ChangeRate, Dimension, Expr, ReduceExpr, SetExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, list_names
from antdsl.program.types.descriptions import KINDS_WITH_POSITION, quote_source, report_mismatch
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.mistakes.number_slips import find_comma_number, make_comma_diagnostic

CallNode = nodes.Call | nodes.VerbLine
ArgumentsBySlot = dict[str, list[nodes.Argument]]


@dataclass(frozen=True, slots=True)
class ArgumentSlot:
    """One parameter of a call.

    - `is_required`: whether the parameter has no default and is not optional.
    - `is_variadic`: whether the parameter accepts any number of values.
    - `is_range`: whether the value consists of two values joined by `..`."""

    name: str
    is_required: bool
    is_variadic: bool = False
    is_range: bool = False


def arrange_arguments(
    scope: NameScope, function_name: str, slots: Sequence[ArgumentSlot], node: CallNode, form: str = ""
) -> ArgumentsBySlot | None:
    """Return the arguments of a call by parameter name, or None after an error that makes the call unusable.

    `slots`: the parameters. `form`: the text of the call up to its bracket, if it is not `function_name`."""
    form = form or function_name
    for argument in node.arguments:
        if isinstance(argument, nodes.Comprehension):
            message = f"`{function_name}` cannot take `… in …: …`"
            scope.report.error("wrong-argument", message, argument.span, "only `sum mean min max count any every best` do")
            return None
    arguments = [each for each in node.arguments if isinstance(each, nodes.Argument)]
    comma = _find_decimal_comma(slots, arguments)
    if comma is not None:
        scope.report.add(
            make_comma_diagnostic(comma, is_single_number=not _is_valid_count(slots, _list_argument_forms(arguments)))
        )
        return None
    arguments_by_slot: ArgumentsBySlot = {}
    names, position, sound = [slot.name for slot in slots], 0, True
    late: list[tuple[nodes.Argument, str]] = []  # positional arguments after a named one
    for number, argument in enumerate(arguments):
        if argument.name is not None:
            sound = _add_named_argument(scope, function_name, names, arguments_by_slot, argument) and sound
            continue
        while position < len(slots) and slots[position].name in arguments_by_slot and not slots[position].is_variadic:
            position += 1
        if position >= len(slots):
            advice, fix = _make_range_fix(slots, arguments) or (f"write `{_format_call(form, slots)}`", None)
            scope.report.error("wrong-arity", f"`{function_name}` takes {_format_count(slots)}", argument.span, advice, fix=fix)
            return None
        arguments_by_slot.setdefault(slots[position].name, []).append(argument)
        if any(each.name is not None for each in arguments[:number]):
            late.append((argument, slots[position].name))
        position += 0 if slots[position].is_variadic else 1
    if late and sound:
        _report_late_positions(scope, next(each.name for each in arguments if each.name is not None), late)
        return None
    missing = [slot.name for slot in slots if slot.is_required and slot.name not in arguments_by_slot]
    if missing and sound:
        words = f"`{function_name}` needs {list_names(missing)}"
        scope.report.error("missing-argument", words, node.span, f"write `{_format_call(form, slots)}`")
    return None if missing or not sound else arguments_by_slot


def _add_named_argument(
    scope: NameScope,
    function_name: str,
    names: list[str],
    arguments_by_slot: dict[str, list[nodes.Argument]],
    argument: nodes.Argument,
) -> bool:
    name = argument.name
    assert name is not None
    if name.text not in names:
        near = find_nearest_name(name.text, names)
        advice = f"did you mean `{near}`?" if near else f"it takes {list_names(names)}" if names else "it takes none"
        span = Span(name.span.source, name.span.start, name.span.start + len(name.text))
        message = f"`{function_name}` has no argument `{name.text}`"
        scope.report.error("unknown-argument", message, name.span, advice, fix=Fix(span, near) if near else None)
        return False
    if name.text in arguments_by_slot:
        first = arguments_by_slot[name.text][0].span
        message = f"`{name.text}` is given twice"
        hint = "delete one of them"
        scope.report.error("duplicate-argument", message, argument.span, hint, labels=(Label(first, "first here"),))
        return False
    arguments_by_slot[name.text] = [argument]
    return True


def _format_count(slots: Sequence[ArgumentSlot]) -> str:
    most = len(slots)
    return "no arguments" if most == 0 else "one argument" if most == 1 else f"at most {most} arguments"


def _format_call(function_name: str, slots: Sequence[ArgumentSlot]) -> str:
    return f"{function_name}({', '.join(slot.name if slot.is_required else slot.name + ': …' for slot in slots)})"


def type_arguments(scope: NameScope, node: CallNode) -> None:
    """Type the arguments of an invalid call. This marks names in the arguments as used and reports their own errors.

    Errors in `with:` are not reported, because the elements of an invalid call are unknown."""
    for argument in node.arguments:
        if isinstance(argument, nodes.Comprehension):
            scope.type_expression(argument.over)
        elif isinstance(argument.value, nodes.RangeExpr):
            scope.type_expression(argument.value.low)
            scope.type_expression(argument.value.high)
        else:
            is_with = argument.name is not None and argument.name.text == "with"
            known = len(scope.declarations.name_uses)
            (scope.with_changes(report=Report()) if is_with else scope).type_expression(argument.value)
            if is_with:
                del scope.declarations.name_uses[known:]  # drops names that were bound during the attempt


def _report_late_positions(
    scope: NameScope, first_named: nodes.Name, late_arguments: Sequence[tuple[nodes.Argument, str]]
) -> None:
    """Report positional arguments after the named argument `first_named`. The fix adds the names of their parameters."""
    span = Span(late_arguments[0][0].span.source, late_arguments[0][0].span.start, late_arguments[-1][0].span.end)
    text, copied_end = "", span.start
    for argument, slot in late_arguments:
        text += f"{span.source.text[copied_end : argument.span.start]}{slot}: "
        copied_end = argument.span.start
    text += span.source.text[copied_end : span.end]
    message = f"{quote_source(late_arguments[0][0].span)} has no name, but comes after the named argument `{first_named.text}:`"
    advice = f"name it: `{' '.join(text.split())}`, or write it before the first with a name"
    scope.report.error("argument-order", message, late_arguments[0][0].span, advice, fix=Fix(span, text))


def _find_decimal_comma(slots: Sequence[ArgumentSlot], arguments: Sequence[nodes.Argument]) -> Span | None:
    """Return the span of the first number with a decimal comma. Such a number was parsed as two arguments. Return None if there
    is none.

    A comma counts as a decimal comma if the call becomes valid when the numbers on both sides are joined. In `vector(1,2,3)`,
    commas separate arguments."""
    joints: dict[int, Span] = {}
    is_second_half = False  # whether the argument was already joined to the previous one
    tight = 0
    for number, (argument, following) in enumerate(pairwise(arguments)):
        span = None
        if following.span.start == argument.span.end + 1:
            tight += 1
            span = find_comma_number(argument.span.source, argument.span.end)
        if span is not None and not is_second_half:
            joints[number] = span
        is_second_half = number in joints and isinstance(following.value, (nodes.Number, nodes.Quantity))
    if not joints:
        return None
    merged: list[list[nodes.Argument]] = []
    for number, argument in enumerate(arguments):
        if number - 1 in joints:
            merged[-1].append(argument)
        else:
            merged.append([argument])
    one = [_ArgumentForm(pieces[0].name, any(isinstance(each.value, nodes.RangeExpr) for each in pieces)) for pieces in merged]
    in_a_row = tight > 1 and tight == len(arguments) - 1 and _is_valid_count(slots, _list_argument_forms(arguments))
    return (
        joints[min(joints)] if _is_valid_count(slots, _merge_range_pairs(slots, one), min_variadic=2) and not in_a_row else None
    )


@dataclass(frozen=True, slots=True)
class _ArgumentForm:
    """What must be known about an argument to decide whether a call has the right number of arguments.

    `name`: the parameter that the argument names; None for a positional argument. `is_range`: whether the value has `..`."""

    name: nodes.Name | None
    is_range: bool


def _list_argument_forms(arguments: Sequence[nodes.Argument]) -> list[_ArgumentForm]:
    return [_ArgumentForm(each.name, isinstance(each.value, nodes.RangeExpr)) for each in arguments]


def _merge_range_pairs(slots: Sequence[ArgumentSlot], forms: Sequence[_ArgumentForm]) -> list[_ArgumentForm] | None:
    """Return the forms of the arguments. Where a parameter expects a range, two positional values are merged into one.

    Returns None if the second value of a range is missing."""
    paired: list[_ArgumentForm] = []
    left = list(forms)
    while left:
        each = left.pop(0)
        place = len(paired)
        if each.name is None and not each.is_range and place < len(slots) and slots[place].is_range:
            if not left or left[0].name is not None or left[0].is_range:
                return None
            left.pop(0)
        paired.append(each)
    return paired


def _make_range_fix(slots: Sequence[ArgumentSlot], arguments: Sequence[nodes.Argument]) -> tuple[str, Fix] | None:
    """Return help and a fix for two separate values where a range is expected. Return None if the call would still have the
    wrong number of arguments."""
    place = next((n for n, slot in enumerate(slots) if slot.is_range), len(arguments))
    if place + 1 >= len(arguments) or not _is_valid_count(slots, _merge_range_pairs(slots, _list_argument_forms(arguments))):
        return None
    low, high = arguments[place : place + 2]
    text = f"{' '.join(low.span.text.split())} .. {' '.join(high.span.text.split())}"
    return f"write the two ends as a range: `{text}`", Fix(Span(low.span.source, low.span.start, high.span.end), text)


def _is_valid_count(slots: Sequence[ArgumentSlot], forms: Sequence[_ArgumentForm] | None, min_variadic: int = 1) -> bool:
    """Return whether the positional and named arguments match the parameters in number and names.

    `min_variadic`: how many positional arguments a call of a variadic function must have at least."""
    if forms is None:
        return False
    by_name = [each.name for each in forms]
    names = [slot.name for slot in slots]
    positional_count = sum(name is None for name in by_name)
    named = {name.text for name in by_name if name is not None}
    many = any(slot.is_variadic for slot in slots)
    if (
        any(name is None for name in by_name[positional_count:])
        or not named <= set(names)
        or len(named) + positional_count < len(forms)
    ):
        return False
    if (
        (positional_count > len(slots) and not many)
        or (many and positional_count < min_variadic)
        or named & set(names[:positional_count])
    ):
        return False
    return all(slot.name in named or number < positional_count for number, slot in enumerate(slots) if slot.is_required)


def type_point(scope: NameScope, node: nodes.Expr, subject: str) -> Expr:
    """Return the typed expression of an argument that must be a point, such as an item, an agent or a position."""
    expr = scope.type_expression(node, ValueType(TypeKind.PLACE))
    if expr.type.kind in (TypeKind.ITEMS, TypeKind.SPECIES):
        return make_nearest_reduction(expr, node.span)
    if (
        expr.type.kind in KINDS_WITH_POSITION
        or expr.type.kind is TypeKind.BAD
        or expr.type == ValueType(TypeKind.VECTOR, Dimension(length=1))
    ):
        return expr
    return report_mismatch(scope.report, node, expr.type, ValueType(TypeKind.PLACE), subject)


def find_element_type(things: ValueType) -> ValueType:
    """Return the type of one item of a group, or of one agent of a species."""
    return ValueType(TypeKind.ITEM if things.kind is TypeKind.ITEMS else TypeKind.AGENT, Dimension(), things.referent)


def make_nearest_reduction(things: Expr, span: Span) -> ReduceExpr:
    """Return a reduction that finds the nearest item of a group, or the nearest agent of a species."""
    type = find_element_type(things.type)
    element = Binding("it", "element", type, ChangeRate.ELEMENT, span)
    over = SetExpr(
        ValueType(TypeKind.SET, Dimension(), type.referent),
        ChangeRate.AGENT,
        span,
        "all",
        type.referent or "",
        (None,),
        element,
        None,
    )
    return ReduceExpr(type, ChangeRate.AGENT, span, "nearest", over, element, None)
