"""A plan's blocks as text for the compiler: what is compiled together, and what running it needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from antdsl.machine_code.machine import Target
from antdsl.machine_code.module import Module
from antdsl.numerics.elementwise import ELEMENTWISE
from antdsl.plan import ir
from antdsl.runtime.backends.compile import BlockCompiler, Instruction
from antdsl.runtime.backends.native import search, sets
from antdsl.runtime.backends.native.asking import ask
from antdsl.runtime.backends.native.block import BlockCode, BlockWriter, Lower
from antdsl.runtime.backends.native.layout import KINDS, Layout
from antdsl.runtime.backends.native.marks import LineCounters
from antdsl.runtime.backends.native.scents import find_bounds
from antdsl.runtime.backends.native.schedule import PAIRED, make_schedule
from antdsl.runtime.backends.native.senses import GUARDS, NATIVE, OF_PAIRS, ON_MOVING_GROUND
from antdsl.runtime.pairs import is_nearest_only
from antdsl.scene.setting import Setting

Blocks = Mapping[tuple[str, str], BlockCompiler]
_RUNS = ("decide", "act", "blend")


def _emit_reduction(b: BlockWriter, instruction: Instruction) -> None:
    """Emit a reduction, and the others that the same search computes."""
    assert isinstance(instruction.what, ir.Node)
    (search.emit_neighbour_reduction if instruction.what.args[0].op == "set.agents" else sets.emit_member_loop)(b, instruction)


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """`text` of all functions, the text of each function by name, and the units that are compiled separately. A unit is a
    function that is called from outside, with everything that it calls. `blocks`: by species and block."""

    text: str
    functions: Mapping[str, str]
    units: Mapping[str, str]
    blocks: Mapping[tuple[str, str], BlockCode]


@dataclass(frozen=True, slots=True)
class WorldFacts:
    """Properties of a world that the code depends on: whether some ground moves, and whether agents may treat boxes as obstacles.
    `timed`: lines are measured (`marks`)."""

    moving: bool
    detail: bool
    timed: bool = False

    @classmethod
    def of(cls, setting: Setting, *, timed: bool = False) -> WorldFacts:
        """Those of a world that is bound to a setting."""
        return cls(any(name in setting.surfaces for name in setting.moves.meshes), setting.detail is not None, timed)


def begin_blocks(plan: ir.Plan, blocks: Blocks, facts: WorldFacts) -> dict[tuple[str, str], BlockCode]:
    """All blocks of a plan but births, which are few, with their instructions in stages."""
    senses = _senses(facts)

    def lowers(of: ir.SpeciesPlan, node: ir.Node) -> bool:
        if node.op.startswith("reduce."):
            return sets.has_machine_code(node, OF_PAIRS) and not is_nearest_only(of, node.args[0])
        return node.op == "get" or node.op in ELEMENTWISE or node.op in senses

    def costly(node: ir.Node) -> bool:
        return node.op.startswith("reduce.") or node.op == "field.strongest"

    output = {}
    for (species, block), compiler in blocks.items():
        if block in _RUNS and compiler.root.code:
            of = plan.species[species]
            order = make_schedule(compiler, partial(lowers, of), costly)
            lines = LineCounters(compiler) if facts.timed else None
            output[species, block] = BlockCode(of, [], Layout(), order, lines, bounds=find_bounds(compiler, order))
    return output


def program(plan: ir.Plan, blocks: Blocks, facts: WorldFacts, target: Target) -> Program:
    """The blocks of a plan with their text."""
    guards = {} if facts.detail else GUARDS

    def combine(field: str) -> str:
        return plan.fields[field].combine

    module = Module(target)
    output = begin_blocks(plan, blocks, facts)
    for (species, block), code in output.items():
        compiler, order = blocks[species, block], code.schedule
        for stage in range(order.stages):
            name = f"{species}.{block}.{stage}"
            BlockWriter(module, code, compiler, stage, _senses(facts), _emit_reduction, guards, ask, combine).write(name)
            code.names.append(name)
        for each in (each for group in order.calls for each in group):
            if each.does not in PAIRED and isinstance(each.what, ir.Node):
                for part, kind in enumerate(ir.TUPLES.get(each.what.op, (each.what.kind,))):
                    code.layout.array(each.out, part, KINDS[kind])
    return Program(module.text(), module.functions, {name: module.unit(name) for name in module.entries()}, output)


def _senses(facts: WorldFacts) -> dict[str, Lower]:
    """Senses that have machine code in a world."""
    return {op: lower for op, lower in NATIVE.items() if not (facts.moving and op in ON_MOVING_GROUND)}
