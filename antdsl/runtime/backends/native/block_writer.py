"""Writes the machine code of a block: one function per stage, which runs the stage's instructions for eight rows at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from antdsl.machine_code.entry_functions import write_outer_function
from antdsl.machine_code.kernels.ir import BasicBlock
from antdsl.machine_code.lanes import LaneBuilder, Lanes, add_elementwise_function
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.machine_code.number_kinds import BOOL, F32, I8, I64, LANE_COUNT, PTR
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockCompiler, BlockInstruction, InstructionKind, RowScope
from antdsl.runtime.backends.native.address_layout import LANE_TYPE_BY_KIND, AddressKey, AddressLayout
from antdsl.runtime.backends.native.field_threshold import emit_limited_strength, emit_may_reach_threshold
from antdsl.runtime.backends.native.line_profiling import LineCounters, add_time_marks
from antdsl.runtime.backends.native.stage_schedule import StageSchedule, list_reduction_operands

_OUT_OF_LINE_FUNCTIONS = frozenset(("sin", "cos", "exp", "log", "pow", "atan2"))  # called as functions of the module, not inlined
_FIRST_CALL_MASK_SLOT = -1_000_000  # slots from here downward are masks of agents that need a call


class FunctionWriter:
    """The writer of one function. It has a builder of instructions, and the layout of the tables of addresses and numbers."""

    def __init__(self, module: LlvmModule, layout: AddressLayout) -> None:
        self.module, self.layout = module, layout
        e = self.builder = LaneBuilder(module)
        self.table, self.begin, self.end = e.named_number(PTR, "%t"), e.named_number(I64, "%begin"), e.named_number(I64, "%end")
        self._loaded_addresses: dict[AddressKey, Lanes] = {}

    def emit_array_address(self, *key: Any) -> Lanes:
        """Return the address of the array with this key, which code at the start of the function loads from the table."""
        if key not in self._loaded_addresses:
            at = self.builder.make_constant(self.layout.find_pointer_index(*key), I64, 1)
            place = self.builder.add_at_entry("element", PTR, self.table, at, x=PTR)
            self._loaded_addresses[key] = self.builder.add_at_entry("load", PTR, place)
        return self._loaded_addresses[key]

    def emit_stage_array_address(self, slot: int, part: int, kind: str) -> Lanes:
        """Return the address at which part `part` of a slot's value is stored for the current eight rows."""
        self.layout.find_array_index(slot, part, kind)
        return self.emit_array_address("array", slot, part)

    def emit_uniform_value(self, kind: str, *key: Any, is_scalar: bool = False) -> Lanes:
        """Return a value that is equal for all agents, in every lane, or as a single number if `is_scalar`."""

        def load_uniform() -> Lanes:
            place = self.builder.address(self.emit_array_address("numbers"), self.layout.find_number_index(*key), I64)
            return self.builder.load_scalar(place, 0, kind)

        single: Lanes = self.builder.get_or_make(("number", kind, *key), load_uniform)
        if is_scalar:
            return single
        lanes: Lanes = self.builder.get_or_make(("numbers", kind, *key), lambda: self.builder.broadcast(single))
        return lanes

    def emit_operation(self, op: str, *args: Lanes) -> Any:
        """Emit code that applies an elementwise operation to lanes. The NumPy backend uses the same formula."""
        formula = FUNCTION_BY_NAME[op]
        if op not in _OUT_OF_LINE_FUNCTIONS:
            return formula(*args)
        name = add_elementwise_function(self.module, f"f.{op}", tuple(each.kind for each in args), formula)
        return self.builder.call_function(name, F32, *args)

    def add_function_to_module(self, name: str) -> None:
        """Add the function to the module under a name that callers outside the module use."""
        outer = write_outer_function(self.module, name)
        self.builder.end(name, (self.table, self.begin, self.end), attribute="noinline", caller_text=outer)


@dataclass(slots=True, eq=False)
class NeighbourSearchPlan:
    """A search for neighbours of a species, shared by several reductions. `set_nodes`: the sets that these reduce.
    `extra_registers`: registers of the others that it needs in the order of its cell grid, up to four names per text."""

    species: str
    set_nodes: list[ir.PlanNode]
    extra_registers: list[str]


