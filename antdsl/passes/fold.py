"""Folds regions with a constant condition: a false region is removed, and a true one is replaced by its statements."""

from __future__ import annotations

from antdsl.passes.rewriting import replace_blocks
from antdsl.plan.ir import Block, If, Plan, PlanStatement, SpeciesPlan
from antdsl.plan.simplify import get_constant_value


def fold_regions(plan: Plan) -> Plan:
    """Return an equivalent plan without regions that have a constant condition. A false region is removed, and a true one is
    replaced by its statements.

    This pass does not fold constants in expressions, because the PlanBuilder has already done so."""
    return replace_blocks(plan, lambda species, block: _fold_block(species, block))


def _fold_block(species: SpeciesPlan, block: Block) -> Block:
    result: list[PlanStatement] = []
    for statement in block.statements:
        if not isinstance(statement, If):
            result.append(statement)
            continue
        known = get_constant_value(statement.condition)
        inner = _fold_block(species, statement.body)
        if known is True:
            result += inner.statements
        elif known is None and inner.statements:
            result.append(If(statement.condition, inner, statement.span))
    return Block(tuple(result))
