"""A check of the available memory before a run. The demand is estimated from counts, before anything is allocated."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import CommandError, ExitCode

if TYPE_CHECKING:
    from antdsl.pipeline import Shot
    from antdsl.runtime.binding.work_estimates import WorkEstimate
    from antdsl.source import Span

ANY_MEMORY_OPTION: bool = typer.Option(False, "--any-memory", help="Start even if the estimate exceeds the available memory.")
_USABLE_MEMORY_SHARE = 0.8  # share of the available memory; the rest is for frames, kernels and other programs
_MAX_LISTED_THINGS = 3  # maximum number of things named in a message


def estimate_shot_work(shot: Shot) -> list[WorkEstimate]:
    """Return estimates of the memory that the world and the crowd of a shot will allocate."""
    from antdsl.plan.registers import count_bytes_by_purpose
    from antdsl.program.model import Constant
    from antdsl.runtime.binding.work_estimates import estimate_world_work
    from antdsl.scene.checks.entry_checks import convert_constant

    sizes = {name: sum(count_bytes_by_purpose(species).values()) for name, species in shot.plan.species.items()}
    fields = {
        name: (declared.surfaces, convert_constant(declared.cell, shot.scene))
        for name, declared in shot.program.fields.items()
        if isinstance(declared.cell, Constant)
    }
    return estimate_world_work(shot.setting, fields, sizes)


def require_available_memory(shots: Sequence[Shot], parallel_runs: int = 1, runs_per_shot: int = 1) -> None:
    """End the command if runs would need more than 80 % of the available memory.

    The message names the largest allocations, and the scene line that causes the largest one. `parallel_runs`: how many runs are
    active at once; the largest are counted. `runs_per_shot`: the number of runs of each shot."""
    from antdsl.numerics.processor.host import measure_available_memory

    available = measure_available_memory()
    works = sorted(
        ((sum(each.bytes for each in work), k, work) for k, work in enumerate(map(estimate_shot_work, shots))), reverse=True
    )
    needed = sum([each for each, *_ in works for _ in range(min(runs_per_shot, parallel_runs))][:parallel_runs])
    if available is None or not works or needed <= _USABLE_MEMORY_SHARE * available:
        return
    _, k, work = works[0]
    largest = sorted(work, key=lambda estimate: -estimate.bytes)[:_MAX_LISTED_THINGS]
    names = ", ".join(
        f"{each.subject} {format_bytes(each.bytes)} ({each.part_count:,} {each.unit_name})" for each in largest if each.bytes
    )
    words = f"this needs at least {format_bytes(needed)}, but 80 % of the available memory are "
    words += f"{format_bytes(int(_USABLE_MEMORY_SHARE * available))}: {names}"
    fewer = ", fewer agents or fewer `--jobs`" if parallel_runs > 1 and runs_per_shot > 1 else " or fewer agents"
    hint = f"use larger cells or voxels, a lighter mesh{fewer}; to start anyway, add `--any-memory`"
    raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {_find_work_span(shots[k], largest[0])}: {words}", hint)


def _find_work_span(shot: Shot, work: WorkEstimate) -> Span:
    """Return the location, in the scene or its program, of the text that causes an allocation."""
    kind, _, name = work.subject.partition(" ")
    if kind == "field":
        return shot.program.fields[name].span
    return shot.scene.find_span("crowd") if kind == "species" else shot.scene.find_span("world", name)


def format_bytes(bytes: int) -> str:
    """Return a number of bytes as text, in a suitable unit."""
    from antdsl import limits

    for unit, words in ((limits.GIB, "GiB"), (limits.MIB, "MiB"), (limits.KIB, "KiB")):
        if bytes >= unit:
            return f"{bytes / unit:,.1f} {words}"
    return f"{bytes} bytes"