@dataclass(slots=True, eq=False)
class BlockCodePlan:
    """A compiled block: the names of its stages' functions, and the data that is needed to run them."""

    species: ir.SpeciesPlan
    function_names: list[str]
    layout: AddressLayout
    schedule: StageSchedule
    line_counters: LineCounters | None = None  # only for code that is timed by line
    fault_sources: list[tuple[str, BlockInstruction]] = field(default_factory=list)  # name of the value and its instruction
    searches: list[NeighbourSearchPlan] = field(default_factory=list)
    lazy_nodes: list[ir.PlanNode] = field(default_factory=list)
    scent_thresholds: dict[int, ir.PlanNode] = field(default_factory=dict)  # by slot: see `field_threshold`
    list_instructions: list[BlockInstruction] = field(default_factory=list)  # statements with lists of rows, from slot -1 down
    optional_calls: list[BlockInstruction] = field(default_factory=list)  # calls for which the code records if agents need them
    mask_slot_by_call: dict[BlockInstruction, int] = field(default_factory=dict)  # calls that only some agents need

    def find_call_mask_slot(self, instruction: BlockInstruction) -> int:
        """Return the slot of a mask: the rows for which a call is made."""
        guarded = self.mask_slot_by_call.get(instruction)
        return self.schedule.resolve_slot(instruction.scope.rows_slot) if guarded is None else guarded


NodeLowerer = Callable[["BlockWriter", ir.PlanNode, tuple[Any, ...]], Any]


