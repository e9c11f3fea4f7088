"""Rebuilds a plan: a new PlanBuilder makes every node again, folds constants and shares equal nodes. Every statement is
copied."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from antdsl.plan.builder import PlanBuilder
from antdsl.plan.ir import (
    Block,
    Claim,
    FieldPlan,
    Give,
    If,
    ParamPlan,
    Plan,
    PlanNode,
    PlanStatement,
    Request,
    SpeciesPlan,
    Store,
)
from antdsl.plan.traverse import PHASES, collect_required_nodes, list_root_nodes

NodeMaker = Callable[[PlanBuilder, str, tuple[PlanNode, ...], tuple[Any, ...]], PlanNode | None]


def replace_blocks(plan: Plan, change_block: Callable[[SpeciesPlan, Block], Block]) -> Plan:
    """Return the plan with `change_block` applied to the block of each phase of each species."""
    species = {
        name: replace(s, **{phase: change_block(s, getattr(s, phase)) for phase in PHASES})  # type: ignore[arg-type]
        for name, s in plan.species.items()
    }
    return replace(plan, species=species)


def rebuild_plan(plan: Plan, make_node: NodeMaker | None = None, tracked_nodes: dict[PlanNode, PlanNode] | None = None) -> Plan:
    """Return an equivalent plan that has only the needed nodes. They are simplified, shared, and numbered without gaps.

    - `make_node`: returns a replacement for an operation, or None to leave it unchanged. Its operands are already rebuilt.
    - `tracked_nodes`: nodes that must not be removed; they may be outside the plan. On return, each is mapped to its new node."""
    builder = PlanBuilder()
    new: dict[PlanNode, PlanNode] = {}
    beside = {} if tracked_nodes is None else tracked_nodes
    for node in collect_required_nodes([*list_root_nodes(plan), *beside]):
        builder.span = node.span
        args = tuple(new[a] for a in node.args)
        other = make_node(builder, node.op, args, node.attrs) if make_node else None
        new[node] = other or builder(node.op, *args, attrs=node.attrs, kind=node.kind)
    changed = _map_plan(plan, new)
    beside.update((node, new[node]) for node in beside)
    return _renumber_nodes(changed, beside)


def _renumber_nodes(plan: Plan, tracked_nodes: dict[PlanNode, PlanNode]) -> Plan:
    """Return the plan without nodes that became unused by folding, and with new numbers. All nodes come from a new PlanBuilder,
    so no two nodes are equal."""
    new: dict[PlanNode, PlanNode] = {}
    for number, node in enumerate(collect_required_nodes([*list_root_nodes(plan), *tracked_nodes.values()])):
        args = tuple(new[a] for a in node.args)
        new[node] = PlanNode(node.op, args, node.attrs, node.kind, node.rate, node.span, number)
    tracked_nodes.update((node, new[now]) for node, now in tracked_nodes.items())
    return replace(_map_plan(plan, new), nodes=tuple(new.values()))


def _map_plan(plan: Plan, node_map: dict[PlanNode, PlanNode]) -> Plan:
    def map_optional(node: PlanNode | None) -> PlanNode | None:
        return None if node is None else node_map[node]

    def map_field(f: FieldPlan) -> FieldPlan:
        return replace(
            f,
            cell=node_map[f.cell],
            retained_share=map_optional(f.retained_share),
            diffuse=map_optional(f.diffuse),
            limit=map_optional(f.limit),
        )

    species = {}
    for name, s in plan.species.items():
        phases = {phase: _map_block(getattr(s, phase), node_map) for phase in PHASES}
        lazy = tuple(dict.fromkeys(node_map[n] for n in s.memoised_senses))
        species[name] = replace(s, memoised_senses=lazy, **phases)  # type: ignore[arg-type]
    return replace(
        plan, species=species, fields={n: map_field(f) for n, f in plan.fields.items()},
        params={n: ParamPlan(p.name, node_map[p.default]) for n, p in plan.params.items()},
    )  # fmt: skip


def _map_block(block: Block, node_map: dict[PlanNode, PlanNode]) -> Block:
    return Block(tuple(_map_statement(s, node_map) for s in block.statements))


def _map_statement(statement: PlanStatement, node_map: dict[PlanNode, PlanNode]) -> PlanStatement:
    match statement:
        case If():
            return If(node_map[statement.condition], _map_block(statement.body, node_map), statement.span)
        case Store():
            return replace(statement, value=node_map[statement.value])
        case Claim():
            item, amount = (None if node is None else node_map[node] for node in (statement.item, statement.amount))
            return replace(statement, item=item, amount=amount)
        case Give():
            return replace(
                statement, item=node_map[statement.item], amount=None if statement.amount is None else node_map[statement.amount]
            )
        case Request():
            return replace(statement, args=tuple(None if node is None else node_map[node] for node in statement.args))
