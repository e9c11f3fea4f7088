"""Determines the types of calls: finds the called function, matches the arguments with the tables, and returns the typed
operation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from antdsl.diagnostics import Fix
from antdsl.program.declarations.behaviours import call_behaviour
from antdsl.program.kinds import BAD_TYPE, NUMBER_TYPE
from antdsl.program.model import ChangeRate, Dimension, Expr, OperationExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, find_highest_rate, make_bad_expression, parse_type_words, suggest_name
from antdsl.program.tables import vocabulary
from antdsl.program.tables.defaults import parse_default_values
from antdsl.program.tables.foreign_words import find_call_replacement
from antdsl.program.tables.rows import ArgumentRow, BuiltinRow
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.units import combine_dimensions, scale_dimension
from antdsl.program.types.arguments import ArgumentSlot, arrange_arguments, type_arguments, type_point
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch, report_operand_mismatch
from antdsl.program.types.expressions import OPTIONAL_KINDS, THING_KINDS, TypedArgument
from antdsl.program.types.folding import find_constant, fold_operation
from antdsl.program.types.operators import convert_to_value, make_draw_site, type_count, type_value
from antdsl.program.types.sets import SET_CHECKERS, type_reduction
from antdsl.source import Span
from antdsl.syntax import nodes

TypeVariables = dict[str, tuple[nodes.Expr, Expr]]
# Kinds of things with a bare name that is a value.
_VALUE_WORDS = {TypeKind(each.args[0].type): (parse_type_words(each.result) or BAD_TYPE).kind for each in find_words("value")}
_VALUE_WORDS[TypeKind.VECTOR_FIELD] = TypeKind.VECTOR


def _make_use_fix(file: nodes.File, library: str) -> Fix | None:
    """Return a fix that adds a `use` line after the edition line and the help text of a file."""
    head = file.help or file.edition
    if head is None:
        return None
    return Fix(Span(file.source, head.span.end, head.span.end), f"\nuse {library}")


def type_call(scope: NameScope, node: nodes.Call, expected_type: ValueType | None) -> Expr:
    """Type a call: a reduction over a set, a built-in operation, or a behaviour."""
    function = node.function
    if isinstance(function, nodes.Member):
        return call_behaviour(scope, node, expected_type)
    if not isinstance(function, nodes.NameRef):
        message = f"{quote_source(function.span)} cannot be called"
        scope.report.error("wrong-kind", message, function.span, "only behaviours and built-in words can be called")
        type_arguments(scope, node)
        return make_bad_expression(node.span)
    name = function.name.text
    if (
        name in vocabulary.REDUCER_HELP
        and len(node.arguments) == 1
        and (isinstance(node.arguments[0], nodes.Comprehension) or name not in vocabulary.BUILTINS_BY_NAME)
    ):
        return type_reduction(scope, node, name)
    if name in vocabulary.BUILTINS_BY_NAME:
        return _type_builtin(scope, node, name, expected_type)
    if scope.file.find_behaviour(name) is not None:
        return call_behaviour(scope, node, expected_type)
    _report_unknown(scope, node, function.name, expected_type)
    type_arguments(scope, node)
    return make_bad_expression(node.span)


def _report_unknown(scope: NameScope, node: nodes.Call, name: nodes.Name, expected_type: ValueType | None) -> None:
    if name.text in vocabulary.RESERVED_WORDS:
        words = f"`{name.text}` is a word of the language that does not work yet"
        scope.report.error("not-yet", words, name.span, "do not use it yet")
        return
    if name.text in vocabulary.REDUCER_HELP:
        message = f"`{name.text}` needs a set"
        scope.report.error("wrong-argument", message, node.span, f"write `{name.text}(n in neighbours(20 mm): …)`")
        return
    home = scope.declarations.find_library(name.text)
    if home is not None and home not in scope.file.libraries:
        if home not in scope.file.missing_uses:
            scope.file.missing_uses.add(home)
            advice = f"write `use {home}` below the first line"
            fix = _make_use_fix(scope.file.node, home)
            scope.report.error("unknown-behaviour", f"`{name.text}` needs the library `{home}`", name.span, advice, fix=fix)
        return
    known = (
        set(vocabulary.BUILTINS_BY_NAME)
        | set(vocabulary.REDUCER_HELP)
        | set(scope.file.own_behaviours)
        | set(scope.file.library_behaviours)
    )
    instead, fix = find_call_replacement(node, name.text), None
    if not node.arguments and name.text in (
        scope.builtins.keys() | vocabulary.RUN_VALUE_TYPES.keys() | vocabulary.SENSE_TYPE_BY_NAME.keys()
    ):
        advice, fix = f"`{name.text}` is a value: write it without brackets", Fix(node.span, name.text)
    elif instead is not None:
        text, is_exact = instead
        advice, fix = (f"write `{text}`", Fix(node.span, text)) if is_exact else (f"here that is `{text}`", None)
    elif name.text in vocabulary.SENSE_REPLACEMENTS:
        advice = f"ask {vocabulary.SENSE_REPLACEMENTS[name.text].replace('X', _find_first_argument_name(node))}"
    else:
        advice = suggest_name(name.text, known, _format_own_behaviour(node, name.text, expected_type))
    scope.report.error("unknown-behaviour", f"no behaviour `{name.text}`", name.span, advice, fix=fix)


def _find_first_argument_name(node: nodes.Call) -> str:
    """Return a call's first argument if it is a name. Otherwise return the example name `food`, for use in a suggestion."""
    first = node.arguments[0] if node.arguments else None
    named = isinstance(first, nodes.Argument) and isinstance(first.value, nodes.NameRef)
    return first.span.text if first is not None and named else "food"


