"""Merges consecutive regions with the same condition, so that the agents that fulfil it are collected only once."""

from __future__ import annotations

from antdsl.passes.rewriting import replace_blocks
from antdsl.plan.ir import Block, If, Plan, PlanNode, PlanStatement, SpeciesPlan
from antdsl.plan.traverse import collect_required_nodes, find_registers_read, iterate_statements
from antdsl.plan.verify import find_written_registers


def merge_regions(plan: Plan) -> Plan:
    """Return an equivalent plan in which consecutive regions with the same condition are merged. They stay separate if the first
    region writes a register that the condition reads."""
    return replace_blocks(plan, lambda species, block: _merge_in_block(species, block))


def _merge_in_block(species: SpeciesPlan, block: Block) -> Block:
    result: list[PlanStatement] = []
    for statement in block.statements:
        if not isinstance(statement, If):
            result.append(statement)
            continue
        last = result[-1] if result else None
        if isinstance(last, If) and last.condition is statement.condition and not _has_condition_store(last.body, last.condition):
            joined = Block((*last.body.statements, *statement.body.statements))
            result[-1] = If(last.condition, _merge_in_block(species, joined), last.span)
        else:
            result.append(If(statement.condition, _merge_in_block(species, statement.body), statement.span))
    return Block(tuple(result))


def _has_condition_store(block: Block, condition: PlanNode) -> bool:
    """Return whether the statements of a block write a register that the condition loads."""
    loaded = find_registers_read(node for node in collect_required_nodes([condition]) if node.op == "load")
    return any(name in loaded for _, statement in iterate_statements(block) for name in find_written_registers(statement))
