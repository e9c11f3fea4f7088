"""Determines the types of operators: arithmetic, comparisons, and/or/not, `no`, `is none`, `chance`, if-then-else."""

from __future__ import annotations

from antdsl.diagnostics import Fix
from antdsl.program.kinds import BAD_TYPE, BOOL_TYPE, NUMBER_TYPE, PER_SECOND_TYPE, PUSH_TYPE, VELOCITY_TYPE
from antdsl.program.model import ChangeRate, Constant, Expr, OperationExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, find_highest_rate, make_bad_expression, parse_type_words
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.units import combine_dimensions, scale_dimension
from antdsl.program.tables.vocabulary import OPERATION_BY_SIGN
from antdsl.program.types.descriptions import (
    FLOW_KIND,
    describe_type,
    is_compatible,
    quote_source,
    report_mismatch,
    report_operand_mismatch,
)
from antdsl.program.types.expressions import OPTIONAL_KINDS, THING_KINDS
from antdsl.program.types.folding import find_constant, fold_operation
from antdsl.program.types.states import STATE_WORDS, find_state
from antdsl.source import Span
from antdsl.syntax import nodes

_ORDER_SIGNS = ("<", "<=", ">", ">=")
_EQUALITY_SIGNS = ("==", "!=")
# The operation for the bare name of a thing where a value is expected, by its kind.
_VALUE_AT_AGENT = {TypeKind(row.args[0].type): (row.op, parse_type_words(row.result) or BAD_TYPE) for row in find_words("value")}
_VALUE_AT_AGENT[TypeKind.VECTOR_FIELD] = _VALUE_AT_AGENT[FLOW_KIND]


def make_operation(name: str, type: ValueType, span: Span, *args: Expr | None, site: str = "") -> OperationExpr:
    """Return an operation. Its rate is the highest rate of its arguments. `site`: the key of a random draw."""
    return OperationExpr(type, find_highest_rate(args), span, name, args, site)


# --- operands --------------------------------------------------------------------------------------------------------


def type_value(scope: NameScope, node: nodes.Expr, expected_type: ValueType | None = None) -> Expr:
    """Return an expression as a value. The name of a field, flow or map becomes its value at the agent."""
    return convert_to_value(scope.type_expression(node, expected_type))


def convert_to_value(expr: Expr) -> Expr:
    """Return the value of a field, flow or map at the agent if the expression is only its name. Return any other expression
    unchanged."""
    value_op = _VALUE_AT_AGENT.get(expr.type.kind)
    return expr if value_op is None else OperationExpr(value_op[1], ChangeRate.AGENT, expr.span, value_op[0], (expr,))


def type_value_as(scope: NameScope, node: nodes.Expr, expected_type: ValueType, place: str) -> Expr:
    """Return the value of an expression that must have the type `expected_type`. `place`: words for its position, for
    messages."""
    expr = type_value(scope, node, expected_type)
    if is_compatible(expr.type, expected_type):
        return expr
    return report_mismatch(scope.report, node, expr.type, expected_type, place, expr)


def type_facing_direction(scope: NameScope, node: nodes.Expr) -> Expr:
    """Return the value of an expression that is a direction to face: a push or a velocity. Its length has no effect."""
    expr = type_value(scope, node, PUSH_TYPE)
    if is_compatible(expr.type, VELOCITY_TYPE):
        return expr
    return (
        expr if is_compatible(expr.type, PUSH_TYPE) else report_mismatch(scope.report, node, expr.type, PUSH_TYPE, "`face`", expr)
    )


def type_condition(scope: NameScope, node: nodes.Expr, place: str) -> Expr:
    """Type an expression as a bool. An item, agent or hit is true if it is not none. A set is true if it is not empty."""
    if not scope.is_evaluated_once and _mentions_event(scope, node):
        scope = scope.with_changes(is_evaluated_once=True)
    return convert_to_bool(scope, node, type_value(scope, node, BOOL_TYPE), place)


