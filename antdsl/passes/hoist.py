"""Moves factors that are equal for all pairs of an agent out of the computation per pair. Factors common to x, y and z are also
computed once.

A product within a set becomes component * (scalars of the pair * (factors of the agent)). The inner bracket is computed once per
agent. The outer bracket is computed once per pair instead of once per component. Division by an agent's value is treated as a
factor. A sign moves to the outside, even out of a sum. The last bit of a result may change. All backends run the same plan after
this pass, so their results remain equal."""

from __future__ import annotations

from functools import reduce
from typing import Any

from antdsl.passes.rewriting import rebuild_plan
from antdsl.plan.builder import PlanBuilder
from antdsl.plan.ir import Plan, PlanNode, UpdateRate

_PAIR_OPERATIONS = frozenset(("pair.x", "pair.y", "pair.z", "other"))


def hoist_factors(plan: Plan, tracked_nodes: dict[PlanNode, PlanNode] | None = None) -> Plan:
    """Return the plan with the factors of products and quotients per pair reordered. Factors that depend only on the agent are
    then multiplied once per agent instead of once per pair.

    `tracked_nodes`: see `rebuild_plan`."""
    return rebuild_plan(plan, _reorder_product, tracked_nodes)


def _reorder_product(b: PlanBuilder, op: str, args: tuple[PlanNode, ...], attrs: tuple[Any, ...]) -> PlanNode | None:
    """Return a cheaper node for an operation per pair, or None to leave the operation unchanged. For the arguments, see
    `NodeMaker`."""
    if op == "reduce.sum" and args[2].op == "neg":  # exact, because rounding to a multiple is symmetric about zero
        return b("neg", b("reduce.sum", *args[:2], args[2].args[0], attrs=attrs))
    if op == "div" and _is_computed_per_pair(args[0]) and not _is_computed_per_pair(args[1]):
        return _build_product(b, (args[0], b("div", b.add_number(1), args[1])))
    if op == "mul" and (_is_computed_per_pair(args[0]) or _is_computed_per_pair(args[1])):
        return _build_product(b, args)
    return None


def _build_product(b: PlanBuilder, args: tuple[PlanNode, ...]) -> PlanNode:
    """Return the product of all factors of the operands. The order of multiplication is component * (pair scalars * (agent
    factors))."""
    factors, negative = _collect_factors(args)
    agent = [n for n in factors if not _is_computed_per_pair(n)]
    pair = [n for n in factors if _is_computed_per_pair(n)]
    first = next((n for n in pair if n.op in _PAIR_OPERATIONS), pair[0])
    pair.remove(first)
    rest = [reduce(lambda p, q: b("mul", p, q), group) for group in (pair, agent) if group]
    result = b("mul", first, reduce(lambda p, q: b("mul", p, q), rest)) if rest else first
    return b("neg", result) if negative else result


def _collect_factors(args: tuple[PlanNode, ...]) -> tuple[list[PlanNode], bool]:
    """Return the factors of the operands, from left to right, and whether the number of negations among them is odd."""
    factors: list[PlanNode] = []
    negative = False
    stack = list(reversed(args))
    while stack:
        node = stack.pop()
        if node.op == "neg" and _is_computed_per_pair(node):
            negative = not negative
            stack.append(node.args[0])
        elif node.op == "mul" and _is_computed_per_pair(node):
            stack += reversed(node.args)
        else:
            factors.append(node)
    return factors, negative


def _is_computed_per_pair(node: PlanNode) -> bool:
    return node.rate is UpdateRate.PAIR
