"""The memory that machine code uses for each part of a block: values passed between stages, lists, recorded faults and
counters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import FeelerQuery
from antdsl.machine_code.memory import get_array_address
from antdsl.machine_code.number_kinds import BOOL, F32, F64, I32, I64, LANE_COUNT
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockInstruction
from antdsl.runtime.backends.native.address_layout import AddressKey
from antdsl.runtime.backends.native.block_writer import BlockCodePlan
from antdsl.runtime.backends.native.search import MAX_LISTED_CANDIDATES

DTYPE_BY_KIND = {F32: np.float32, F64: np.float64, BOOL: np.bool_, I32: np.int32, I64: np.int64}
Arrays = dict[tuple[int, int], NDArray[Any]]  # by slot and part
_LANE_KEY_KINDS = ("array", "laid", "notes", "counts", "needs", "ticks", "candidates")  # kinds of keys with an array per lane


class LaneBuffers:
    """The memory that machine code uses for one part of a block's rows.

    `counts`: entry 0 is positive if an agent has too many neighbours; the other entries are the lengths of the lists of requests.
    `needed_calls`: for each optional call, positive if an agent needs it. `list_columns`: for each list of requests, the rows and
    their values. `ticks`: the time counters by source line, if lines are timed. `deposit_flags`: by field, whether anything was
    deposited. `max_radii`: the greatest radius (mm) of each search, for eight agents at a time."""

    def __init__(self, code: BlockCodePlan, pointers: NDArray[np.int64]) -> None:
        self.code, self.pointers = code, np.zeros_like(pointers)
        self.address = get_array_address(self.pointers)
        self.arrays: Arrays = {}
        self.list_columns: list[list[NDArray[Any]]] = []
        self.fault_notes = np.zeros(1, np.int64)
        self.counts, self.needed_calls = (
            np.zeros(1 + len(code.list_instructions), np.int64),
            np.zeros(max(len(code.optional_calls), 1), np.uint8),
        )
        self.ticks = np.zeros(0 if code.line_counters is None else len(code.line_counters.instruction_numbers), np.int64)
        self.deposit_flags: dict[str, NDArray[np.bool_]] = {}
        self.max_radii = [np.zeros(LANE_COUNT, np.float32) for _ in code.searches]
        self._candidates = np.zeros(0, np.int32)
        self._keys = [
            (key, place)
            for key, place in code.layout.pointer_indices.items()
            if key[0] in _LANE_KEY_KINDS or key[2:] == ("widest",)
        ]
        self._lane_entries = np.array([place for _, place in self._keys], np.intp)
        self._lane_addresses = np.zeros(len(self._keys), np.int64)

    def copy_pointers(self, pointers: NDArray[np.int64]) -> None:
        """Copy the addresses that are equal for all parts from the table `pointers`."""
        self.pointers[:] = pointers
        self.pointers[self._lane_entries] = self._lane_addresses

    def reset_counts(self) -> None:
        """Set all counters to 0."""
        self.fault_notes[0] = 0
        self.counts.fill(0)
        if self.code.optional_calls:
            self.needed_calls.fill(0)

    def allocate_arrays(self, arrays: Arrays, rows: int, other_count: int) -> None:
        """Use `arrays` as the memory for `rows` rows and eight spare rows at the end.

        `other_count`: the number of agents in the largest species that is searched; buffers have this size."""
        self.arrays = arrays
        self.list_columns.clear()
        for number in range(len(self.code.list_instructions)):
            parts = sorted(part for slot, part in self.arrays if slot == -1 - number)
            self.list_columns.append([self.arrays[-1 - number, part] for part in parts])
        notes, candidates = (
            1 + 2 * (len(self.code.fault_sources) * (rows // LANE_COUNT + 1)),
            2 * other_count + (LANE_COUNT + 1) * MAX_LISTED_CANDIDATES,
        )
        if len(self.fault_notes) < notes:
            self.fault_notes = np.zeros(notes, np.int64)
        if len(self._candidates) < candidates:
            self._candidates = np.zeros(candidates, np.int32)  # for one agent, with distances
        for number, (key, _) in enumerate(self._keys):
            self._lane_addresses[number] = get_array_address(self._find_array(key))

    def _find_array(self, key: AddressKey) -> NDArray[Any]:
        """Return the array of this part that a key of the layout refers to."""
        match key[0]:
            case "array":
                return self.arrays[int(str(key[1])), int(str(key[2]))]
            case "grid":
                return self.max_radii[int(str(key[1]))]
            case "laid":
                return self.deposit_flags.setdefault(str(key[1]), np.zeros(1, np.bool_))
            case "notes":
                return self.fault_notes
            case "counts":
                return self.counts
            case "needs":
                return self.needed_calls
            case "ticks":
                return self.ticks
        return self._candidates


class LaneBufferPool:
    """The memories of all parts of a block that run at the same time.

    Results of a stage are contiguous over all parts: the arrays of a part are slices of `arrays`."""

    def __init__(self, code: BlockCodePlan) -> None:
        self.code = code
        self.arrays: Arrays = {}
        self.every: list[LaneBuffers] = []  # includes lanes of earlier runs with more parts
        self._part_rows = self._largest_species = self._part_count = 0
        self._queries: dict[
            BlockInstruction, tuple[FeelerQuery, list[tuple[ir.PlanNode, Any]]]
        ] = {}  # the query of each call, with its uniform operands and their values

    def prepare_lane_buffers(self, parts: int, rows: int, other_count: int, pointers: NDArray[np.int64]) -> list[LaneBuffers]:
        """Return the memories of `parts` parts, for `rows` rows each. `pointers`: the addresses that are equal for all parts.

        If there are several parts, `rows` must be a multiple of eight. `other_count`: the number of agents in the largest species
        that is searched."""
        while len(self.every) < parts:
            self.every.append(LaneBuffers(self.code, pointers))
        if rows != self._part_rows or parts > self._part_count or other_count > self._largest_species:
            self._part_rows, self._part_count, self._largest_species = (
                rows,
                max(parts, self._part_count),
                max(other_count, self._largest_species),
            )
            self._allocate_arrays()
        lanes = self.every[:parts]
        for lane in lanes:
            lane.copy_pointers(pointers)
        return lanes

    def _allocate_arrays(self) -> None:
        """Allocate the arrays of all parts, and give each part its slices."""
        rows, length = self._part_rows, self._part_count * self._part_rows + LANE_COUNT
        self._queries.clear()
        for key, kind in self.code.layout.array_kind_by_slot.items():
            if key not in self.arrays or len(self.arrays[key]) < length:
                self.arrays[key] = np.zeros(length, DTYPE_BY_KIND[kind])
        for k, lane in enumerate(self.every[: self._part_count]):
            own = {key: array[k * rows : (k + 1) * rows + LANE_COUNT] for key, array in self.arrays.items()}
            lane.allocate_arrays(own, rows, self._largest_species)

    def build_query(
        self, instruction: BlockInstruction, rows: int, uniform: Mapping[int, ir.PlanNode], values: Mapping[ir.PlanNode, Any]
    ) -> FeelerQuery:
        """Return the query of a call for all parts: the rows that need it, its arguments, and the arrays for its results.

        `rows`: the total number of rows. `uniform`: by slot, the node of each argument that is equal for all agents. `values`:
        the values of these nodes."""
        known = self._queries.get(instruction)
        if known is not None:
            request, same = known
            if len(request[0]) == rows and all([values[node] is value for node, value in same]):
                return request
        slots = [self.code.schedule.resolve_slot(slot) for slot in instruction.inputs]
        same = [(uniform[slot], values[uniform[slot]]) for slot in slots if (slot, 0) not in self.arrays]
        operands = [
            self.arrays[slot, 0][:rows] if (slot, 0) in self.arrays else np.full(rows, values[uniform[slot]]) for slot in slots
        ]
        assert isinstance(instruction.subject, ir.PlanNode)
        results = [
            self.arrays[instruction.slot, part][:rows] for part in range(len(ir.TUPLE_KINDS_BY_OPERATION[instruction.subject.op]))
        ]
        request = (self.arrays[self.code.find_call_mask_slot(instruction), 0][:rows], tuple(operands), tuple(results))
        self._queries[instruction] = (request, same)
        return request