def convert_to_bool(scope: NameScope, node: nodes.Expr, expr: Expr, place: str) -> Expr:
    """Return a typed expression as a bool. Report an error if it cannot be one."""
    kind = expr.type.kind
    if kind in (TypeKind.BOOL, TypeKind.BAD):
        return expr
    if kind in OPTIONAL_KINDS or kind is TypeKind.SET or (kind is TypeKind.PLACE and scope.is_generic):
        return make_operation("is_some", BOOL_TYPE, expr.span, expr)
    return report_mismatch(scope.report, node, expr.type, BOOL_TYPE, place)


def _mentions_event(scope: NameScope, node: nodes.Expr) -> bool:
    """Return whether a condition mentions an event.

    An event is present for one step only. Therefore a `chance` in the same condition is a probability and not a rate."""
    stack: list[nodes.Expr] = [node]
    while stack:
        part = stack.pop()
        if isinstance(part, nodes.NameRef):
            name = part.name.text
            if name in scope.declarations.events and name not in scope.local_names:
                return True
        elif isinstance(part, nodes.Binary) and part.op in ("and", "or"):
            stack += [part.left, part.right]
    return False


# --- one operand -----------------------------------------------------------------------------------------------------


def type_unary(scope: NameScope, node: nodes.Unary, expected_type: ValueType | None) -> Expr:
    """Type `-x`, `not x`, `no x` and `chance x`."""
    if node.op == "-":
        expr = type_value(scope, node.operand)
        if expr.type.kind not in (TypeKind.NUMBER, TypeKind.VECTOR, TypeKind.BAD):
            report_mismatch(scope.report, node.operand, expr.type, NUMBER_TYPE, "`-`")
            return make_bad_expression(node.span)
        return fold_operation(scope.report, make_operation("neg", expr.type, node.span, expr))
    if node.op == "not":
        return _type_not(scope, node)
    if node.op == "no":
        return _type_no_test(scope, node)
    return _type_chance(scope, node)


def _type_not(scope: NameScope, node: nodes.Unary) -> Expr:
    expr = type_value(scope, node.operand, BOOL_TYPE)
    if expr.type == NUMBER_TYPE:
        return make_operation("sub", NUMBER_TYPE, node.span, Constant(NUMBER_TYPE, ChangeRate.CONST, node.span, 1.0), expr)
    if expr.type == BAD_TYPE:
        return make_bad_expression(node.span)
    return make_operation("not", BOOL_TYPE, node.span, convert_to_bool(scope, node.operand, expr, "`not`"))


def _type_no_test(scope: NameScope, node: nodes.Unary) -> Expr:
    expr = scope.type_expression(node.operand)
    return _make_none_test(scope, node.operand, expr, node.span, "no")


def _make_none_test(scope: NameScope, node: nodes.Expr, expr: Expr, span: Span, word: str) -> Expr:
    kind = expr.type.kind
    if kind in OPTIONAL_KINDS or kind in (TypeKind.SET, TypeKind.BAD, TypeKind.PLACE):
        return make_operation("is_none", BOOL_TYPE, span, expr)
    advice = "`not` needs a yes or no" if kind is TypeKind.BOOL else "only an item, an agent, a hit or a set can be none"
    fix = None
    if kind in (TypeKind.ITEMS, TypeKind.SPECIES):
        nearest = f"nearest({' '.join(node.span.text.split())})"
        advice, fix = f"test for one of them: `no {nearest}`", Fix(node.span, nearest)
    message = f"{quote_source(node.span)} is {describe_type(expr.type)}, which is never none"
    scope.report.error("wrong-kind", message, node.span, advice, fix=fix)
    return make_bad_expression(span)


def type_is_none(scope: NameScope, node: nodes.IsNone, expected_type: ValueType | None) -> Expr:
    expr = scope.type_expression(node.operand)
    test = _make_none_test(scope, node.operand, expr, node.span, "is none")
    return make_operation("not", BOOL_TYPE, node.span, test) if node.is_negated and isinstance(test, OperationExpr) else test


