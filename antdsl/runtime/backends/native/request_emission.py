"""Machine code for agents' requests to the world. Deposits are added directly to cells.

All other requests are written to lists, one per statement, in row order."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.pheromone import DEPOSIT_QUANTUM, MAX_DEPOSIT
from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import F32, F64, FLOAT_KINDS, I8, I32, I64, LANE_COUNT
from antdsl.plan import ir
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.runtime.backends.block_compiler import BlockInstruction
from antdsl.runtime.backends.native.block_writer import BlockWriter
from antdsl.runtime.backends.native.native_senses import prefetch_cell_amounts
from antdsl.runtime.requests import ClaimEntry, EffectRequests, GiftEntry, RequestEntry


def _emit_deposit(b: BlockWriter, instruction: BlockInstruction, statement: ir.Request) -> None:
    """Emit code that deposits amounts in cells, with the same result as `fields.pheromone.PheromoneField.deposit`."""
    e, mask, name = b.builder, b.mask[-1], statement.target
    amount: Lanes = b.find_slot_value(instruction.inputs[0])
    mask = _emit_finite_check(b, mask, amount, EFFECT_BY_OPERATION[statement.op].fault_name.format(of=name), instruction)
    cell = e.load_lanes(b.emit_array_address("cell", name), b.row, I32)
    laid = mask & (cell >= 0) & (amount != 0)
    prefetch_cell_amounts(b, name, b.emit_array_address("field", name, "pending_deposits"), 8)
    with e.write_if(e.any_lane(laid)):
        wide = e.emit_clamp(e.convert(amount, F64), e.make_constant(-MAX_DEPOSIT, F64), e.make_constant(MAX_DEPOSIT, F64))
        amounts, cells = e.allocate_slot(I64, LANE_COUNT), e.allocate_slot(I32, LANE_COUNT)
        e.store_number(amounts, e.to_int64(wide / DEPOSIT_QUANTUM))
        e.store_number(cells, cell)
        bits = e.mask_to_i64(laid)
        pending = b.emit_array_address("field", name, "pending_deposits")
        with e.write_loop(LANE_COUNT) as lane, e.write_if(e.emit_bit_test(bits, lane)):
            at, increment = e.load_scalar(cells, lane, I32), e.load_scalar(amounts, lane, I64)
            place = e.address(pending, e.convert(at, I64), I64)
            adds = b.field_combination(name) == "add"
            together = b.emit_uniform_value(I64, "threads", is_scalar=True)
            with e.write_if(together > 1):
                e.op("atomic.add" if adds else "atomic.max", I64, place, increment)
            with e.write_if(together <= 1):
                old_value = e.load(place, I64)
                e.store_number(
                    place, old_value + increment if adds else e.select_lanes(increment > old_value, increment, old_value)
                )
        e.store_number(b.emit_array_address("laid", name), e.make_constant(1, I8, 1))


def _emit_list_append(b: BlockWriter, instruction: BlockInstruction, mask: Lanes, values: list[Lanes]) -> None:
    """Emit code that appends to a statement's list: the rows of those of eight agents that are in `mask`, and their `values`."""
    e, number = b.builder, len(b.code.list_instructions)
    b.code.list_instructions.append(instruction)
    with e.write_if(e.any_lane(mask)):
        stored = [e.to_stored_form(value) for value in values]
        columns = [
            b.emit_stage_array_address(-1 - number, part, kind)
            for part, kind in enumerate((I64, *(value.kind for value in values)))
        ]
        slots = []
        for value in stored:
            slots.append(e.allocate_slot(value.kind, LANE_COUNT))
            e.store_number(slots[-1], value)
        left = e.allocate_slot(I64)
        bits = e.mask_to_i64(mask)
        e.store_number(left, bits)
        total = e.address(b.emit_array_address("counts"), 1 + number, I64)
        old_total = e.load(total, I64)
        count = e.op("ctpop", I64, bits)
        with e.write_loop(count) as k:
            rest = e.load(left, I64)
            lane = e.op("cttz", I64, rest)
            e.store_number(left, rest & (rest - 1))
            at = old_total + k
            e.store_number(e.address(columns[0], at, I64), b.row + lane)
            for column, place, value in zip(columns[1:], slots, stored, strict=True):
                e.store_number(e.address(column, at, value.kind), e.load_scalar(place, lane, value.kind))
        e.store_number(total, old_total + count)


