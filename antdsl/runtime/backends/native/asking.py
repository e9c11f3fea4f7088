"""What agents ask of the world, as machine code: scent that is laid goes straight into its cells, all else is written down in
lists, one for each statement, with those who ask in the order of their rows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.pheromone import LARGEST_DEPOSIT, UNIT
from antdsl.machine_code.lanes import BOOL, F32, F64, FLOATS, I8, I32, I64, PTR, WIDTH, Lanes
from antdsl.plan import ir
from antdsl.program.tables.effects import EFFECTS
from antdsl.runtime.backends.compile import Instruction
from antdsl.runtime.backends.native.block import BlockWriter
from antdsl.runtime.backends.native.senses import fetch_ahead
from antdsl.runtime.requests import Asked, ClaimEntry, Effects, GiveEntry

_WHOLE = 6755399441055744.0  # 1.5 * 2**52: in a sum with it a whole number stands in the last bits


def _deposit(b: BlockWriter, each: Instruction, what: ir.Request) -> None:
    """As `fields.pheromone.PheromoneField.deposit`: whole numbers of a unit, which add in any order."""
    e, mask, name = b.e, b.mask[-1], what.of
    amount: Lanes = b.slot(each.inputs[0])
    mask = _sound(b, mask, amount, EFFECTS[what.op].refused.format(of=name), what.span)
    cell = e.load(b.base("cell", name), b.row, I32)
    laid = mask & (cell >= 0) & (amount != 0)
    fetch_ahead(b, name, b.base("field", name, "pending"), 8)
    with e.inside(e.some(laid)):
        wide = e.between(e.convert(amount, F64), e.constant(-LARGEST_DEPOSIT, F64), e.constant(LARGEST_DEPOSIT, F64))
        unit = np.rint(wide / UNIT) + _WHOLE
        whole = e.bits(unit, I64) - e.bits(e.constant(_WHOLE, F64), I64)
        amounts, cells = e.slot(I64), e.slot(I32)
        e.put(amounts, whole)
        e.put(cells, cell)
        bits = e.one(f"zext i8 {e.mask_bits(laid).name} to i64", I64)
        pending = b.base("field", name, "pending")
        with e.loop(e.constant(WIDTH, I64, one=True)) as lane:
            bit = e.one(f"lshr i64 {bits.name}, {lane.name}", I64)
            with e.inside(e.one(f"trunc i64 {bit.name} to i1", BOOL)):
                at = e.load_one(Lanes(e, PTR, cells, one=True), lane, I32)
                more = e.load_one(Lanes(e, PTR, amounts, one=True), lane, I64)
                place = e.address(pending, e.convert(at, I64), I64).name
                word = "add" if b.combine(name) == "add" else "max"
                together = b.number(I64, "threads", one=True)
                with e.inside(e.one(f"icmp sgt i64 {together.name}, 1", BOOL)):
                    e.one(f"atomicrmw {word} ptr {place}, i64 {more.name} monotonic", I64)
                with e.inside(e.one(f"icmp sle i64 {together.name}, 1", BOOL)):
                    before = e.get(place, I64, one=True)
                    if word == "add":
                        after = e.one(f"add i64 {before.name}, {more.name}", I64)
                    else:
                        larger = e.one(f"icmp sgt i64 {more.name}, {before.name}", BOOL)
                        after = e.one(f"select i1 {larger.name}, i64 {more.name}, i64 {before.name}", I64)
                    e.put(place, after)
        e.do(f"store i8 1, ptr {b.base('laid', name).name}")


def _write_down(b: BlockWriter, each: Instruction, mask: Lanes, values: list[Lanes]) -> None:
    """Append the rows of those of eight agents for whom a condition holds to a statement's list, and a value of each beside."""
    e, number = b.e, len(b.code.lists)
    b.code.lists.append(each)
    with e.inside(e.some(mask)):
        stored = [e.convert(value, I8) if value.kind == BOOL else value for value in values]
        columns = [b.array(-1 - number, part, kind) for part, kind in enumerate((I64, *(value.kind for value in values)))]
        places = []
        for value in stored:
            places.append(e.slot(value.kind))
            e.put(places[-1], value)
        left = e.slot(I64, one=True)
        bits = e.one(f"zext i8 {e.mask_bits(mask).name} to i64", I64)
        e.put(left, bits)
        total = e.address(b.base("counts"), e.constant(1 + number, I64, one=True), I64)
        before = e.get(total.name, I64, one=True)
        more = e.intrinsic("ctpop", bits)
        e.module.declare("llvm.cttz.i64", I64, [I64, BOOL])
        with e.loop(more) as k:
            rest = e.get(left, I64, one=True)
            lane = e.one(f"call i64 @llvm.cttz.i64(i64 {rest.name}, i1 true)", I64)
            less = e.one(f"sub i64 {rest.name}, 1", I64)
            e.put(left, e.one(f"and i64 {rest.name}, {less.name}", I64))
            at = e.one(f"add i64 {before.name}, {k.name}", I64)
            e.put(e.address(columns[0], at, I64).name, e.one(f"add i64 {b.row.name}, {lane.name}", I64))
            for column, place, value in zip(columns[1:], places, stored, strict=True):
                single = e.load_one(Lanes(e, PTR, place, one=True), lane, value.kind)
                e.put(e.address(column, at, value.kind).name, single)
        e.put(total.name, e.one(f"add i64 {before.name}, {more.name}", I64))