def _format_own_behaviour(node: nodes.Call, name: str, expected_type: ValueType | None) -> str:
    """Return the text that declares a behaviour `name` with the arguments of the call and the expected type."""
    kind = expected_type.kind if expected_type is not None else TypeKind.NUMBER
    gives = {TypeKind.BOOL: "bool", TypeKind.VECTOR: "push"}.get(kind, "number")
    arguments = ", ".join(f"{letter}: place" for letter, _ in zip("abcdefgh", node.arguments, strict=False))
    own = f"write your own: `behaviour {name}({arguments}) -> {gives} {{ … }}`"
    return own if gives == "push" else f"use `touching(x)`, `distance(x)`, `nearest(x, within: 40 mm)`, or {own}"


# --- built-in operations ---------------------------------------------------------------------------------------------


def _type_builtin(scope: NameScope, node: nodes.Call, name: str, expected_type: ValueType | None) -> Expr:
    rows = vocabulary.BUILTINS_BY_NAME[name]
    if rows[0].op in SET_CHECKERS:
        return SET_CHECKERS[rows[0].op](scope, node, name, rows[0])
    row, node = (rows[0], node) if len(rows) == 1 else _find_matching_row(scope, node, rows)
    arguments_by_slot = arrange_arguments(scope, name, [_make_slot(each) for each in row.args], node)
    if arguments_by_slot is None:
        type_arguments(scope, node)
        return make_bad_expression(node.span)
    variables: TypeVariables = {}
    args: list[Expr | None] = []
    for arg in row.args:
        written = arguments_by_slot.get(arg.name)
        if written is None:
            args += _make_default(scope, arg, node)
        else:
            for each in written:
                args += _type_argument(scope, name, arg, each.value, variables, expected_type)
    if any(a is not None and a.type.kind is TypeKind.BAD for a in args):
        return OperationExpr(_infer_result_type(row, variables, args), find_highest_rate(args), node.span, row.op, tuple(args))
    return _make_operation(scope, node, row, tuple(args), variables)


def _make_slot(arg: ArgumentRow) -> ArgumentSlot:
    return ArgumentSlot(arg.name, arg.default is None and not arg.is_optional, arg.is_variadic, arg.type.startswith("range"))


def _find_matching_row(scope: NameScope, node: nodes.Call, rows: tuple[BuiltinRow, ...]) -> tuple[BuiltinRow, nodes.Call]:
    """Return the row that accepts a call: its first argument, and the names of its arguments. If none does, return the first
    row.

    Also return the call with the first argument already typed, so that nested calls are typed only once."""
    named = {a.name.text for a in node.arguments if isinstance(a, nodes.Argument) and a.name}
    fitting = [row for row in rows if named <= {a.name for a in row.args}] or list(rows)
    first = node.arguments[0] if node.arguments else None
    if not isinstance(first, nodes.Argument) or isinstance(first.value, (nodes.RangeExpr, nodes.Number, nodes.Quantity)):
        return fitting[0], node
    expr = scope.type_expression(first.value)
    kind = expr.type.kind
    if kind is not TypeKind.FIELD or (len(node.arguments) > 1 and not named):
        kind = _VALUE_WORDS.get(kind, kind)  # `max(trail, 0.5)` is the greater of two numbers; only `nearest:` reads cells
    known = nodes.Argument(first.name, cast(nodes.Expr, TypedArgument(expr, first.value.span)), first.span)
    node = nodes.Call(node.function, (known, *node.arguments[1:]), node.span)
    return next((row for row in fitting if TypeKind(row.args[0].type.split()[0]) is kind), fitting[0]), node


def _make_default(scope: NameScope, arg: ArgumentRow, node: nodes.Call) -> list[Expr | None]:
    if arg.default is None:
        return [None] * (2 if arg.type.startswith("range") else 1)
    return list(parse_default_values(scope, arg.default, node.span))


