"""Builds a plan again: every node by a new PlanBuilder, which folds constants and shares nodes, and a copy of every statement."""

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
from antdsl.plan.traverse import PHASES, required_nodes, roots

NodeMaker = Callable[[PlanBuilder, str, tuple[PlanNode, ...], tuple[Any, ...]], PlanNode | None]


def with_blocks(plan: Plan, change: Callable[[SpeciesPlan, Block], Block]) -> Plan:
    """Return the plan with `change` applied to each phase of each species."""
    species = {
        name: replace(s, **{phase: change(s, getattr(s, phase)) for phase in PHASES})  # type: ignore[arg-type]
        for name, s in plan.species.items()
    }
    return replace(plan, species=species)


def rebuild(plan: Plan, make: NodeMaker | None = None, watched: dict[PlanNode, PlanNode] | None = None) -> Plan:
    """Return an equivalent plan with only the needed nodes, simplified, shared and numbered without gaps.

    - `make`: may return another node for an operation. The operands are already rebuilt.
    - `watched`: nodes of the plan, or outside it, that must not be removed. On return, each is mapped to its new node."""
    builder = PlanBuilder()
    new: dict[PlanNode, PlanNode] = {}
    beside = {} if watched is None else watched
    for node in required_nodes([*roots(plan), *beside]):
        builder.span = node.span
        args = tuple(new[a] for a in node.args)
        other = make(builder, node.op, args, node.attrs) if make else None
        new[node] = other or builder(node.op, *args, attrs=node.attrs, kind=node.kind)
    changed = _carry_over(plan, new)
    beside.update((node, new[node]) for node in beside)
    return _renumber(changed, beside)


def _renumber(plan: Plan, beside: dict[PlanNode, PlanNode]) -> Plan:
    """Return the plan without the unused nodes that folding leaves. A new PlanBuilder made all nodes, so no two nodes are
    equal."""
    new: dict[PlanNode, PlanNode] = {}
    for number, node in enumerate(required_nodes([*roots(plan), *beside.values()])):
        args = tuple(new[a] for a in node.args)
        new[node] = PlanNode(node.op, args, node.attrs, node.kind, node.rate, node.span, number)
    beside.update((node, new[now]) for node, now in beside.items())
    return replace(_carry_over(plan, new), nodes=tuple(new.values()))


def _carry_over(plan: Plan, new: dict[PlanNode, PlanNode]) -> Plan:
    def optional(node: PlanNode | None) -> PlanNode | None:
        return None if node is None else new[node]

    def field(f: FieldPlan) -> FieldPlan:
        return replace(f, cell=new[f.cell], keep=optional(f.keep), diffuse=optional(f.diffuse), limit=optional(f.limit))

    species = {}
    for name, s in plan.species.items():
        phases = {phase: _block(getattr(s, phase), new) for phase in PHASES}
        lazy = tuple(dict.fromkeys(new[n] for n in s.lazy))
        species[name] = replace(s, lazy=lazy, **phases)  # type: ignore[arg-type]
    return replace(
        plan, species=species, fields={n: field(f) for n, f in plan.fields.items()},
        params={n: ParamPlan(p.name, new[p.default]) for n, p in plan.params.items()},
    )  # fmt: skip


def _block(block: Block, new: dict[PlanNode, PlanNode]) -> Block:
    return Block(tuple(_statement(s, new) for s in block.statements))


def _statement(s: PlanStatement, new: dict[PlanNode, PlanNode]) -> PlanStatement:
    match s:
        case If():
            return If(new[s.condition], _block(s.then, new), s.span)
        case Store():
            return replace(s, value=new[s.value])
        case Claim():
            item, amount = (None if node is None else new[node] for node in (s.item, s.amount))
            return replace(s, item=item, amount=amount)
        case Give():
            return replace(s, item=new[s.item], amount=None if s.amount is None else new[s.amount])
        case Request():
            return replace(s, args=tuple(None if node is None else new[node] for node in s.args))
