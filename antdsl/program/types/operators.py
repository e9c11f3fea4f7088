"""Types of signs and words between values: arithmetic, comparisons, and/or/not, `no`, `is none`, `chance`, if-then-else."""

from __future__ import annotations

from antdsl.diagnostics import Fix
from antdsl.program.kinds import BAD, BOOL, NUMBER, PER_SECOND, PUSH, VELOCITY
from antdsl.program.model import Const, Expr, Kind, Op, Rate, Type
from antdsl.program.names.scope import Scope, bad_expression, rate_of, type_from_words
from antdsl.program.tables.senses import find_words
from antdsl.program.tables.units import combine_dimensions, scale_dimension
from antdsl.program.tables.vocabulary import SIGN_OPS
from antdsl.program.types.descriptions import is_compatible, quote_source, report_disagreement, report_mismatch, type_words
from antdsl.program.types.expressions import MAY_BE_NONE, THINGS
from antdsl.program.types.folding import constant_behind, fold
from antdsl.program.types.states import STATE_WORDS, find_state
from antdsl.source import Span
from antdsl.syntax import nodes

_COMPARED = ("<", "<=", ">", ">=")
_EQUAL = ("==", "!=")
# What the bare name of a thing is in the place of a value, by the kind of thing.
_VALUE_HERE = {Kind(row.args[0].type): (row.op, type_from_words(row.result) or BAD) for row in find_words("value")}


def op(name: str, type: Type, span: Span, *args: Expr | None, site: str = "") -> Op:
    return Op(type, rate_of(args), span, name, args, site)


# --- operands --------------------------------------------------------------------------------------------------------


def value(scope: Scope, node: nodes.Expr, want: Type | None = None) -> Expr:
    """Return an expression as a value: the name of a field, flow or map stands for its value here."""
    return as_value(scope.type_expression(node, want))


def as_value(expr: Expr) -> Expr:
    value_op = _VALUE_HERE.get(expr.type.kind)
    return expr if value_op is None else Op(value_op[1], Rate.AGENT, expr.span, value_op[0], (expr,))


def value_of_type(scope: Scope, node: nodes.Expr, want: Type, place: str) -> Expr:
    """Return the value of an expression of a required type; `place` describes the place for messages."""
    expr = value(scope, node, want)
    if is_compatible(expr.type, want):
        return expr
    return report_mismatch(scope.report, node, expr.type, want, place, expr)


def facing_direction(scope: Scope, node: nodes.Expr) -> Expr:
    """Return the value of an expression that gives a direction to face: a push or a velocity, of which only the direction
    counts."""
    expr = value(scope, node, PUSH)
    if is_compatible(expr.type, VELOCITY):
        return expr
    return expr if is_compatible(expr.type, PUSH) else report_mismatch(scope.report, node, expr.type, PUSH, "`face`", expr)


def condition(scope: Scope, node: nodes.Expr, place: str) -> Expr:
    """Return an expression as a bool; an item, agent, hit or set is true if it is not empty."""
    if not scope.runs_once and _mentions_event(scope, node):
        scope = scope.with_changes(runs_once=True)
    return truth(scope, node, value(scope, node, BOOL), place)


def truth(scope: Scope, node: nodes.Expr, expr: Expr, place: str) -> Expr:
    kind = expr.type.kind
    if kind in (Kind.BOOL, Kind.BAD):
        return expr
    if kind in MAY_BE_NONE or kind is Kind.SET or (kind is Kind.PLACE and scope.generic):
        return op("is_some", BOOL, expr.span, expr)
    return report_mismatch(scope.report, node, expr.type, BOOL, place)


def _mentions_event(scope: Scope, node: nodes.Expr) -> bool:
    """Return whether a condition mentions an event. An event lasts one step only, so a `chance` beside it is a share and not a
    rate."""
    stack: list[nodes.Expr] = [node]
    while stack:
        part = stack.pop()
        if isinstance(part, nodes.NameRef):
            name = part.name.text
            if name in scope.declared.events and name not in scope.locals:
                return True
        elif isinstance(part, nodes.Binary) and part.op in ("and", "or"):
            stack += [part.left, part.right]
    return False


# --- one operand -----------------------------------------------------------------------------------------------------