def _type_argument(
    scope: NameScope,
    function_name: str,
    arg: ArgumentRow,
    node: nodes.Expr,
    variables: TypeVariables,
    expected_type: ValueType | None,
) -> list[Expr | None]:
    """Return the typed value of one argument: one expression, or two for a range."""
    word, _, variable = arg.type.partition(" ")
    who = f"`{arg.name}` of `{function_name}`"
    if word == "range":
        return _type_range(scope, function_name, who, node, variable, variables)
    if word == "place":
        return [type_point(scope, node, who)]
    if word == "count":
        return [type_count(scope, node, who)]
    if word == "any":
        return [
            _bind_variable(
                scope,
                function_name,
                node,
                scope.type_expression(node, variables[variable][1].type if variable in variables else expected_type),
                variable,
                variables,
            )
        ]
    if variable:
        kind = TypeKind(word)
        expr = type_value(scope, node)
        if expr.type.kind not in (kind, TypeKind.BAD):
            report_mismatch(
                scope.report,
                node,
                expr.type,
                ValueType(kind, variables[variable][1].type.dimension if variable in variables else Dimension()),
                who,
            )
            return [make_bad_expression(node.span)]
        return [_bind_variable(scope, function_name, node, expr, variable, variables, ignores_kind=True)]
    type = parse_type_words(word) or BAD_TYPE
    expr = scope.type_expression(node, type) if type.kind in THING_KINDS else type_value(scope, node, type)
    if not is_compatible(expr.type, type):
        report_mismatch(scope.report, node, expr.type, type, who, expr)
        return [make_bad_expression(node.span)]
    check_row_limits(scope, arg, who, node.span, expr)
    return [expr]


def check_row_limits(scope: NameScope, arg: ArgumentRow, subject: str, span: Span, expr: Expr, sample: str = "") -> None:
    """Report a constant that is outside the limits of its row. `sample`: a correct example line for the message."""
    known = find_constant(expr)
    if known is None:
        return
    if arg.lower_bound is not None and known.number <= arg.lower_bound:
        message = f"{subject} must be above {arg.lower_bound:g}, but is {quote_source(span)}"
        if arg.display_name:
            message = f"{quote_source(span)} is no {arg.display_name}"
        help = f"write {describe_type(expr.type)} above {arg.lower_bound:g}" + (f": `{sample}`" if sample else "")
        scope.report.error("out-of-range", message, span, help)
    if arg.is_integer and known.number % 1 != 0:
        words = f"{subject} needs a whole number, not {quote_source(span)}"
        scope.report.error("wrong-count", words, span, "write a number such as `3`")


def _bind_variable(
    scope: NameScope,
    function_name: str,
    node: nodes.Expr,
    expr: Expr,
    variable: str,
    variables: TypeVariables,
    ignores_kind: bool = False,
) -> Expr:
    """Bind a type variable such as `A` to the type of a value. If it is already bound to another type, report an error."""
    expr = convert_to_value(expr)
    if variable not in variables or variables[variable][1].type.kind is TypeKind.BAD:
        variables[variable] = (node, expr)
        return expr
    first_node, first = variables[variable]
    agrees = is_compatible(expr.type, first.type)
    if ignores_kind and TypeKind.BAD not in (first.type.kind, expr.type.kind):
        agrees = first.type.dimension == expr.type.dimension
    if agrees:
        return expr
    report_operand_mismatch(scope.report, function_name, node.span, (first_node, first), (node, expr))
    return make_bad_expression(node.span)


def _type_range(
    scope: NameScope, function_name: str, subject: str, node: nodes.Expr, variable: str, variables: TypeVariables
) -> list[Expr | None]:
    if not isinstance(node, nodes.RangeExpr):
        expr = scope.type_expression(node)
        if expr.type.kind is not TypeKind.BAD:
            message = f"{subject} needs a range, but {quote_source(node.span)} is one value"
            scope.report.error("wrong-kind", message, node.span, "write two values with `..` between: `0 mm .. 5 mm`")
        return [make_bad_expression(node.span), make_bad_expression(node.span)]
    low, high = (type_value(scope, end) for end in (node.low, node.high))
    for end, expr in ((node.low, low), (node.high, high)):
        if expr.type.kind not in (TypeKind.NUMBER, TypeKind.BAD):
            report_mismatch(scope.report, end, expr.type, NUMBER_TYPE, subject)
            return [make_bad_expression(node.span), make_bad_expression(node.span)]
    ends: list[Expr | None] = [
        _bind_variable(scope, function_name, node.low, low, variable, variables, True),
        _bind_variable(scope, function_name, node.high, high, variable, variables, True),
    ]
    a, b = find_constant(low), find_constant(high)
    if "from" in subject and a and b and (a.unit_power, a.step, a.number) == (b.unit_power, b.step, b.number):
        words = f"the range {quote_source(node.span)} has no width"
        scope.report.error("empty-range", words, node.span, "write two different ends")
    return ends


