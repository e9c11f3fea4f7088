"""`antdsl plan FILE`: the array passes that a program became."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.exits import Exit, Stop


def plan(
    file: Path = typer.Argument(..., help="A program (.ant) or a scene (.yaml)."),
    raw: bool = typer.Option(False, "--raw", help="As lowered, before any pass has improved it."),
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
    typer.echo(planning.show(lowered if raw else passes.optimise(lowered)))
