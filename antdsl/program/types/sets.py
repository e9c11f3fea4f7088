"""Determines the types of sets and of reductions over them: `neighbours`, `all`, `nearest`, `feelers`, `sum(n in SET: …)` and
others."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.program.kinds import BOOL_TYPE, LENGTH_TYPE, NUMBER_TYPE
from antdsl.program.model import Binding, ChangeRate, Constant, Dimension, Expr, ReduceExpr, SetExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, make_bad_expression, parse_type_words
from antdsl.program.tables.defaults import parse_default_values
from antdsl.program.tables.rows import ArgumentRow, BuiltinRow
from antdsl.program.traverse import find_bindings
from antdsl.program.types.arguments import (
    ArgumentSlot,
    arrange_arguments,
    find_element_type,
    make_nearest_reduction,
    type_arguments,
)
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_condition, type_count, type_value, type_value_as
from antdsl.syntax import nodes

_SET_OWNER_KINDS = (TypeKind.ITEMS, TypeKind.SPECIES)


def _arrange_arguments(scope: NameScope, node: nodes.Call, name: str, row: BuiltinRow) -> dict[str, list[nodes.Argument]] | None:
    arguments_by_slot = arrange_arguments(
        scope, name, [ArgumentSlot(a.name, a.default is None and not a.is_optional, a.is_variadic) for a in row.args], node
    )
    if arguments_by_slot is None:
        type_arguments(scope, node)
    return arguments_by_slot


def _type_optional(
    scope: NameScope, function_name: str, arg: ArgumentRow, arguments_by_slot: dict[str, list[nodes.Argument]], node: nodes.Call
) -> Expr | None:
    """Return the typed value of an argument. If the argument is absent, return its default, or None if it has no default."""
    written = arguments_by_slot.get(arg.name)
    if written is None:
        return parse_default_values(scope, arg.default, node.span)[0] if arg.default else None
    return type_value_as(scope, written[0].value, parse_type_words(arg.type) or NUMBER_TYPE, f"`{arg.name}` of `{function_name}`")


def _type_set_source(scope: NameScope, function_name: str, node: nodes.Expr, kinds: tuple[TypeKind, ...]) -> Expr | None:
    expr = scope.type_expression(node)
    if expr.type.kind in kinds:
        return expr
    if expr.type.kind is not TypeKind.BAD:
        names = "items or a species" if kinds == _SET_OWNER_KINDS else "a species"
        message = f"`{function_name}` needs {names}, but {quote_source(node.span)} is {describe_type(expr.type)}"
        scope.report.error("wrong-kind", message, node.span, f"write a name of {names}")
    return None


def make_element_binding(type: ValueType, name: str, node: nodes.Expr | nodes.Name) -> Binding:
    return Binding(name, "element", type, ChangeRate.ELEMENT, node.span)


def type_neighbours(scope: NameScope, node: nodes.Call, name: str, row: BuiltinRow) -> Expr:
    """Type `neighbours(radius, fov, of:)`: other agents of the agent's own species or, with `of`, of another species."""
    arguments_by_slot = _arrange_arguments(scope, node, name, row)
    if arguments_by_slot is None:
        return make_bad_expression(node.span)
    radius, fov = (_type_optional(scope, name, arg, arguments_by_slot, node) for arg in row.args[:2])
    of = scope.species.name if scope.species else None
    if "of" in arguments_by_slot:
        species = _type_set_source(scope, name, arguments_by_slot["of"][0].value, (TypeKind.SPECIES,))
        if species is None:
            return make_bad_expression(node.span)
        of = species.type.referent
    elif scope.behaviour is None and scope.species is None:
        return scope.report_error("wrong-argument", "`neighbours` without a species", node.span, "write `of: forager`")
    _check_reach(scope, radius, node)
    most = _type_count_limit(scope, name, row, arguments_by_slot, node)
    element = make_element_binding(ValueType(TypeKind.AGENT, Dimension(), of), "it", node)
    return SetExpr(
        ValueType(TypeKind.SET, Dimension(), of),
        ChangeRate.AGENT,
        node.span,
        "neighbours",
        of or "",
        (radius, fov, most),
        element,
        None,
    )


def _check_reach(scope: NameScope, radius: Expr | None, node: nodes.Call) -> None:
    known = find_constant(radius) if radius is not None else None
    if known is not None and known.number <= 0:
        message = "a radius of 0 or less reaches no agent"
        advice = "write a length above 0"
        scope.report.error("out-of-range", message, node.arguments[0].span if node.arguments else node.span, advice)