def _make_operation(
    scope: NameScope, node: nodes.Call, row: BuiltinRow, args: tuple[Expr | None, ...], variables: TypeVariables
) -> Expr:
    site = make_draw_site(scope, node.function.span.text, node.span) if row.uses_draws else ""
    rate = max(find_highest_rate(args), ChangeRate.AGENT) if row.uses_draws or row.depends_on_agent else find_highest_rate(args)
    operation = OperationExpr(_infer_result_type(row, variables, args), rate, node.span, row.op, args, site)
    check = _EXTRA_CHECKS.get(row.op)
    if check is not None:
        check(scope, node, operation)
    return fold_operation(scope.report, operation)


def _infer_result_type(
    row: BuiltinRow, variables: Mapping[str, tuple[nodes.Expr, Expr]], args: list[Expr | None] | tuple[Expr | None, ...]
) -> ValueType:
    """Return the result type of a row. Its type variables are replaced by the types that the arguments have given them."""
    word, _, of = row.result.partition(" ")
    if word in ("number", "vector") and of:
        kind = TypeKind(word)
        if of == "1/length":
            return ValueType(kind, Dimension(length=-1))
        if of.startswith("sqrt "):
            return ValueType(kind, scale_dimension(_find_variable_dimension(variables, of[5:]), 0.5))
        if "*" in of:
            a, b = of.split("*")
            return ValueType(
                kind, combine_dimensions(_find_variable_dimension(variables, a), _find_variable_dimension(variables, b))
            )
        return ValueType(kind, _find_variable_dimension(variables, of))
    if word == "any":
        bound_types = [v.type for _, v in variables.values() if v.type.kind is not TypeKind.BAD]
        return bound_types[0] if bound_types else BAD_TYPE
    if word == "agent":
        first = args[0]
        return ValueType(TypeKind.AGENT, referent=first.type.referent if first is not None else None)
    return parse_type_words(word) or ValueType(TypeKind(word))


def _find_variable_dimension(variables: Mapping[str, tuple[nodes.Expr, Expr]], name: str) -> Dimension:
    return variables[name][1].type.dimension if name in variables else Dimension()


# --- what the table cannot say ---------------------------------------------------------------------------------------


def _check_first(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    if operation.type.kind not in (*OPTIONAL_KINDS, TypeKind.BAD):
        scope.report.error(
            "wrong-kind",
            f"`first` picks the first thing that exists, but {quote_source(node.arguments[0].span)} "
            f"is {describe_type(operation.type)}, which always exists",
            node.span,
            "for things write `first(nearest(food, with: load > 0), nearest(food))`; for the larger number write `max(a, b)`",
        )  # fmt: skip


def _check_pick(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    if operation.type.kind in THING_KINDS or operation.type.kind is TypeKind.SET:
        message = f"`pick` cannot choose {describe_type(operation.type)}"
        scope.report.error("wrong-kind", message, node.span, "choose between values; `random(rabbit)` is one agent of a species")


def _check_clamp(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    low, high = (find_constant(a) if a is not None else None for a in operation.args[1:3])
    if low and high and (low.unit_power, low.step) == (high.unit_power, high.step) and low.number > high.number:
        span: Span = node.arguments[1].span if len(node.arguments) > 1 else node.span
        scope.report.error("empty-range", "the range ends before it begins", span, "write the lower end first")


def _check_uniform(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    low, high = (find_constant(a) if a is not None else None for a in operation.args)
    if low and high and (low.unit_power, low.step) == (high.unit_power, high.step) and low.number > high.number:
        written = [arg for arg in node.arguments if isinstance(arg, nodes.Argument)]
        lesser, greater = (" ".join(arg.value.span.text.split()) for arg in reversed(written))
        better = f"uniform({lesser}, {greater})"
        fix = None if any(arg.name for arg in written) else Fix(node.span, better)
        message = f"{quote_source(node.span)} ends before it begins"
        scope.report.error("empty-range", message, node.span, f"write `{better}`", fix=fix)


def _check_normal(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    deviation = find_constant(operation.args[1]) if operation.args[1] is not None else None
    if deviation is not None and deviation.number < 0:
        span = node.arguments[-1].span
        scope.report.error(
            "out-of-range", "the deviation of `normal` is below 0", span, "write 0 or more, as in `normal(0 deg, 20 deg)`"
        )


_EXTRA_CHECKS: dict[str, Callable[[NameScope, nodes.Call, OperationExpr], None]] = {
    "first": _check_first, "pick": _check_pick, "clamp": _check_clamp, "uniform": _check_uniform, "normal": _check_normal,
}  # fmt: skip
