"""The registers of agents: those of pair values, their sizes in bytes, and the times at which a block reads registers.

A pair value has slots. A slot stores the id of another agent and the value about it. A `load` is normally evaluated at its first
use. The exception is a load with uses before and after a store to its register, in regions that do not share values. It is then
evaluated before the statement that contains both uses. `find_early_loads` returns these loads by position."""

from __future__ import annotations

from collections.abc import Iterable

from antdsl.plan import ir
from antdsl.plan.ir import SpeciesPlan, ValueKind
from antdsl.plan.traverse import collect_required_nodes, iterate_with_positions, list_operands

_BYTES_BY_KIND = {ValueKind.F32: 4, ValueKind.BOOL: 1, ValueKind.I32: 4, ValueKind.I64: 8}
_ID_BYTES = 8  # bytes of the other agent's id in a slot


def find_written_register(statement: ir.PlanStatement) -> str | None:
    """Return the name of the register to which a statement assigns a value, or None."""
    if isinstance(statement, ir.Store):
        return statement.register
    return statement.register if isinstance(statement, ir.Give) else None


def find_early_loads(block: ir.Block) -> dict[tuple[int, ...], list[ir.PlanNode]]:
    """Return the loads that must run before their first use, grouped by the position of the statement that they must precede.

    A statement's position is its index in each block around it, outermost first."""
    read_paths: dict[ir.PlanNode, list[tuple[int, ...]]] = {}
    stores: dict[str, list[tuple[int, ...]]] = {}
    for path, statement in iterate_with_positions(block):
        for node in collect_required_nodes(list_operands(statement)):
            if node.op == "load":
                read_paths.setdefault(node, []).append(path)
        register = find_written_register(statement)
        if register is not None:
            stores.setdefault(register, []).append(path)
    loads: dict[tuple[int, ...], list[ir.PlanNode]] = {}
    for node, paths in read_paths.items():
        if any(paths[0] <= store < paths[-1] for store in stores.get(node.attrs[0], ())):
            loads.setdefault(_find_common_place(paths), []).append(node)
    return loads


def _find_common_place(paths: list[tuple[int, ...]]) -> tuple[int, ...]:
    """Return the position of one statement in the smallest block that contains all of `paths`. It is the statement that contains
    the first of `paths`."""
    first, depth = paths[0], min(len(p) for p in paths) - 1
    while any(p[:depth] != first[:depth] for p in paths):
        depth -= 1
    return first[: depth + 1]


def number_statements(species: ir.SpeciesPlan) -> dict[ir.PlanStatement, int]:
    """Return the number of each statement of a species: its position in the order of blocks and statements, from 0."""
    blocks = (species.born, species.decide, species.act, species.blend)
    return {
        statement: k
        for k, statement in enumerate(statement for block in blocks for _, statement in iterate_with_positions(block))
    }


def find_cacheable_senses(species: ir.SpeciesPlan) -> tuple[ir.PlanNode, ...]:
    """Return the shared senses that keep the same value during a complete step. No statement writes a register that such a sense
    reads."""
    return tuple(node for node in species.memoised_senses if all(part.op != "load" for part in collect_required_nodes((node,))))


def count_bytes_by_purpose(species: SpeciesPlan) -> dict[str, int]:
    """Return how many bytes per agent the registers of a species need, by their purpose.

    - `attribute`: built-in attributes and those that the author declares.
    - `memory`: states, `keep`, latches, waiting times.
    - `pair`: pair values.
    - `temp`: registers that last only one step. All other registers persist from step to step."""
    sizes = {"attribute": _ID_BYTES, "pair": 0, "memory": 0, "temp": 0}
    for register in species.registers.values():
        sizes[register.role] += _BYTES_BY_KIND[register.kind]
    return sizes


def list_slot_register_names(name: str, count: int) -> list[tuple[str, str]]:
    """Return, for each slot of a pair value, the names of its two registers. They store the other agent's id (I64, -1 for a free
    slot) and the value (F32)."""
    return [(f"{name}|{k}.id", f"{name}|{k}") for k in range(count)]


def find_pair_values(registers: Iterable[str]) -> dict[str, list[tuple[str, str]]]:
    """Return the pair values among a species' registers, by name. For each slot, the result has the names of two registers: for
    the id, and for the value."""
    counts: dict[str, int] = {}
    for register in registers:
        name, slot, number = register.partition("|")
        if slot and number.isdecimal():
            counts[name] = counts.get(name, 0) + 1
    return {name: list_slot_register_names(name, count) for name, count in counts.items()}
