"""Checks `fuzzy NAME { A and B -> 0.8; C -> 0.1 }`: rules with degrees of truth that are combined into one number."""

from __future__ import annotations

from antdsl import limits
from antdsl.program.kinds import BAD_TYPE, BOOL_TYPE, NUMBER_TYPE
from antdsl.program.model import Expr, TypeKind
from antdsl.program.names.scope import NameScope, make_bad_expression
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import convert_to_bool, make_operation, type_value, type_value_as
from antdsl.syntax import nodes


def type_fuzzy_mean(scope: NameScope, node: nodes.Fuzzy) -> Expr:
    """Return the mean of the rules' outputs, weighted by the degree of truth of each rule. It is 0 if no rule applies.

    This is zero-order Sugeno inference, a weighted mean of singletons (Takagi and Sugeno, Fuzzy identification of systems, IEEE
    Trans. SMC 15(1), 1985, section II). In the paper, the outputs are linear functions. Here, they may be any number, so linear
    functions are also possible.
    The arguments of the operation are degree, output, degree, output, …"""
    if not node.rules:
        message = f"`fuzzy {node.name.text}` has no rules"
        return scope.report_error("empty-fuzzy", message, node.span, "write rules such as `near and fast -> 0.8`")
    if len(node.rules) > limits.MAX_FUZZY_RULES:
        over = node.rules[limits.MAX_FUZZY_RULES].span
        scope.report.error("too-many", f"more than {limits.MAX_FUZZY_RULES} rules in one `fuzzy`", over, "put some together")
        return make_bad_expression(node.span)
    inner = scope.with_changes(allows_degrees=True)
    parts: list[Expr] = []
    first: Expr | None = None
    for rule in node.rules:
        parts.append(_type_degree(inner, rule.condition))
        who = f"`fuzzy {node.name.text}`"
        said = type_value(scope, rule.value) if first is None else type_value_as(scope, rule.value, first.type, who)
        if said.type.kind not in (TypeKind.NUMBER, TypeKind.BAD):
            report_mismatch(scope.report, rule.value, said.type, NUMBER_TYPE, "a rule")
            said = make_bad_expression(rule.value.span)
        first = said if first is None or first.type.kind is TypeKind.BAD else first
        parts.append(said)
    assert first is not None
    known = all(part.type.kind is not TypeKind.BAD for part in parts)
    return make_operation("fuzzy", first.type if known else BAD_TYPE, node.span, *parts)


def _type_degree(scope: NameScope, node: nodes.Expr) -> Expr:
    """Return the degree of truth of a rule, 0 to 1. A shade is such a degree; a bool counts as 1 or 0."""
    expr = type_value(scope, node, BOOL_TYPE)
    if expr.type.kind is not TypeKind.NUMBER:
        return convert_to_bool(scope, node, expr, "a rule")
    if not is_compatible(expr.type, NUMBER_TYPE):
        text = " ".join(node.span.text.split())
        message = f"{quote_source(node.span)} is {describe_type(expr.type)}, but a rule needs a share from 0 to 1"
        advice = f"define its start and its end: `rising({text if len(text) <= 30 else '…'}, a .. b)`"
        return scope.report_error("wrong-unit", message, node.span, advice)
    known = find_constant(expr)
    if known is not None and not 0 <= known.number <= 1:
        message = f"{quote_source(node.span)} is not a degree of truth"
        scope.report.error("out-of-range", message, node.span, "write a degree from 0 to 1, such as `0.5`")
    return expr
