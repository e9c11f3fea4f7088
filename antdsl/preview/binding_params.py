"""Which params are asked for before the first step, so that another value asks for more than another number."""

from __future__ import annotations

from antdsl.plan.ir import Plan
from antdsl.plan.traverse import field_nodes, needed, operands, statements


def asked_before_the_first_step(plan: Plan) -> frozenset[str]:
    """Params that fields, other params or newborn agents are made with. All others may change between two steps."""
    nodes = [node for made in plan.fields.values() for node in field_nodes(made)]
    nodes += [param.default for param in plan.params.values()]
    for species in plan.species.values():
        nodes += [node for _, statement in statements(species.born) for node in operands(statement)]
    return frozenset(str(node.attrs[0]) for node in needed(nodes) if node.op == "param")
