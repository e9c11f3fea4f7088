"""Machine code of a block: one function per stage, which runs eight rows at a time through all instructions of the stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from antdsl.machine_code.entries import outer_text
from antdsl.machine_code.kernels.ir import BasicBlock
from antdsl.machine_code.kinds import BOOL, F32, I8, I64, LANE_COUNT, PTR
from antdsl.machine_code.lanes import LaneBuilder, Lanes, elementwise
from antdsl.machine_code.module import LlvmModule
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.runtime.backends.compile import BlockCompiler, BlockInstruction, InstructionKind, RowScope
from antdsl.runtime.backends.native.layout import LANE_TYPE_BY_KIND, AddressKey, AddressLayout
from antdsl.runtime.backends.native.marks import LineCounters, add_marks
from antdsl.runtime.backends.native.scents import may_reach, strength
from antdsl.runtime.backends.native.schedule import StageSchedule, operands_of

_OUT_OF_LINE_FUNCTIONS = frozenset(("sin", "cos", "exp", "log", "pow", "atan2"))  # called as functions of the module, not inlined
_FIRST_GUARD_SLOT = -1_000_000  # slots from here downward are masks of agents that need a call


class FunctionWriter:
    """The context for writing one function: a builder, and the table indices of arrays and numbers."""

    def __init__(self, module: LlvmModule, layout: AddressLayout) -> None:
        self.module, self.layout = module, layout
        e = self.e = LaneBuilder(module)
        self.table, self.begin, self.end = e.named_number(PTR, "%t"), e.named_number(I64, "%begin"), e.named_number(I64, "%end")
        self._bases: dict[AddressKey, Lanes] = {}

    def base(self, *key: Any) -> Lanes:
        """Return the address of an array, which is read once per call of the function."""
        if key not in self._bases:
            at = self.e.constant(self.layout.pointer(*key), I64, 1)
            place = self.e.at_entry("element", PTR, self.table, at, x=PTR)
            self._bases[key] = self.e.at_entry("load", PTR, place)
        return self._bases[key]

    def array(self, slot: int, part: int, kind: str) -> Lanes:
        """Return the address of a stored value for the current rows."""
        self.layout.array(slot, part, kind)
        return self.base("array", slot, part)

    def number(self, kind: str, *key: Any, one: bool = False) -> Lanes:
        """Return a value that is equal for all agents: in every lane, or (`one`) as a single number."""

        def make() -> Lanes:
            place = self.e.address(self.base("numbers"), self.layout.number(*key), I64)
            return self.e.read_one(place, 0, kind)

        single: Lanes = self.e.get_or_make(("number", kind, *key), make)
        if one:
            return single
        lanes: Lanes = self.e.get_or_make(("numbers", kind, *key), lambda: self.e.widened(single))
        return lanes

    def apply(self, op: str, *args: Lanes) -> Any:
        """Apply an elementwise operation to lanes, with the function that NumPy also uses."""
        formula = FUNCTION_BY_NAME[op]
        if op not in _OUT_OF_LINE_FUNCTIONS:
            return formula(*args)
        name = elementwise(self.module, f"f.{op}", tuple(each.kind for each in args), formula)
        return self.e.call(name, F32, *args)

    def add(self, name: str) -> None:
        """Add the function to the module under a name that can be called from outside."""
        self.e.end(name, (self.table, self.begin, self.end), attribute="noinline", outer=outer_text(self.module, name))


@dataclass(slots=True, eq=False)
class NeighbourSearch:
    """Reductions over neighbours of one species that share one search. `sets`: the sets that they reduce.
    `beside`: registers of the others, needed in the order of the cell grid; each text names up to four."""

    species: str
    sets: list[ir.PlanNode]
    beside: list[str]


@dataclass(slots=True, eq=False)
class BlockCode:
    """A compiled block: the names of its stages' functions, and the tables, calls and lists that running them needs."""

    species: ir.SpeciesPlan
    names: list[str]
    layout: AddressLayout
    schedule: StageSchedule
    lines: LineCounters | None = None  # for code that is timed by line
    faults: list[tuple[str, BlockInstruction]] = field(default_factory=list)  # name of the value and its instruction
    near: list[NeighbourSearch] = field(default_factory=list)
    lazy_nodes: list[ir.PlanNode] = field(default_factory=list)
    bounds: dict[int, ir.PlanNode] = field(default_factory=dict)  # `scents.bounds`
    lists: list[BlockInstruction] = field(default_factory=list)  # statements with lists of requesting rows, from slot -1 downward
    needs: list[BlockInstruction] = field(default_factory=list)  # calls for which the code records whether an agent needs them
    guarded: dict[BlockInstruction, int] = field(default_factory=dict)  # calls that only some agents need, with their mask slot

    def mask_of(self, each: BlockInstruction) -> int:
        """Return the slot of the mask of rows for which a call is made."""
        guarded = self.guarded.get(each)
        return self.schedule.slot(each.scope.rows) if guarded is None else guarded


