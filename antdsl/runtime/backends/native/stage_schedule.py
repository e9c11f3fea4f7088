"""Assigns each instruction of a block to a stage, and determines the values that a stage must store for later stages.

Operations without machine code (rays, curves, flows) are called between two stages. All rows run through stage 0, then the calls
at its end run, then all rows run through stage 1. A statement runs in the first stage in which its operands are known, in source
order. A value is computed in the stage that first needs it. It is stored in an array if a later stage or a call also needs it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockCompiler, BlockInstruction, InstructionKind, RowScope

_OPS_LOADED_IN_EACH_STAGE = frozenset(("snap", "id"))  # loaded again in each stage, not stored in an array
PAIR_INSTRUCTION_KINDS = (
    InstructionKind.PAIRS,
    InstructionKind.REPEAT_FOR_PAIRS,
    InstructionKind.PAIR_LEAF,
    InstructionKind.PAIR_OPERATION,
)


@dataclass(slots=True, eq=False)
class StageSchedule:
    """The stages of a block. `stage_count`: the number of stages.

    `stage_by_slot`: the stage in which each slot's value is computed. `use_stages`: for each slot, the stages that use its value.
    `stored_slots`: the slots with values that are stored in arrays. `calls_after_stage[k]`: the calls after stage k.
    `slot_aliases`: for each slot that only gathers a value, the slot of that value. The mask of a scope has the slot of the
    scope's rows. The mask of the root is known in every stage."""

    stage_count: int
    stage_by_slot: dict[int, int]
    stored_slots: set[int]
    use_stages: dict[int, set[int]]
    stage_by_instruction: dict[BlockInstruction, int]  # stage of statements, or of the end of a cached sense
    calls_after_stage: list[list[BlockInstruction]]
    slot_aliases: dict[int, int]
    native_instructions: frozenset[BlockInstruction]  # values and reductions with machine code
    inlined_senses: frozenset[BlockInstruction]  # cached senses that are cheap enough to compute again

    def resolve_slot(self, slot: int) -> int:
        """Return the slot that stores the value of `slot`. For a value that is gathered from an enclosing scope, it is the slot
        of the outermost scope."""
        while slot in self.slot_aliases:
            slot = self.slot_aliases[slot]
        return slot

    def is_run_in_stage(self, scope: RowScope, stage: int) -> bool:
        """Return whether any instruction of a scope runs in a stage."""
        return stage in self.use_stages.get(self.resolve_slot(scope.rows_slot), ())


@dataclass(slots=True)
class _ScheduleBuilder:
    """The stages of a block while they are being assigned. The fields are those of `StageSchedule`."""

    compiler: BlockCompiler
    has_machine_code: Callable[[ir.PlanNode], bool]
    is_costly: Callable[[ir.PlanNode], bool]
    uniform_slots: frozenset[int] = frozenset()
    first_stage_by_slot: dict[int, int] = field(default_factory=dict)  # earliest stage in which a slot's value can be known
    last_store_stages: dict[object, int] = field(default_factory=dict)
    last_load_stages: dict[object, int] = field(default_factory=dict)
    slot_aliases: dict[int, int] = field(default_factory=dict)
    stage_by_instruction: dict[BlockInstruction, int] = field(default_factory=dict)
    native_instructions: set[BlockInstruction] = field(default_factory=set)
    inlined_senses: set[BlockInstruction] = field(default_factory=set)
    calls_by_stage: dict[int, list[BlockInstruction]] = field(default_factory=dict)
    pair_slots: set[int] = field(default_factory=set)  # slots over pairs that calls need


def make_schedule(
    compiler: BlockCompiler, has_machine_code: Callable[[ir.PlanNode], bool], is_costly: Callable[[ir.PlanNode], bool]
) -> StageSchedule:
    """Return the stages of a block.

    `can_compile_node`: returns whether a node has machine code. `is_costly`: returns whether a cached node takes so long to
    compute again that machine code must store it."""
    maker = _ScheduleBuilder(compiler, has_machine_code, is_costly, frozenset(compiler.uniform_slots.values()))
    for instruction in _iterate_instructions(compiler.root_scope):
        what = instruction.subject
        if instruction.kind is InstructionKind.REDUCE and isinstance(what, ir.PlanNode) and not has_machine_code(what):
            _find_pair_slots(maker, instruction)
    _assign_stages(maker, compiler.root_scope, 0)
    return _find_slot_uses(maker)


def _iterate_instructions(scope: RowScope) -> Iterator[BlockInstruction]:
    for instruction in scope.code:
        yield instruction
        if instruction.inner_scope is not None:
            yield from _iterate_instructions(instruction.inner_scope)