def unary(scope: Scope, node: nodes.Unary, want: Type | None) -> Expr:
    if node.op == "-":
        expr = value(scope, node.operand)
        if expr.type.kind not in (Kind.NUMBER, Kind.VECTOR, Kind.BAD):
            report_mismatch(scope.report, node.operand, expr.type, NUMBER, "`-`")
            return bad_expression(node.span)
        return fold(scope.report, op("neg", expr.type, node.span, expr))
    if node.op == "not":
        return _not(scope, node)
    if node.op == "no":
        return _no_test(scope, node)
    return _chance(scope, node)


def _not(scope: Scope, node: nodes.Unary) -> Expr:
    expr = value(scope, node.operand, BOOL)
    if expr.type == NUMBER:
        return op("sub", NUMBER, node.span, Const(NUMBER, Rate.CONST, node.span, 1.0), expr)
    if expr.type == BAD:
        return bad_expression(node.span)
    return op("not", BOOL, node.span, truth(scope, node.operand, expr, "`not`"))


def _no_test(scope: Scope, node: nodes.Unary) -> Expr:
    expr = scope.type_expression(node.operand)
    return _none_test(scope, node.operand, expr, node.span, "no")


def _none_test(scope: Scope, node: nodes.Expr, expr: Expr, span: Span, word: str) -> Expr:
    kind = expr.type.kind
    if kind in MAY_BE_NONE or kind in (Kind.SET, Kind.BAD, Kind.PLACE):
        return op("is_none", BOOL, span, expr)
    advice = "`not` needs a yes or no" if kind is Kind.BOOL else "only an item, an agent, a hit or a set can be none"
    fix = None
    if kind in (Kind.ITEMS, Kind.SPECIES):
        nearest = f"nearest({' '.join(node.span.text.split())})"
        advice, fix = f"test for one of them: `no {nearest}`", Fix(node.span, nearest)
    message = f"{quote_source(node.span)} is {type_words(expr.type)}, which is never none"
    scope.report.error("wrong-kind", message, node.span, advice, fix=fix)
    return bad_expression(span)


def is_none(scope: Scope, node: nodes.IsNone, want: Type | None) -> Expr:
    expr = scope.type_expression(node.operand)
    test = _none_test(scope, node.operand, expr, node.span, "is none")
    return op("not", BOOL, node.span, test) if node.negated and isinstance(test, Op) else test


def _chance(scope: Scope, node: nodes.Unary) -> Expr:
    expr = value(scope, node.operand)
    site = draw_site(scope, "chance", node.span)
    _check_chance(scope, node, expr)
    if is_compatible(expr.type, PER_SECOND) or (scope.runs_once and is_compatible(expr.type, NUMBER)):
        return Op(BOOL, max(expr.rate, Rate.AGENT), node.span, "chance", (expr,), site)
    if expr.type == NUMBER:
        text = " ".join(node.operand.span.text.split())
        if isinstance(node.operand, nodes.Number | nodes.Quantity):
            text = text.replace(",", ".")
        message = f"{quote_source(node.operand.span)} does not say per what time"
        advice = f"write `chance {text}{'/s' if text.endswith('%') else ' /s'}` for so much a second"
        scope.report.error("not-a-rate", message, node.operand.span, advice)
    else:
        report_mismatch(scope.report, node.operand, expr.type, PER_SECOND, "`chance`")
    return bad_expression(node.span)


def _check_chance(scope: Scope, node: nodes.Unary, expr: Expr) -> None:
    known = constant_behind(expr)
    if known is None:
        return
    if known.number < 0:
        message = f"a chance below 0: {quote_source(node.operand.span)}"
        scope.report.error("out-of-range", message, node.operand.span, "write a chance of 0 or more")
    elif known.type == NUMBER and known.number > 1 and scope.runs_once:
        words = f"a chance above 100 %: {quote_source(node.operand.span)}"
        scope.report.error("out-of-range", words, node.operand.span, "write at most `100 %`")


def draw_site(scope: Scope, word: str, span: Span) -> str:
    """Return the name of a draw. Draws inside a set are errors, because the result would depend on the order of the elements."""
    if scope.sets:
        message = f"`{word}` draws a random number inside a set"
        scope.report.error("draw-in-set", message, span, "draw before the set: `let x = …`, and use `x` inside")
    return scope.keys.next(word)


def count(scope: Scope, node: nodes.Expr, who: str) -> Expr:
    """A whole number that is known before anything runs."""
    expr = value(scope, node)
    if expr.type.kind is Kind.BAD or (scope.generic and expr.type == NUMBER):
        return expr
    known = constant_behind(expr)
    if known is not None and known.type == NUMBER and 1 <= known.number <= 64 and known.number == int(known.number):
        return Const(NUMBER, Rate.CONST, node.span, known.number)
    message = f"{who} wants a whole number from 1 to 64, not {quote_source(node.span)}"
    return scope.reject("wrong-count", message, node.span, "write a number such as `3`")


