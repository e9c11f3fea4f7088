"""What agents ask of the world, settled by machine code itself: scent that is laid goes straight into its cells."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from antdsl.fields.pheromone import LARGEST_DEPOSIT, UNIT
from antdsl.machine_code.lanes import BOOL, F64, I32, I64, PTR, WIDTH, Lanes
from antdsl.plan import ir
from antdsl.program.tables.effects import EFFECTS
from antdsl.runtime.backends.compile import Instruction
from antdsl.runtime.backends.native.block import BlockWriter

_WHOLE = 6755399441055744.0  # 1.5 * 2**52: in a sum with it a whole number stands in the last bits


def _deposit(b: BlockWriter, each: Instruction, what: ir.Request) -> None:
    """As `fields.pheromone.PheromoneField.deposit`: whole numbers of a unit, which add in any order."""
    e, mask, name = b.e, b.mask[-1], what.of
    amount: Lanes = b.slot(each.inputs[0])
    good = np.isfinite(amount)
    b.refuse(mask & ~good, EFFECTS[what.op].refused.format(of=name), what.span)
    cell = e.load(b.base("cell", name), b.row, I32)
    laid = mask & good & (cell >= 0) & (amount != 0)
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
                before = e.get(place, I64, one=True)
                if b.combine(name) == "add":
                    after = e.one(f"add i64 {before.name}, {more.name}", I64)
                else:
                    larger = e.one(f"icmp sgt i64 {more.name}, {before.name}", BOOL)
                    after = e.one(f"select i1 {larger.name}, i64 {more.name}, i64 {before.name}", I64)
                e.put(place, after)
        e.do(f"store i8 1, ptr {b.base('laid', name).name}")


# By the op of an effect: what its lines become in machine code; others are asked for once the block has run.
ASKING: Mapping[str, Callable[[BlockWriter, Instruction, ir.Request], None]] = {"deposit": _deposit}
