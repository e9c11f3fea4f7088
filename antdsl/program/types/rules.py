"""The table of the typing functions, with one row for each class of syntax node."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from antdsl.program.model import Expr
from antdsl.program.types import calls, expressions, operators, pair_values, states
from antdsl.syntax import nodes

TYPING_RULES: Mapping[type, Callable[..., Expr]] = {
    nodes.Number: expressions.type_number,
    nodes.Quantity: expressions.type_quantity,
    nodes.NameRef: expressions.type_name,
    nodes.Member: expressions.type_member,
    nodes.Index: pair_values.type_pair_index,
    nodes.NoneOf: expressions.type_none,
    nodes.RangeExpr: expressions.reject_range,
    nodes.PairOf: pair_values.reject_pair,
    nodes.BadExpr: expressions.type_bad_expression,
    expressions.TypedArgument: expressions.type_typed_argument,
    nodes.Unary: operators.type_unary,
    nodes.Binary: operators.type_binary,
    nodes.IsNone: operators.type_is_none,
    nodes.ClipTest: states.type_clip_test,
    nodes.IfElse: operators.type_if_else,
    nodes.Call: calls.type_call,
}