# --- two operands ----------------------------------------------------------------------------------------------------


def binary(scope: Scope, node: nodes.Binary, want: Type | None) -> Expr:
    if node.op in ("and", "or"):
        return _logic(scope, node)
    if node.op in _EQUAL:
        return _equal(scope, node)
    left, right = value(scope, node.left), value(scope, node.right)
    if Kind.BAD in (left.type.kind, right.type.kind):
        return op(SIGN_OPS[node.op], BOOL if node.op in _COMPARED else BAD, node.span, left, right)
    if node.op in _COMPARED:
        return _compare(scope, node, left, right)
    return _ARITHMETIC[node.op](scope, node, left, right)


def _logic(scope: Scope, node: nodes.Binary) -> Expr:
    """Type `and` or `or`: of two bools, or as the minimum or maximum of two degrees of truth."""
    left, right = value(scope, node.left, BOOL), value(scope, node.right, BOOL)
    if BAD in (left.type, right.type) and {left.type, right.type} <= {BAD, NUMBER}:
        return op(node.op, BAD, node.span, left, right)  # what is wrong may have been meant as a shade of truth
    if left.type == NUMBER and right.type == NUMBER:
        return op("min" if node.op == "and" else "max", NUMBER, node.span, left, right)
    if scope.shades and NUMBER in (left.type, right.type):  # elsewhere a number beside a yes or no is mostly a slip
        pairs = ((node.left, left), (node.right, right))
        parts = (e if e.type == NUMBER else truth(scope, n, e, f"`{node.op}`") for n, e in pairs)
        return op(node.op, NUMBER, node.span, *parts)
    a = truth(scope, node.left, left, f"`{node.op}`")
    b = truth(scope, node.right, right, f"`{node.op}`")
    return op(node.op, BOOL, node.span, a, b)


def _looks_like_state(node: nodes.Expr) -> bool:
    if isinstance(node, nodes.Member):
        return node.name.text in STATE_WORDS
    return isinstance(node, nodes.NameRef) and node.name.text in STATE_WORDS


def _is_state(scope: Scope, node: nodes.Expr) -> bool:
    machines = scope.species.machines.values() if scope.species is not None else ()
    return isinstance(node, nodes.NameRef) and any(node.name.text in machine.states for machine in machines)


def _equal(scope: Scope, node: nodes.Binary) -> Expr:
    left_node, right_node = node.left, node.right
    if _looks_like_state(right_node) and not _looks_like_state(left_node):
        left_node, right_node = right_node, left_node
    left = value(scope, left_node)
    if left.type.kind is Kind.BAD and _is_state(scope, right_node):
        return bad_expression(node.span)
    if left.type.kind is Kind.STATE:
        pair = find_state(scope, left, right_node)
        if pair is not None:
            return op(SIGN_OPS[node.op], BOOL, node.span, *pair)
    right = value(scope, right_node, left.type)
    if isinstance(left_node, nodes.NoneOf) and left_node.of is None and right.type.kind in MAY_BE_NONE:
        left = value(scope, left_node, right.type)
    if is_compatible(left.type, right.type) and left.type.kind not in THINGS | {Kind.SET, Kind.VECTOR}:
        return op(SIGN_OPS[node.op], BOOL, node.span, left, right)
    if left.type.kind is right.type.kind and left.type.kind is not Kind.NUMBER:
        message = f"{quote_source(node.span)} compares what cannot be compared"
        scope.report.error("kinds-differ", message, node.span, "compare numbers, states, items or agents")
    else:
        report_disagreement(scope.report, node.op, node.span, (left_node, left), (right_node, right))
    return op(SIGN_OPS[node.op], BOOL, node.span, left, right)