NodeLowerer = Callable[["BlockWriter", ir.PlanNode, tuple[Any, ...]], Any]


class BlockWriter(FunctionWriter):
    """Writes the function of one stage."""

    def __init__(
        self,
        module: LlvmModule,
        code: BlockCode,
        compiler: BlockCompiler,
        stage: int,
        senses: dict[str, NodeLowerer],
        reduce: Callable[[BlockWriter, BlockInstruction], None],
        guards: Mapping[str, tuple[NodeLowerer, tuple[Any, ...]]],
        ask: Callable[[BlockWriter, BlockInstruction], None],
        combine: Callable[[str], str],
    ) -> None:
        super().__init__(module, code.layout)
        self.code, self.compiler, self.stage, self.senses, self._reduce = code, compiler, stage, senses, reduce
        self.guards, self.ask, self.combine = guards, ask, combine
        self.schedule, self.species = code.schedule, code.species.name
        self._uniform = {slot: node for node, slot in compiler.uniforms.items()}
        self._makers: dict[int, BlockInstruction] = {}
        self._kept: dict[int, ir.PlanNode] = {}
        self._kinds: dict[int, tuple[str, ...]] = {}
        self._reductions: list[BlockInstruction] = []
        self._index(compiler.root)
        self.mask: list[Lanes] = []
        self._nobody: list[int] = []  # mask slots that are cleared first, in case their scope is skipped
        self.at_top: list[Callable[[], None]] = []  # write code that runs first for each eight rows; called at the end
        self.groups: dict[BlockInstruction, Any] = {}  # reductions over neighbours, by the search that finds them

    def _index(self, scope: RowScope) -> None:
        for each in scope.code:
            if each.does is InstructionKind.REDUCE and each in self.schedule.native:
                self._reductions.append(each)
            if isinstance(each.what, ir.PlanNode) and each.out >= 0:
                self._makers[each.out] = each
                kinds = ir.TUPLE_KINDS_BY_OPERATION.get(each.what.op, (each.what.kind,))
                self._kinds[each.out] = tuple(LANE_TYPE_BY_KIND.get(kind, "") for kind in kinds)
                if each.does is InstructionKind.KEEP and each not in self.schedule.inlined:
                    self._kept[each.out] = each.what
            if each.inner is not None:
                self._kinds[each.inner.rows] = (BOOL,)
                self._index(each.inner)

    def write(self, name: str) -> None:
        """Add the function to the module."""
        e = self.e
        rows = self.end - self.begin
        with e.loop(rows, LANE_COUNT) as offset:
            self.offset = offset
            self.row = self.begin + offset
            root = self.compiler.root
            mask = (offset + e.iota() < rows) & ~e.read(self.base("quarantined"), self.row, BOOL)
            if root.rows in self.schedule.left and self.stage == 0:
                e.write(self.array(root.rows, 0, BOOL), offset, mask)
            e.known[-1][root.rows] = mask
            self.mask.append(mask)
            top, place = e.block_now, len(e.block_now.body)
            self._scope(root)
            last, e.block_now = e.block_now, BasicBlock("", [])
            for slot in self._nobody:
                e.write(self.array(slot, 0, BOOL), offset, e.constant(False, BOOL))
            for do in self.at_top:
                do()
            top.body[place:place] = e.block_now.body
            e.block_now = last
        if self.code.lines is not None:
            add_marks(self)
        self.add(name)

    # --- instructions --------------------------------------------------------------------------------------------------

    def _timed_instruction(self, each: BlockInstruction) -> AbstractContextManager[None]:
        """Return a context in which written code is timed for an instruction, if lines are timed."""
        return nullcontext() if self.code.lines is None else self._time_with_counter(self.code.lines.counter(each))

    @contextmanager
    def _time_with_counter(self, counter: int) -> Iterator[None]:
        previous_line, self.e.line = self.e.line, counter
        yield
        self.e.line = previous_line

    def _scope(self, scope: RowScope) -> None:
        for each in scope.code:
            with self._timed_instruction(each):
                match each.does:
                    case InstructionKind.REGION:
                        self._region(each)
                    case InstructionKind.KEEP:
                        self._write_lazy(each)
                    case InstructionKind.STATEMENT:
                        if self.schedule.at[each] == self.stage:
                            self._statement(each)
                    case InstructionKind.VALUE if each in self.schedule.calls[self.stage]:
                        self._guard(each)
                    case InstructionKind.VALUE | InstructionKind.REDUCE if each in self.schedule.native:
                        if self.schedule.home.get(each.out) == self.stage:
                            self.slot(each.out)

    def _note_need(self, each: BlockInstruction, mask: Lanes) -> None:
        """Emit code that records whether any agent needs a call."""
        e = self.e
        place = e.address(self.base("needs"), len(self.code.needs), I8)
        self.code.needs.append(each)
        e.put(place, e.load(place, I8) | e.mask_bits(mask))

    def _guard(self, each: BlockInstruction) -> None:
        """Emit code that records which agents need a call, if that is known, and stores the result for the others."""
        assert isinstance(each.what, ir.PlanNode)
        guard = self.guards.get(each.what.op)
        if guard is None:
            self._note_need(each, self.mask[-1])
            return
        asks, others = guard
        needed = self.mask[-1] & asks(self, each.what, tuple(self.slot(k) for k in each.inputs))
        self._note_need(each, needed)
        slot = self.code.guarded.setdefault(each, _FIRST_GUARD_SLOT - len(self.code.guarded))
        self._nobody.append(slot)
        self.e.write(self.array(slot, 0, BOOL), self.offset, needed)
        for part, (value, kind) in enumerate(zip(others, self._kinds[each.out], strict=True)):
            self.e.write(self.array(each.out, part, kind), self.offset, self.e.constant(value, kind))

    def _region(self, each: BlockInstruction) -> None:
        inner = each.inner
        assert inner is not None
        if not self.schedule.has(inner, self.stage):
            return
        mask = self._mask(inner, lambda: self.mask[-1] & self.slot(each.inputs[0]))
        with self.e.inside(self.e.any_lane(mask)):
            self.mask.append(mask)
            self._scope(inner)
            self.mask.pop()

    def _mask(self, inner: RowScope, make: Callable[[], Lanes]) -> Lanes:
        """Return the mask of an inner scope: computed in this stage, or stored by an earlier stage."""
        mask: Lanes
        if self.schedule.home[inner.rows] != self.stage:
            mask = self.slot(inner.rows)
            return mask
        mask = self.e.known[-1][inner.rows] = make()
        if inner.rows in self.schedule.left:
            self._nobody.append(inner.rows)
            self._store_slot(inner.rows, mask)
        return mask

    def _write_lazy(self, each: BlockInstruction) -> None:
        inner, node = each.inner, each.what
        assert inner is not None and isinstance(node, ir.PlanNode)
        if each in self.schedule.inlined:
            self._scope(inner)
            return
        if not self.schedule.has(inner, self.stage):
            return
        if node not in self.code.lazy_nodes:
            self.code.lazy_nodes.append(node)
        e, number = self.e, self.code.lazy_nodes.index(node)
        has = self.base("kept", number, "has")

        def missing() -> Lanes:
            asks = self.mask[-1] & ~e.read(has, self.row, BOOL)
            return asks & may_reach(self, node, self.code.bounds[each.out]) if each.out in self.code.bounds else asks

        mask = self._mask(inner, missing)
        with e.inside(e.any_lane(mask)):
            self.mask.append(mask)
            self._scope(inner)
            if self.schedule.at[each] == self.stage:
                result = self.slot(each.result)
                for part, value in enumerate(result if isinstance(result, tuple) else (result,)):
                    e.write_where(mask, self.base("kept", number, part), self.row, value)
                e.write_where(mask, has, self.row, e.constant(True, BOOL))
            self.mask.pop()
        if self.schedule.at[each] == self.stage and each.out in self.schedule.left:
            self.slot(each.out)

    # --- values --------------------------------------------------------------------------------------------------------

    def slot(self, slot: int) -> Any:
        """Return the value of a slot: known, loop-invariant, loaded from an earlier stage, or computed by new code."""
        slot = self.schedule.slot(slot)
        if slot in self._uniform:
            node = self._uniform[slot]
            return self.number(LANE_TYPE_BY_KIND[node.kind], "node", node)
        return self.e.get_or_make(slot, lambda: self._compute(slot))

    def _compute(self, slot: int) -> Any:
        if slot in self._kept:
            number, kinds = self.code.lazy_nodes.index(self._kept[slot]), self._kinds[slot]
            parts = tuple(self.e.read(self.base("kept", number, k), self.row, kind) for k, kind in enumerate(kinds))
            if slot in self.code.bounds:
                parts = (strength(self, self._kept[slot], self.code.bounds[slot], parts[0]), *parts[1:])
            self._store_slot(slot, parts)
            return parts if len(parts) > 1 else parts[0]
        each = self._makers.get(slot)
        node = None if each is None else each.what
        is_recomputed = isinstance(node, ir.PlanNode) and node.op in ("snap", "id") and slot not in self.schedule.left
        if each is None or each not in self.schedule.native or (self.schedule.home[slot] != self.stage and not is_recomputed):
            parts = tuple(self.e.read(self.array(slot, k, kind), self.offset, kind) for k, kind in enumerate(self._kinds[slot]))
            return parts if len(parts) > 1 else parts[0]
        with self._timed_instruction(each):
            if each.does is InstructionKind.REDUCE:
                self._reduce(self, each)
                return self.e.known[-1][slot]
            assert isinstance(node, ir.PlanNode)
            if node.op == "get":
                value = self.slot(each.inputs[0])[node.attrs[0]]
            else:
                args = tuple(self.slot(k) for k in each.inputs)
                value = self.apply(node.op, *args) if node.op in FUNCTION_BY_NAME else self.senses[node.op](self, node, args)
            self._store_slot(slot, value)
        return value

    def known(self, slot: int, value: Any) -> None:
        """Record the value of a slot that other code has computed already, and store it if a later stage needs it."""
        self.e.known[-1][slot] = value
        self._store_slot(slot, value)

    def _store_slot(self, slot: int, value: Any) -> None:
        if slot in self.schedule.left:
            for part, each in enumerate(value if isinstance(value, tuple) else (value,)):
                self.e.write(self.array(slot, part, each.kind), self.offset, each)

    def joint_reductions(self, first: BlockInstruction) -> list[BlockInstruction]:
        """Return other reductions over the same species or items that one search can compute with `first`.
        They must not depend on its result. Reductions over agents may be in other scopes."""
        assert isinstance(first.what, ir.PlanNode)
        reductions, of = [], first.what.args[0]
        for each in self._reductions:
            node = each.what
            if (
                each is first
                or not isinstance(node, ir.PlanNode)
                or node.args[0].op != of.op
                or node.args[0].attrs[0] != of.attrs[0]
            ):
                continue
            if self.schedule.home.get(each.out) != self.stage or any(each.out in names for names in self.e.known):
                continue
            if each.scope is not first.scope and of.op != "set.agents":
                continue
            if all(self._is_ready(slot) for slot in operands_of(each)):
                reductions.append(each)
        return reductions

    def _is_ready(self, slot: int) -> bool:
        """Return whether a value is known or needs only operations, without any reduction or register that changes."""
        slot = self.schedule.slot(slot)
        if slot in self._uniform or any(slot in names for names in self.e.known):
            return True
        each = self._makers.get(slot)
        if each is None or self.schedule.home.get(slot) != self.stage:
            return slot not in self._kept
        if each.does is not InstructionKind.VALUE or not isinstance(each.what, ir.PlanNode) or each.what.op == "load":
            return False
        return all(self._is_ready(k) for k in each.inputs)

    # --- statements ----------------------------------------------------------------------------------------------------

    def _statement(self, each: BlockInstruction) -> None:
        what = each.what
        if isinstance(what, ir.Store):
            self._store(each, what)
        else:
            self.ask(self, each)

    def _store(self, each: BlockInstruction, what: ir.Store) -> None:
        value, mask = self.slot(each.inputs[0]), self.mask[-1]
        if value.kind == F32:
            good = np.isfinite(value)
            if what.infinite:
                good = good | (value == float("inf"))
            self.refuse(mask & ~good, what.register, each)
            mask = mask & good
        self.e.write_where(mask, self.base("now", what.register), self.row, value)

    def refuse(self, bad: Lanes, what: str, by: BlockInstruction) -> None:
        """Emit code that records eight rows with a value that is not finite: the first row, and a mask of the faulty rows.
        The number of the rejected value is stored above the bits of the mask."""
        e, faults = self.e, self.code.faults
        with e.inside(e.any_lane(bad)):
            faults.append((what, by))  # one entry per place; its notes have space for one of each eight rows
            notes = self.base("notes")
            count = e.read_one(notes, 0, I64)
            first = e.address(notes, count * 2, I64)
            note_word = e.mask_word(bad) | ((len(faults) - 1) << LANE_COUNT)
            for k, value in enumerate((self.row, note_word)):
                e.put(e.address(first, k + 1, I64), value)
            e.put(notes, count + 1)
