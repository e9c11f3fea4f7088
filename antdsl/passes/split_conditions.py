"""Splits conditions into a cheap and an expensive part, so that the expensive part runs only for agents that fulfil the cheap
part."""

from __future__ import annotations

from antdsl.passes.rewriting import replace_blocks
from antdsl.plan.ir import SENSE_OPERATIONS, Block, If, Plan, PlanNode, PlanStatement, SpeciesPlan
from antdsl.plan.traverse import collect_required_nodes


def split_conditions(plan: Plan) -> Plan:
    """Return the plan with each `where cheap and expensive:` replaced by two nested regions. Only the inner region's condition
    needs a sense."""
    return replace_blocks(plan, lambda species, block: _split_in_block(species, block))


def _split_in_block(species: SpeciesPlan, block: Block) -> Block:
    return Block(tuple(_split_statement(species, s) for s in block.statements))


def _split_statement(species: SpeciesPlan, statement: PlanStatement) -> PlanStatement:
    if not isinstance(statement, If):
        return statement
    inner = _split_in_block(species, statement.body)
    cheap: list[PlanNode] = []
    dear: list[PlanNode] = []
    for part in _split_conjunction(statement.condition):
        (dear if _needs_sense(part) else cheap).append(part)
    if not cheap or not dear:
        return If(statement.condition, inner, statement.span)
    for part in reversed(cheap + dear):
        inner = Block((If(part, inner, statement.span),))
    only = inner.statements[0]
    assert isinstance(only, If)
    return only


def _split_conjunction(condition: PlanNode) -> list[PlanNode]:
    """Return the operands of a condition's `and` operators, in order."""
    conditions: list[PlanNode] = []
    stack = [condition]
    while stack:
        node = stack.pop()
        if node.op == "and":
            stack += reversed(node.args)
        else:
            conditions.append(node)
    return conditions


def _needs_sense(node: PlanNode) -> bool:
    return any(n.op in SENSE_OPERATIONS for n in collect_required_nodes([node]))