class BlockWriter(FunctionWriter):
    """The writer of the function of one stage."""

    def __init__(
        self, module: LlvmModule, code: BlockCodePlan, compiler: BlockCompiler, stage: int, senses: dict[str, NodeLowerer],
        reduce: Callable[[BlockWriter, BlockInstruction], None], guards: Mapping[str, tuple[NodeLowerer, tuple[Any, ...]]],
        write_request: Callable[[BlockWriter, BlockInstruction], None], combine: Callable[[str], str],
    ) -> None:  # fmt: skip
        super().__init__(module, code.layout)
        self.code, self.compiler, self.stage, self.senses, self._emit_reduction = code, compiler, stage, senses, reduce
        self.guards, self.write_request, self.field_combination = guards, write_request, combine
        self.schedule, self.species = code.schedule, code.species.name
        self._uniform_nodes = {slot: node for node, slot in compiler.uniform_slots.items()}
        self._instruction_by_slot: dict[int, BlockInstruction] = {}
        self._cached_senses: dict[int, ir.PlanNode] = {}
        self._kinds_by_slot: dict[int, tuple[str, ...]] = {}
        self._reductions: list[BlockInstruction] = []
        self._index_slots_of_scope(compiler.root_scope)
        self.mask: list[Lanes] = []
        self._cleared_masks: list[int] = []  # mask slots that are cleared first, in case their scope is skipped
        self.top_writers: list[Callable[[], None]] = []  # write code that runs first for each eight rows; called at the end
        self.groups: dict[BlockInstruction, Any] = {}  # reductions over neighbours, by the search that finds them

    def _index_slots_of_scope(self, scope: RowScope) -> None:
        for each in scope.code:
            if each.kind is InstructionKind.REDUCE and each in self.schedule.native_instructions:
                self._reductions.append(each)
            if isinstance(each.subject, ir.PlanNode) and each.slot >= 0:
                self._instruction_by_slot[each.slot] = each
                kinds = ir.TUPLE_KINDS_BY_OPERATION.get(each.subject.op, (each.subject.kind,))
                self._kinds_by_slot[each.slot] = tuple(LANE_TYPE_BY_KIND.get(kind, "") for kind in kinds)
                if each.kind is InstructionKind.CACHED_SENSE and each not in self.schedule.inlined_senses:
                    self._cached_senses[each.slot] = each.subject
            if each.inner_scope is not None:
                self._kinds_by_slot[each.inner_scope.rows_slot] = (BOOL,)
                self._index_slots_of_scope(each.inner_scope)

    def write_function(self, name: str) -> None:
        """Write the function, and add it to the module."""
        e = self.builder
        rows = self.end - self.begin
        with e.write_loop(rows, LANE_COUNT) as offset:
            self.offset = offset
            self.row = self.begin + offset
            root = self.compiler.root_scope
            mask = (offset + e.make_lane_numbers() < rows) & ~e.load_lanes(self.emit_array_address("quarantined"), self.row, BOOL)
            if root.rows_slot in self.schedule.stored_slots and self.stage == 0:
                e.store_lanes(self.emit_stage_array_address(root.rows_slot, 0, BOOL), offset, mask)
            e.known[-1][root.rows_slot] = mask
            self.mask.append(mask)
            top, place = e.current_block, len(e.current_block.body)
            self._write_scope(root)
            last, e.current_block = e.current_block, BasicBlock("", [])
            for slot in self._cleared_masks:
                e.store_lanes(self.emit_stage_array_address(slot, 0, BOOL), offset, e.make_constant(False, BOOL))
            for do in self.top_writers:
                do()
            top.body[place:place] = e.current_block.body
            e.current_block = last
        if self.code.line_counters is not None:
            add_time_marks(self)
        self.add_function_to_module(name)

    # --- instructions --------------------------------------------------------------------------------------------------

    def _time_instruction(self, instruction: BlockInstruction) -> AbstractContextManager[None]:
        """Return a context that assigns the time of all code written in it to the instruction, if lines are timed."""
        return nullcontext() if (c := self.code.line_counters) is None else self._time_with_counter(c.find_counter(instruction))

    @contextmanager
    def _time_with_counter(self, counter: int) -> Iterator[None]:
        previous_line, self.builder.line = self.builder.line, counter
        yield
        self.builder.line = previous_line

    def _write_scope(self, scope: RowScope) -> None:
        for each in scope.code:
            with self._time_instruction(each):
                match each.kind:
                    case InstructionKind.REGION:
                        self._write_region(each)
                    case InstructionKind.CACHED_SENSE:
                        self._write_lazy_sense(each)
                    case InstructionKind.STATEMENT:
                        if self.schedule.stage_by_instruction[each] == self.stage:
                            self._write_statement(each)
                    case InstructionKind.VALUE if each in self.schedule.calls_after_stage[self.stage]:
                        self._write_guard(each)
                    case InstructionKind.VALUE | InstructionKind.REDUCE if each in self.schedule.native_instructions:
                        if self.schedule.stage_by_slot.get(each.slot) == self.stage:
                            self.find_slot_value(each.slot)

    def _write_call_request(self, instruction: BlockInstruction, mask: Lanes) -> None:
        """Emit code that records whether any agent needs a call. `mask`: the agents that need it."""
        e = self.builder
        place = e.address(self.emit_array_address("needs"), len(self.code.optional_calls), I8)
        self.code.optional_calls.append(instruction)
        e.store_number(place, e.load(place, I8) | e.mask_to_i8(mask))

    def _write_guard(self, instruction: BlockInstruction) -> None:
        """Emit code that determines which agents need a call, if possible, and stores the call's result for all other agents."""
        assert isinstance(instruction.subject, ir.PlanNode)
        guard = self.guards.get(instruction.subject.op)
        if guard is None:
            self._write_call_request(instruction, self.mask[-1])
            return
        asks, others = guard
        needed = self.mask[-1] & asks(self, instruction.subject, tuple(self.find_slot_value(k) for k in instruction.inputs))
        self._write_call_request(instruction, needed)
        slot = self.code.mask_slot_by_call.setdefault(instruction, _FIRST_CALL_MASK_SLOT - len(self.code.mask_slot_by_call))
        self._cleared_masks.append(slot)
        self.builder.store_lanes(self.emit_stage_array_address(slot, 0, BOOL), self.offset, needed)
        e = self.builder
        for part, (value, kind) in enumerate(zip(others, self._kinds_by_slot[instruction.slot], strict=True)):
            e.store_lanes(self.emit_stage_array_address(instruction.slot, part, kind), self.offset, e.make_constant(value, kind))

    def _write_region(self, instruction: BlockInstruction) -> None:
        inner = instruction.inner_scope
        assert inner is not None
        if not self.schedule.is_run_in_stage(inner, self.stage):
            return
        mask = self._find_scope_mask(inner, lambda: self.mask[-1] & self.find_slot_value(instruction.inputs[0]))
        with self.builder.write_if(self.builder.any_lane(mask)):
            self.mask.append(mask)
            self._write_scope(inner)
            self.mask.pop()

    def _find_scope_mask(self, inner: RowScope, emit_mask: Callable[[], Lanes]) -> Lanes:
        """Return the mask of an inner scope: computed by `emit_mask` if this stage is the first to need it, else loaded."""
        mask: Lanes
        if self.schedule.stage_by_slot[inner.rows_slot] != self.stage:
            mask = self.find_slot_value(inner.rows_slot)
            return mask
        mask = self.builder.known[-1][inner.rows_slot] = emit_mask()
        if inner.rows_slot in self.schedule.stored_slots:
            self._cleared_masks.append(inner.rows_slot)
            self._store_slot(inner.rows_slot, mask)
        return mask

    def _write_lazy_sense(self, instruction: BlockInstruction) -> None:
        inner, node = instruction.inner_scope, instruction.subject
        assert inner is not None and isinstance(node, ir.PlanNode)
        if instruction in self.schedule.inlined_senses:
            self._write_scope(inner)
            return
        if not self.schedule.is_run_in_stage(inner, self.stage):
            return
        if node not in self.code.lazy_nodes:
            self.code.lazy_nodes.append(node)
        e, number = self.builder, self.code.lazy_nodes.index(node)
        has = self.emit_array_address("kept", number, "has")

        def find_missing_rows() -> Lanes:
            asks = self.mask[-1] & ~e.load_lanes(has, self.row, BOOL)
            bound = self.code.scent_thresholds.get(instruction.slot)
            return asks if bound is None else asks & emit_may_reach_threshold(self, node, bound)

        mask = self._find_scope_mask(inner, find_missing_rows)
        with e.write_if(e.any_lane(mask)):
            self.mask.append(mask)
            self._write_scope(inner)
            if self.schedule.stage_by_instruction[instruction] == self.stage:
                result = self.find_slot_value(instruction.inner_result_slot)
                for part, value in enumerate(result if isinstance(result, tuple) else (result,)):
                    e.store_masked(mask, self.emit_array_address("kept", number, part), self.row, value)
                e.store_masked(mask, has, self.row, e.make_constant(True, BOOL))
            self.mask.pop()
        if self.schedule.stage_by_instruction[instruction] == self.stage and instruction.slot in self.schedule.stored_slots:
            self.find_slot_value(instruction.slot)

    # --- values --------------------------------------------------------------------------------------------------------

    def find_slot_value(self, slot: int) -> Any:
        """Return the value of a slot. If necessary, emit code that computes it, or loads what an earlier stage stored."""
        slot = self.schedule.resolve_slot(slot)
        if slot in self._uniform_nodes:
            node = self._uniform_nodes[slot]
            return self.emit_uniform_value(LANE_TYPE_BY_KIND[node.kind], "node", node)
        return self.builder.get_or_make(slot, lambda: self._compute_slot(slot))

    def _compute_slot(self, slot: int) -> Any:
        if slot in self._cached_senses:
            number, kinds = self.code.lazy_nodes.index(self._cached_senses[slot]), self._kinds_by_slot[slot]
            load, row = self.builder.load_lanes, self.row
            parts = tuple(load(self.emit_array_address("kept", number, k), row, kind) for k, kind in enumerate(kinds))
            if slot in self.code.scent_thresholds:
                bound = self.code.scent_thresholds[slot]
                parts = (emit_limited_strength(self, self._cached_senses[slot], bound, parts[0]), *parts[1:])
            self._store_slot(slot, parts)
            return parts if len(parts) > 1 else parts[0]
        each = self._instruction_by_slot.get(slot)
        node = None if each is None else each.subject
        is_recomputed = isinstance(node, ir.PlanNode) and node.op in ("snap", "id") and slot not in self.schedule.stored_slots
        is_native = each is not None and each in self.schedule.native_instructions
        if each is None or not is_native or (self.schedule.stage_by_slot[slot] != self.stage and not is_recomputed):
            parts = tuple(
                self.builder.load_lanes(self.emit_stage_array_address(slot, k, kind), self.offset, kind)
                for k, kind in enumerate(self._kinds_by_slot[slot])
            )
            return parts if len(parts) > 1 else parts[0]
        with self._time_instruction(each):
            if each.kind is InstructionKind.REDUCE:
                self._emit_reduction(self, each)
                return self.builder.known[-1][slot]
            assert isinstance(node, ir.PlanNode)
            if node.op == "get":
                value = self.find_slot_value(each.inputs[0])[node.attrs[0]]
            elif node.op in FUNCTION_BY_NAME:
                value = self.emit_operation(node.op, *(self.find_slot_value(k) for k in each.inputs))
            else:
                value = self.senses[node.op](self, node, tuple(self.find_slot_value(k) for k in each.inputs))
            self._store_slot(slot, value)
        return value

    def record_slot_value(self, slot: int, value: Any) -> None:
        """Record `value` as the value of a slot. Emit code that stores it if a later stage needs it."""
        self.builder.known[-1][slot] = value
        self._store_slot(slot, value)

    def _store_slot(self, slot: int, value: Any) -> None:
        if slot in self.schedule.stored_slots:
            for part, each in enumerate(value if isinstance(value, tuple) else (value,)):
                self.builder.store_lanes(self.emit_stage_array_address(slot, part, each.kind), self.offset, each)

    def find_joint_reductions(self, first: BlockInstruction) -> list[BlockInstruction]:
        """Return the other reductions over the same species or items that the search for `first` can compute as well. They must
        not depend on the result of `first`. Reductions over agents may be in other scopes."""
        assert isinstance(first.subject, ir.PlanNode)
        reductions, of = [], first.subject.args[0]
        for each in self._reductions:
            node = each.subject
            if each is first or not isinstance(node, ir.PlanNode):
                continue
            if node.args[0].op != of.op or node.args[0].attrs[0] != of.attrs[0]:
                continue
            if self.schedule.stage_by_slot.get(each.slot) != self.stage or any(each.slot in k for k in self.builder.known):
                continue
            if each.scope is not first.scope and of.op != "set.agents":
                continue
            if all(self._is_slot_available(slot) for slot in list_reduction_operands(each)):
                reductions.append(each)
        return reductions

    def _is_slot_available(self, slot: int) -> bool:
        """Return whether a slot's value is known, or can be computed now without a reduction or a register that changes."""
        slot = self.schedule.resolve_slot(slot)
        if slot in self._uniform_nodes or any(slot in names for names in self.builder.known):
            return True
        each = self._instruction_by_slot.get(slot)
        if each is None or self.schedule.stage_by_slot.get(slot) != self.stage:
            return slot not in self._cached_senses
        if each.kind is not InstructionKind.VALUE or not isinstance(each.subject, ir.PlanNode) or each.subject.op == "load":
            return False
        return all(self._is_slot_available(k) for k in each.inputs)

    # --- statements ----------------------------------------------------------------------------------------------------

    def _write_statement(self, instruction: BlockInstruction) -> None:
        what = instruction.subject
        if isinstance(what, ir.Store):
            self._write_store(instruction, what)
        else:
            self.write_request(self, instruction)

    def _write_store(self, instruction: BlockInstruction, statement: ir.Store) -> None:
        value, mask = self.find_slot_value(instruction.inputs[0]), self.mask[-1]
        if value.kind == F32:
            good = np.isfinite(value)
            if statement.allows_infinity:
                good = good | (value == float("inf"))
            self.write_fault_record(mask & ~good, statement.register, instruction)
            mask = mask & good
        self.builder.store_masked(mask, self.emit_array_address("now", statement.register), self.row, value)

    def write_fault_record(self, is_bad: Lanes, value_name: str, instruction: BlockInstruction) -> None:
        """Emit code that records non-finite values among eight rows as two words: the number of the first row, and a mask of the
        faulty rows. The bits above the mask contain the number of the rejected value."""
        e, faults = self.builder, self.code.fault_sources
        with e.write_if(e.any_lane(is_bad)):
            faults.append((value_name, instruction))  # one entry per place; its notes have space for one of each eight rows
            notes = self.emit_array_address("notes")
            count = e.load_scalar(notes, 0, I64)
            first = e.address(notes, count * 2, I64)
            note_word = e.mask_to_i64(is_bad) | ((len(faults) - 1) << LANE_COUNT)
            for k, value in enumerate((self.row, note_word)):
                e.store_number(e.address(first, k + 1, I64), value)
            e.store_number(notes, count + 1)