def _type_chance(scope: NameScope, node: nodes.Unary) -> Expr:
    expr = type_value(scope, node.operand)
    site = make_draw_site(scope, "chance", node.span)
    _check_chance(scope, node, expr)
    if is_compatible(expr.type, PER_SECOND_TYPE) or (scope.is_evaluated_once and is_compatible(expr.type, NUMBER_TYPE)):
        return OperationExpr(BOOL_TYPE, max(expr.rate, ChangeRate.AGENT), node.span, "chance", (expr,), site)
    if expr.type == NUMBER_TYPE:
        text = " ".join(node.operand.span.text.split())
        if isinstance(node.operand, nodes.Number | nodes.Quantity):
            text = text.replace(",", ".")
        message = f"{quote_source(node.operand.span)} has no time unit"
        advice = f"write `chance {text}{'/s' if text.endswith('%') else ' /s'}` for a rate per second"
        scope.report.error("not-a-rate", message, node.operand.span, advice)
    else:
        report_mismatch(scope.report, node.operand, expr.type, PER_SECOND_TYPE, "`chance`")
    return make_bad_expression(node.span)


def _check_chance(scope: NameScope, node: nodes.Unary, expr: Expr) -> None:
    known = find_constant(expr)
    if known is None:
        return
    if known.number < 0:
        message = f"a chance below 0: {quote_source(node.operand.span)}"
        scope.report.error("out-of-range", message, node.operand.span, "write a chance of 0 or more")
    elif known.type == NUMBER_TYPE and known.number > 1 and scope.is_evaluated_once:
        words = f"a chance above 100 %: {quote_source(node.operand.span)}"
        scope.report.error("out-of-range", words, node.operand.span, "write at most `100 %`")


def make_draw_site(scope: NameScope, word: str, span: Span) -> str:
    """Return the key of a random draw. Report an error for a draw inside a set, because its result would depend on the order of
    the elements."""
    if scope.set_elements:
        message = f"`{word}` draws a random number inside a set"
        scope.report.error("draw-in-set", message, span, "draw before the set: `let x = …`, and use `x` inside")
    return scope.keys.make_key(word)


def type_count(scope: NameScope, node: nodes.Expr, subject: str) -> Expr:
    """Return the typed expression of an integer that is constant during a run. Report an error for other expressions."""
    expr = type_value(scope, node)
    if expr.type.kind is TypeKind.BAD or (scope.is_generic and expr.type == NUMBER_TYPE):
        return expr
    known = find_constant(expr)
    if known is not None and known.type == NUMBER_TYPE and 1 <= known.number <= 64 and known.number == int(known.number):
        return Constant(NUMBER_TYPE, ChangeRate.CONST, node.span, known.number)
    message = f"{subject} needs a whole number from 1 to 64, not {quote_source(node.span)}"
    return scope.report_error("wrong-count", message, node.span, "write a number such as `3`")


# --- two operands ----------------------------------------------------------------------------------------------------


def type_binary(scope: NameScope, node: nodes.Binary, expected_type: ValueType | None) -> Expr:
    """Type an operator with two operands."""
    if node.op in ("and", "or"):
        return _type_logic(scope, node)
    if node.op in _EQUALITY_SIGNS:
        return _type_equality(scope, node)
    left, right = type_value(scope, node.left), type_value(scope, node.right)
    if TypeKind.BAD in (left.type.kind, right.type.kind):
        return make_operation(
            OPERATION_BY_SIGN[node.op], BOOL_TYPE if node.op in _ORDER_SIGNS else BAD_TYPE, node.span, left, right
        )
    if node.op in _ORDER_SIGNS:
        return _type_comparison(scope, node, left, right)
    return _MAKER_BY_SIGN[node.op](scope, node, left, right)


def _type_logic(scope: NameScope, node: nodes.Binary) -> Expr:
    """Type `and` or `or`. The result is a bool for two bools, or the minimum or maximum of two degrees of truth."""
    left, right = type_value(scope, node.left, BOOL_TYPE), type_value(scope, node.right, BOOL_TYPE)
    if BAD_TYPE in (left.type, right.type) and {left.type, right.type} <= {BAD_TYPE, NUMBER_TYPE}:
        return make_operation(
            node.op, BAD_TYPE, node.span, left, right
        )  # the invalid operand may have been meant as a degree of truth
    if left.type == NUMBER_TYPE and right.type == NUMBER_TYPE:
        return make_operation("min" if node.op == "and" else "max", NUMBER_TYPE, node.span, left, right)
    if scope.allows_degrees and NUMBER_TYPE in (left.type, right.type):  # elsewhere, a number next to a bool is usually a mistake
        pairs = ((node.left, left), (node.right, right))
        parts = (e if e.type == NUMBER_TYPE else convert_to_bool(scope, n, e, f"`{node.op}`") for n, e in pairs)
        return make_operation(node.op, NUMBER_TYPE, node.span, *parts)
    a = convert_to_bool(scope, node.left, left, f"`{node.op}`")
    b = convert_to_bool(scope, node.right, right, f"`{node.op}`")
    return make_operation(node.op, BOOL_TYPE, node.span, a, b)


