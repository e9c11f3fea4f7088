"""Runs one block as machine code.

Rows are divided into parts, which pass through all stages, possibly in several threads. Operations without machine code are
called between stages. At the end, requests to the world are collected."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import accumulate
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.number_kinds import LANE_COUNT
from antdsl.numerics import parallel
from antdsl.numerics.processor.host import PARTS_PER_THREAD, count_available_cores
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import (
    EFFECTS_SLOT,
    PAIRS_SLOT,
    POPULATION_SLOT,
    THREADS_SLOT,
    WORLD_SLOT,
    BlockInstruction,
    InstructionKind,
    RowScope,
)
from antdsl.runtime.backends.metering import BlockCallMeter
from antdsl.runtime.backends.native.address_tables import AddressTables
from antdsl.runtime.backends.native.compile_queue import CompiledPlanCode
from antdsl.runtime.backends.native.lane_memory import LaneBuffers
from antdsl.runtime.backends.native.line_profiling import LineTimeCounters
from antdsl.runtime.backends.native.padded_arrays import PaddedArrays
from antdsl.runtime.backends.native.request_emission import record_request
from antdsl.runtime.requests import FaultEntry
from antdsl.runtime.sensing.world_senses import BATCHED_SENSES, SENSE_FUNCTIONS
from antdsl.runtime.world import Population, World

_PART_ROW_MULTIPLE = 64  # part sizes are multiples of this, so that few births change no size
# Calls at the end of a stage, in groups of one sense with one name: whether the sense writes its results to the arrays itself,
# and each call with its index in `BlockCodePlan.needs`, -1 for none.
StageCallList = list[tuple[bool, list[tuple[BlockInstruction, int]]]]


class BlockRunner:
    """The runner of one block's machine code, used again in each step."""

    def __init__(self, compiled_code: CompiledPlanCode, species: str, name: str, padded_arrays: PaddedArrays) -> None:
        self.code, self.compiler = compiled_code.block_codes[species, name], compiled_code.blocks[species, name]
        self.tables = AddressTables(self.code, padded_arrays)
        self.numpy_calls = compiled_code.calls
        self.uniform_nodes = {slot: node for node, slot in self.compiler.uniform_slots.items()}
        numbers = {each: number for number, each in enumerate(self.code.optional_calls)}
        self._prepared_for: tuple[int, ...] = ()
        self._part_groups: list[RowPartGroup] = []
        self.stages: list[tuple[Any, StageCallList]] = []  # the function of each stage, and the calls after it
        for stage, function in enumerate(self.code.function_names):
            groups = compiled_code.call_groups[species, name, stage]
            calls = [(_is_batched_sense(group[0]), [(each, numbers.get(each, -1)) for each in group]) for group in groups]
            self.stages.append((compiled_code.get_function(function), calls))

    def run_block(
        self, world: World, population: Population, values: dict[ir.PlanNode, Any], metered_block: BlockCallMeter | None
    ) -> list[tuple[int, int]]:
        """Run the block for all agents, and add their requests to the population's effects in row order.

        Return the ranges of rows (first row, end row) in which an agent has too many neighbours for machine code. NumPy must run
        these. `values`: by node, the values that are equal for all agents. `metered_block`: receives the time of each source
        line, or None."""
        count, others = len(population), self.tables.count_agents_of_largest_species(world)
        of = (count, others, world.options.chunk, world.options.threads, self.tables.version)
        if of != self._prepared_for:
            self._prepare_lane_buffers(*of)
            self._prepared_for = of
        if metered_block is not None:
            return self._run_with_line_times(world, population, values, metered_block)
        return self._run_parts(world, population, values)

    def _prepare_lane_buffers(self, count: int, other_count: int, chunk: int, threads: int, version: int) -> None:
        """Divide `count` rows into parts, and prepare the memory of each part."""
        threads = max(1, min(threads, count_available_cores()))
        size = _choose_part_size(count, chunk, threads)
        bounds = [(begin, min(begin + size, count)) for begin in range(0, count, size)]
        lanes = self.tables.prepare_lane_buffers(
            min(len(bounds), PARTS_PER_THREAD * threads if threads > 1 else 1), size, other_count
        )
        chunks = [RowPartRun(self, lane) for lane in lanes]
        firsts = range(0, len(bounds), len(lanes))
        self._part_groups = [RowPartGroup(self, chunks, bounds[first : first + len(lanes)], threads) for first in firsts]

    def _run_with_line_times(
        self, world: World, population: Population, values: dict[ir.PlanNode, Any], metered_block: BlockCallMeter
    ) -> list[tuple[int, int]]:
        """Run all rows, and add the time of each source line to `metered_block`. Same result as `run_block`."""
        lines, chunks, began = self.code.line_counters, self._part_groups[0].chunks, perf_counter()
        for each in chunks:
            each.line_times = None if lines is None else LineTimeCounters(lines, each.lane.ticks, metered_block.make_counters())
        bad = self._run_parts(world, population, values)
        counted = [each.line_times for each in chunks if each.line_times is not None]
        if counted:
            for spent in counted:
                spent.distribute_to_lines()
            metered_block.add_counters(
                [spent.counters for spent in counted], perf_counter() - began if len(chunks) > 1 else np.inf
            )
        return bad

    def _run_parts(self, world: World, population: Population, values: dict[ir.PlanNode, Any]) -> list[tuple[int, int]]:
        bad: list[tuple[int, int]] = []
        for each in self._part_groups:
            bad += each.run_parts(world, population, values)
        return bad


