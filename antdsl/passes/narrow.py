"""Splits conditions, so that the expensive half is evaluated only for agents for which the cheap half holds."""

from __future__ import annotations

from antdsl.passes.rewriting import with_blocks
from antdsl.plan.ir import SENSE_OPERATIONS, Block, If, Plan, PlanNode, PlanStatement, SpeciesPlan
from antdsl.plan.traverse import required_nodes


def narrow(plan: Plan) -> Plan:
    """Return a plan in which `where cheap and expensive:` is two nested regions. Only the conditions of the inner region need a
    sense."""
    return with_blocks(plan, lambda species, block: _block(species, block))


def _block(species: SpeciesPlan, block: Block) -> Block:
    return Block(tuple(_statement(species, s) for s in block.statements))


def _statement(species: SpeciesPlan, statement: PlanStatement) -> PlanStatement:
    if not isinstance(statement, If):
        return statement
    inner = _block(species, statement.then)
    cheap: list[PlanNode] = []
    dear: list[PlanNode] = []
    for part in _parts(statement.condition):
        (dear if _needs_sense(part) else cheap).append(part)
    if not cheap or not dear:
        return If(statement.condition, inner, statement.span)
    for part in reversed(cheap + dear):
        inner = Block((If(part, inner, statement.span),))
    only = inner.statements[0]
    assert isinstance(only, If)
    return only


def _parts(condition: PlanNode) -> list[PlanNode]:
    """Return the conditions that a condition joins by `and`, in order."""
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
    return any(n.op in SENSE_OPERATIONS for n in required_nodes([node]))
