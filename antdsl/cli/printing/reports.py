"""Printing of findings from all stages, in the requested format."""

from __future__ import annotations

import sys

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.diagnostics import Report

_FILE_ERROR_CODES = frozenset(("cannot-read", "cannot-write", "no-such-file", "not-a-file", "file-too-large"))


def print_report(report: Report, format: str = "full", *, to_stderr: bool = False) -> None:
    """Print the findings, except those that a comment ignores. Machine-readable formats are printed even without findings,
    because other programs expect a document."""
    from antdsl.diagnostics.ignore_comments import remove_ignored
    from antdsl.diagnostics.render import render

    report = remove_ignored(report)
    if not report.diagnostics and format in ("full", "concise", "github"):
        return
    text = render(report, format)
    if text:
        print(text.rstrip("\n"), file=sys.stderr if to_stderr else sys.stdout)


def exit_on_errors(report: Report) -> None:
    """Print the findings to standard error. If there are errors, exit with the code from `choose_exit_code`."""
    print_report(report, to_stderr=True)
    if not report.ok:
        raise CommandError(choose_exit_code(report))


def choose_exit_code(report: Report) -> ExitCode:
    """Return the exit code for a report: INPUT_OUTPUT if a file could not be read or written, else FINDINGS."""
    errors = [d for d in report.diagnostics if d.severity == "error"]
    if errors and all(d.span is None and d.code in _FILE_ERROR_CODES for d in errors):
        return ExitCode.INPUT_OUTPUT
    return ExitCode.FINDINGS if errors else ExitCode.SUCCESS
