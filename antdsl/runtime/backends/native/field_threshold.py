"""Scents that are only compared with a bound. If no nearby cell reaches the bound, no cell is read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import BOOL, I32
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockCompiler, BlockInstruction, InstructionKind, RowScope
from antdsl.runtime.backends.native.stage_schedule import StageSchedule

_STRENGTH_PART = 0  # index of the strength in the result of `field.strongest`
_COMPARISON_OPERATIONS = frozenset(("lt", "le", "gt", "ge"))


def read_own_cell(w: Any, field: str) -> Lanes:
    """Return the agent's own cell; the index after the last cell if it has none."""
    cell = w.builder.load_lanes(w.array_address("cell", field), w.row, I32)
    cell_number: Lanes = w.builder.select_lanes(cell < 0, w.read_uniform(I32, "cells", field), cell)
    return cell_number


def may_reach_bound(w: Any, node: ir.PlanNode, bound: ir.PlanNode) -> Lanes:
    """Return the lanes for which a nearby cell may reach the bound."""

    def load_reached() -> Lanes:
        is_reached: Lanes = w.builder.gather(
            w.array_address("reached", *node.attrs, bound), read_own_cell(w, node.attrs[0]), BOOL
        )
        return is_reached

    may: Lanes = w.builder.get_or_make(("reached", *node.attrs, bound), load_reached)
    return may


def limit_strength(w: Any, node: ir.PlanNode, bound: ir.PlanNode, stored_strength: Lanes) -> Lanes:
    """Return `stored_strength` for lanes that may reach the bound, and 0 for other lanes.

    For the other lanes, the true value is also below the bound."""
    bounded_strength: Lanes = w.builder.select_lanes(
        may_reach_bound(w, node, bound), stored_strength, w.builder.make_constant(0.0, stored_strength.kind)
    )
    return bounded_strength


def find_bounds(compiler: BlockCompiler, schedule: StageSchedule) -> dict[int, ir.PlanNode]:
    """Return the bounds of scents, by slot.

    Only scents count that are stored for the step and compared with a single number, which must be equal for all agents."""
    uniform = {slot: node for node, slot in compiler.uniform_slots.items()}
    readers: dict[int, list[BlockInstruction]] = {}
    scents: list[int] = []
    for each in _all_instructions(compiler.root_scope):
        if each.kind is not InstructionKind.GATHER:  # a gather has the slot of its source
            for slot in (*each.inputs, each.result):
                readers.setdefault(schedule.resolve_slot(slot), []).append(each)
        if (
            each.kind is InstructionKind.CACHED_SENSE
            and _operation_name(each) == "field.strongest"
            and each.slot not in schedule.stored_slots
        ):
            scents.append(each.slot)
    scent_bounds = {}
    for scent in scents:
        parts = readers.get(scent, [])
        numbers = {schedule.resolve_slot(part.slot) for part in parts}
        compared = [by for number in numbers for by in readers.get(number, [])]
        if (
            not compared
            or not all(_is_strength_part(part) for part in parts)
            or not all(_operation_name(by) in _COMPARISON_OPERATIONS for by in compared)
        ):
            continue
        others = {schedule.resolve_slot(slot) for by in compared for slot in by.inputs} - numbers
        if len(others) == 1 and (slot := others.pop()) in uniform:
            scent_bounds[scent] = uniform[slot]
    return scent_bounds


def _operation_name(instruction: BlockInstruction) -> str:
    return instruction.subject.op if isinstance(instruction.subject, ir.PlanNode) else ""


def _is_strength_part(instruction: BlockInstruction) -> bool:
    """Return whether an instruction selects the strength from the result of `field.strongest`."""
    return (
        instruction.kind is InstructionKind.VALUE
        and isinstance(instruction.subject, ir.PlanNode)
        and instruction.subject.op == "get"
        and instruction.subject.attrs[0] == _STRENGTH_PART
    )


def _all_instructions(scope: RowScope) -> Iterator[BlockInstruction]:
    for each in scope.code:
        yield each
        if each.inner is not None:
            yield from _all_instructions(each.inner)