def _looks_like_state(node: nodes.Expr) -> bool:
    if isinstance(node, nodes.Member):
        return node.name.text in STATE_WORDS
    return isinstance(node, nodes.NameRef) and node.name.text in STATE_WORDS


def _is_state(scope: NameScope, node: nodes.Expr) -> bool:
    machines = scope.species.machines.values() if scope.species is not None else ()
    return isinstance(node, nodes.NameRef) and any(node.name.text in machine.states for machine in machines)


def _type_equality(scope: NameScope, node: nodes.Binary) -> Expr:
    left_node, right_node = node.left, node.right
    if _looks_like_state(right_node) and not _looks_like_state(left_node):
        left_node, right_node = right_node, left_node
    left = type_value(scope, left_node)
    if left.type.kind is TypeKind.BAD and _is_state(scope, right_node):
        return make_bad_expression(node.span)
    if left.type.kind is TypeKind.STATE:
        pair = find_state(scope, left, right_node)
        if pair is not None:
            return make_operation(OPERATION_BY_SIGN[node.op], BOOL_TYPE, node.span, *pair)
    right = type_value(scope, right_node, left.type)
    if isinstance(left_node, nodes.NoneOf) and left_node.of is None and right.type.kind in OPTIONAL_KINDS:
        left = type_value(scope, left_node, right.type)
    if is_compatible(left.type, right.type) and left.type.kind not in THING_KINDS | {TypeKind.SET, TypeKind.VECTOR}:
        return make_operation(OPERATION_BY_SIGN[node.op], BOOL_TYPE, node.span, left, right)
    if left.type.kind is right.type.kind and left.type.kind is not TypeKind.NUMBER:
        message = f"{quote_source(node.span)} compares values that cannot be compared"
        scope.report.error("kinds-differ", message, node.span, "compare numbers, states, items or agents")
    else:
        report_operand_mismatch(scope.report, node.op, node.span, (left_node, left), (right_node, right))
    return make_operation(OPERATION_BY_SIGN[node.op], BOOL_TYPE, node.span, left, right)