def _emit_finite_check(b: BlockWriter, mask: Lanes, amount: Lanes, value_name: str, instruction: BlockInstruction) -> Lanes:
    """Return a mask of the agents in `mask` with a finite `amount`. Emit code that records a fault for the others."""
    good: Lanes = np.isfinite(amount)
    b.write_fault_record(mask & ~good, value_name, instruction)
    return mask & good


def _emit_world_request(b: BlockWriter, instruction: BlockInstruction, statement: ir.Request) -> None:
    """Emit code that appends a request to the statement's list, with the same result as in `numpy_statements`."""
    row, slots = EFFECT_BY_OPERATION[statement.op], iter(instruction.inputs)
    args: list[Lanes] = [b.find_slot_value(next(slots)) for node in statement.args if node is not None]
    mask = b.mask[-1]
    numbers = [arg for arg in args if arg.kind in FLOAT_KINDS] if row.fault_name else []
    if numbers:
        good = np.isfinite(numbers[0])
        for arg in numbers[1:]:
            good = good & np.isfinite(arg)
        b.write_fault_record(mask & ~good, row.fault_name.format(of=statement.target), instruction)
        mask = mask & good
    if row.needs_positive_operand and statement.args[0] is not None:
        mask = mask & (args[0] > 0)
    _emit_list_append(b, instruction, mask, args)


def _emit_claim(b: BlockWriter, instruction: BlockInstruction, statement: ir.Claim) -> None:
    """Emit code that appends a claim to the statement's list, with the same result as in `numpy_statements`."""
    e, mask, slots = b.builder, b.mask[-1], iter(instruction.inputs)
    item: Lanes = (
        e.load_lanes(b.emit_array_address("cell", statement.target), b.row, I32)
        if statement.item is None
        else b.find_slot_value(next(slots))
    )
    amount = e.make_constant(np.inf, F32)
    if statement.amount is not None:
        amount = b.find_slot_value(next(slots))
        mask = _emit_finite_check(b, mask, amount, f"take {statement.attribute or statement.target}", instruction)
    _emit_list_append(b, instruction, mask, [item, amount])


def _emit_gift(b: BlockWriter, instruction: BlockInstruction, statement: ir.Give) -> None:
    """Emit code that appends a gift to the statement's list, with the same result as in `numpy_statements`."""
    e, mask, own = b.builder, b.mask[-1], b.emit_array_address("now", statement.register)
    item: Lanes = b.find_slot_value(instruction.inputs[0])
    had = e.load_lanes(own, b.row, F32)
    amount = had
    if statement.amount is not None:
        amount = b.find_slot_value(instruction.inputs[1])
        mask = _emit_finite_check(b, mask, amount, f"give {statement.register}", instruction)
    is_valid = mask & (item >= 0) & (item < b.emit_uniform_value(I32, "items", statement.items))
    zero = e.make_constant(0.0, F32)
    most = e.select_lanes(had > zero, had, zero)
    cut = e.select_lanes(amount > zero, amount, zero)
    left = had - e.select_lanes(cut < most, cut, most) + zero
    e.store_masked(is_valid, own, b.row, left)
    _emit_list_append(b, instruction, is_valid, [item, e.convert(had, F64) - e.convert(left, F64)])


def emit_request(b: BlockWriter, instruction: BlockInstruction) -> None:
    """Emit the code of a statement that requests something from the world."""
    match instruction.subject:
        case ir.Request(op="deposit") as what:
            _emit_deposit(b, instruction, what)
        case ir.Request() as what:
            _emit_world_request(b, instruction, what)
        case ir.Claim() as what:
            _emit_claim(b, instruction, what)
        case ir.Give() as what:
            _emit_gift(b, instruction, what)


def record_request(instruction: BlockInstruction, columns: Sequence[NDArray[Any]], effects: EffectRequests) -> None:
    """Add the content of a statement's list to the effects of a step. `columns`: the rows, followed by their stored values."""
    what = instruction.subject
    match what:
        case ir.Claim():
            rows, item, amount = columns
            effects.claims.append(ClaimEntry(what, instruction.statement_order, rows, item, amount))
        case ir.Give():
            _, item, amount = columns
            effects.gifts.append(GiftEntry(what, item, amount))
        case ir.Request():
            rest = iter(columns[1:])
            args = tuple(None if node is None else next(rest) for node in what.args)
            effects.add_request(RequestEntry(what, instruction.statement_order, columns[0], args))
