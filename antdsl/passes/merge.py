"""Merges two successive regions with the same condition, so that their agents are collected once."""

from __future__ import annotations

from antdsl.passes.rewriting import with_blocks
from antdsl.plan.ir import Block, If, Plan, PlanNode, PlanStatement, SpeciesPlan
from antdsl.plan.traverse import registers_read, required_nodes, statements
from antdsl.plan.verify import written_registers


def merge(plan: Plan) -> Plan:
    """Return a plan with merged regions and equal effects. Regions with the same condition node are not merged if the first one
    writes a register that the condition reads."""
    return with_blocks(plan, lambda species, block: _block(species, block))


def _block(species: SpeciesPlan, block: Block) -> Block:
    result: list[PlanStatement] = []
    for statement in block.statements:
        if not isinstance(statement, If):
            result.append(statement)
            continue
        last = result[-1] if result else None
        if isinstance(last, If) and last.condition is statement.condition and not _changes(last.then, last.condition):
            joined = Block((*last.then.statements, *statement.then.statements))
            result[-1] = If(last.condition, _block(species, joined), last.span)
        else:
            result.append(If(statement.condition, _block(species, statement.then), statement.span))
    return Block(tuple(result))


def _changes(block: Block, condition: PlanNode) -> bool:
    """Return whether the statements write a register that the condition loads."""
    loaded = registers_read(node for node in required_nodes([condition]) if node.op == "load")
    return any(name in loaded for _, statement in statements(block) for name in written_registers(statement))