def _sound(b: BlockWriter, mask: Lanes, amount: Lanes, what: str, span: Any) -> Lanes:
    """Those of some agents whose amount is a finite number; the others are at fault."""
    good: Lanes = np.isfinite(amount)
    b.refuse(mask & ~good, what, span)
    return mask & good


def _request(b: BlockWriter, each: Instruction, what: ir.Request) -> None:
    """As `numpy_statements` asks."""
    row, slots = EFFECTS[what.op], iter(each.inputs)
    args: list[Lanes] = [b.slot(next(slots)) for node in what.args if node is not None]
    mask = b.mask[-1]
    numbers = [arg for arg in args if arg.kind in FLOATS] if row.refused else []
    if numbers:
        good = np.isfinite(numbers[0])
        for arg in numbers[1:]:
            good = good & np.isfinite(arg)
        b.refuse(mask & ~good, row.refused.format(of=what.of), what.span)
        mask = mask & good
    if row.above_0 and what.args[0] is not None:
        mask = mask & (args[0] > 0)
    _write_down(b, each, mask, args)


def _claim(b: BlockWriter, each: Instruction, what: ir.Claim) -> None:
    e, mask, slots = b.e, b.mask[-1], iter(each.inputs)
    item: Lanes = e.load(b.base("cell", what.of), b.row, I32) if what.item is None else b.slot(next(slots))
    amount = e.constant(np.inf, F32)
    if what.amount is not None:
        amount = b.slot(next(slots))
        mask = _sound(b, mask, amount, f"take {what.attribute or what.of}", what.span)
    _write_down(b, each, mask, [item, amount])


def _give(b: BlockWriter, each: Instruction, what: ir.Give) -> None:
    e, mask, own = b.e, b.mask[-1], b.base("now", what.own)
    item: Lanes = b.slot(each.inputs[0])
    had = e.load(own, b.row, F32)
    amount = had
    if what.amount is not None:
        amount = b.slot(each.inputs[1])
        mask = _sound(b, mask, amount, f"give {what.own}", what.span)
    there = mask & (item >= 0) & (item < b.number(I32, "items", what.items))
    zero = e.constant(0.0, F32)
    most = e.where(had > zero, had, zero)
    cut = e.where(amount > zero, amount, zero)
    left = had - e.where(cut < most, cut, most) + zero
    e.store_where(there, own, b.row, left)
    _write_down(b, each, there, [item, e.convert(had, F64) - e.convert(left, F64)])


def ask(b: BlockWriter, each: Instruction) -> None:
    """Emit a statement that asks for something."""
    match each.what:
        case ir.Request(op="deposit") as what:
            _deposit(b, each, what)
        case ir.Request() as what:
            _request(b, each, what)
        case ir.Claim() as what:
            _claim(b, each, what)
        case ir.Give() as what:
            _give(b, each, what)


def asked(each: Instruction, columns: Sequence[NDArray[Any]], effects: Effects) -> None:
    """Put what a statement's list holds to the effects of a step: rows, then what was written down beside them."""
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
            effects.ask(Asked(what, each.order, columns[0], args))
