"""`antdsl check PATH…`: all that can be known about programs and scenes without running them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import Exit, Stop

if TYPE_CHECKING:
    from antdsl.diagnostics import Report
    from antdsl.loading import Parsed
    from antdsl.program.model import Program


class Format(StrEnum):
    full = "full"
    concise = "concise"
    json = "json"
    sarif = "sarif"
    github = "github"
    junit = "junit"


def check(
    paths: list[Path] = typer.Argument(None, help="Files (.ant, .yaml) or folders. Folders are searched.", show_default=False),
    format: Format = typer.Option(Format.full, "--format", help="How findings are written."),
    strict: bool = typer.Option(False, "--strict", help="Warnings count as errors."),
    explain: str = typer.Option(
        None, "--explain", metavar="CODE", help="Say what a code such as `unknown-state` means, and stop."
    ),
    params: bool = typer.Option(False, "--params", help="List every param with its default and range."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
) -> None:
    """Find mistakes in .ant files and scenes without running them."""
    if explain is not None:
        _explain(explain)
        return
    if params and format not in (Format.full, Format.concise):
        raise typer.BadParameter("params are listed as text; ask for them without `--format`", param_hint="--params")
    if not paths:
        raise typer.BadParameter("name a file or a folder", param_hint="PATH")
    from antdsl.cli.arguments import grants
    from antdsl.cli.reports import show, verdict
    from antdsl.pipeline import Choices, check_path, find_files

    files, report = find_files(paths)
    choices = Choices(grants(root))
    programs: list[tuple[Path, Program]] = []
    parsed: Parsed = {}
    for file in files:
        program, findings = check_path(file, choices, strict=strict, parsed=parsed)
        report.extend(findings)
        if program is not None:
            programs.append((file, program))
    if strict:
        report = _strict(report)
    show(report, format.value)
    if params:
        _params(programs)
    if not report.ok:
        raise Stop(verdict(report))
    if format is Format.full:
        warnings = len(report.diagnostics)
        tail = f", {warnings} warning{'s' if warnings > 1 else ''}" if warnings else ", nothing to complain about"
        typer.echo(f"checked {len(files)} file{'' if len(files) == 1 else 's'}{tail}")


def _strict(report: Report) -> Report:
    from dataclasses import replace

    from antdsl.diagnostics import Report

    return Report([replace(d, severity="error") for d in report.diagnostics])


def _explain(code: str) -> None:
    from antdsl.diagnostics.codes import CODES
    from antdsl.diagnostics.suggestion import nearest_name

    if code not in CODES:
        near = nearest_name(code, CODES)
        raise Stop(
            Exit.USAGE, f"error: no code `{code}`", f"did you mean `{near}`?" if near else "codes stand in brackets after `error`"
        )
    typer.echo(f"{code}: {CODES[code]}")


def _params(programs: list[tuple[Path, Program]]) -> None:
    """Each param under the first file that brings it."""
    listed = set()
    for file, program in programs:
        new = [param for param in program.params.values() if param.span not in listed]
        if new:
            typer.echo(f"{file}:")
        for param in new:
            listed.add(param.span)
            low, high = (p.span.text if p is not None else "" for p in (param.low, param.high))
            bounds = f"  in {low} .. {high}" if low or high else ""
            typer.echo(f"  {param.name} = {param.default.span.text}{bounds}  {param.help}".rstrip())
