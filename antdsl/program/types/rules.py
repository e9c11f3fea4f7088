"""The table of typing functions, with one row for each class of node."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from antdsl.program.model import Expr
from antdsl.program.types import calls, expressions, operators, pair_values, states
from antdsl.syntax import nodes

TYPING_RULES: Mapping[type, Callable[..., Expr]] = {
    nodes.Number: expressions.number_of,
    nodes.Quantity: expressions.quantity_of,
    nodes.NameRef: expressions.name_of,
    nodes.Member: expressions.member_of,
    nodes.Index: pair_values.index_of,
    nodes.NoneOf: expressions.none_of,
    nodes.RangeExpr: expressions.range_of,
    nodes.PairOf: pair_values.pair_of,
    nodes.BadExpr: expressions.bad_expr,
    expressions.TypedArgument: expressions.typed_argument,
    nodes.Unary: operators.unary,
    nodes.Binary: operators.binary,
    nodes.IsNone: operators.is_none,
    nodes.ClipTest: states.clip_test,
    nodes.IfElse: operators.if_else,
    nodes.Call: calls.call,
}
