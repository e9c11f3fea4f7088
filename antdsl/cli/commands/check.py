"""`antdsl check PATH…`: runs all checks of programs and scenes that do not need a simulation."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.arguments import STDIN_PATH, parse_grants, read_standard_input
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_result

if TYPE_CHECKING:
    from antdsl.diagnostics import Report


class ReportFormat(StrEnum):
    """Output formats of findings."""

    full = "full"
    concise = "concise"
    json = "json"
    sarif = "sarif"
    github = "github"
    junit = "junit"


def run_check_command(
    paths: list[Path] = typer.Argument(
        None,
        help="Files (.ant, .yaml), folders, or patterns such as 'shots/**/*.ant'; - reads a program from standard input. "
        "[default: this folder]",
    ),
    format: ReportFormat = typer.Option(ReportFormat.full, "--format", help="Format of the findings."),
    strict: bool = typer.Option(False, "--strict", help="Count warnings as errors."),
    explain: str = typer.Option(
        None, "--explain", metavar="WORD", help="Explain a code such as `unknown-state`, a word or a behaviour, and stop."
    ),
    params: bool = typer.Option(False, "--params", help="List params, and the settings with defaults by edition, as tables."),
    cost: bool = typer.Option(
        False,
        "--cost",
        help="List the senses and cost of each state, the memory per agent, and the faces, voxels, cells and points of a scene.",
    ),
    imports: bool = typer.Option(False, "--imports", help="List for each mesh of a scene what was read and changed."),
    cpu_limit: float = typer.Option(
        300.0, "--cpu-limit", metavar="SECONDS", min=0, max=1e6, help="Limit of processor time per file; 0: no limit."
    ),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant scenes a folder of assets outside their own."),
) -> None:
    """Find mistakes in .ant files and scenes without running them."""
    if explain is not None:
        _print_explanation(explain)
        return
    for is_requested, flag in ((params, "--params"), (cost, "--cost"), (imports, "--imports")):
        if is_requested and format not in (ReportFormat.full, ReportFormat.concise):
            raise typer.BadParameter("this list is available as text only; leave out `--format`", param_hint=flag)
    if STDIN_PATH in (paths or []) and len(paths) > 1:
        raise typer.BadParameter("standard input cannot be combined with other inputs", param_hint="-")
    from antdsl.checking import check_files, check_text
    from antdsl.cli.printing.reports import choose_exit_code, print_report
    from antdsl.diagnostics import Report
    from antdsl.diagnostics.ignore_comments import apply_ignore_comments, remove_ignored
    from antdsl.files import find_files
    from antdsl.numerics.processor.host import count_available_cores
    from antdsl.pipeline import RunChoices, open_scene

    choices = RunChoices(parse_grants(root))
    if paths == [STDIN_PATH]:
        result = check_text(read_standard_input(), choices, strict=strict, cpu_seconds=cpu_limit)
        files, report = list(result.reports), Report()
    else:
        files, report = find_files(paths or [Path()])
        result = check_files(
            files, choices, strict=strict, cores=count_available_cores(), programs=params or cost, cpu_seconds=cpu_limit
        )
    for file in files:
        report.extend(result.reports[file])
    report = apply_ignore_comments(report, result.sources, strict=strict)
    if strict:
        report = _treat_warnings_as_errors(report)
    print_report(report, format.value)
    if format is ReportFormat.full and report.diagnostics:
        codes = list(dict.fromkeys(each.code for each in remove_ignored(report).sort_by_place()))
        others = ", ".join(f"`{code}`" for code in codes[1:4]) + (" …" if len(codes) > 4 else "")
        if codes:
            print_result(f"for details, run `antdsl check --explain {codes[0]}`{f', or name {others}' if others else ''}\n")
    if params or cost:
        from antdsl.cli.printing.check_tables import (
            explain_missing_table,
            format_cost_table,
            format_params_table,
            format_settings_table,
            format_work_table,
        )

        programs = [(file, result.programs[file]) for file in files if file in result.programs]
        error_free = [(file, program) for file, program in programs if result.reports[file].ok]
        for line in (*format_params_table(programs), *format_settings_table(programs)) if params else ():
            print_result(line)
        for line in format_cost_table(error_free) if cost else ():
            print_result(line)
        for file in files if cost else ():
            if not result.reports[file].ok:
                print_result(explain_missing_table("costs", file, result.reports[file]))
        for file, _ in error_free if cost else ():
            shot = open_scene(file, choices)[0] if file.suffix != ".ant" else None
            for line in format_work_table(file, shot) if shot is not None else ():
                print_result(line)
    if imports:
        from antdsl.cli.printing.check_tables import format_import_table

        for line in format_import_table(files, result.reports, choices):
            print_result(line)
    if not report.ok:
        raise CommandError(choose_exit_code(report))
    if format is ReportFormat.full:
        from antdsl.cli.printing.check_tables import format_agent_counts

        for line in format_agent_counts(files, choices):
            print_result(line)
        warnings = len(report.diagnostics)
        if not files and not warnings:
            folders = ", ".join(f"`{path}`" for path in paths or [Path()])
            print_result(f"no file was checked: there is no program and no scene in {folders}")
            return
        tail = f", {warnings} warning{'s' if warnings > 1 else ''}" if warnings else ", no findings"
        print_result(f"checked {len(files)} file{'' if len(files) == 1 else 's'}{tail}")


def _treat_warnings_as_errors(report: Report) -> Report:
    from dataclasses import replace

    from antdsl.diagnostics import Report

    return Report([replace(d, severity="error") for d in report.diagnostics])


def _print_explanation(word: str) -> None:
    """Print the page of a diagnostic code, or the meaning of a word."""
    import re

    from antdsl.cli.printing.pages import print_code_page, print_markdown
    from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
    from antdsl.diagnostics.suggestion import find_nearest_name
    from antdsl.lsp.word_help import explain_word, list_known_words
    from antdsl.syntax.mistakes.number_slips import find_unit_help
    from antdsl.syntax.words import UNIT_NAMES

    if word in CODE_DESCRIPTIONS:
        print_code_page(word)
        return
    page = explain_word(word.removesuffix("()"))
    if page is not None:
        print_markdown(page)
        return
    slip = [part for part in re.findall("[A-Za-z]+", word) if part not in UNIT_NAMES] if re.search("[/*^%]", word) else []
    if slip:
        raise CommandError(ExitCode.USAGE, f"error: unknown unit `{slip[0]}` in `{word}`", find_unit_help(slip[0]))
    near = (
        find_nearest_name(word, CODE_DESCRIPTIONS)
        if "-" in word
        else find_nearest_name(word, {*list_known_words(), *CODE_DESCRIPTIONS})
    )
    usual = "codes are in brackets after `error`; words are words of the language and names of behaviours"
    raise CommandError(
        ExitCode.USAGE,
        f"error: `{word}` is neither a code nor a word of the language",
        f"did you mean `{near}`?" if near else usual,
    )
