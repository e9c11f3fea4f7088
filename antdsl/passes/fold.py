"""Regions with a known condition: moved straight into their place, or left out."""

from __future__ import annotations

from antdsl.passes.rewriting import with_blocks
from antdsl.plan.ir import Block, If, Plan, PlanStatement, SpeciesPlan
from antdsl.plan.simplify import constant_value


def fold(plan: Plan) -> Plan:
    """Return an equivalent plan: regions of no agents are removed, regions of all agents have no condition. What is constant in a
    plan is a constant already: a Builder made its nodes."""
    return with_blocks(plan, lambda species, block: _block(species, block))


def _block(species: SpeciesPlan, block: Block) -> Block:
    result: list[PlanStatement] = []
    for statement in block.statements:
        if not isinstance(statement, If):
            result.append(statement)
            continue
        known = constant_value(statement.condition)
        inner = _block(species, statement.then)
        if known is True:
            result += inner.statements
        elif known is None and inner.statements:
            result.append(If(statement.condition, inner, statement.span))
    return Block(tuple(result))
