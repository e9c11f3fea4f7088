"""`antdsl check PATH…`: all that can be known about programs and scenes without running them."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import Exit, Stop

if TYPE_CHECKING:
    from antdsl.diagnostics import Report
    from antdsl.program.model import Const, Param, Program
    from antdsl.source import Span


class Format(StrEnum):
    full = "full"
    concise = "concise"
    json = "json"
    sarif = "sarif"
    github = "github"
    junit = "junit"


def check(
    paths: list[Path] = typer.Argument(
        None, help="Files (.ant, .yaml), folders, or patterns such as 'shots/**/*.ant'.", show_default=False
    ),
    format: Format = typer.Option(Format.full, "--format", help="How findings are written."),
    strict: bool = typer.Option(False, "--strict", help="Warnings count as errors."),
    explain: str = typer.Option(
        None, "--explain", metavar="CODE", help="Show the page of a code such as `unknown-state`, and stop."
    ),
    params: bool = typer.Option(False, "--params", help="List every param as a table: default, unit, range, help."),
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
    from antdsl.diagnostics.ignoring import judged
    from antdsl.loading import Kept
    from antdsl.pipeline import Choices, check_path, find_files, sources

    files, report = find_files(paths)
    choices = Choices(grants(root))
    programs: list[tuple[Path, Program]] = []
    parsed = Kept()
    for file in files:
        program, findings = check_path(file, choices, strict=strict, parsed=parsed)
        report.extend(findings)
        if program is not None:
            programs.append((file, program))
    report = judged(report, sources(files, parsed), strict=strict)
    if strict:
        report = _strict(report)
    show(report, format.value)
    if format is Format.full and report.diagnostics:
        codes = {diagnostic.code for diagnostic in report.diagnostics}
        typer.echo(f"`antdsl check --explain {codes.pop() if len(codes) == 1 else 'CODE'}` says more\n")
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
    from antdsl.cli.pages import show_page

    show_page(code)


def _params(programs: list[tuple[Path, Program]]) -> None:
    """A table of the params under the first file that brings them."""
    listed: set[Span] = set()
    for file, program in programs:
        new = [param for param in program.params.values() if param.span not in listed]
        listed.update(param.span for param in new)
        if new:
            typer.echo(f"{file}:")
            rows = [_HEADS, *(_row(param) for param in new)]
            widths = [max(len(row[k]) for row in rows) for k in range(len(_HEADS) - 1)]
            for row in rows:
                cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
                typer.echo("  " + "  ".join([*cells, row[-1]]).rstrip())
    if not listed:
        typer.echo("no program here has a param")


_HEADS = ("param", "default", "unit", "range", "help")


def _row(param: Param) -> tuple[str, ...]:
    """Name, default, unit, range and help; numbers in the unit that the author wrote, those of another kind as written."""
    from antdsl.diagnostics.places import safe
    from antdsl.program.kinds import Kind
    from antdsl.program.units import measure

    known = measure(param.unit) if param.unit else None

    def cell(value: Const | None) -> str:
        if value is None:
            return "…"
        if param.type.kind is Kind.BOOL:
            return "true" if value.number else "false"
        if known is None or (known.u, known.step) != (value.u, value.step):
            return " ".join(value.span.text.split()) if param.unit else f"{value.number:.6g}"
        return f"{value.number / known.factor:.6g}"

    bounded = param.low is not None or param.high is not None
    range = f"{cell(param.low)} .. {cell(param.high)}" if bounded else "any"
    return param.name, cell(param.default), param.unit or "-", range, safe(param.help)
