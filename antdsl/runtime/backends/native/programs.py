"""Converts a plan's blocks to LLVM text: functions that are compiled separately, and the data needed to run them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from antdsl.machine_code.llvm_compiler import Target
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockCompiler, BlockInstruction
from antdsl.runtime.backends.native import reduction_loops, search
from antdsl.runtime.backends.native.address_layout import LANE_TYPE_BY_KIND, AddressLayout
from antdsl.runtime.backends.native.block_writer import BlockCodePlan, BlockWriter, NodeLowerer
from antdsl.runtime.backends.native.field_threshold import find_scent_thresholds
from antdsl.runtime.backends.native.line_profiling import LineCounters
from antdsl.runtime.backends.native.native_senses import (
    GUARDED_SENSES,
    NATIVE_LOWERERS,
    PAIR_SENSES,
    SENSES_CALLED_ON_MOVING_GROUND,
)
from antdsl.runtime.backends.native.request_emission import emit_request
from antdsl.runtime.backends.native.stage_schedule import PAIR_INSTRUCTION_KINDS, make_schedule
from antdsl.runtime.sensing.pairs import needs_only_nearest
from antdsl.scene.setting import WorldSetting

CompiledBlocks = Mapping[tuple[str, str], BlockCompiler]
_STEP_BLOCKS = ("decide", "act", "blend")


def _emit_reduction(b: BlockWriter, instruction: BlockInstruction) -> None:
    """Emit a reduction together with all others that the same search can compute."""
    assert isinstance(instruction.subject, ir.PlanNode)
    (search.emit_neighbour_reduction if instruction.subject.args[0].op == "set.agents" else reduction_loops.emit_member_loop)(
        b, instruction
    )


@dataclass(frozen=True, slots=True, eq=False)
class NativeProgram:
    """The LLVM text of a plan.

    `text`: all functions. `functions`: the text of each function, by name. `units`: the texts that are compiled separately, by
    name. A unit is a function with external callers, together with all functions that it calls. `blocks`: the block codes, by
    species and block."""

    text: str
    functions: Mapping[str, str]
    units: Mapping[str, str]
    blocks: Mapping[tuple[str, str], BlockCodePlan]


@dataclass(frozen=True, slots=True)
class WorldFacts:
    """Properties of a world on which the machine code depends.

    `has_moving_ground`: whether any part of the ground moves. `has_detail_levels`: whether agents may sense obstacles as boxes.
    `is_timed`: whether the time of source lines is measured (`line_profiling`)."""

    has_moving_ground: bool
    has_detail_levels: bool
    is_timed: bool = False

    @classmethod
    def from_setting(cls, setting: WorldSetting, *, is_timed: bool = False) -> WorldFacts:
        """Return the properties of a world that will be bound to a setting."""
        return cls(any(name in setting.surfaces for name in setting.motion.meshes), setting.level_of_detail is not None, is_timed)


def schedule_blocks(plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts) -> dict[tuple[str, str], BlockCodePlan]:
    """Assign the instructions of each block to stages.

    Return block codes, by species and block, that have no functions yet. Blocks of births are omitted, because births are
    rare."""
    senses = _find_native_senses(facts)

    def has_machine_code(species: ir.SpeciesPlan, node: ir.PlanNode) -> bool:
        if node.op.startswith("reduce."):
            plain = plan.period is None and not needs_only_nearest(species, node.args[0])  # pairs of images have no machine code
            return plain and reduction_loops.can_compile_node(node, PAIR_SENSES)
        return node.op == "get" or node.op in FUNCTION_BY_NAME or node.op in senses

    def is_costly(node: ir.PlanNode) -> bool:
        return node.op.startswith("reduce.") or node.op == "field.strongest"

    output = {}
    for (species, block), compiler in blocks.items():
        if block in _STEP_BLOCKS and compiler.root_scope.code:
            of = plan.species[species]
            order = make_schedule(compiler, partial(has_machine_code, of), is_costly)
            lines = LineCounters(compiler) if facts.is_timed else None
            output[species, block] = BlockCodePlan(
                of, [], AddressLayout(), order, lines, scent_thresholds=find_scent_thresholds(compiler, order)
            )
    return output


def write_program(plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts, target: Target) -> NativeProgram:
    """Return the LLVM text of all blocks of a plan for a processor `target`."""
    guards = {} if facts.has_detail_levels else GUARDED_SENSES

    def get_combination(field: str) -> str:
        return plan.fields[field].combine

    module = LlvmModule(target)
    output = schedule_blocks(plan, blocks, facts)
    for (species, block), code in output.items():
        compiler, order = blocks[species, block], code.schedule
        for stage in range(order.stage_count):
            name = f"{species}.{block}.{stage}"
            BlockWriter(
                module, code, compiler, stage, _find_native_senses(facts), _emit_reduction, guards, emit_request, get_combination
            ).write_function(name)
            code.function_names.append(name)
        for each in (each for group in order.calls_after_stage for each in group):
            if each.kind not in PAIR_INSTRUCTION_KINDS and isinstance(each.subject, ir.PlanNode):
                for part, kind in enumerate(ir.TUPLE_KINDS_BY_OPERATION.get(each.subject.op, (each.subject.kind,))):
                    code.layout.find_array_index(each.slot, part, LANE_TYPE_BY_KIND[kind])
    return NativeProgram(
        module.text(), module.functions, {name: module.extract_unit_text(name) for name in module.list_entry_names()}, output
    )


def _find_native_senses(facts: WorldFacts) -> dict[str, NodeLowerer]:
    """Return the senses that have machine code in a world with these `facts`, by operation."""
    return {
        op: lower
        for op, lower in NATIVE_LOWERERS.items()
        if not (facts.has_moving_ground and op in SENSES_CALLED_ON_MOVING_GROUND)
    }