def _type_count_limit(
    scope: NameScope, function_name: str, row: BuiltinRow, arguments_by_slot: dict[str, list[nodes.Argument]], node: nodes.Call
) -> Expr | None:
    """Return the largest number of nearest elements that a set may have. A constant number must be whole and at least 1."""
    arg = next((arg for arg in row.args if arg.name == "most"), None)
    most = _type_optional(scope, function_name, arg, arguments_by_slot, node) if arg is not None else None
    known = find_constant(most) if most is not None else None
    if known is not None and (known.number < 1 or known.number != int(known.number)):
        text = quote_source(arguments_by_slot["most"][0].value.span)
        message = f"`most` of `{function_name}` is the number of elements that count, not {text}"
        advice = "write a whole number, 1 or more: `most: 3`"
        scope.report.error("out-of-range", message, arguments_by_slot["most"][0].value.span, advice)
    return most


def type_all(scope: NameScope, node: nodes.Call, name: str, row: BuiltinRow) -> Expr:
    """Type `all(X, within:, with:)`."""
    arguments_by_slot = _arrange_arguments(scope, node, name, row)
    things = _type_set_source(scope, name, arguments_by_slot["of"][0].value, _SET_OWNER_KINDS) if arguments_by_slot else None
    if arguments_by_slot is None or things is None:
        return make_bad_expression(node.span)
    within = _type_optional(scope, name, row.args[1], arguments_by_slot, node)
    element = make_element_binding(find_element_type(things.type), "it", node)
    where = None
    if "with" in arguments_by_slot:
        where = type_condition(
            _make_set_scope(scope, element).with_changes(element=element), arguments_by_slot["with"][0].value, "`with`"
        )
    most = _type_count_limit(scope, name, row, arguments_by_slot, node)
    set_expr = SetExpr(
        ValueType(TypeKind.SET, Dimension(), things.type.referent),
        ChangeRate.AGENT,
        node.span,
        "all",
        things.type.referent or "",
        (within, most),
        element,
        where,
    )
    _check_nesting(scope, set_expr, node)
    return set_expr


def _make_set_scope(scope: NameScope, element: Binding) -> NameScope:
    return scope.with_changes(
        set_elements=(*scope.set_elements, element), no_keep_reason="inside a set it is not clear which agent stores it"
    )


def type_nearest(scope: NameScope, node: nodes.Call, name: str, row: BuiltinRow) -> Expr:
    """Type `nearest(X, within:, with:)` or `nearest(SET)`."""
    first = node.arguments[0].value if len(node.arguments) == 1 and isinstance(node.arguments[0], nodes.Argument) else None
    if isinstance(first, (nodes.Call, nodes.NameRef)):
        expr = scope.type_expression(first)
        if isinstance(expr, SetExpr):
            return _make_nearest(expr, node)
        if expr.type.kind in _SET_OWNER_KINDS:
            return make_nearest_reduction(expr, node.span)
        if expr.type.kind is not TypeKind.BAD:
            message = f"`nearest` needs items, a species or a set, but {quote_source(first.span)} is {describe_type(expr.type)}"
            scope.report.error("wrong-kind", message, first.span, "write `nearest(food)` or `nearest(neighbours(20 mm))`")
        return make_bad_expression(node.span)
    over = type_all(scope, node, name, row)
    return _make_nearest(over, node) if isinstance(over, SetExpr) else over


def _make_nearest(elements: SetExpr, node: nodes.Call) -> ReduceExpr:
    return ReduceExpr(elements.element.type, ChangeRate.AGENT, node.span, "nearest", elements, elements.element, None)


def type_feelers(scope: NameScope, node: nodes.Call, name: str, row: BuiltinRow) -> Expr:
    """Type `feelers(X, count, spread, reach)`, which are rays ahead and to both sides. The elements of the set are the hits of
    these rays."""
    arguments_by_slot = _arrange_arguments(scope, node, name, row)
    if arguments_by_slot is None:
        return make_bad_expression(node.span)
    target = scope.type_expression(arguments_by_slot["on"][0].value)
    if not is_compatible(target.type, ValueType(TypeKind.OBSTACLE)):
        report_mismatch(
            scope.report, arguments_by_slot["on"][0].value, target.type, ValueType(TypeKind.OBSTACLE), f"`on` of `{name}`"
        )
        return make_bad_expression(node.span)
    how_many = (
        type_count(scope, arguments_by_slot["count"][0].value, f"`count` of `{name}`")
        if "count" in arguments_by_slot
        else parse_default_values(scope, row.args[1].default or "3", node.span)[0]
    )
    spread, reach = (_type_optional(scope, name, arg, arguments_by_slot, node) for arg in row.args[2:])
    element = make_element_binding(ValueType(TypeKind.HIT), "it", node)
    of = target.type.referent or ""
    return SetExpr(
        ValueType(TypeKind.SET, Dimension(), "hit"),
        ChangeRate.AGENT,
        node.span,
        "feelers",
        of,
        (how_many, spread, reach),
        element,
        None,
    )


SET_CHECKERS: dict[str, Callable[[NameScope, nodes.Call, str, BuiltinRow], Expr]] = {
    "neighbours": type_neighbours, "all": type_all, "nearest": type_nearest, "feelers": type_feelers,
}  # fmt: skip


# --- over sets -------------------------------------------------------------------------------------------------------


