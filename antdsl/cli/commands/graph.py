"""`antdsl graph FILE`: draws the state machines of a program as a picture."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.destinations import choose_default_path, is_standard_output, protect_inputs, require_writable_file, write_result
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note

if TYPE_CHECKING:
    from antdsl.graphs import Chart


class GraphFormat(StrEnum):
    """File formats of state machine pictures."""

    svg = "svg"
    png = "png"
    mermaid = "mermaid"
    dot = "dot"


def run_graph_command(
    file: Path = typer.Argument(..., help="A program (.ant) or a scene (.yaml)."),
    format: GraphFormat = typer.Option(None, "--format", help="Format. [default: by the ending of --out, else svg]"),
    out: Path = typer.Option(None, "--out", metavar="FILE", help="Output file; `-` prints it. [default: FILE.svg here]"),
    only: list[str] = typer.Option(
        [], "--only", metavar="NAME", help="Only this species, or SPECIES.MACHINE. May be given several times."
    ),
) -> None:
    """Draw the state machines of a program."""
    from antdsl import graphs, pipeline
    from antdsl.cli.printing.reports import exit_on_errors

    chosen = _choose_format(format, out)
    target = out or choose_default_path(Path(), file.stem + graphs.CHART_FORMATS[chosen][0][0])
    require_writable_file(target, "--out")
    with protect_inputs({"--out": target}) as inputs:
        inputs.append(file)
        program, report = pipeline.check_path(file)
    exit_on_errors(report)
    if program is None:
        raise CommandError(ExitCode.FINDINGS)
    charts = _select_charts(graphs.build_charts(program), only)
    if not charts:
        words = f"error: `{file}` has no species with states"
        raise CommandError(ExitCode.FINDINGS, words, "`antdsl graph` draws states and transitions")
    data, report = graphs.write_charts(charts, chosen)
    exit_on_errors(report)
    assert data is not None
    write_result(target, data, sys.stdout)
    if not is_standard_output(target):
        print_note(str(target))


def _choose_format(format: GraphFormat | None, target: Path | None) -> str:
    """Return the requested format. By default, it follows from the suffix of the output file, or is svg without a file."""
    from antdsl.graphs import CHART_FORMATS

    if format is not None:
        return format.value
    if target is None or is_standard_output(target):
        return next(iter(CHART_FORMATS))
    for name, (endings, _) in CHART_FORMATS.items():
        if target.suffix.lower() in endings:
            return name
    all_endings = ", ".join(ending for endings, _ in CHART_FORMATS.values() for ending in endings)
    raise typer.BadParameter(f"`{target}` has no known ending ({all_endings}): add `--format`", param_hint="--out")


def _select_charts(charts: tuple[Chart, ...], names: list[str]) -> tuple[Chart, ...]:
    """Return the charts of the named species and machines, in the order of the source text."""
    from antdsl.diagnostics.suggestion import find_nearest_name

    known_names = dict.fromkeys(part for chart in charts for part in (chart.title.partition(".")[0], chart.title))
    for name in names:
        if name not in known_names:
            near = find_nearest_name(name, known_names)
            hint = f"did you mean `{near}`?" if near else "there is " + ", ".join(f"`{k}`" for k in known_names)
            raise CommandError(ExitCode.USAGE, f"error: no species or machine `{name}`", hint)
    requested_names = set(names)
    return tuple(
        c for c in charts if not requested_names or c.title in requested_names or c.title.partition(".")[0] in requested_names
    )
