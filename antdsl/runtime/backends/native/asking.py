"""Machine code for agents' requests to the world. Deposits are added directly to cells.

All other requests are written to lists, one per statement, in the order of the agents' rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.pheromone import DEPOSIT_UNIT, MAX_DEPOSIT
from antdsl.machine_code.kinds import F32, F64, FLOAT_KINDS, I8, I32, I64, LANE_COUNT
from antdsl.machine_code.lanes import Lanes
from antdsl.plan import ir
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.runtime.backends.compile import BlockInstruction
from antdsl.runtime.backends.native.block import BlockWriter
from antdsl.runtime.backends.native.senses import prefetch_cells
from antdsl.runtime.requests import ClaimEntry, EffectRequests, GiveEntry, RequestEntry


def _deposit(b: BlockWriter, each: BlockInstruction, what: ir.Request) -> None:
    """Emit a deposit, with the result of `fields.pheromone.PheromoneField.deposit`: whole multiples of a unit, which add in
    any order."""
    e, mask, name = b.e, b.mask[-1], what.of
    amount: Lanes = b.slot(each.inputs[0])
    mask = _check_finite(b, mask, amount, EFFECT_BY_OPERATION[what.op].refused.format(of=name), each)
    cell = e.read(b.base("cell", name), b.row, I32)
    laid = mask & (cell >= 0) & (amount != 0)
    prefetch_cells(b, name, b.base("field", name, "pending"), 8)
    with e.inside(e.any_lane(laid)):
        wide = e.clamp(e.convert(amount, F64), e.constant(-MAX_DEPOSIT, F64), e.constant(MAX_DEPOSIT, F64))
        amounts, cells = e.slot(I64, LANE_COUNT), e.slot(I32, LANE_COUNT)
        e.put(amounts, e.rounded_bits(wide / DEPOSIT_UNIT))
        e.put(cells, cell)
        bits = e.mask_word(laid)
        pending = b.base("field", name, "pending")
        with e.loop(LANE_COUNT) as lane, e.inside(e.has_bit(bits, lane)):
            at, increment = e.read_one(cells, lane, I32), e.read_one(amounts, lane, I64)
            place = e.address(pending, e.convert(at, I64), I64)
            adds = b.combine(name) == "add"
            together = b.number(I64, "threads", one=True)
            with e.inside(together > 1):
                e.op("atomic.add" if adds else "atomic.max", I64, place, increment)
            with e.inside(together <= 1):
                old_value = e.load(place, I64)
                e.put(place, old_value + increment if adds else e.where(increment > old_value, increment, old_value))
        e.put(b.base("laid", name), e.constant(1, I8, 1))


def _append_rows(b: BlockWriter, each: BlockInstruction, mask: Lanes, values: list[Lanes]) -> None:
    """Emit code that appends to a statement's list: the rows of eight agents for which a condition holds, and their `values`."""
    e, number = b.e, len(b.code.lists)
    b.code.lists.append(each)
    with e.inside(e.any_lane(mask)):
        stored = [e.as_stored(value) for value in values]
        columns = [b.array(-1 - number, part, kind) for part, kind in enumerate((I64, *(value.kind for value in values)))]
        slots = []
        for value in stored:
            slots.append(e.slot(value.kind, LANE_COUNT))
            e.put(slots[-1], value)
        left = e.slot(I64)
        bits = e.mask_word(mask)
        e.put(left, bits)
        total = e.address(b.base("counts"), 1 + number, I64)
        old_total = e.load(total, I64)
        count = e.op("ctpop", I64, bits)
        with e.loop(count) as k:
            rest = e.load(left, I64)
            lane = e.op("cttz", I64, rest)
            e.put(left, rest & (rest - 1))
            at = old_total + k
            e.put(e.address(columns[0], at, I64), b.row + lane)
            for column, place, value in zip(columns[1:], slots, stored, strict=True):
                e.put(e.address(column, at, value.kind), e.read_one(place, lane, value.kind))
        e.put(total, old_total + count)