def _compare(scope: Scope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if left.type.kind is Kind.NUMBER and is_compatible(left.type, right.type):
        return op(SIGN_OPS[node.op], BOOL, node.span, left, right)
    if left.type.kind is Kind.NUMBER or right.type.kind is Kind.NUMBER:
        report_disagreement(scope.report, node.op, node.span, (node.left, left), (node.right, right))
    else:
        report_mismatch(scope.report, node.left, left.type, NUMBER, f"`{node.op}`")
    return op(SIGN_OPS[node.op], BOOL, node.span, left, right)


def _sum(scope: Scope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if left.type.kind in (Kind.NUMBER, Kind.VECTOR) and is_compatible(left.type, right.type):
        return fold(scope.report, op(SIGN_OPS[node.op], left.type, node.span, left, right))
    odd = next(
        ((n, e) for n, e in ((node.left, left), (node.right, right)) if e.type.kind not in (Kind.NUMBER, Kind.VECTOR)), None
    )
    if odd is not None:
        report_mismatch(scope.report, odd[0], odd[1].type, NUMBER, f"`{node.op}`")
    else:
        report_disagreement(scope.report, node.op, node.span, (node.left, left), (node.right, right))
    return bad_expression(node.span)


def _check_operands(scope: Scope, node: nodes.Binary, left: Expr, right: Expr) -> bool:
    """Whether both are numbers or vectors; complains about the first that is not."""
    for part, expr in ((node.left, left), (node.right, right)):
        if expr.type.kind not in (Kind.NUMBER, Kind.VECTOR):
            report_mismatch(scope.report, part, expr.type, NUMBER, f"`{node.op}`")
            return False
    return True


def _product(scope: Scope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if not _check_operands(scope, node, left, right):
        return bad_expression(node.span)
    vectors = [e for e in (left, right) if e.type.kind is Kind.VECTOR]
    if len(vectors) == 2:
        help = "write `dot(a, b)` for a number or `cross(a, b)` for a vector"
        scope.report.error("wrong-kind", f"{quote_source(node.span)} multiplies two vectors", node.op_span, help)
        return bad_expression(node.span)
    type = Type(Kind.VECTOR if vectors else Kind.NUMBER, combine_dimensions(left.type.dim, right.type.dim))
    return fold(scope.report, op("mul", type, node.span, left, right))


def _quotient(scope: Scope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if not _check_operands(scope, node, left, right):
        return bad_expression(node.span)
    if right.type.kind is Kind.VECTOR:
        advice = f"divide by its length: `length({quote_source(node.right.span).strip('`')})`"
        scope.report.error("wrong-kind", f"{quote_source(node.span)} divides by a vector", node.op_span, advice)
        return bad_expression(node.span)
    type = Type(left.type.kind, combine_dimensions(left.type.dim, right.type.dim, -1))
    return fold(scope.report, op("div", type, node.span, left, right))


def _power(scope: Scope, node: nodes.Binary, left: Expr, right: Expr) -> Expr:
    if left.type.kind is not Kind.NUMBER:
        report_mismatch(scope.report, node.left, left.type, NUMBER, "`^`")
        return bad_expression(node.span)
    if right.type != NUMBER:
        report_mismatch(scope.report, node.right, right.type, NUMBER, "`^`")
        return bad_expression(node.span)
    exponent = constant_behind(right)
    if left.type.dim != NUMBER.dim and exponent is None:
        message = f"{quote_source(node.left.span)} is {type_words(left.type)}, so its power must be a plain number"
        scope.report.error("wrong-unit", message, node.right.span, "write `^ 2`")
        return bad_expression(node.span)
    dim = scale_dimension(left.type.dim, exponent.number) if exponent else left.type.dim
    return fold(scope.report, op("pow", Type(Kind.NUMBER, dim), node.span, left, right))


_ARITHMETIC = {"+": _sum, "-": _sum, "*": _product, "/": _quotient, "^": _power}


# --- if c then a else b ----------------------------------------------------------------------------------------------


def if_else(scope: Scope, node: nodes.IfElse, want: Type | None) -> Expr:
    test = condition(scope, node.condition, "`if`")
    inner = scope.with_changes(no_keep="under `if` it would not be clear when it moves on")
    bare = isinstance(node.then, nodes.NoneOf) and node.then.of is None
    if bare:
        otherwise = value(inner, node.otherwise, want)
        then = value(inner, node.then, otherwise.type)
    else:
        then = value(inner, node.then, want)
        otherwise = value(inner, node.otherwise, then.type)
    if not is_compatible(then.type, otherwise.type):
        report_disagreement(scope.report, "if … then … else", node.span, (node.then, then), (node.otherwise, otherwise))
        return bad_expression(node.span)
    type = otherwise.type if then.type.kind is Kind.BAD else then.type
    if type.kind in THINGS or type.kind is Kind.SET:
        message = f"`if` cannot choose {type_words(type)}"
        return scope.reject("wrong-kind", message, node.span, "choose between values: numbers, vectors, items, agents")
    return op("if", type, node.span, test, then, otherwise)
