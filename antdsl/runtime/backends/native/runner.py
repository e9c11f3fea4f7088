"""Runs one block of machine code: its rows in parts, perhaps in several threads, and each part through its stages, the calls
between them, and what is asked of the world."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import accumulate
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.lanes import WIDTH
from antdsl.numerics import compiled
from antdsl.numerics.cores import cores
from antdsl.plan import ir
from antdsl.runtime.backends.compile import EFFECTS, NEARBY, PAIRS, POPULATION, WORLD, BlockCompiler, Instruction, Scope
from antdsl.runtime.backends.metering import Metered
from antdsl.runtime.backends.native.asking import asked
from antdsl.runtime.backends.native.block import BlockCode
from antdsl.runtime.backends.native.marks import Times
from antdsl.runtime.backends.native.ready import Ready
from antdsl.runtime.backends.native.tables import Lane, Tables
from antdsl.runtime.pairs import NearbySets
from antdsl.runtime.requests import Effects, FaultEntry
from antdsl.runtime.sensing import SENSES
from antdsl.runtime.world import Population, World

_PART = 1_024  # agents for whom a part of their own pays


@dataclass(slots=True, eq=False)
class Block:
    """A block of one species in one step; `values` are those that are the same for all agents, `timed` tells of its lines while
    they are timed."""

    ready: Ready
    code: BlockCode
    compiler: BlockCompiler
    tables: Tables
    world: World
    population: Population
    values: dict[ir.Node, Any]
    timed: Metered | None = None

    def run(self) -> list[tuple[int, int]]:
        """Take all rows through the block, and put what they ask for into the population's effects, in the order of their rows.
        Gives the parts, as first row and the one after the last, in which some agent has too many others in a radius."""
        count, threads = len(self.population), max(1, min(self.world.options.threads, cores()))
        size = _part(count, self.world.options.chunk, threads)
        bounds = [(begin, min(begin + size, count)) for begin in range(0, count, size)]
        lanes = [self.tables.lane(k, self.world, min(size, count)) for k in range(min(threads, len(bounds)))]
        lines, timed, began = self.code.lines, self.timed, perf_counter()
        times = [None if timed is None or lines is None else Times(lines, lane.ticks, timed.lane()) for lane in lanes]
        effects, good, coming = [Effects() for _ in bounds], [False] * len(bounds), iter(range(len(bounds)))

        def work(number: int) -> None:
            for k in coming:  # the next one that nobody has
                good[k] = Chunk(self, lanes[number], times[number], *bounds[k], effects[k]).run()

        compiled.side_by_side(work, len(lanes))
        for each in effects:
            self.population.effects.take(each)
        counted = [each for each in times if each is not None]
        if timed is not None and counted:
            for spent in counted:
                spent.end()
            timed.take([spent.lane for spent in counted], perf_counter() - began if len(lanes) > 1 else np.inf)
        return [part for part, well in zip(bounds, good, strict=True) if not well]


def _part(count: int, chunk: int, threads: int) -> int:
    """Rows of a part: as many as a chunk has at most, and where that pays two parts for each thread, of whole eights."""
    parts = max(-(-count // max(WIDTH, chunk)), min(2 * threads, count // _PART) if threads > 1 else 1)
    most = WIDTH * parts
    return WIDTH * max(1, -(-count // most))


@dataclass(slots=True, eq=False)
class Chunk:
    """Some rows of a block. `run` says whether all went well: False where some agent has too many others in a radius."""

    block: Block
    lane: Lane
    times: Times | None
    begin: int
    end: int
    effects: Effects
    _picked: dict[int, NDArray[np.intp]] = field(default_factory=dict)
    _slots: list[Any] | None = None

    def run(self) -> bool:
        """Take the rows through all stages; what is asked of the world is added to the effects."""
        block, lane = self.block, self.lane
        lane.notes[0] = 0
        lane.counts.fill(0)
        lane.needs.fill(0)
        for stage, name in enumerate(block.code.names):
            function, began = block.ready.function(name), perf_counter()
            function(lane.address, self.begin, self.end)
            if self.times is not None:
                self.times.seconds += perf_counter() - began
            some = block.ready.together[block.population.name, block.compiler.name, stage]
            if some:
                with np.errstate(all="ignore"):
                    self._calls(some)
        crowded, *counts = lane.counts.tolist()
        if crowded:
            return False
        if any(counts):
            with np.errstate(all="ignore"):
                for number, count in enumerate(counts):
                    if count:
                        each = block.code.lists[number]
                        asked(each, [column[:count].copy() for column in lane.columns[number]], self.effects)
        self._faults()
        return True

    def _took(self, began: float, some: list[Instruction], rows: list[int]) -> None:
        """Calls have come to their end; each has its share of the time by the rows that it was made for."""
        if self.times is not None:
            each_row = (perf_counter() - began) / sum(rows)
            for each, count in zip(some, rows, strict=True):
                self.times.called(each, count * each_row)

    def _faults(self) -> None:
        """Values that were refused."""
        notes = self.lane.notes
        for k in range(int(notes[0])):
            row, told = int(notes[1 + 2 * k]), int(notes[2 + 2 * k])
            refused, span = self.block.code.faults[told >> WIDTH]
            rows = row + np.flatnonzero([told >> bit & 1 for bit in range(WIDTH)])
            self.effects.faults.append(FaultEntry(self.block.compiler.name, refused, span, rows))

    # --- calls ---------------------------------------------------------------------------------------------------------

    def _known(self) -> list[Any]:
        """Slots as NumPy's calls have them."""
        if self._slots is None:
            block = self.block
            v = self._slots = [None] * block.compiler.slots
            v[WORLD], v[POPULATION], v[EFFECTS] = block.world, block.population, self.effects
            v[PAIRS], v[NEARBY] = {}, NearbySets(1)
            v[block.compiler.root.rows] = slice(self.begin, self.end)
            for node, slot in block.compiler.uniforms.items():
                v[slot] = block.values[node]
        return self._slots

    def _rows_of(self, slot: int) -> NDArray[np.intp]:
        """Rows, counted within the chunk, for which a mask holds."""
        if slot not in self._picked:
            (self._picked[slot],) = self.lane.arrays[slot, 0][: self.end - self.begin].nonzero()
        return self._picked[slot]

    def _enter(self, scope: Scope) -> NDArray[np.intp]:
        rows, v = self._rows_of(self.block.code.schedule.slot(scope.rows)), self._known()
        whole = len(rows) == self.end - self.begin
        v[scope.rows], v[scope.size] = (slice(self.begin, self.end) if whole else rows + self.begin), len(rows)
        return rows

    def _operand(self, slot: int, rows: NDArray[np.intp]) -> Any:
        """What a stage has left for some rows, or what is the same for all."""
        source = self.block.code.schedule.slot(slot)
        array = self.lane.arrays.get((source, 0))
        if array is not None:
            return array.take(rows)
        return self._known()[source]

    def _made(self, each: Instruction, rows: NDArray[np.intp]) -> Any:
        """Run a call of NumPy's for some rows."""
        v = self._known()
        for slot in each.inputs:
            v[slot] = self._operand(slot, rows)
        self.block.ready.calls[each](v)
        return v[each.out]

    def _calls(self, every: list[list[Instruction]]) -> None:
        """Make the calls at the end of a stage that somebody needs."""
        nobody = {each for each, need in zip(self.block.code.needs, self.lane.needs.tolist(), strict=False) if not need}
        for some in every:
            needed = [each for each in some if each not in nobody]
            if needed:
                self._call(needed)

    def _call(self, some: list[Instruction]) -> None:
        """Make a call, or several of one sense with one name at once: who asks is named as often as it asks."""
        code, began = self.block.code, perf_counter()
        if len(some) == 1 and some[0] not in code.guarded:
            rows = self._enter(some[0].scope)
            if len(rows):
                self._leave(some[0], rows, self._made(some[0], rows))
                self._took(began, some, [len(rows)])
            return
        chosen = [self._rows_of(code.guarded.get(each, code.schedule.slot(each.scope.rows))) for each in some]
        ends = list(accumulate(len(rows) for rows in chosen))
        if not ends[-1]:
            return
        columns = []
        for place in range(len(some[0].inputs)):
            parts = [self._operand(each.inputs[place], rows) for each, rows in zip(some, chosen, strict=True)]
            pairs = zip(parts, chosen, strict=True)
            spread = [part if isinstance(part, np.ndarray) and part.ndim else np.full(len(rows), part) for part, rows in pairs]
            columns.append(np.concatenate(spread))
        node = some[0].what
        assert isinstance(node, ir.Node)
        asking = np.concatenate(chosen) + self.begin
        found = SENSES[node.op](self.block.world, self.block.population, node, asking, *columns)
        parts_of = found if isinstance(found, tuple) else (found,)
        for each, rows, end in zip(some, chosen, ends, strict=True):
            if len(rows):
                self._leave(each, rows, tuple(part[end - len(rows) : end] for part in parts_of))
        self._took(began, some, [len(rows) for rows in chosen])

    def _leave(self, each: Instruction, rows: NDArray[np.intp], found: Any) -> None:
        """Put the results of a call where the next stage looks for them."""
        for part, value in enumerate(found if isinstance(found, tuple) else (found,)):
            array = self.lane.arrays.get((each.out, part))
            if array is not None:
                array[rows] = value
