"""Stores the results of compiling a plan for later runs: the inputs of its functions, and the keys of their texts.

With these, a later run can load the code of a plan without writing its text, which is the slowest part. The key is a hash of the
plan, of all modules of antdsl, and of everything else that affects the text. Files belong to `object_cache`, and are signed
because they determine which addresses the code reads."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from hashlib import blake2b
from typing import Any

from antdsl.machine_code import code_cache, object_cache
from antdsl.machine_code.llvm_compiler import Target
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import BlockInstruction
from antdsl.runtime.backends.metering import list_scope_instructions
from antdsl.runtime.backends.native.block_writer import BlockCodePlan, NeighbourSearchPlan
from antdsl.runtime.backends.native.programs import CompiledBlocks, NativeProgram, WorldFacts, schedule_blocks
from antdsl.source import Span
from antdsl.source_hash import has_module_sources, hash_sources

_BlockKey = tuple[str, str]
StoredBlocks = tuple[
    Mapping[str, str], Mapping[_BlockKey, BlockCodePlan]
]  # keys of texts by the names of functions, and the blocks


class _UnsupportedValue(Exception):
    """Error: a value cannot be stored in a file, or may differ in another run."""


@dataclass(frozen=True, slots=True, eq=False)
class IndexedPlan:
    """A plan and its blocks, with numbers for their nodes and instructions. `key`: the key of the file that stores them.

    `nodes`: the number of each node. `instructions`: the instructions of each block; the file refers to them by index."""

    plan: ir.Plan
    blocks: CompiledBlocks
    facts: WorldFacts
    key: str
    nodes: Mapping[ir.PlanNode, int]
    instructions: Mapping[_BlockKey, list[BlockInstruction]]


def index_plan(plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts, target: Target) -> IndexedPlan | None:
    """Return a plan with numbered nodes and instructions, and the key of its file. None if the plan cannot be stored."""
    written = _PlanWriter()
    instructions = {place: list_scope_instructions(compiler.root_scope) for place, compiler in blocks.items()}
    if not has_module_sources():
        return None
    try:
        written.add_value((hash_sources(), facts.has_moving_ground, facts.has_detail_levels, facts.is_timed, plan))
        if facts.is_timed:
            written.add_value([_get_timed_line(each) for place in instructions.values() for each in place])
    except (_UnsupportedValue, OSError):
        return None
    text = "program " + blake2b("\n".join(written.parts).encode("utf-8", "surrogatepass"), digest_size=32).hexdigest()
    key = object_cache.compute_object_key(text, target, versions=object_cache.list_environment_versions())
    return IndexedPlan(plan, blocks, facts, key, written.numbers, instructions)


def make_text_key(text: str) -> str:
    """Return the key under which the code for the text of a function is stored."""
    return "program text " + blake2b(text.encode(), digest_size=32).hexdigest()


def read_stored_blocks(stored_subject: IndexedPlan) -> StoredBlocks | None:
    """Return the stored blocks of a plan. None if nothing is stored for it."""
    data = code_cache.load_stored_data(stored_subject.key)
    if data is None:
        return None
    nodes = list(stored_subject.nodes)
    with suppress(ValueError, TypeError, KeyError, IndexError):
        read = json.loads(data)
        blocks = schedule_blocks(stored_subject.plan, stored_subject.blocks, stored_subject.facts)
        for place, code in blocks.items():
            _fill_block_from_json(code, read["blocks"][" ".join(place)], nodes, stored_subject.instructions[place])
        return read["units"], blocks
    return None


def store_blocks(stored_subject: IndexedPlan, program: NativeProgram) -> None:
    """Store the results of compiling a plan, if all of them can be stored."""
    with suppress(_UnsupportedValue, KeyError):
        blocks = {
            " ".join(place): _block_to_json(code, stored_subject.nodes, stored_subject.instructions[place])
            for place, code in program.blocks.items()
        }
        units = {name: make_text_key(text) for name, text in program.units.items()}
        code_cache.store_data(stored_subject.key, json.dumps({"units": units, "blocks": blocks}).encode())


def _block_to_json(code: BlockCodePlan, nodes: Mapping[ir.PlanNode, int], instructions: list[BlockInstruction]) -> dict[str, Any]:
    """Return a compiled block as JSON values, with numbers in place of nodes and instructions."""
    numbers = {each: number for number, each in enumerate(instructions)}
    layout = code.layout
    return {
        "names": code.function_names,
        "pointers": [_key_to_json(key, nodes) for key in layout.pointer_indices],
        "numbers": [_key_to_json(key, nodes) for key in layout.number_indices],
        "arrays": [[*key, kind] for key, kind in layout.array_kind_by_slot.items()],
        "faults": [[what, numbers[each]] for what, each in code.fault_sources],
        "near": [[each.species, [nodes[node] for node in each.set_nodes], each.extra_registers] for each in code.searches],
        "kept": [nodes[node] for node in code.lazy_nodes],
        "lists": [numbers[each] for each in code.list_instructions],
        "needs": [numbers[each] for each in code.optional_calls],
        "guarded": [[numbers[each], slot] for each, slot in code.mask_slot_by_call.items()],
        "lines": None if code.line_counters is None else code.line_counters.instruction_numbers,
    }


def _fill_block_from_json(
    code: BlockCodePlan, form: Mapping[str, Any], nodes: list[ir.PlanNode], instructions: list[BlockInstruction]
) -> None:
    """Fill a block from JSON values in the form that `_block_to_json` returns."""
    code.function_names[:] = form["names"]
    code.layout.pointer_indices = {_key_from_json(key, nodes): place for place, key in enumerate(form["pointers"])}
    code.layout.number_indices = {_key_from_json(key, nodes): place for place, key in enumerate(form["numbers"])}
    code.layout.array_kind_by_slot = {(slot, part): kind for slot, part, kind in form["arrays"]}
    code.fault_sources[:] = [(what, instructions[number]) for what, number in form["faults"]]
    code.searches[:] = [
        NeighbourSearchPlan(species, [nodes[number] for number in sets], beside) for species, sets, beside in form["near"]
    ]
    code.lazy_nodes[:] = [nodes[number] for number in form["kept"]]
    code.list_instructions[:] = [instructions[number] for number in form["lists"]]
    code.optional_calls[:] = [instructions[number] for number in form["needs"]]
    code.mask_slot_by_call.update({instructions[number]: slot for number, slot in form["guarded"]})
    if code.line_counters is not None:
        code.line_counters.instruction_numbers[:] = form["lines"]


def _key_to_json(key: Iterable[Any], nodes: Mapping[ir.PlanNode, int]) -> list[Any]:
    """Return a key of the layout as a list, in which a list with a number stands for each node."""
    form: list[Any] = []
    for each in key:
        if isinstance(each, ir.PlanNode):
            form.append([nodes[each]])
        elif each is None or type(each) in (str, int, bool):
            form.append(each)
        else:
            raise _UnsupportedValue
    return form


def _key_from_json(form: list[Any], nodes: list[ir.PlanNode]) -> tuple[Any, ...]:
    return tuple([nodes[each[0]] if isinstance(each, list) else each for each in form])


class _PlanWriter:
    """A writer that converts values to text, such that equal values give equal text. Positions in the source are omitted.

    `numbers`: the number of each node, in order of first use."""

    def __init__(self) -> None:
        self.parts: list[str] = []
        self.numbers: dict[ir.PlanNode, int] = {}

    def add_value(self, value: Any) -> None:
        """Append the text of a value. Raises _UnsupportedValue if the value may differ in another run."""
        kind = type(value)
        if kind is ir.PlanNode:
            self._add_node(value)
        elif value is None or kind in (str, int, float, bool):
            self.parts.append(f"{kind.__name__} {value!r}")
        elif isinstance(value, Span):
            self.parts.append("span")
        elif isinstance(value, Enum):
            self.parts.append(f"{kind.__name__} {value.name}")
        elif isinstance(value, Mapping):
            self.parts.append(f"mapping {len(value)}")
            for item in value.items():
                self.add_value(item)
        elif isinstance(value, tuple | list):
            self.parts.append(f"sequence {len(value)}")
            for each in value:
                self.add_value(each)
        elif is_dataclass(value):
            self.parts.append(kind.__name__)
            for each in fields(value):
                self.add_value(getattr(value, each.name))
        else:
            raise _UnsupportedValue

    def _add_node(self, node: ir.PlanNode) -> None:
        """Append the text of a node, after its operands. A node that was written earlier is written as its number."""
        pending = [node]
        while pending:
            last = pending[-1]
            missing = [] if last in self.numbers else [arg for arg in last.args if arg not in self.numbers]
            if missing:
                pending += missing[::-1]
                continue
            pending.pop()
            if last not in self.numbers:
                self.numbers[last] = len(self.numbers)
                self.parts.append(f"node {last.op} {[self.numbers[arg] for arg in last.args]} {last.kind.name} {last.rate.name}")
                self.add_value(last.attrs)
        self.parts.append(f"number {self.numbers[node]}")


def _get_timed_line(instruction: BlockInstruction) -> tuple[str, int, int]:
    """Return the file, line and layer for which the time of an instruction counts."""
    span = instruction.span
    return (
        ("", 0, instruction.layer)
        if span is None
        else (span.source.path, span.source.find_line_column(span.start)[0], instruction.layer)
    )
