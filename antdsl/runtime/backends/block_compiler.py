"""Converts a block of the plan into lists of vectorised instructions over slots.

A slot holds one value for each row of a scope. A scope is the set of rows for which a region's condition holds. A value is
computed in the first scope that uses it, and inner scopes gather it from there. Lazy senses are stored for the complete step, in
arrays with one entry per agent. A later use computes them only for rows that have no value yet. NumPy runs the instructions one
by one (`numpy_calls`). `native` makes machine code from the same lists."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from antdsl.numerics.elementwise import FUNCTION_BY_NAME, UFUNC_BY_NAME
from antdsl.plan import ir
from antdsl.plan.registers import find_cacheable_senses, find_early_loads, find_written_register
from antdsl.plan.traverse import collect_required_nodes, iterate_with_positions, list_operands
from antdsl.runtime.sensing.pairs import needs_only_nearest
from antdsl.runtime.world import DTYPE_BY_KIND
from antdsl.source import Span

SlotValues = list[Any]
SlotFunction = Callable[[SlotValues], None]
SlotFunctionMaker = Callable[[int, tuple[int, ...], "int | None"], SlotFunction]  # slots of the result, the inputs and the buffer
(
    WORLD_SLOT,
    POPULATION_SLOT,
    EFFECTS_SLOT,
    BUFFERS_SLOT,
    LAZY_VALUES_SLOT,
    PAIRS_SLOT,
    THREADS_SLOT,
    CALL_SECONDS_SLOT,
    FIRST_VALUE_SLOT,
) = 0, 1, 2, 3, 4, 5, 6, 7, 8


class InstructionKind(Enum):
    """The kind of an instruction."""

    VALUE = "value"  # a node's value for the rows of the scope
    GATHER = "gather"  # a value of the enclosing scope, for the rows of this scope
    REGION = "region"  # runs the inner scope for the rows where the condition holds
    CACHED_SENSE = "keep"  # runs the inner scope for rows without a stored value; the result is the stored values
    PAIRS = "pairs"  # the pairs of a set
    REPEAT_FOR_PAIRS = "spread"  # an agent's value for each of its pairs
    PAIR_LEAF = "of pair"  # a leaf of the pair's other agent, or a sense that depends on that agent
    PAIR_OPERATION = "by pair"  # an elementwise operation over pairs
    REDUCE = "reduce"
    STATEMENT = "statement"


@dataclass(slots=True, eq=False)
class BlockInstruction:
    """One instruction of a block. `subject`: the node or the statement that it computes.

    `slot`, `inputs`: the slots of its result and of its operands. `dtype`: the type of the buffer for its result; None if it
    allocates an array. `scope`: the rows for which it runs. `span`: the source text from which it comes. `layer`: the number of
    the first layer that needs the instruction, -1 for none. `inner_scope`: the inner scope that it runs for some of these rows.
    `inner_result_slot`: the slot of that scope's result. `statement_order`: the position of a statement in the source of its
    species."""

    kind: InstructionKind
    subject: ir.PlanNode | ir.PlanStatement
    slot: int
    inputs: tuple[int, ...]
    dtype: Any
    scope: RowScope
    span: Span | None
    layer: int
    inner_scope: RowScope | None = None
    inner_result_slot: int = -1  # slot of the inner scope that is read after it
    block: str = ""
    statement_order: int = -1  # position of a statement in the text of its species


@dataclass(slots=True, eq=False)
class RowScope:
    """The rows for which a region runs, and the region's instructions `code`. `parent_scope`: the enclosing scope.

    Three fields are slots. `rows_slot`: the row numbers in the species (slice or array). `parent_indices_slot`: the indices of
    these rows within the parent's rows (None: all). `row_count_slot`: the number of rows. `slot_by_node`: the slots of the
    values that this scope computes or gathers. `pair_scopes`: the pairs of each set."""

    parent_scope: RowScope | None
    rows_slot: int
    parent_indices_slot: int
    row_count_slot: int
    code: list[BlockInstruction] = field(default_factory=list)
    slot_by_node: dict[ir.PlanNode, int] = field(default_factory=dict)
    pair_scopes: dict[ir.PlanNode, PairScope] = field(default_factory=dict)
    draw_slots: dict[tuple[str, int], int] = field(default_factory=dict)  # (site, block) -> slot of its four words
    view_slots: dict[tuple[Any, int], int] = field(default_factory=dict)  # (dtype, number of buffer) -> slot of its view
    bound_calls: list[SlotFunction] = field(default_factory=list)


@dataclass(slots=True, eq=False)
class PairScope:
    """The pairs of one set in one scope. `slot`: the slot of the pairs. `slot_by_node`: for each node, the slot of its values,
    one per pair."""

    slot: int
    slot_by_node: dict[ir.PlanNode, int] = field(default_factory=dict)


class BlockCompiler:
    """Compiler that turns one plan block into instructions on slots, in nested row scopes."""

    def __init__(
        self, species: ir.SpeciesPlan, block: str, order: dict[ir.PlanStatement, int], sets: dict[ir.PlanNode, int]
    ) -> None:
        self.name, self._species, self._order = block, species, order
        self.uniform_slots: dict[ir.PlanNode, int] = {}
        self.slot_count = FIRST_VALUE_SLOT
        self.lazy_nodes = frozenset(find_cacheable_senses(species)) if block != "born" else frozenset()
        self.root_scope = self._make_scope(None)
        self.buffer_counts: dict[Any, int] = {}  # number of buffers, by dtype
        self.stored_registers: set[str] = set()  # registers that the block stores
        self.region_count_by_set = sets  # for each set of the species: the number of regions that use it
        self.complete_species: set[str] = set()  # species of which a set contains all agents
        self._layer_spans = tuple(layer.span for layer in species.layers) if block == "blend" else ()
        self._layer_number = -1

    def allocate_slot(self) -> int:
        """Return the number of a new slot."""
        self.slot_count += 1
        return self.slot_count - 1

    def _make_scope(self, parent: RowScope | None) -> RowScope:
        return RowScope(parent, self.allocate_slot(), self.allocate_slot(), self.allocate_slot())

    def _emit_instruction(
        self,
        scope: RowScope,
        kind: InstructionKind,
        subject: ir.PlanNode | ir.PlanStatement,
        result_slot: int,
        inputs: tuple[int, ...],
        dtype: Any = None,
        *,
        inner: RowScope | None = None,
        inner_result_slot: int = -1,
    ) -> None:
        order = -1 if isinstance(subject, ir.PlanNode) else self._order[subject]
        scope.code.append(
            BlockInstruction(
                kind,
                subject,
                result_slot,
                inputs,
                dtype,
                scope,
                subject.span,
                self._layer_number,
                inner,
                inner_result_slot,
                self.name,
                order,
            )
        )

    def compile(self, block: ir.Block) -> None:
        """Emit the instructions of a block into the root scope."""
        self.early = find_early_loads(block)
        self.stored_registers.update(
            name for _, each in iterate_with_positions(block) if (name := find_written_register(each)) is not None
        )
        self._compile_block(self.root_scope, block, ())

    # --- statements ----------------------------------------------------------------------------------------------------

    def _compile_block(self, scope: RowScope, block: ir.Block, path: tuple[int, ...]) -> None:
        """Emit the statements of a block or region into `scope`. `path`: the position of the block or region in the nested
        regions."""
        for k, (statement, layer) in enumerate(zip(block.statements, self._find_statement_layers(block), strict=True)):
            self._layer_number = layer
            for node in self.early.get((*path, k), ()):
                self.emit_value(scope, node)
            inputs = tuple(self.emit_value(scope, node) for node in list_operands(statement))
            if isinstance(statement, ir.If):
                inner = self._make_scope(scope)
                self._compile_block(inner, statement.body, (*path, k))
                self._layer_number = layer
                if inner.code:
                    self._emit_instruction(scope, InstructionKind.REGION, statement, -1, (inputs[0],), inner=inner)
                continue
            self._emit_instruction(scope, InstructionKind.STATEMENT, statement, -1, inputs)

    def _find_statement_layers(self, block: ir.Block) -> list[int]:
        """Return the layer of each statement, found by its source line.

        A statement that stores the memory of a behaviour is in another file. It belongs to the layer that called the behaviour,
        which is the layer of the next statement that has one."""
        if not self._layer_spans:
            return [-1] * len(block.statements)
        numbers, current = [], self._layer_number
        for statement in reversed(block.statements):
            span = statement.span
            for number, layer in enumerate(self._layer_spans):
                if span is not None and span.source is layer.source and layer.start <= span.start < layer.end:
                    current = number
            numbers.append(current)
        return numbers[::-1]

    # --- values --------------------------------------------------------------------------------------------------------

    def emit_value(self, scope: RowScope, node: ir.PlanNode, recompute: bool = False) -> int:
        """Return the slot of a node's value in a scope. Emit the instructions for the value unless it is already computed.

        `recompute`: whether to compute the value even if it is stored for the step."""
        if node.rate <= ir.UpdateRate.STEP:
            return self._find_uniform_slot(node)
        missing: set[ir.PlanNode] = set()
        pending = [node]
        while pending:
            top = pending.pop()
            if top in missing or top.rate <= ir.UpdateRate.STEP or self._find_scope_of_node(scope, top) is not None:
                continue
            if top.rate == ir.UpdateRate.AGENT and top.kind is not ir.ValueKind.SET:
                missing.add(top)
                if top in self.lazy_nodes and not (recompute and top is node):
                    continue
            pending.extend(top.args)
        for each in sorted(missing, key=lambda n: n.number):
            if each in self.lazy_nodes and not (recompute and each is node):
                self._emit_lazy_sense(scope, each)
            else:
                self._emit_node(scope, each)
        return self._find_stored_slot(scope, node)

    def _find_uniform_slot(self, node: ir.PlanNode) -> int:
        """Return the slot of a node's value that is equal for all agents."""
        if node not in self.uniform_slots:
            self.uniform_slots[node] = self.allocate_slot()
        return self.uniform_slots[node]

    @staticmethod
    def _find_scope_of_node(scope: RowScope | None, node: ir.PlanNode) -> RowScope | None:
        """Return the innermost scope, starting from `scope`, that contains the value of a node. None if no enclosing scope
        contains it."""
        while scope is not None and node not in scope.slot_by_node:
            scope = scope.parent_scope
        return scope

    def _find_stored_slot(self, scope: RowScope, node: ir.PlanNode) -> int:
        """Return the slot of a value that this scope or an enclosing scope contains.

        If an enclosing scope contains it, emit an instruction that gathers it for the rows of this scope."""
        if node.rate <= ir.UpdateRate.STEP:
            return self._find_uniform_slot(node)
        holders = [scope]
        while node not in holders[-1].slot_by_node:
            outer = holders[-1].parent_scope
            assert outer is not None, f"{node!r} is not known"
            holders.append(outer)
        for inner in reversed(holders[:-1]):
            assert inner.parent_scope is not None
            inner.slot_by_node[node] = slot = self.allocate_slot()
            self._emit_instruction(inner, InstructionKind.GATHER, node, slot, (inner.parent_scope.slot_by_node[node],))
        return scope.slot_by_node[node]

    def _emit_node(self, scope: RowScope, node: ir.PlanNode) -> None:
        """Emit the instruction of one node, given that its operands have slots."""
        if node.op.startswith("reduce."):
            does, inputs = InstructionKind.REDUCE, self._emit_reduction(scope, node)
        else:
            does, inputs = InstructionKind.VALUE, tuple(self._find_stored_slot(scope, a) for a in node.args)
        slot = self.allocate_slot()
        self._emit_instruction(scope, does, node, slot, inputs, DTYPE_BY_KIND[node.kind] if node.op in UFUNC_BY_NAME else None)
        scope.slot_by_node[node] = slot

    def _emit_lazy_sense(self, scope: RowScope, node: ir.PlanNode) -> None:
        """Emit a sense that is stored for the step. An inner scope computes it for the rows that have no stored value yet."""
        inner = self._make_scope(scope)
        result = self.emit_value(inner, node, recompute=True)
        slot = scope.slot_by_node[node] = self.allocate_slot()
        self._emit_instruction(scope, InstructionKind.CACHED_SENSE, node, slot, (), inner=inner, inner_result_slot=result)

    # --- sets ----------------------------------------------------------------------------------------------------------

    def _emit_reduction(self, scope: RowScope, node: ir.PlanNode) -> tuple[int, ...]:
        """Emit the pairs of a reduction, and its values for these pairs. Return the slots of the reduction's inputs."""
        pairs = self._find_or_emit_pairs(scope, node.args[0])
        bodies = node.args[1:]
        for each in collect_required_nodes(bodies):
            if each.rate == ir.UpdateRate.PAIR and each not in pairs.slot_by_node:
                self._emit_pair_value(scope, pairs, each)
        return pairs.slot, *(self._find_or_emit_pair_value(scope, pairs, body) for body in bodies)

    def _find_or_emit_pairs(self, scope: RowScope, node: ir.PlanNode) -> PairScope:
        """Return the pairs of a set in a scope. Emit the instruction that finds them, unless the scope already has them."""
        if node not in scope.pair_scopes:
            if node.op == "set.every" and not needs_only_nearest(self._species, node):
                self.complete_species.add(node.attrs[0])
            inputs = tuple(self._find_stored_slot(scope, a) for a in node.args)
            pairs = scope.pair_scopes[node] = PairScope(self.allocate_slot())
            if self.name != "born" and all(part.op != "load" for part in collect_required_nodes((node,))):
                self.region_count_by_set[node] = self.region_count_by_set.get(node, 0) + 1
            self._emit_instruction(scope, InstructionKind.PAIRS, node, pairs.slot, inputs)
        return scope.pair_scopes[node]

    def _find_or_emit_pair_value(self, scope: RowScope, pairs: PairScope, node: ir.PlanNode) -> int:
        """Return the slot of a node's values over pairs, one per pair. Emit its instructions unless the scope already has them.

        A value of the requesting agent is repeated for each of its pairs."""
        if node.rate <= ir.UpdateRate.STEP:
            return self._find_uniform_slot(node)
        if node in pairs.slot_by_node:
            return pairs.slot_by_node[node]
        slot = pairs.slot_by_node[node] = self.allocate_slot()
        self._emit_instruction(
            scope, InstructionKind.REPEAT_FOR_PAIRS, node, slot, (self._find_stored_slot(scope, node), pairs.slot)
        )
        return slot

    def _emit_pair_value(self, scope: RowScope, pairs: PairScope, node: ir.PlanNode) -> None:
        inputs = tuple(self._find_or_emit_pair_value(scope, pairs, a) for a in node.args)
        does = InstructionKind.PAIR_OPERATION if node.op in FUNCTION_BY_NAME else InstructionKind.PAIR_LEAF
        slot = pairs.slot_by_node[node] = self.allocate_slot()
        self._emit_instruction(
            scope, does, node, slot, inputs if does is InstructionKind.PAIR_OPERATION else (pairs.slot, *inputs)
        )


