"""Measures the time of machine code by source line. Where code of another source line begins, a mark reads the processor's time
counter. Only code that is compiled for timing has marks (`programs.WorldFacts`). The time between two marks is added to the
counter of the line between them. The total duration of the functions is used to convert counters to seconds. If several lines
share a call, its time counts for the line at which it is in the code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels.ir import BasicBlock
from antdsl.machine_code.kernels.values import Number
from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import I64
from antdsl.runtime.backends.block_compiler import BlockCompiler, BlockInstruction
from antdsl.runtime.backends.metering import list_scope_instructions

if TYPE_CHECKING:
    from antdsl.runtime.backends.native.block_writer import FunctionWriter


class LineCounters:
    """The time counters of a block. Each layer has one counter per source line. Counter 0 is for instructions without a line.

    `number_by_instruction`: the index of each instruction in `BlockCallMeter.instructions`. `instruction_numbers`: for each
    counter, the index of an instruction on its line, -1 for none."""

    def __init__(self, compiler: BlockCompiler) -> None:
        self.number_by_instruction = {each: k for k, each in enumerate(list_scope_instructions(compiler.root_scope))}
        self.instruction_numbers = [-1]
        self._counters: dict[tuple[str, int, int], int] = {}

    def find_counter(self, instruction: BlockInstruction) -> int:
        """Return the number of the counter for the line of an instruction. Create the counter if the line has none."""
        span = instruction.span
        place = ("", 0) if span is None else (span.source.path, span.source.find_line_column(span.start)[0])
        key = (*place, instruction.layer)
        if key not in self._counters:
            self._counters[key] = len(self.instruction_numbers)
            self.instruction_numbers.append(self.number_by_instruction[instruction])
        return self._counters[key]


class _TimeMarkWriter:
    """A writer that inserts marks into a function, between instructions with different time counters."""

    def __init__(self, w: FunctionWriter) -> None:
        self.builder, self._ticks, self._last_time_slot = w.builder, w.emit_array_address("ticks"), w.builder.allocate_slot(I64)
        self._needs_fence = w.module.target.is_x86
        self._pending_slots: dict[str, Number] = {}  # stack slots that hold values, by type
        self._mark_end = 0  # index in the block after the last mark

    def write_time_marks(self) -> None:
        """Insert the marks into all basic blocks of the function."""
        e, blocks = self.builder, self.builder.blocks
        e.blocks, e.current_block = blocks[:1], BasicBlock(blocks[0].label, [])
        e.blocks[0] = e.current_block
        e.store_number(self._last_time_slot, self._read_counter())
        current = 0
        for k, block in enumerate(blocks):
            if k:
                e.begin_block(block.label)
            self._mark_end = len(e.current_block.body)
            for each in block.body:
                if each.line != current:
                    self._add_ticks(current)
                    current = each.line
                e.current_block.body.append(each)
        self._add_ticks(current)

    def _add_ticks(self, number: int) -> None:
        """Emit code that adds the time since the previous mark to counter `number`."""
        e = self.builder
        self._store_pending()
        last, now = e.load(self._last_time_slot, I64), self._read_counter()
        passed, place = now - last, e.address(self._ticks, number, I64)
        e.store_number(place, e.load(place, I64) + passed)
        e.store_number(self._last_time_slot, now)
        self._add_barrier(now)

    def _read_counter(self) -> Lanes:
        """Emit code that reads the processor's time counter. Return the value. The code waits for earlier instructions first.
        Otherwise slow operations (divisions, roots) would count for a later line."""
        if self._needs_fence:
            self.builder.emit_void("wait")
        return self.builder.op("ticks", I64, lanes=1)

    def _store_pending(self) -> None:
        """Store all values that are not used yet, so that they are computed before the mark.

        LLVM does not move these stores past the mark. Without them, it would move the computations to where the values are used,
        in another line."""
        written = self.builder.current_block.body[self._mark_end :]
        read = {operand.name for each in written for operand in each.operands}
        for value in [each.result for each in written if each.result is not None and each.result.name not in read]:
            if value.type not in self._pending_slots:
                self._pending_slots[value.type] = self.builder.allocate_slot(value.kind, value.lanes)
            self.builder.emit_void("volatile", value, self._pending_slots[value.type])

    def _add_barrier(self, count: Lanes) -> None:
        """Prevent LLVM from moving later operations before this point.

        LLVM reorders instructions only within a basic block, and a branch that it cannot predict starts a new block. `count` is
        never 0, but LLVM cannot know this."""
        e, never, following = self.builder, self.builder.make_label("never"), self.builder.make_label("marked")
        e.branch(count != 0, following, never)
        e.begin_block(never)
        e.emit_void("border")
        e.jump(following)
        e.begin_block(following)
        self._mark_end = 0


def add_time_marks(w: FunctionWriter) -> None:
    """Add time marks to a function that is complete except for its end."""
    _TimeMarkWriter(w).write_time_marks()


@dataclass(slots=True, eq=False)
class LineTimeCounters:
    """The times of one part of a block in one run of the block.

    `ticks`: the time counters by source line, in ticks of the processor, written by machine code. `counters`: the times by
    instruction, from `BlockCallMeter.make_counters`. `seconds`: the total time of the functions."""

    line_counters: LineCounters
    ticks: NDArray[np.int64]
    counters: list[float]
    seconds: float = 0.0

    def __post_init__(self) -> None:
        self.ticks[:] = 0

    def add_call_time(self, instruction: BlockInstruction, seconds: float) -> None:
        """Add `seconds` to the time of an instruction that runs without machine code."""
        self._add_seconds(self.line_counters.number_by_instruction[instruction], seconds)

    def distribute_to_lines(self) -> None:
        """Divide the time of the functions among the source lines, in proportion to their ticks."""
        ticks = np.maximum(self.ticks, 0)  # counters of two processors may differ
        to_seconds = self.seconds / max(int(ticks.sum()), 1)
        for number, count in zip(self.line_counters.instruction_numbers, ticks.tolist(), strict=True):
            if number >= 0:
                self._add_seconds(number, count * to_seconds)

    def _add_seconds(self, number: int, seconds: float) -> None:
        self.counters[number] += seconds
        self.counters[-1] += seconds
