"""Compute what is known, and write regions straight into their place where the condition is known."""

from __future__ import annotations

from antdsl.passes.rewriting import rebuilt, with_blocks
from antdsl.plan.ir import Block, If, Plan, SpeciesPlan, Statement
from antdsl.plan.lowering.simplify import value


def fold(plan: Plan) -> Plan:
    """Same effects: what is constant is a constant, regions of nobody are gone, regions of everybody have no condition."""
    return open_known(rebuilt(plan))


def open_known(plan: Plan) -> Plan:
    """`fold` of a plan whose nodes a Builder has just made: all that is known of them it has computed already."""
    return with_blocks(plan, lambda species, block: _block(species, block))


def _block(species: SpeciesPlan, block: Block) -> Block:
    result: list[Statement] = []
    for statement in block.statements:
        if not isinstance(statement, If):
            result.append(statement)
            continue
        known = value(statement.condition)
        inner = _block(species, statement.then)
        if known is True:
            result += inner.statements
        elif known is None and inner.statements:
            result.append(If(statement.condition, inner, statement.span))
    return Block(tuple(result))
