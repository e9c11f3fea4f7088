"""Take out of the pairs what is the same for all pairs of an agent.

(pair * a) * b becomes pair * (a * b), and pair / a becomes pair * (1 / a): the right side is computed once an agent. This may
move the last bit of a result; every backend runs the plan that comes out, so all still agree.
"""

from __future__ import annotations

from antdsl.passes.rewriting import rebuilt
from antdsl.plan.builder import Builder
from antdsl.plan.ir import Node, Plan, Rate


def hoist(plan: Plan) -> Plan:
    """The same plan with products and quotients of pairs put in a better order."""
    return rebuilt(plan, _make)


def _make(b: Builder, op: str, args: tuple[Node, ...]) -> Node | None:
    if op == "div" and _pair(args[0]) and not _pair(args[1]):
        return _product(b, args[0], b("div", b.number(1), args[1]))
    if op == "mul" and _pair(args[0]) is not _pair(args[1]):
        pair, agent = args if _pair(args[0]) else (args[1], args[0])
        return _product(b, pair, agent)
    return None


def _product(b: Builder, pair: Node, agent: Node) -> Node:
    """pair * agent, joined with a factor of the agent's that `pair` has already."""
    if pair.op == "mul" and _pair(pair.args[0]) and not _pair(pair.args[1]):
        return b("mul", pair.args[0], b("mul", pair.args[1], agent))
    return b("mul", pair, agent)


def _pair(node: Node) -> bool:
    return node.rate is Rate.PAIR