def _is_batched_sense(instruction: BlockInstruction) -> bool:
    """Return whether an instruction is a sense that a single call computes for all parts, directly in the arrays of the parts."""
    return (
        instruction.kind is InstructionKind.VALUE
        and isinstance(instruction.subject, ir.PlanNode)
        and instruction.subject.op in BATCHED_SENSES
    )


def _choose_part_size(count: int, chunk: int, threads: int) -> int:
    """Return the number of rows of a part, given `count` rows in total.

    At most `chunk`; less if more parts balance the work of the threads better. All parts that one thread runs together have at
    most `chunk` rows, so that their data stays in the processor's cache from stage to stage."""
    most = chunk if threads < 2 else chunk // PARTS_PER_THREAD
    parts = max(
        -(-count // max(LANE_COUNT, most)),
        min(PARTS_PER_THREAD * threads, count // parallel.MIN_AGENTS_PER_THREAD) if threads > 1 else 1,
    )
    most = _PART_ROW_MULTIPLE * parts
    return _PART_ROW_MULTIPLE * max(1, -(-count // most))


class RowPartGroup:
    """Consecutive parts of a block's rows, which pass through its stages together.

    Each stage runs for all parts without the interpreter. Then the calls at the end of the stage are made, and the next stage
    begins."""

    def __init__(self, block: BlockRunner, chunks: list[RowPartRun], bounds: list[tuple[int, int]], threads: int) -> None:
        self._block, self._threads, self._bounds = block, threads, bounds
        self.chunks = chunks[: len(bounds)]
        self._begin, self._end = bounds[0][0], bounds[-1][1]
        self._table = np.array([(each.lane.address, *part) for each, part in zip(self.chunks, bounds, strict=True)], np.int64)

    def run_parts(self, world: World, population: Population, values: dict[ir.PlanNode, Any]) -> list[tuple[int, int]]:
        """Run the parts through all stages, and add their requests to the population's effects.

        Return the parts (first row, end row) in which an agent has too many neighbours for machine code."""
        chunks, timed = self.chunks, self.chunks[0].line_times is not None
        for each, part in zip(chunks, self._bounds, strict=True):
            each.prepare_run(world, population, values, *part)
        for function, calls in self._block.stages:
            if timed:
                self._run_in_threads(partial(RowPartRun.run_stage, function=function))
            else:
                parallel.call_for_each_row(function, self._table, self._threads)
            if calls:
                self._run_needed_calls(world, population, values, calls)
        return [part for each, part in zip(chunks, self._bounds, strict=True) if not each.finish_run()]

    def _run_in_threads(self, run_part: Callable[[RowPartRun], object]) -> None:
        """Run `run_part` for each part, in several threads."""
        coming = iter(self.chunks)

        def run_parts(_: int) -> None:
            for each in coming:  # the next part that no thread has taken yet
                run_part(each)

        if len(self.chunks) > 1:
            parallel.run_in_threads(run_parts, min(self._threads, len(self.chunks)))
        else:
            run_parts(0)

    def _run_needed_calls(
        self, world: World, population: Population, values: dict[ir.PlanNode, Any], stage_calls: StageCallList
    ) -> None:
        """Run those calls at the end of a stage that at least one agent needs."""
        needs = [max(each) for each in zip(*[chunk.lane.needed_calls.tolist() for chunk in self.chunks], strict=True)]
        others = []
        for in_place, group in stage_calls:
            needed = [each for each, number in group if number < 0 or needs[number]]
            if needed and in_place:
                self._run_calls_of_all_parts(world, population, values, needed)
            elif needed:
                others.append(group)
        if others:
            self._run_in_threads(partial(RowPartRun.run_calls, stage_calls=others))

    def _run_calls_of_all_parts(
        self, world: World, population: Population, values: dict[ir.PlanNode, Any], instructions: list[BlockInstruction]
    ) -> None:
        """Run one call, or several calls of the same sense with the same name, for all parts at once.

        Inputs are read from arrays that the previous stage wrote. Results are written to arrays that the next stage reads."""
        began, block, node = perf_counter(), self._block, instructions[0].subject
        assert isinstance(node, ir.PlanNode)
        answer, nothing = BATCHED_SENSES[node.op]
        queries = [
            block.tables.lanes.build_query(each, self._end - self._begin, block.uniform_nodes, values) for each in instructions
        ]
        for each, (_, _, results) in zip(instructions, queries, strict=True):
            if each not in block.code.mask_slot_by_call:
                for array, value in zip(results, nothing, strict=True):
                    array.fill(value)
        answer(world, population, node, slice(self._begin, self._end), queries)
        if self.chunks[0].line_times is not None:
            self.chunks[0].add_call_time(began, instructions, [int(np.count_nonzero(asking)) for asking, _, _ in queries])


class RowPartRun:
    """A range of a block's rows that one thread runs through a stage. `line_times`: receives the times of source lines, or
    None."""

    world: World
    population: Population
    values: dict[ir.PlanNode, Any]
    first_row: int
    end_row: int

    def __init__(self, block: BlockRunner, lane: LaneBuffers) -> None:
        self.runner, self.lane = block, lane
        self.line_times: LineTimeCounters | None = None
        self._rows_by_mask: dict[int, NDArray[np.intp]] = {}
        self._slots: list[Any] | None = None

    def prepare_run(self, world: World, population: Population, values: dict[ir.PlanNode, Any], first: int, last: int) -> None:
        """Set the world, the values and the rows of the next run: from `first` to `last` - 1."""
        self.world, self.population, self.values = world, population, values
        self.first_row, self.end_row = first, last
        self._slots = None
        self._rows_by_mask.clear()
        self.lane.reset_counts()

    def run_stage(self, function: Callable[[int, int, int], None]) -> None:
        """Run a stage for the rows, and record its time."""
        began = perf_counter()
        function(self.lane.address, self.first_row, self.end_row)
        if self.line_times is not None:
            self.line_times.seconds += perf_counter() - began

    def finish_run(self) -> bool:
        """After all stages, add the requests of the rows to the population's effects.

        Return False, and add nothing, if an agent has too many neighbours."""
        lane, effects = self.lane, self.population.effects
        crowded, *counts = lane.counts.tolist()
        if not crowded:
            for number, count in enumerate(counts):
                if count:
                    record_request(
                        self.runner.code.list_instructions[number],
                        [column[:count].copy() for column in lane.list_columns[number]],
                        effects,
                    )
            if lane.fault_notes[0]:
                self._record_faults()
        self._slots = None
        del self.world, self.population, self.values  # not needed once no other thread uses them
        return not crowded

    def add_call_time(self, start_time: float, instructions: list[BlockInstruction], rows: list[int]) -> None:
        """Divide the time since `start_time` among the calls that ran, in proportion to the `rows` of each."""
        if self.line_times is not None:
            each_row = (perf_counter() - start_time) / max(sum(rows), 1)
            for each, count in zip(instructions, rows, strict=True):
                self.line_times.add_call_time(each, count * each_row)

    def _record_faults(self) -> None:
        """Record a fault for each value that machine code rejected."""
        notes = self.lane.fault_notes
        for k in range(int(notes[0])):
            row, fault_word = int(notes[1 + 2 * k]), int(notes[2 + 2 * k])
            refused, by = self.runner.code.fault_sources[fault_word >> LANE_COUNT]
            rows = row + np.flatnonzero([fault_word >> bit & 1 for bit in range(LANE_COUNT)])
            self.population.effects.faults.append(FaultEntry(self.runner.compiler.name, refused, by.span, rows))

    # --- calls ---------------------------------------------------------------------------------------------------------

    def _make_numpy_slots(self) -> list[Any]:
        """Return a list of slots as NumPy calls expect it."""
        if self._slots is None:
            compiler = self.runner.compiler
            v = self._slots = [None] * compiler.slot_count
            v[WORLD_SLOT], v[POPULATION_SLOT], v[EFFECTS_SLOT] = self.world, self.population, self.population.effects
            v[PAIRS_SLOT], v[THREADS_SLOT] = {}, 1
            v[compiler.root_scope.rows_slot] = slice(self.first_row, self.end_row)
            for node, slot in compiler.uniform_slots.items():
                v[slot] = self.values[node]
        return self._slots

    def _find_masked_rows(self, slot: int) -> NDArray[np.intp]:
        """Return the rows for which the mask in a slot is true, counted from the first row of the chunk."""
        if slot not in self._rows_by_mask:
            (self._rows_by_mask[slot],) = self.lane.arrays[slot, 0][: self.end_row - self.first_row].nonzero()
        return self._rows_by_mask[slot]

    def _find_scope_rows(self, scope: RowScope) -> NDArray[np.intp]:
        rows, v = self._find_masked_rows(self.runner.code.schedule.resolve_slot(scope.rows_slot)), self._make_numpy_slots()
        is_complete = len(rows) == self.end_row - self.first_row
        v[scope.rows_slot], v[scope.row_count_slot] = (
            (slice(self.first_row, self.end_row) if is_complete else rows + self.first_row),
            len(rows),
        )
        return rows

    def _read_operand_values(self, slot: int, rows: NDArray[np.intp]) -> Any:
        """Return the stored value of a slot for the given rows; a single number if it is equal for all agents."""
        source = self.runner.code.schedule.resolve_slot(slot)
        array = self.lane.arrays.get((source, 0))
        if array is not None:
            return array.take(rows)
        return self._make_numpy_slots()[source]

    def _run_call(self, instruction: BlockInstruction, rows: NDArray[np.intp]) -> Any:
        """Return the result of a NumPy call for the given rows."""
        v = self._make_numpy_slots()
        for slot in instruction.inputs:
            v[slot] = self._read_operand_values(slot, rows)
        self.runner.numpy_calls[instruction](v)
        return v[instruction.slot]

    def run_calls(self, stage_calls: Sequence[list[tuple[BlockInstruction, int]]]) -> None:
        """Run groups of calls, each call for the rows that need it."""
        needs = self.lane.needed_calls.tolist()
        for group in stage_calls:
            needed = [each for each, number in group if number < 0 or needs[number]]
            if needed:
                with np.errstate(all="ignore"):
                    self._run_call_group(needed)

    def _run_call_group(self, instructions: list[BlockInstruction]) -> None:
        """Run one call, or several calls of the same sense with the same name. A row is computed once for each of its
        requests."""
        code, began = self.runner.code, perf_counter()
        if len(instructions) == 1 and instructions[0] not in code.mask_slot_by_call:
            rows = self._find_scope_rows(instructions[0].scope)
            if len(rows):
                self._store_results(instructions[0], rows, self._run_call(instructions[0], rows))
                self.add_call_time(began, instructions, [len(rows)])
            return
        chosen = [self._find_masked_rows(code.find_call_mask_slot(each)) for each in instructions]
        ends = list(accumulate(len(rows) for rows in chosen))
        if not ends[-1]:
            return
        columns = []
        for place in range(len(instructions[0].inputs)):
            parts = [self._read_operand_values(each.inputs[place], rows) for each, rows in zip(instructions, chosen, strict=True)]
            pairs = zip(parts, chosen, strict=True)
            spread = [part if isinstance(part, np.ndarray) and part.ndim else np.full(len(rows), part) for part, rows in pairs]
            columns.append(np.concatenate(spread))
        node = instructions[0].subject
        assert isinstance(node, ir.PlanNode)
        asking = np.concatenate(chosen) + self.first_row
        results = SENSE_FUNCTIONS[node.op](self.world, self.population, node, asking, *columns)
        parts_of = results if isinstance(results, tuple) else (results,)
        for each, rows, end in zip(instructions, chosen, ends, strict=True):
            if len(rows):
                self._store_results(each, rows, tuple(part[end - len(rows) : end] for part in parts_of))
        self.add_call_time(began, instructions, [len(rows) for rows in chosen])

    def _store_results(self, instruction: BlockInstruction, rows: NDArray[np.intp], results: Any) -> None:
        """Write the results of a call for `rows` to the arrays that the next stage reads."""
        for part, value in enumerate(results if isinstance(results, tuple) else (results,)):
            array = self.lane.arrays.get((instruction.slot, part))
            if array is not None:
                array[rows] = value