def _check_finite(b: BlockWriter, mask: Lanes, amount: Lanes, what: str, by: BlockInstruction) -> Lanes:
    """Return the mask of agents with a finite amount; record a fault for the others."""
    good: Lanes = np.isfinite(amount)
    b.refuse(mask & ~good, what, by)
    return mask & good


def _request(b: BlockWriter, each: BlockInstruction, what: ir.Request) -> None:
    """Emit a request, with the result of `numpy_statements`."""
    row, slots = EFFECT_BY_OPERATION[what.op], iter(each.inputs)
    args: list[Lanes] = [b.slot(next(slots)) for node in what.args if node is not None]
    mask = b.mask[-1]
    numbers = [arg for arg in args if arg.kind in FLOAT_KINDS] if row.refused else []
    if numbers:
        good = np.isfinite(numbers[0])
        for arg in numbers[1:]:
            good = good & np.isfinite(arg)
        b.refuse(mask & ~good, row.refused.format(of=what.of), each)
        mask = mask & good
    if row.above_0 and what.args[0] is not None:
        mask = mask & (args[0] > 0)
    _append_rows(b, each, mask, args)


def _claim(b: BlockWriter, each: BlockInstruction, what: ir.Claim) -> None:
    """Emit a claim, with the result of `numpy_statements`."""
    e, mask, slots = b.e, b.mask[-1], iter(each.inputs)
    item: Lanes = e.read(b.base("cell", what.of), b.row, I32) if what.item is None else b.slot(next(slots))
    amount = e.constant(np.inf, F32)
    if what.amount is not None:
        amount = b.slot(next(slots))
        mask = _check_finite(b, mask, amount, f"take {what.attribute or what.of}", each)
    _append_rows(b, each, mask, [item, amount])


def _give(b: BlockWriter, each: BlockInstruction, what: ir.Give) -> None:
    """Emit a gift, with the result of `numpy_statements`."""
    e, mask, own = b.e, b.mask[-1], b.base("now", what.own)
    item: Lanes = b.slot(each.inputs[0])
    had = e.read(own, b.row, F32)
    amount = had
    if what.amount is not None:
        amount = b.slot(each.inputs[1])
        mask = _check_finite(b, mask, amount, f"give {what.own}", each)
    is_valid = mask & (item >= 0) & (item < b.number(I32, "items", what.items))
    zero = e.constant(0.0, F32)
    most = e.where(had > zero, had, zero)
    cut = e.where(amount > zero, amount, zero)
    left = had - e.where(cut < most, cut, most) + zero
    e.write_where(is_valid, own, b.row, left)
    _append_rows(b, each, is_valid, [item, e.convert(had, F64) - e.convert(left, F64)])


def ask(b: BlockWriter, each: BlockInstruction) -> None:
    """Emit a statement that requests something from the world."""
    match each.what:
        case ir.Request(op="deposit") as what:
            _deposit(b, each, what)
        case ir.Request() as what:
            _request(b, each, what)
        case ir.Claim() as what:
            _claim(b, each, what)
        case ir.Give() as what:
            _give(b, each, what)


def record_request(each: BlockInstruction, columns: Sequence[NDArray[Any]], effects: EffectRequests) -> None:
    """Add the contents of a statement's list to the effects of a step. `columns`: rows, then the values stored for them."""
    what = each.what
    match what:
        case ir.Claim():
            rows, item, amount = columns
            effects.claims.append(ClaimEntry(what, each.order, rows, item, amount))
        case ir.Give():
            _, item, amount = columns
            effects.gives.append(GiveEntry(what, item, amount))
        case ir.Request():
            rest = iter(columns[1:])
            args = tuple(None if node is None else next(rest) for node in what.args)
            effects.ask(RequestEntry(what, each.order, columns[0], args))
