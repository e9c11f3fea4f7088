"""Types calls: finds the called function, matches the arguments with the tables, and returns the operation with its type."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import cast

from antdsl.diagnostics import Fix
from antdsl.program.declarations.behaviours import call_behaviour
from antdsl.program.kinds import BAD_TYPE, NUMBER_TYPE
from antdsl.program.model import ChangeRate, Dimension, Expr, OperationExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, bad_expression, did_you_mean, rate_of, type_from_words
from antdsl.program.tables import vocabulary
from antdsl.program.tables.defaults import default_values
from antdsl.program.tables.other_words import call_replacement
from antdsl.program.tables.rows import ArgumentRow, BuiltinRow
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.units import combine_dimensions, scale_dimension
from antdsl.program.types.arguments import ArgumentSlot, arrange_arguments, place, type_arguments
from antdsl.program.types.descriptions import is_compatible, quote_source, report_disagreement, report_mismatch, type_words
from antdsl.program.types.expressions import OPTIONAL_KINDS, THING_KINDS, TypedArgument
from antdsl.program.types.folding import constant_behind, fold
from antdsl.program.types.operators import as_value, count, draw_site, value
from antdsl.program.types.sets import SET_CHECKERS, reduce
from antdsl.source import Span
from antdsl.syntax import nodes

TypeVariables = dict[str, tuple[nodes.Expr, Expr]]
# Kinds of things of which the bare name is a value.
_VALUES = {TypeKind(each.args[0].type): (type_from_words(each.result) or BAD_TYPE).kind for each in find_words("value")}


def _use_line(file: nodes.File, library: str) -> Fix | None:
    """Return a fix that adds a `use` line below the edition and the help of a file."""
    head = file.help or file.edition
    if head is None:
        return None
    return Fix(Span(file.source, head.span.end, head.span.end), f"\nuse {library}")


def call(scope: NameScope, node: nodes.Call, want: ValueType | None) -> Expr:
    """Type a call: a reduction over a set, a built-in operation, or a behaviour."""
    function = node.function
    if isinstance(function, nodes.Member):
        return call_behaviour(scope, node, want)
    if not isinstance(function, nodes.NameRef):
        message = f"{quote_source(function.span)} cannot be called"
        scope.report.error("wrong-kind", message, function.span, "only behaviours and built-in words can be called")
        type_arguments(scope, node)
        return bad_expression(node.span)
    name = function.name.text
    if (
        name in vocabulary.REDUCER_HELP
        and len(node.arguments) == 1
        and (isinstance(node.arguments[0], nodes.Comprehension) or name not in vocabulary.BUILTINS_BY_NAME)
    ):
        return reduce(scope, node, name)
    if name in vocabulary.BUILTINS_BY_NAME:
        return _builtin(scope, node, name, want)
    if scope.file.behaviour(name) is not None:
        return call_behaviour(scope, node, want)
    _report_unknown(scope, node, function.name, want)
    type_arguments(scope, node)
    return bad_expression(node.span)


def _report_unknown(scope: NameScope, node: nodes.Call, name: nodes.Name, want: ValueType | None) -> None:
    if name.text in vocabulary.RESERVED_WORDS:
        words = f"`{name.text}` is a word of the language that does not work yet"
        scope.report.error("not-yet", words, name.span, "leave it out for now")
        return
    if name.text in vocabulary.REDUCER_HELP:
        message = f"`{name.text}` needs a set"
        scope.report.error("wrong-argument", message, node.span, f"write `{name.text}(n in neighbours(20 mm): …)`")
        return
    home = scope.declared.home(name.text)
    if home is not None and home not in scope.file.libraries:
        if home not in scope.file.wanting:
            scope.file.wanting.add(home)
            advice = f"write `use {home}` below the first line"
            fix = _use_line(scope.file.node, home)
            scope.report.error("unknown-behaviour", f"`{name.text}` is in the library `{home}`", name.span, advice, fix=fix)
        return
    known = set(vocabulary.BUILTINS_BY_NAME) | set(vocabulary.REDUCER_HELP) | set(scope.file.own) | set(scope.file.library)
    instead, fix = call_replacement(node, name.text), None
    if not node.arguments and name.text in (
        scope.builtins.keys() | vocabulary.RUN_VALUE_TYPES.keys() | vocabulary.SENSE_TYPE_BY_NAME.keys()
    ):
        advice, fix = f"`{name.text}` is a value: write it without brackets", Fix(node.span, name.text)
    elif instead is not None:
        text, is_exact = instead
        advice, fix = (f"write `{text}`", Fix(node.span, text)) if is_exact else (f"here that is `{text}`", None)
    elif name.text in vocabulary.SENSE_REPLACEMENTS:
        advice = f"ask {vocabulary.SENSE_REPLACEMENTS[name.text].replace('X', _first_argument_name(node))}"
    else:
        advice = did_you_mean(name.text, known, _own_behaviour_text(node, name.text, want))
    scope.report.error("unknown-behaviour", f"no behaviour `{name.text}`", name.span, advice, fix=fix)


def _first_argument_name(node: nodes.Call) -> str:
    """Return the text of the first argument if it is a name, else `food`."""
    first = node.arguments[0] if node.arguments else None
    named = isinstance(first, nodes.Argument) and isinstance(first.value, nodes.NameRef)
    return first.span.text if first is not None and named else "food"


def _own_behaviour_text(node: nodes.Call, name: str, want: ValueType | None) -> str:
    """Return the declaration of a behaviour `name` that fits the arguments of the call and the expected type."""
    kind = want.kind if want is not None else TypeKind.NUMBER
    gives = {TypeKind.BOOL: "bool", TypeKind.VECTOR: "push"}.get(kind, "number")
    arguments = ", ".join(f"{letter}: place" for letter, _ in zip("abcdefgh", node.arguments, strict=False))
    own = f"write your own: `behaviour {name}({arguments}) -> {gives} {{ … }}`"
    return own if gives == "push" else f"use `touching(x)`, `distance(x)`, `nearest(x, within: 40 mm)`, or {own}"


# --- built-in operations ---------------------------------------------------------------------------------------------


def _builtin(scope: NameScope, node: nodes.Call, name: str, want: ValueType | None) -> Expr:
    rows = vocabulary.BUILTINS_BY_NAME[name]
    if rows[0].op in SET_CHECKERS:
        return SET_CHECKERS[rows[0].op](scope, node, name, rows[0])
    row, node = (rows[0], node) if len(rows) == 1 else _matching_row(scope, node, rows)
    arguments_by_slot = arrange_arguments(scope, name, [_slot(each) for each in row.args], node)
    if arguments_by_slot is None:
        type_arguments(scope, node)
        return bad_expression(node.span)
    variables: TypeVariables = {}
    args: list[Expr | None] = []
    for arg in row.args:
        written = arguments_by_slot.get(arg.name)
        if written is None:
            args += _default(scope, arg, node)
        else:
            for each in written:
                args += _argument(scope, name, arg, each.value, variables, want)
    if any(a is not None and a.type.kind is TypeKind.BAD for a in args):
        return OperationExpr(_result_type(row, variables, args), rate_of(args), node.span, row.op, tuple(args))
    return _operation(scope, node, row, tuple(args), variables)


def _slot(arg: ArgumentRow) -> ArgumentSlot:
    return ArgumentSlot(arg.name, arg.default is None and not arg.optional, arg.variadic, arg.type.startswith("range"))


def _matching_row(scope: NameScope, node: nodes.Call, rows: tuple[BuiltinRow, ...]) -> tuple[BuiltinRow, nodes.Call]:
    """Return the row that accepts the first argument and the argument names, among several operations with one name.

    Also return the call with its first argument typed, so that nested calls are typed only once."""
    named = {a.name.text for a in node.arguments if isinstance(a, nodes.Argument) and a.name}
    fitting = [row for row in rows if named <= {a.name for a in row.args}] or list(rows)
    first = node.arguments[0] if node.arguments else None
    if not isinstance(first, nodes.Argument) or isinstance(first.value, (nodes.RangeExpr, nodes.Number, nodes.Quantity)):
        return fitting[0], node
    expr = scope.type_expression(first.value)
    kind = expr.type.kind
    if kind is not TypeKind.FIELD or (len(node.arguments) > 1 and not named):
        kind = _VALUES.get(kind, kind)  # `max(trail, 0.5)` is the greater of two numbers; only `nearest:` reads cells
    known = nodes.Argument(first.name, cast(nodes.Expr, TypedArgument(expr, first.value.span)), first.span)
    node = nodes.Call(node.function, (known, *node.arguments[1:]), node.span)
    return next((row for row in fitting if TypeKind(row.args[0].type.split()[0]) is kind), fitting[0]), node


def _default(scope: NameScope, arg: ArgumentRow, node: nodes.Call) -> list[Expr | None]:
    if arg.default is None:
        return [None] * (2 if arg.type.startswith("range") else 1)
    return list(default_values(scope, arg.default, node.span))


def _argument(
    scope: NameScope, called: str, arg: ArgumentRow, node: nodes.Expr, variables: TypeVariables, want: ValueType | None
) -> list[Expr | None]:
    """Return the typed value of one argument: one expression, or two for a range."""
    word, _, variable = arg.type.partition(" ")
    who = f"`{arg.name}` of `{called}`"
    if word == "range":
        return _range(scope, called, who, node, variable, variables)
    if word == "place":
        return [place(scope, node, who)]
    if word == "count":
        return [count(scope, node, who)]
    if word == "any":
        return [
            _bind_variable(
                scope,
                called,
                node,
                scope.type_expression(node, variables[variable][1].type if variable in variables else want),
                variable,
                variables,
            )
        ]
    if variable:
        kind = TypeKind(word)
        expr = value(scope, node)
        if expr.type.kind not in (kind, TypeKind.BAD):
            report_mismatch(
                scope.report,
                node,
                expr.type,
                ValueType(kind, variables[variable][1].type.dim if variable in variables else Dimension()),
                who,
            )
            return [bad_expression(node.span)]
        return [_bind_variable(scope, called, node, expr, variable, variables, dims_only=True)]
    type = type_from_words(word) or BAD_TYPE
    expr = scope.type_expression(node, type) if type.kind in THING_KINDS else value(scope, node, type)
    if not is_compatible(expr.type, type):
        report_mismatch(scope.report, node, expr.type, type, who, expr)
        return [bad_expression(node.span)]
    check_row_limits(scope, arg, who, node.span, expr)
    return [expr]


def check_row_limits(scope: NameScope, arg: ArgumentRow, who: str, span: Span, expr: Expr, sample: str = "") -> None:
    """Check a constant against the limits in its row. `sample`: a correct example line for the message."""
    known = constant_behind(expr)
    if known is None:
        return
    if arg.above is not None and known.number <= arg.above:
        message = f"{who} has to be above {arg.above:g}, and is {quote_source(span)}"
        if arg.called:
            message = f"{quote_source(span)} is no {arg.called}"
        help = f"write {type_words(expr.type)} above {arg.above:g}" + (f": `{sample}`" if sample else "")
        scope.report.error("out-of-range", message, span, help)
    if arg.is_integer and known.number % 1 != 0:
        words = f"{who} wants a whole number, not {quote_source(span)}"
        scope.report.error("wrong-count", words, span, "write a number such as `3`")


def _bind_variable(
    scope: NameScope, called: str, node: nodes.Expr, expr: Expr, variable: str, variables: TypeVariables, dims_only: bool = False
) -> Expr:
    """Bind a type variable such as `A` to the type of a value. If it is bound already, report an error for a different type."""
    expr = as_value(expr)
    if variable not in variables or variables[variable][1].type.kind is TypeKind.BAD:
        variables[variable] = (node, expr)
        return expr
    first_node, first = variables[variable]
    agrees = is_compatible(expr.type, first.type)
    if dims_only and TypeKind.BAD not in (first.type.kind, expr.type.kind):
        agrees = first.type.dim == expr.type.dim
    if agrees:
        return expr
    report_disagreement(scope.report, called, node.span, (first_node, first), (node, expr))
    return bad_expression(node.span)


def _range(
    scope: NameScope, called: str, who: str, node: nodes.Expr, variable: str, variables: TypeVariables
) -> list[Expr | None]:
    if not isinstance(node, nodes.RangeExpr):
        expr = scope.type_expression(node)
        if expr.type.kind is not TypeKind.BAD:
            message = f"{who} wants a range, and {quote_source(node.span)} is one value"
            scope.report.error("wrong-kind", message, node.span, "write two values with `..` between: `0 mm .. 5 mm`")
        return [bad_expression(node.span), bad_expression(node.span)]
    low, high = (value(scope, end) for end in (node.low, node.high))
    for end, expr in ((node.low, low), (node.high, high)):
        if expr.type.kind not in (TypeKind.NUMBER, TypeKind.BAD):
            report_mismatch(scope.report, end, expr.type, NUMBER_TYPE, who)
            return [bad_expression(node.span), bad_expression(node.span)]
    ends: list[Expr | None] = [
        _bind_variable(scope, called, node.low, low, variable, variables, True),
        _bind_variable(scope, called, node.high, high, variable, variables, True),
    ]
    a, b = constant_behind(low), constant_behind(high)
    if "from" in who and a and b and (a.u, a.step, a.number) == (b.u, b.step, b.number):
        words = f"the range {quote_source(node.span)} has no width"
        scope.report.error("empty-range", words, node.span, "write two different ends")
    return ends


def _operation(
    scope: NameScope, node: nodes.Call, row: BuiltinRow, args: tuple[Expr | None, ...], variables: TypeVariables
) -> Expr:
    site = draw_site(scope, node.function.span.text, node.span) if row.draws else ""
    rate = max(rate_of(args), ChangeRate.AGENT) if row.draws or row.sense else rate_of(args)
    operation = OperationExpr(_result_type(row, variables, args), rate, node.span, row.op, args, site)
    check = _EXTRA_CHECKS.get(row.op)
    if check is not None:
        check(scope, node, operation)
    return fold(scope.report, operation)


def _result_type(
    row: BuiltinRow, variables: Mapping[str, tuple[nodes.Expr, Expr]], args: list[Expr | None] | tuple[Expr | None, ...]
) -> ValueType:
    """Return the result type of a row, with its type variables replaced."""
    word, _, of = row.result.partition(" ")
    if word in ("number", "vector") and of:
        kind = TypeKind(word)
        if of == "1/length":
            return ValueType(kind, Dimension(length=-1))
        if of.startswith("sqrt "):
            return ValueType(kind, scale_dimension(_variable_dimension(variables, of[5:]), 0.5))
        if "*" in of:
            a, b = of.split("*")
            return ValueType(kind, combine_dimensions(_variable_dimension(variables, a), _variable_dimension(variables, b)))
        return ValueType(kind, _variable_dimension(variables, of))
    if word == "any":
        bound_types = [v.type for _, v in variables.values() if v.type.kind is not TypeKind.BAD]
        return bound_types[0] if bound_types else BAD_TYPE
    if word == "agent":
        first = args[0]
        return ValueType(TypeKind.AGENT, of=first.type.of if first is not None else None)
    return type_from_words(word) or ValueType(TypeKind(word))


def _variable_dimension(variables: Mapping[str, tuple[nodes.Expr, Expr]], name: str) -> Dimension:
    return variables[name][1].type.dim if name in variables else Dimension()


# --- what the table cannot say ---------------------------------------------------------------------------------------


def _check_first(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    if operation.type.kind not in (*OPTIONAL_KINDS, TypeKind.BAD):
        scope.report.error(
            "wrong-kind",
            f"`first` is for things that may be none, and {quote_source(node.arguments[0].span)} is {type_words(operation.type)}",
            node.span,
            "write `first(nearest(food, with: load > 0), nearest(food))` or `max(a, b)`",
        )  # fmt: skip


def _check_pick(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    if operation.type.kind in THING_KINDS or operation.type.kind is TypeKind.SET:
        message = f"`pick` cannot choose {type_words(operation.type)}"
        scope.report.error("wrong-kind", message, node.span, "choose between values; `random(rabbit)` is one agent of a species")


def _check_clamp(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    low, high = (constant_behind(a) if a is not None else None for a in operation.args[1:3])
    if low and high and (low.u, low.step) == (high.u, high.step) and low.number > high.number:
        span: Span = node.arguments[1].span if len(node.arguments) > 1 else node.span
        scope.report.error("empty-range", "the range ends before it begins", span, "write the lower end first")


def _check_uniform(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    low, high = (constant_behind(a) if a is not None else None for a in operation.args)
    if low and high and (low.u, low.step) == (high.u, high.step) and low.number > high.number:
        written = [arg for arg in node.arguments if isinstance(arg, nodes.Argument)]
        lesser, greater = (" ".join(arg.value.span.text.split()) for arg in reversed(written))
        better = f"uniform({lesser}, {greater})"
        fix = None if any(arg.name for arg in written) else Fix(node.span, better)
        message = f"{quote_source(node.span)} ends before it begins"
        scope.report.error("empty-range", message, node.span, f"write `{better}`", fix=fix)


def _check_normal(scope: NameScope, node: nodes.Call, operation: OperationExpr) -> None:
    deviation = constant_behind(operation.args[1]) if operation.args[1] is not None else None
    if deviation is not None and deviation.number < 0:
        span = node.arguments[-1].span
        scope.report.error("out-of-range", "a deviation below 0", span, "write a width above 0, as in `normal(0 deg, 20 deg)`")


_EXTRA_CHECKS: dict[str, Callable[[NameScope, nodes.Call, OperationExpr], None]] = {
    "first": _check_first, "pick": _check_pick, "clamp": _check_clamp, "uniform": _check_uniform, "normal": _check_normal,
}  # fmt: skip
