"""A readable listing of a plan's machine code: the stages, their LLVM instructions, and the calls between them."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from antdsl.machine_code.llvm_compiler import Target
from antdsl.plan import ir
from antdsl.runtime.backends.native.programs import NativeProgram, WorldFacts, write_program
from antdsl.runtime.backends.numpy_backend import NumpyBackend

_HEADER_PREFIXES = ("define ", "declare ", "}", "@")


STATIC_WORLD_FACTS = WorldFacts(has_moving_ground=False, has_detail_levels=False)


def build_program(plan: ir.Plan, target: Target, facts: WorldFacts = STATIC_WORLD_FACTS) -> NativeProgram:
    """Return the program that a plan compiles to, for a world with these `facts`."""
    return write_program(plan, NumpyBackend(plan).blocks, facts, target)


def count_instructions_by_function(native_program: NativeProgram) -> dict[str, int]:
    """Return the number of LLVM instructions in the text of each function, by name."""
    return {name: count_instructions(text) for name, text in native_program.functions.items() if text.startswith("define")}


def count_instructions(text: str) -> int:
    """Return the number of instructions in a function's text: the number of lines without labels, first line and last line."""
    lines = (line.strip() for line in text.splitlines())
    return sum(1 for line in lines if line and not line.startswith(_HEADER_PREFIXES) and not line.endswith(":"))


def format_listing(native_program: NativeProgram) -> str:
    """Return the listing as text. The same plan always gives the same text."""
    size, lines, named = count_instructions_by_function(native_program), [], set()
    species = ""
    for (name, block), code in native_program.blocks.items():
        if name != species:
            lines.append(f"species {name}")
            species = name
        lines.append(f"  {block}")
        for stage, function in enumerate(code.function_names):
            lines.append(f"    stage {stage}: {size[function]:,} instructions")
            named.add(function)
            called: Counter[str] = Counter()
            for each in code.schedule.calls_after_stage[stage]:
                if isinstance(each.subject, ir.PlanNode):
                    of = f"({each.subject.attrs[0]})" if each.subject.attrs else ""
                    called[f"{each.subject.op}{of}{_get_source_location(each.subject)}"] += 1
            lines += [f"    then NumPy: {what}{f', {count} times' if count > 1 else ''}" for what, count in called.items()]
        for search in code.searches:
            lines.append(
                f"    searches {search.species} for {len(search.set_nodes)} set{'s' if len(search.set_nodes) > 1 else ''}"
            )
        lines += [
            f"    asks for {_get_instruction_name(each.subject)}{_get_source_location(each.subject)}"
            for each in code.list_instructions
        ]
    shared = sorted(set(size) - named)
    lines += ["functions of all", *(f"  {name}: {size[name]:,} instructions" for name in shared)]
    return "\n".join(lines) + "\n"


def _get_instruction_name(node: ir.PlanNode | ir.PlanStatement) -> str:
    return node.op if isinstance(node, ir.Request) else type(node).__name__.lower()


def _get_source_location(node: ir.PlanNode | ir.PlanStatement) -> str:
    span = node.span
    return "" if span is None else f", {Path(span.source.path).name}:{span.source.find_line_column(span.start)[0]}"
