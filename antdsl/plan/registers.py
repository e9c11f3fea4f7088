"""Registers of agents: the names of registers for values per pair, their size in bytes, and when a block reads them.

Values per pair have slots, each with the id of another agent and the value that is stored about it.
A `load` is evaluated at its first use. If one is used both before and after a store to its register, in regions that do not share
a value, it is read before the region that contains both; `early_loads` returns which and where."""

from __future__ import annotations

from collections.abc import Iterable

from antdsl.plan import ir
from antdsl.plan.ir import SpeciesPlan, ValueKind
from antdsl.plan.traverse import operands, placed, required_nodes

_BYTES_BY_KIND = {ValueKind.F32: 4, ValueKind.BOOL: 1, ValueKind.I32: 4, ValueKind.I64: 8}
_ID_BYTES = 8  # its id


def written(statement: ir.PlanStatement) -> str | None:
    """Return the register that a statement itself changes, or None."""
    if isinstance(statement, ir.Store):
        return statement.register
    return statement.own if isinstance(statement, ir.Give) else None


def early_loads(block: ir.Block) -> dict[tuple[int, ...], list[ir.PlanNode]]:
    """Loads to evaluate just before the statement at a place, in the region that holds it."""
    read_paths: dict[ir.PlanNode, list[tuple[int, ...]]] = {}
    stores: dict[str, list[tuple[int, ...]]] = {}
    for path, statement in placed(block):
        for node in required_nodes(operands(statement)):
            if node.op == "load":
                read_paths.setdefault(node, []).append(path)
        register = written(statement)
        if register is not None:
            stores.setdefault(register, []).append(path)
    loads: dict[tuple[int, ...], list[ir.PlanNode]] = {}
    for node, paths in read_paths.items():
        if any(paths[0] <= store < paths[-1] for store in stores.get(node.attrs[0], ())):
            loads.setdefault(_common_place(paths), []).append(node)
    return loads


def _common_place(paths: list[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the place where several paths meet: in the smallest block around all of them, the statement that contains the first
    of them."""
    first, depth = paths[0], min(len(p) for p in paths) - 1
    while any(p[:depth] != first[:depth] for p in paths):
        depth -= 1
    return first[: depth + 1]


def statement_numbers(species: ir.SpeciesPlan) -> dict[ir.PlanStatement, int]:
    """Every statement of a species by its place in the text."""
    blocks = (species.born, species.decide, species.act, species.blend)
    return {statement: k for k, statement in enumerate(statement for block in blocks for _, statement in placed(block))}


def cacheable_senses(species: ir.SpeciesPlan) -> tuple[ir.PlanNode, ...]:
    """Return the lazy nodes with a value that holds for the whole step: none of its parts is written in between."""
    return tuple(node for node in species.lazy if all(part.op != "load" for part in required_nodes((node,))))


def bytes_by_purpose(species: SpeciesPlan) -> dict[str, int]:
    """Return bytes per agent by use: `attribute` (the author's and those that every animal has), `memory` (states, `keep`,
    latches, waiting times), `pair` (values per pair), and `temp`. All but `temp`, which is used during a step only, persist from
    step to step."""
    sizes = {"attribute": _ID_BYTES, "pair": 0, "memory": 0, "temp": 0}
    for register in species.registers.values():
        sizes[register.role] += _BYTES_BY_KIND[register.kind]
    return sizes


def slot_names(name: str, count: int) -> list[tuple[str, str]]:
    """The registers of a value per pair, slot by slot: of the other's id (I64, -1 for a free slot), of the value (F32)."""
    return [(f"{name}|{k}.id", f"{name}|{k}") for k in range(count)]


def pair_values(registers: Iterable[str]) -> dict[str, list[tuple[str, str]]]:
    """Return the pair values among the registers of a species, by name, each with its slots as in `slot_names`."""
    counts: dict[str, int] = {}
    for register in registers:
        name, slot, number = register.partition("|")
        if slot and number.isdecimal():
            counts[name] = counts.get(name, 0) + 1
    return {name: slot_names(name, count) for name, count in counts.items()}