# --- buffers ---------------------------------------------------------------------------------------------------------


def _flatten_instructions(scope: RowScope, order: list[tuple[BlockInstruction, bool]]) -> None:
    """Append the instructions of a scope to `order` in execution order, as pairs (instruction, whether its inner scope has run).

    An instruction with an inner scope is appended twice: with False before that scope, and with True after it."""
    for instruction in scope.code:
        order.append((instruction, False))
        if instruction.inner_scope is not None:
            _flatten_instructions(instruction.inner_scope, order)
            order.append((instruction, True))


def bind_instruction_calls(
    compiler: BlockCompiler, find_call_maker: Callable[[BlockInstruction, BlockCompiler], SlotFunctionMaker]
) -> None:
    """Assign buffers to elementwise results, and create the function call of each instruction.

    `find_call_maker`: returns the function that creates an instruction's call. A buffer is reused after the last use of its
    value: a linear scan over the execution order (M. Poletto and V. Sarkar, TOPLAS 21(5), 1999, p. 895). It is valid because no
    region runs twice."""
    order: list[tuple[BlockInstruction, bool]] = []
    _flatten_instructions(compiler.root_scope, order)
    last: dict[int, int] = {}
    for position, (instruction, is_after) in enumerate(order):
        for slot in (instruction.inner_result_slot,) if is_after else instruction.inputs:
            last[slot] = position
    for instruction, is_after in reversed(order):
        if instruction.kind is InstructionKind.GATHER and not is_after:  # the result may be the input itself
            (source,) = instruction.inputs
            last[source] = max(last[source], last.get(instruction.slot, -1))
    free: dict[Any, list[int]] = {}
    held: dict[int, tuple[Any, int]] = {}
    for position, (instruction, is_after) in enumerate(order):
        for slot in [s for s in held if last.get(s, -1) <= position]:
            dtype, number = held.pop(slot)
            free[dtype].append(number)
        buffer = None
        if instruction.dtype is not None and not is_after:
            spare = free.setdefault(instruction.dtype, [])
            if not spare:
                spare.append(compiler.buffer_counts.get(instruction.dtype, 0))
                compiler.buffer_counts[instruction.dtype] = spare[-1] + 1
            number = spare.pop()
            held[instruction.slot] = (instruction.dtype, number)
            buffer = instruction.scope.view_slots.setdefault((instruction.dtype, number), -1)
            if buffer == -1:
                buffer = instruction.scope.view_slots[instruction.dtype, number] = compiler.allocate_slot()
        if not is_after:
            make = find_call_maker(instruction, compiler)
            instruction.scope.bound_calls.append(make(instruction.slot, instruction.inputs, buffer))
