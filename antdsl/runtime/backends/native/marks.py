"""Times machine code by line: marks in it read the processor's counter where the line that is worked out changes.

Only code that somebody measures has them (`programs.Facts.timed`). What passes between two marks is added to the counter of the
line before the later one; counters become seconds by the time that the functions took. What a line calls, such as a search that
finds what several lines ask, counts for the line where it stands in the code."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.lanes import BOOL, I64, PTR, Lanes
from antdsl.machine_code.line_marks import NO_MARKS, Marks
from antdsl.runtime.backends.compile import BlockCompiler, Instruction
from antdsl.runtime.backends.metering import instructions_of

if TYPE_CHECKING:
    from antdsl.runtime.backends.native.block import Writer

_COUNTER = "llvm.readcyclecounter"
_FENCE = "llvm.x86.sse2.lfence"  # waits for all instructions before it, which are at work side by side
_NAMES = re.compile(r"%[\w.]+")


class Lines:
    """Counters of a block: one for each line of the text within each layer, the first for what belongs to none. `numbers` are the
    places of instructions among those of `Metered`; `told` has for each counter that of one whose line it is, -1 for none."""

    def __init__(self, compiler: BlockCompiler) -> None:
        self.numbers = {each: k for k, each in enumerate(instructions_of(compiler.root))}
        self.told = [-1]
        self._counters: dict[tuple[str, int, int], int] = {}

    def counter(self, instruction: Instruction) -> int:
        """That of an instruction's line."""
        span = instruction.span
        place = ("", 0) if span is None else (span.source.path, span.source.line_column(span.start)[0])
        key = (*place, instruction.layer)
        if key not in self._counters:
            self._counters[key] = len(self.told)
            self.told.append(self.numbers[instruction])
        return self._counters[key]


class LineMarks:
    """Writes the marks of a function. `current` is the counter of what the text has come to; a mark is written before the next
    instruction of another one, so that lines which need no instruction of their own have none."""

    def __init__(self, w: Writer, lines: Lines) -> None:
        self.e, self.lines, self.current = w.e, lines, 0
        self._wanted = 0
        self._ticks = w.base("ticks").name
        self._last = w.e.slot(I64, one=True)
        self._kept: dict[str, str] = {}  # places on the stack that values are kept in, by type
        self._values: list[Lanes] = []  # worked out since the last mark in the block that the text has come to
        self._texts: list[str] = []  # what has been emitted since
        w.module.declare(_COUNTER, I64, [])
        self._fenced = w.module.target.x86
        if self._fenced:
            w.module.declare(_FENCE, "void", [])
        w.e.put(self._last, self._now())
        w.e.marks = self

    @contextmanager
    def of(self, instruction: Instruction) -> Iterator[None]:
        """What is emitted within belongs to an instruction."""
        before, self._wanted = self._wanted, self.lines.counter(instruction)
        yield
        self._wanted = before

    @contextmanager
    def elsewhere(self) -> Iterator[None]:
        """What is emitted within belongs to no line, and is put where no line has begun."""
        before, self.current = self.current, 0
        yield
        self.current = before
        self.block()

    def emitted(self, text: str, value: Lanes | None = None) -> None:
        """An instruction has been emitted, with the value that it gives."""
        self._texts.append(text)
        if value is not None:
            self._values.append(value)

    def block(self) -> None:
        """Another block begins."""
        self._texts.clear()
        self._values.clear()

    def before(self) -> None:
        """An instruction is emitted next."""
        if self._wanted != self.current:
            self.count()

    def count(self) -> None:
        """Add what has passed since the last mark."""
        e, number, self.current = self.e, self.current, self._wanted
        self._keep()
        last = e.get(self._last, I64, one=True)
        now = self._now()
        passed = e.one(f"sub i64 {now.name}, {last.name}", I64)
        place = e.one(f"getelementptr i64, ptr {self._ticks}, i64 {number}", PTR).name
        e.put(place, e.one(f"add i64 {e.get(place, I64, one=True).name}, {passed.name}", I64))
        e.put(self._last, now)
        self._border(now)

    def _now(self) -> Lanes:
        """The counter, once all before it is done: else a line's divisions and roots are those of a later one."""
        if self._fenced:
            self.e.do(f"call void @{_FENCE}()")
        return self.e.one(f"call i64 @{_COUNTER}()", I64)

    def _keep(self) -> None:
        """Have the values that nothing has read yet stored, which is not moved past the counter: else LLVM works them out where
        they are read, in another line."""
        read = set(_NAMES.findall(" ".join(self._texts)))
        for value in [each for each in self._values if each.name not in read]:
            if value.type not in self._kept:
                self._kept[value.type] = self.e.slot(value.kind, one=value.one)
            self.e.do(f"store volatile {value.typed}, ptr {self._kept[value.type]}")

    def _border(self, count: Lanes) -> None:
        """Operations that follow are not moved before this: LLVM puts those of a block in an order of its own, and another block
        begins where there is a branch that it cannot know to be always taken. No count is 0."""
        e, never, following = self.e, self.e.label("never"), self.e.label("marked")
        e.branch(e.one(f"icmp ne i64 {count.name}, 0", BOOL), following, never)
        e.begin(never)
        e.do('call void asm sideeffect "", ""()')
        e.jump(following)
        e.begin(following)


def marks_of(w: Writer, lines: Lines | None) -> Marks:
    """The marks of a function, where its lines are counted."""
    return NO_MARKS if lines is None else LineMarks(w, lines)


@dataclass(slots=True, eq=False)
class Times:
    """What the parts of a block take in one run of it: `ticks` are the counters that its code adds to, `lane` is as
    `Metered.lane` gives it, `seconds` what the functions took."""

    lines: Lines
    ticks: NDArray[np.int64]
    lane: list[float]
    seconds: float = 0.0

    def __post_init__(self) -> None:
        self.ticks[:] = 0

    def called(self, instruction: Instruction, seconds: float) -> None:
        """An instruction that has no machine code took so long."""
        self._add(self.lines.numbers[instruction], seconds)

    def end(self) -> None:
        """Share what the functions took among their lines."""
        ticks = np.maximum(self.ticks, 0)  # counters of two processors may differ
        to_seconds = self.seconds / max(int(ticks.sum()), 1)
        for number, count in zip(self.lines.told, ticks.tolist(), strict=True):
            if number >= 0:
                self._add(number, count * to_seconds)

    def _add(self, number: int, seconds: float) -> None:
        self.lane[number] += seconds
        self.lane[-1] += seconds