def _type_comparison(scope: NameScope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if left.type.kind is TypeKind.NUMBER and is_compatible(left.type, right.type):
        return make_operation(OPERATION_BY_SIGN[node.op], BOOL_TYPE, node.span, left, right)
    if left.type.kind is TypeKind.NUMBER or right.type.kind is TypeKind.NUMBER:
        report_operand_mismatch(scope.report, node.op, node.span, (node.left, left), (node.right, right))
    else:
        report_mismatch(scope.report, node.left, left.type, NUMBER_TYPE, f"`{node.op}`")
    return make_operation(OPERATION_BY_SIGN[node.op], BOOL_TYPE, node.span, left, right)


def _type_sum(scope: NameScope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if left.type.kind in (TypeKind.NUMBER, TypeKind.VECTOR) and is_compatible(left.type, right.type):
        return fold_operation(scope.report, make_operation(OPERATION_BY_SIGN[node.op], left.type, node.span, left, right))
    odd = next(
        ((n, e) for n, e in ((node.left, left), (node.right, right)) if e.type.kind not in (TypeKind.NUMBER, TypeKind.VECTOR)),
        None,
    )
    if odd is not None:
        report_mismatch(scope.report, odd[0], odd[1].type, NUMBER_TYPE, f"`{node.op}`")
    else:
        report_operand_mismatch(scope.report, node.op, node.span, (node.left, left), (node.right, right))
    return make_bad_expression(node.span)


def _check_operands(scope: NameScope, node: nodes.Binary, left: Expr, right: Expr) -> bool:
    """Return whether both operands are numbers or vectors. Report the first one that is not."""
    for part, expr in ((node.left, left), (node.right, right)):
        if expr.type.kind not in (TypeKind.NUMBER, TypeKind.VECTOR):
            report_mismatch(scope.report, part, expr.type, NUMBER_TYPE, f"`{node.op}`")
            return False
    return True


def _type_product(scope: NameScope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if not _check_operands(scope, node, left, right):
        return make_bad_expression(node.span)
    vectors = [e for e in (left, right) if e.type.kind is TypeKind.VECTOR]
    if len(vectors) == 2:
        help = "write `dot(a, b)` for a number or `cross(a, b)` for a vector"
        scope.report.error("wrong-kind", f"{quote_source(node.span)} multiplies two vectors", node.op_span, help)
        return make_bad_expression(node.span)
    type = ValueType(
        TypeKind.VECTOR if vectors else TypeKind.NUMBER, combine_dimensions(left.type.dimension, right.type.dimension)
    )
    return fold_operation(scope.report, make_operation("mul", type, node.span, left, right))


def _type_quotient(scope: NameScope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if not _check_operands(scope, node, left, right):
        return make_bad_expression(node.span)
    if right.type.kind is TypeKind.VECTOR:
        advice = f"divide by its length: `length({quote_source(node.right.span).strip('`')})`"
        scope.report.error("wrong-kind", f"{quote_source(node.span)} divides by a vector", node.op_span, advice)
        return make_bad_expression(node.span)
    type = ValueType(left.type.kind, combine_dimensions(left.type.dimension, right.type.dimension, -1))
    return fold_operation(scope.report, make_operation("div", type, node.span, left, right))


def _type_power(scope: NameScope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if left.type.kind is not TypeKind.NUMBER:
        report_mismatch(scope.report, node.left, left.type, NUMBER_TYPE, "`^`")
        return make_bad_expression(node.span)
    if right.type != NUMBER_TYPE:
        report_mismatch(scope.report, node.right, right.type, NUMBER_TYPE, "`^`")
        return make_bad_expression(node.span)
    exponent = find_constant(right)
    if left.type.dimension != NUMBER_TYPE.dimension and exponent is None:
        message = f"{quote_source(node.left.span)} is {describe_type(left.type)}, so its power must be a plain number"
        scope.report.error("wrong-unit", message, node.right.span, "write `^ 2`")
        return make_bad_expression(node.span)
    dim = scale_dimension(left.type.dimension, exponent.number) if exponent else left.type.dimension
    return fold_operation(scope.report, make_operation("pow", ValueType(TypeKind.NUMBER, dim), node.span, left, right))


_MAKER_BY_SIGN = {"+": _type_sum, "-": _type_sum, "*": _type_product, "/": _type_quotient, "^": _type_power}


# --- if c then a else b ----------------------------------------------------------------------------------------------


def type_if_else(scope: NameScope, node: nodes.IfElse, expected_type: ValueType | None) -> Expr:
    test = type_condition(scope, node.condition, "`if`")
    inner = scope.with_changes(no_keep_reason="inside `if` it would not be updated in every step")
    bare = isinstance(node.then, nodes.NoneOf) and node.then.of is None
    if bare:
        otherwise = type_value(inner, node.otherwise, expected_type)
        then = type_value(inner, node.then, otherwise.type)
    else:
        then = type_value(inner, node.then, expected_type)
        otherwise = type_value(inner, node.otherwise, then.type)
    if not is_compatible(then.type, otherwise.type):
        report_operand_mismatch(scope.report, "if … then … else", node.span, (node.then, then), (node.otherwise, otherwise))
        return make_bad_expression(node.span)
    type = otherwise.type if then.type.kind is TypeKind.BAD else then.type
    if type.kind in THING_KINDS or type.kind is TypeKind.SET:
        message = f"`if` cannot choose {describe_type(type)}"
        return scope.report_error("wrong-kind", message, node.span, "choose between values: numbers, vectors, items, agents")
    return make_operation("if", type, node.span, test, then, otherwise)
