"""`antdsl plan FILE`: the array passes that a program became."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import Exit, Stop

if TYPE_CHECKING:
    from antdsl.plan.ir import Plan


def plan(
    file: Path = typer.Argument(..., help="A program (.ant) or a scene (.yaml)."),
    raw: bool = typer.Option(False, "--raw", help="As lowered, before any pass has improved it."),
    native: bool = typer.Option(
        False, "--native", help="What of it is machine code: stages, counts of instructions, what NumPy is called for."
    ),
    code: bool = typer.Option(False, "--ir", help="With --native, the machine code too, in LLVM's language."),
) -> None:
    """Print the array passes that a program became."""
    from antdsl import passes, pipeline
    from antdsl import plan as planning
    from antdsl.cli.printing.reports import demand

    program, report = pipeline.check_path(file)
    if program is not None and report.ok:
        lowered, findings = planning.lower(program)
        report.extend(findings)
    demand(report)
    if program is None:
        raise Stop(Exit.FINDINGS)
    made = lowered if raw else passes.optimise(lowered)
    typer.echo(_as_code(made, code) if native else planning.show(made))


def _as_code(made: Plan, code: bool) -> str:
    from antdsl.runtime.backends.native import listing, machine

    if not machine.available():
        raise Stop(Exit.FINDINGS, "machine code cannot be made here: llvmlite is not there", "pip install llvmlite")
    found = listing.of_plan(made, machine.host())
    return listing.show(found) + (f"\n{found.text}" if code else "")
