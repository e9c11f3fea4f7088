"""Faster reads of field values that a program only compares with a threshold. If no nearby cell reaches the threshold, no cell is
read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import BOOL, I32
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockCompiler, BlockInstruction, InstructionKind, RowScope
from antdsl.runtime.backends.native.stage_schedule import StageSchedule

_STRENGTH_INDEX_IN_RESULT = 0  # index of the strength in the result of `field.strongest`
_COMPARISON_OPERATIONS = frozenset(("lt", "le", "gt", "ge"))


def emit_own_cell(w: Any, field: str) -> Lanes:
    """Return the field cell in which each of the eight agents is. An agent without a cell gets the number of cells."""
    cell = w.builder.load_lanes(w.emit_array_address("cell", field), w.row, I32)
    cell_number: Lanes = w.builder.select_lanes(cell < 0, w.emit_uniform_value(I32, "cells", field), cell)
    return cell_number


def emit_may_reach_threshold(w: Any, node: ir.PlanNode, bound: ir.PlanNode) -> Lanes:
    """Return a mask of the agents that have a cell nearby in which the field may reach the threshold. `bound`: the node of the
    threshold."""

    def load_reached() -> Lanes:
        is_reached: Lanes = w.builder.gather(
            w.emit_array_address("reached", *node.attrs, bound), emit_own_cell(w, node.attrs[0]), BOOL
        )
        return is_reached

    may: Lanes = w.builder.get_or_make(("reached", *node.attrs, bound), load_reached)
    return may


def emit_limited_strength(w: Any, node: ir.PlanNode, bound: ir.PlanNode, stored_strength: Lanes) -> Lanes:
    """Return `stored_strength` for agents near a cell that may reach the threshold, and 0 for all others.

    For the others, the strength is below the threshold in any case, so the comparison gives the same result."""
    bounded_strength: Lanes = w.builder.select_lanes(
        emit_may_reach_threshold(w, node, bound), stored_strength, w.builder.make_constant(0.0, stored_strength.kind)
    )
    return bounded_strength


def find_scent_thresholds(compiler: BlockCompiler, schedule: StageSchedule) -> dict[int, ir.PlanNode]:
    """Return the node of the threshold with which each scent is compared, by the scent's slot.

    Included are only scents that are stored for the step, and thresholds that are one number, equal for all agents."""
    uniform = {slot: node for node, slot in compiler.uniform_slots.items()}
    readers: dict[int, list[BlockInstruction]] = {}
    scents: list[int] = []
    for each in _iterate_instructions(compiler.root_scope):
        if each.kind is not InstructionKind.GATHER:  # a gather has the slot of its source
            for slot in (*each.inputs, each.inner_result_slot):
                readers.setdefault(schedule.resolve_slot(slot), []).append(each)
        if (
            each.kind is InstructionKind.CACHED_SENSE
            and _get_operation_name(each) == "field.strongest"
            and each.slot not in schedule.stored_slots
        ):
            scents.append(each.slot)
    scent_thresholds = {}
    for scent in scents:
        parts = readers.get(scent, [])
        numbers = {schedule.resolve_slot(part.slot) for part in parts}
        compared = [by for number in numbers for by in readers.get(number, [])]
        if (
            not compared
            or not all(_is_strength_result(part) for part in parts)
            or not all(_get_operation_name(by) in _COMPARISON_OPERATIONS for by in compared)
        ):
            continue
        others = {schedule.resolve_slot(slot) for by in compared for slot in by.inputs} - numbers
        if len(others) == 1 and (slot := others.pop()) in uniform:
            scent_thresholds[scent] = uniform[slot]
    return scent_thresholds


def _get_operation_name(instruction: BlockInstruction) -> str:
    return instruction.subject.op if isinstance(instruction.subject, ir.PlanNode) else ""


def _is_strength_result(instruction: BlockInstruction) -> bool:
    """Return whether an instruction extracts the strength from the result of `field.strongest`."""
    return (
        instruction.kind is InstructionKind.VALUE
        and isinstance(instruction.subject, ir.PlanNode)
        and instruction.subject.op == "get"
        and instruction.subject.attrs[0] == _STRENGTH_INDEX_IN_RESULT
    )


def _iterate_instructions(scope: RowScope) -> Iterator[BlockInstruction]:
    for each in scope.code:
        yield each
        if each.inner_scope is not None:
            yield from _iterate_instructions(each.inner_scope)