def _find_pair_slots(builder: _ScheduleBuilder, reduce: BlockInstruction) -> None:
    """Record the slots of the pair values that a reduction without machine code needs."""
    makers = {each.slot: each for each in reduce.scope.code if each.kind in PAIR_INSTRUCTION_KINDS}
    pending = [slot for slot in reduce.inputs if slot in makers]
    while pending:
        slot = pending.pop()
        if slot not in builder.pair_slots:
            builder.pair_slots.add(slot)
            pending += [each for each in makers[slot].inputs if each in makers]


def _resolve_alias(builder: _ScheduleBuilder, slot: int) -> int:
    while slot in builder.slot_aliases:
        slot = builder.slot_aliases[slot]
    return slot


def _find_earliest_stage(builder: _ScheduleBuilder, slots: tuple[int, ...]) -> int:
    """Return the first stage in which the values of all slots are known."""
    return max((builder.first_stage_by_slot.get(_resolve_alias(builder, slot), 0) for slot in slots), default=0)


def _assign_stages(builder: _ScheduleBuilder, scope: RowScope, mask_stage: int) -> None:
    """Determine the first stage in which each value can be known, and the stage of each statement.

    `mask_stage`: the first stage in which the scope's mask is known."""
    builder.first_stage_by_slot[scope.rows_slot] = mask_stage
    for each in scope.code:
        stage, what = max(mask_stage, _find_earliest_stage(builder, each.inputs)), each.subject
        match each.kind:
            case InstructionKind.GATHER:
                builder.slot_aliases[each.slot] = each.inputs[0]
            case InstructionKind.REGION:
                assert each.inner_scope is not None
                _assign_stages(builder, each.inner_scope, stage)
            case InstructionKind.CACHED_SENSE:
                assert each.inner_scope is not None and isinstance(what, ir.PlanNode)
                key = ("kept", what)
                stage = max(mask_stage, builder.last_store_stages.get(key, 0))
                if builder.has_machine_code(what) and not builder.is_costly(what):
                    builder.inlined_senses.add(each)
                    builder.slot_aliases[each.slot], builder.slot_aliases[each.inner_scope.rows_slot] = (
                        each.inner_result_slot,
                        scope.rows_slot,
                    )
                    _assign_stages(builder, each.inner_scope, mask_stage)
                else:
                    builder.last_load_stages[key] = stage
                    _assign_stages(builder, each.inner_scope, stage)
                    result = builder.first_stage_by_slot.get(_resolve_alias(builder, each.inner_result_slot), 0)
                    builder.stage_by_instruction[each] = builder.last_store_stages[key] = builder.first_stage_by_slot[
                        each.slot
                    ] = max(stage, result)
            case InstructionKind.STATEMENT:
                register = what.register if isinstance(what, ir.Store) else what.register if isinstance(what, ir.Give) else None
                if register is not None:
                    stage = max(stage, builder.last_store_stages.get(register, 0), builder.last_load_stages.get(register, 0))
                    builder.last_store_stages[register] = stage
                builder.stage_by_instruction[each] = stage
            case InstructionKind.VALUE | InstructionKind.REDUCE if isinstance(what, ir.PlanNode) and builder.has_machine_code(
                what
            ):
                if what.op == "load":
                    stage = max(stage, builder.last_store_stages.get(what.attrs[0], 0))
                    builder.last_load_stages[what.attrs[0]] = max(stage, builder.last_load_stages.get(what.attrs[0], 0))
                elif each.kind is InstructionKind.REDUCE:
                    stage = max(mask_stage, _find_earliest_stage(builder, list_reduction_operands(each)))
                builder.native_instructions.add(each)
                builder.first_stage_by_slot[each.slot] = stage
            case _:
                if each.kind in PAIR_INSTRUCTION_KINDS and each.slot not in builder.pair_slots:
                    if each.kind is InstructionKind.REPEAT_FOR_PAIRS:
                        builder.slot_aliases[each.slot] = each.inputs[0]
                    else:
                        builder.first_stage_by_slot[each.slot] = stage
                    continue
                builder.calls_by_stage.setdefault(stage, []).append(each)
                builder.first_stage_by_slot[each.slot] = stage if each.kind in PAIR_INSTRUCTION_KINDS else stage + 1


def list_reduction_operands(reduce: BlockInstruction) -> tuple[int, ...]:
    """Return the slots of the requesting agents' values on which a reduction with machine code depends."""
    makers = {each.slot: each for each in reduce.scope.code if each.kind in PAIR_INSTRUCTION_KINDS}
    operands: dict[int, None] = {}
    pending = list(reduce.inputs)
    visited: set[int] = set()
    while pending:
        slot = pending.pop()
        if slot in visited:
            continue
        visited.add(slot)
        producer = makers.get(slot)
        if producer is None:
            operands[slot] = None
        elif producer.kind is InstructionKind.REPEAT_FOR_PAIRS:
            operands[producer.inputs[0]] = None
        else:
            pending += producer.inputs
    return tuple(operands)


