"""Reports every use of the unit `step`, for `check --strict`. Values per step, and durations in steps, depend on the frame
rate."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from antdsl.diagnostics import Fix, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.names.scope import FileNames
from antdsl.program.tables.units import find_unit_measure
from antdsl.program.traverse import iterate_nodes
from antdsl.program.types.descriptions import quote_source
from antdsl.source import Span
from antdsl.syntax import nodes

ASSUMED_FPS = 24  # frames per second of film; replacements have equal values at this rate


def check_step_units(context: CheckContext, report: Report) -> None:
    """Report each quantity with the unit `step`, with a replacement if there is one."""
    if not context.declarations.strict:
        return
    for file in _iterate_files(context.files):
        around: dict[int, nodes.Setting | nodes.AnimalProperty] = {}
        for part, _ in iterate_nodes(file.node.items):
            if isinstance(part, nodes.Setting | nodes.AnimalProperty):
                around[id(part.value)] = part
            elif isinstance(part, nodes.Quantity) and (known := find_unit_measure(part.unit)) is not None and known.step:
                fix, help = _suggest_quantity_without_steps(part, known.step, around.get(id(part)))
                message = f"{quote_source(part.span)} depends on the frames per second"
                report.warning("per-step", message, part.span, help, fix=fix)


def _iterate_files(files: Sequence[FileNames]) -> Iterator[FileNames]:
    """Yield the files of the program and all files that they use by path, without duplicates."""
    stack, visited = list(files), set[int]()
    while stack:
        file = stack.pop()
        if id(file) not in visited and not file.is_missing:
            visited.add(id(file))
            stack += file.aliases.values()
            yield file


def _suggest_quantity_without_steps(
    node: nodes.Quantity, power: float, parent: nodes.Setting | nodes.AnimalProperty | None
) -> tuple[Fix | None, str]:
    """Return a fix that replaces a quantity with the unit `step` by one that does not depend on the step, and its help text. The
    fix is None if there is no replacement.

    `power`: the exponent of the unit `step`. `parent`: the setting that contains the quantity."""
    if isinstance(parent, nodes.Setting) and parent.name.text == "keeps":
        share = node.value * (0.01 if "%" in node.unit else 1.0)
        if not 0 < share < 1:
            return None, "say how fast the field fades: `half_life 8 s`"
        return _describe_fix(parent.span, f"half_life {-math.log(2) / math.log(share) / ASSUMED_FPS:.3g} s", "fades as fast")
    if isinstance(parent, nodes.AnimalProperty) and parent.name.text == "response" and node.value <= 1:
        return Fix(node.span, "0.001 s"), "write `response 0.001 s`, which is immediate at any frame rate"
    if node.unit == "step":
        return _describe_fix(node.span, f"{node.value / ASSUMED_FPS:.3g} s", "is as long")
    if power == -1 and node.unit.endswith("/step"):
        unit = f"{node.unit.removesuffix('/step')}/s"
        return _describe_fix(node.span, f"{node.value * ASSUMED_FPS:.6g} {unit}", "is as much")
    return None, "say it in seconds"


def _describe_fix(span: Span, text: str, description: str) -> tuple[Fix, str]:
    return Fix(span, text), f"write `{text}`, which {description} at {ASSUMED_FPS} frames a second"