def type_reduction(scope: NameScope, node: nodes.Call, reducer: str) -> Expr:
    """Type `sum(n in SET: …)` and similar reductions. `count(SET)` and `any(SET)` need no body."""
    argument = node.arguments[0]
    if isinstance(argument, nodes.Comprehension):
        over = scope.type_expression(argument.over)
        if over.type.kind in _SET_OWNER_KINDS:
            over = make_complete_set(over)
        variable: nodes.Name | None = argument.variable
    else:
        over, variable = scope.type_expression(argument.value), None
    if not isinstance(over, SetExpr):
        if over.type.kind is not TypeKind.BAD:
            message = f"`{reducer}` needs a set, but {quote_source(over.span)} is {describe_type(over.type)}"
            scope.report.error("wrong-kind", message, over.span, "write a set, such as `neighbours(20 mm)` or `all(food)`")
        return make_bad_expression(node.span)
    if variable is None or not isinstance(argument, nodes.Comprehension):
        if reducer not in ("count", "any"):
            message = f"`{reducer}` needs a value of each element"
            return scope.report_error(
                "wrong-argument", message, node.span, f"write `{reducer}(n in {' '.join(over.span.text.split())}: …)`"
            )
        element = over.element
        body: Expr = Constant(BOOL_TYPE, ChangeRate.CONST, node.span, 1.0)
    else:
        element, inner = make_element_scope(scope, over, variable)
        body = type_reduction_body(inner, reducer, argument.body)
    reduction = ReduceExpr(_find_result_type(reducer, body, element), ChangeRate.AGENT, node.span, reducer, over, element, body)
    _check_nesting(scope, reduction, node)
    return reduction


def make_element_scope(scope: NameScope, elements: SetExpr, variable: nodes.Name) -> tuple[Binding, NameScope]:
    """Return the binding of a name to the elements of a set, and the scope in which this name is visible."""
    element = make_element_binding(elements.element.type, variable.text, variable)
    _check_shadow(scope, variable)
    return element, _make_set_scope(scope, element).with_changes(local_names={**scope.local_names, variable.text: element})


def make_complete_set(things: Expr) -> SetExpr:
    """Return the set of all items or agents that `things` names, such as `food`."""
    element = Binding("it", "element", find_element_type(things.type), ChangeRate.ELEMENT, things.span)
    return SetExpr(
        ValueType(TypeKind.SET, Dimension(), things.type.referent),
        ChangeRate.AGENT,
        things.span,
        "all",
        things.type.referent or "",
        (None,),
        element,
        None,
    )


def _check_shadow(scope: NameScope, variable: nodes.Name) -> None:
    names = scope.species
    own = (
        names is not None
        and scope.behaviour is None
        and (variable.text in names.attributes or variable.text in names.bindings or variable.text in names.params)
    )
    if own or variable.text in scope.local_names:
        message = f"`{variable.text}` is already defined here"
        scope.report.error("duplicate-name", message, variable.span, "choose another name for the element")


def type_reduction_body(scope: NameScope, reducer: str, node: nodes.Expr) -> Expr:
    """Return the typed body of a reduction. For `count`, `any` and `every`, it must be a bool. For `sum`, it must be a number or
    vector. For the others, it must be a number."""
    if reducer in ("count", "any", "every"):
        return type_condition(scope, node, f"`{reducer}`")
    expr = type_value(scope, node)
    allowed = (TypeKind.NUMBER, TypeKind.VECTOR, TypeKind.BAD) if reducer in ("sum", "mean") else (TypeKind.NUMBER, TypeKind.BAD)
    if expr.type.kind in allowed:
        return expr
    if expr.type.kind is TypeKind.BOOL and reducer in ("sum", "mean"):
        message = f"`{reducer}` adds numbers, but {quote_source(node.span)} is a yes or no"
        scope.report.error("wrong-kind", message, node.span, "use `count` to count how many meet a condition")
    else:
        report_mismatch(
            scope.report,
            node,
            expr.type,
            LENGTH_TYPE if reducer in ("min", "max", "best") and expr.type.dimension == LENGTH_TYPE.dimension else NUMBER_TYPE,
            f"`{reducer}`",
        )
    return make_bad_expression(node.span)


def _find_result_type(reducer: str, body: Expr, element: Binding) -> ValueType:
    if reducer == "count":
        return NUMBER_TYPE
    if reducer in ("any", "every"):
        return BOOL_TYPE
    return element.type if reducer == "best" else body.type


def _check_nesting(scope: NameScope, expr: Expr, node: nodes.Call) -> None:
    """Report a set inside another set if the inner set depends on an element of the outer set. Neighbours of neighbours are not
    supported."""
    if not scope.set_elements:
        return
    used = find_bindings(expr)
    outer = next((element for element in scope.set_elements if element in used), None)
    if outer is not None:
        message = f"{quote_source(node.span)} would search the neighbours of neighbours, through `{outer.name}`"
        scope.report.error("set-in-set", message, node.span, "store the inner result in an attribute, and read that")
