"""Safe algebra on one operation: what is known is computed, what changes nothing is left out.

Only rewrites that give the same value for every operand, NaN and infinity included; the sign of a zero may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from antdsl.plan.floats import ARITHMETIC, COMPARISONS, f32, greatest, least
from antdsl.plan.ir import Kind, Node

if TYPE_CHECKING:
    from antdsl.plan.builder import Builder

Value = float | int | bool | None
_CONSTS = frozenset(("const", "const.bool", "const.i32", "const.i64"))


def value(node: Node) -> Any:
    """The value of a constant node (float, int or bool), None of any other."""
    return node.attrs[0] if node.op in _CONSTS else None


def simplify(b: Builder, op: str, args: tuple[Node, ...], attrs: tuple[Any, ...]) -> Node | None:
    """A node that stands for the operation, or None if nothing simpler is known."""
    if not args:
        return None
    values = [value(a) for a in args]
    if all(v is not None for v in values):
        known = _computed(b, op, values)
        if known is not None:
            return known
    rule = _ALGEBRA.get(op)
    return rule(b, args, values) if rule else None


def _computed(b: Builder, op: str, values: list[Any]) -> Node | None:
    if op in ARITHMETIC:
        return b.number(f32(ARITHMETIC[op](*values)))
    if op in COMPARISONS:
        return b.truth(COMPARISONS[op](*values))
    if op in ("min", "max"):
        chosen = (least if op == "min" else greatest)(*values)
        return None if chosen is None else b.number(chosen)
    if op == "number":
        return b.number(float(values[0]))
    return None


def _add(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return args[0] if v[1] == 0 else args[1] if v[0] == 0 else None


def _sub(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return args[0] if v[1] == 0 else b("neg", args[1]) if v[0] == 0 else None


def _mul(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    if v[1] == 1:
        return args[0]
    if v[0] == 1:
        return args[1]
    if v[1] == -1:
        return b("neg", args[0])
    return b("neg", args[1]) if v[0] == -1 else None


def _div(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return args[0] if v[1] == 1 else None


def _neg(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return args[0].args[0] if args[0].op == "neg" else None


def _same(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return args[0] if args[0] is args[1] else None


def _and(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    if v[0] is False or v[1] is False:
        return b.false
    if v[0] is True or args[0] is args[1]:
        return args[1]
    return args[0] if v[1] is True else None


def _or(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    if v[0] is True or v[1] is True:
        return b.true
    if v[0] is False or args[0] is args[1]:
        return args[1]
    return args[0] if v[1] is False else None


def _not(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    if v[0] is not None:
        return b.truth(not v[0])
    inner = args[0]
    if inner.op == "not":
        return inner.args[0]
    if inner.op in ("eq", "ne"):  # each other's opposite for NaN too; the orderings are not
        return b("ne" if inner.op == "eq" else "eq", *inner.args)
    return None


def _where(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    condition, then, other = args
    if v[0] is not None:
        return then if v[0] else other
    if then is other:
        return then
    if condition.op == "not":
        return b("where", condition.args[0], other, then)
    if v[1] is True and v[2] is False:
        return condition
    if v[1] is False and v[2] is True:
        return b("not", condition)
    return None


def _eq(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return b.true if args[0] is args[1] and args[0].kind is not Kind.F32 else None


def _ne(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return b.false if args[0] is args[1] and args[0].kind is not Kind.F32 else None


def _alive(b: Builder, args: tuple[Node, ...], v: list[Value]) -> Node | None:
    return b.false if v[0] == -1 else None


_ALGEBRA = {
    "add": _add, "sub": _sub, "mul": _mul, "div": _div, "neg": _neg, "min": _same, "max": _same, "and": _and, "or": _or,
    "not": _not, "where": _where, "eq": _eq, "ne": _ne, "item.alive": _alive, "agent.alive": _alive,
}  # fmt: skip