def _find_slot_uses(builder: _ScheduleBuilder) -> StageSchedule:
    """Find the stages that use each value, going backwards from the last instruction. Return the schedule."""
    stages = 1 + max(
        [*builder.first_stage_by_slot.values(), *builder.stage_by_instruction.values(), *(k + 1 for k in builder.calls_by_stage)],
        default=0,
    )
    calls = [builder.calls_by_stage.get(k, []) for k in range(stages)]
    called = {each for group in calls for each in group}
    use_stages: dict[int, set[int]] = {}
    home: dict[int, int] = {}
    left: set[int] = set()

    def require_slots(slots: tuple[int, ...], stage: int, array: bool = False) -> None:
        for slot in slots:
            slot = _resolve_alias(builder, slot)
            if slot in builder.uniform_slots:
                continue
            use_stages.setdefault(slot, set()).add(stage)
            if array:
                left.add(slot)

    made_by_calls = {each.slot for each in called}
    reread_slots: set[int] = set()
    for each in reversed(list(_iterate_run_order(builder.compiler.root_scope))):
        instruction, ending = each
        scope, out = instruction.scope, instruction.slot
        if instruction.kind is InstructionKind.REGION:
            assert instruction.inner_scope is not None
            mask = instruction.inner_scope.rows_slot
            if not ending and mask in use_stages:
                home[mask] = min(use_stages[mask])
                require_slots((instruction.inputs[0], scope.rows_slot), home[mask])
                _propagate_uses_to_parents(builder, scope, use_stages, use_stages[mask])
        elif instruction.kind is InstructionKind.CACHED_SENSE:
            assert instruction.inner_scope is not None
            mask = instruction.inner_scope.rows_slot
            if instruction in builder.inlined_senses:
                continue
            if ending:
                if out in use_stages:
                    require_slots((instruction.inner_result_slot, mask), builder.stage_by_instruction[instruction])
            elif mask in use_stages:
                home[mask] = min(use_stages[mask])  # no earlier stage runs the scope that computes it
                require_slots((scope.rows_slot,), home[mask])
                _propagate_uses_to_parents(builder, scope, use_stages, use_stages[mask])
        elif ending:
            continue
        elif instruction in called:
            stage = next(k for k, group in enumerate(calls) if instruction in group)
            inputs = tuple(
                slot for slot in instruction.inputs if _resolve_alias(builder, slot) not in made_by_calls | builder.pair_slots
            )
            require_slots(inputs, stage, array=True)
            require_slots((scope.rows_slot,), stage, array=True)
            home[out] = stage + 1
        elif instruction.kind is InstructionKind.STATEMENT:
            require_slots((*instruction.inputs, scope.rows_slot), builder.stage_by_instruction[instruction])
        elif instruction in builder.native_instructions and out in use_stages:
            what = instruction.subject
            assert isinstance(what, ir.PlanNode)
            inputs = list_reduction_operands(instruction) if instruction.kind is InstructionKind.REDUCE else instruction.inputs
            if what.op in _OPS_LOADED_IN_EACH_STAGE and out not in left:
                home[out] = min(use_stages[out])
                reread_slots.add(out)
                for stage in use_stages[out]:
                    require_slots((scope.rows_slot,), stage)
                continue
            home[out] = builder.first_stage_by_slot[out] if what.op == "load" else min(use_stages[out])
            require_slots((*inputs, scope.rows_slot), home[out])
            if max(use_stages[out]) > home[out]:
                left.add(out)
    for slot, stages_ in use_stages.items():
        if slot in home and max(stages_) > home[slot] and slot not in made_by_calls and slot not in reread_slots:
            left.add(slot)
    return StageSchedule(
        stages,
        home,
        left,
        use_stages,
        builder.stage_by_instruction,
        calls,
        builder.slot_aliases,
        frozenset(builder.native_instructions),
        frozenset(builder.inlined_senses),
    )


def _propagate_uses_to_parents(
    builder: _ScheduleBuilder, scope: RowScope, use_stages: dict[int, set[int]], stages: set[int]
) -> None:
    """Add `stages` to the stages in which the scopes that enclose an inner scope are used."""
    use_stages.setdefault(_resolve_alias(builder, scope.rows_slot), set()).update(stages)


def _iterate_run_order(scope: RowScope) -> Iterator[tuple[BlockInstruction, bool]]:
    """Yield the instructions of a scope in execution order, as pairs (instruction, whether its inner scope has run).

    An instruction with an inner scope occurs twice: with False before that scope, and with True after it."""
    for instruction in scope.code:
        yield instruction, False
        if instruction.inner_scope is not None:
            yield from _iterate_run_order(instruction.inner_scope)
            yield instruction, True
