"""Removes temporary registers that no part of the plan reads, and the stores to them."""

from __future__ import annotations

from dataclasses import replace

from antdsl.plan.ir import Block, Claim, If, Plan, PlanStatement, SpeciesPlan, Store
from antdsl.plan.traverse import (
    PHASES,
    collect_required_nodes,
    find_registers_read,
    iterate_statements,
    list_blocks,
    list_operands,
)

RESULT_TEMPS = frozenset(f"{name}.{axis}" for name in ("push", "~face") for axis in "xyz")  # read by the runtime


def drop_unused_stores(plan: Plan) -> Plan:
    """Return an equivalent plan without temporary registers that are never read. Attributes and memories remain, because they
    are part of the agent's state.

    Nodes that only the removed stores used are removed by the next pass that rebuilds nodes."""
    return replace(plan, species={name: _drop_unused_in_species(s) for name, s in plan.species.items()})


def _drop_unused_in_species(species: SpeciesPlan) -> SpeciesPlan:
    while True:
        everything = [s for _, block in list_blocks(species) for _, s in iterate_statements(block)]
        read = find_registers_read(collect_required_nodes(n for s in everything for n in list_operands(s))) | RESULT_TEMPS
        read |= {s.won_register for s in everything if isinstance(s, Claim)}
        unread = {name for name, r in species.registers.items() if r.role == "temp" and name not in read}
        if not unread:
            return species
        phases = {phase: _remove_stores(getattr(species, phase), unread) for phase in PHASES}
        registers = {name: r for name, r in species.registers.items() if name not in unread}
        species = replace(species, registers=registers, **phases)  # type: ignore[arg-type]


def _remove_stores(block: Block, unread_registers: set[str]) -> Block:
    result: list[PlanStatement] = []
    for statement in block.statements:
        if isinstance(statement, Store) and statement.register in unread_registers:
            continue
        if isinstance(statement, If):
            inner = _remove_stores(statement.body, unread_registers)
            if inner.statements:
                result.append(If(statement.condition, inner, statement.span))
            continue
        result.append(statement)
    return Block(tuple(result))
