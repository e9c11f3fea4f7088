"""Converts a plan's blocks to LLVM text: the functions that are compiled separately, and the data that running them needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from antdsl.machine_code.machine import Target
from antdsl.machine_code.module import LlvmModule
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.runtime.backends.compile import BlockCompiler, BlockInstruction
from antdsl.runtime.backends.native import search, sets
from antdsl.runtime.backends.native.asking import ask
from antdsl.runtime.backends.native.block import BlockCode, BlockWriter, NodeLowerer
from antdsl.runtime.backends.native.layout import LANE_TYPE_BY_KIND, AddressLayout
from antdsl.runtime.backends.native.marks import LineCounters
from antdsl.runtime.backends.native.scents import find_bounds
from antdsl.runtime.backends.native.schedule import PAIR_INSTRUCTION_KINDS, make_schedule
from antdsl.runtime.backends.native.senses import GUARDED_SENSES, NATIVE_LOWERERS, PAIR_SENSES, SENSES_CALLED_ON_MOVING_GROUND
from antdsl.runtime.pairs import is_nearest_only
from antdsl.scene.setting import WorldSetting

CompiledBlocks = Mapping[tuple[str, str], BlockCompiler]
_STEP_BLOCKS = ("decide", "act", "blend")


def _emit_reduction(b: BlockWriter, instruction: BlockInstruction) -> None:
    """Emit a reduction, and all others that the same search computes."""
    assert isinstance(instruction.what, ir.PlanNode)
    (search.emit_neighbour_reduction if instruction.what.args[0].op == "set.agents" else sets.emit_member_loop)(b, instruction)


@dataclass(frozen=True, slots=True, eq=False)
class NativeProgram:
    """The LLVM text of a plan.

    `text`: all functions. `functions`: the text of each function, by name.
    `units`: the texts that are compiled separately, by name. A unit is a function called from outside, with everything that it
    calls. `blocks`: the block codes, by species and block."""

    text: str
    functions: Mapping[str, str]
    units: Mapping[str, str]
    blocks: Mapping[tuple[str, str], BlockCode]


@dataclass(frozen=True, slots=True)
class WorldFacts:
    """Properties of a world that the code depends on.

    `moving`: some ground moves. `detail`: agents may sense obstacles as boxes. `timed`: lines are timed (`marks`)."""

    moving: bool
    detail: bool
    timed: bool = False

    @classmethod
    def of(cls, setting: WorldSetting, *, timed: bool = False) -> WorldFacts:
        """Return the properties of a world that is bound to a setting."""
        return cls(any(name in setting.surfaces for name in setting.moves.meshes), setting.detail is not None, timed)


def begin_blocks(plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts) -> dict[tuple[str, str], BlockCode]:
    """Return all blocks of a plan, with their instructions assigned to stages. Births are left out, because they are few."""
    senses = _senses(facts)

    def lowers(of: ir.SpeciesPlan, node: ir.PlanNode) -> bool:
        if node.op.startswith("reduce."):
            return sets.has_machine_code(node, PAIR_SENSES) and not is_nearest_only(of, node.args[0])
        return node.op == "get" or node.op in FUNCTION_BY_NAME or node.op in senses

    def costly(node: ir.PlanNode) -> bool:
        return node.op.startswith("reduce.") or node.op == "field.strongest"

    output = {}
    for (species, block), compiler in blocks.items():
        if block in _STEP_BLOCKS and compiler.root.code:
            of = plan.species[species]
            order = make_schedule(compiler, partial(lowers, of), costly)
            lines = LineCounters(compiler) if facts.timed else None
            output[species, block] = BlockCode(of, [], AddressLayout(), order, lines, bounds=find_bounds(compiler, order))
    return output


def program(plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts, target: Target) -> NativeProgram:
    """Return the blocks of a plan with their LLVM text."""
    guards = {} if facts.detail else GUARDED_SENSES

    def combine(field: str) -> str:
        return plan.fields[field].combine

    module = LlvmModule(target)
    output = begin_blocks(plan, blocks, facts)
    for (species, block), code in output.items():
        compiler, order = blocks[species, block], code.schedule
        for stage in range(order.stages):
            name = f"{species}.{block}.{stage}"
            BlockWriter(module, code, compiler, stage, _senses(facts), _emit_reduction, guards, ask, combine).write(name)
            code.names.append(name)
        for each in (each for group in order.calls for each in group):
            if each.does not in PAIR_INSTRUCTION_KINDS and isinstance(each.what, ir.PlanNode):
                for part, kind in enumerate(ir.TUPLE_KINDS_BY_OPERATION.get(each.what.op, (each.what.kind,))):
                    code.layout.array(each.out, part, LANE_TYPE_BY_KIND[kind])
    return NativeProgram(module.text(), module.functions, {name: module.unit(name) for name in module.entries()}, output)


def _senses(facts: WorldFacts) -> dict[str, NodeLowerer]:
    """Return the senses that have machine code in a world with these `facts`."""
    return {op: lower for op, lower in NATIVE_LOWERERS.items() if not (facts.moving and op in SENSES_CALLED_ON_MOVING_GROUND)}
