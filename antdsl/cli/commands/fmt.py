"""`antdsl fmt PATH…`: formats .ant files in the standard layout. Files with errors are reported and not changed."""

from __future__ import annotations

import difflib
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.arguments import STDIN_PATH, read_standard_input
from antdsl.cli.exits import RETRY_ADVICE, CommandError, ExitCode, describe_recovery
from antdsl.cli.printing.messages import print_note, print_result
from antdsl.syntax.editions import EDITIONS

if TYPE_CHECKING:
    from antdsl.diagnostics import Report


def run_fmt_command(
    paths: list[Path] = typer.Argument(
        None, help="Files (.ant), folders or patterns; - reads standard input and writes to standard output."
    ),
    check: bool = typer.Option(False, "--check", help="Change nothing; name the files that would change, with exit code 1."),
    diff: bool = typer.Option(False, "--diff", help="Change nothing; show what would change, with exit code 1."),
    edition: int | None = typer.Option(
        None, "--edition", help="Rewrite files for this edition of the language, and write out the old defaults that they use."
    ),
) -> None:
    """Format .ant files: blanks, columns and line breaks. Meaning and comments stay the same."""
    if edition is not None and edition not in EDITIONS:
        editions = " or ".join(str(each) for each in EDITIONS)
        raise typer.BadParameter(f"no edition {edition}; write {editions}", param_hint="--edition")
    if not paths:
        raise typer.BadParameter("name a file or a folder, or - for standard input", param_hint="PATH")
    if STDIN_PATH in paths and len(paths) > 1:
        raise typer.BadParameter("standard input cannot be combined with other inputs", param_hint="-")
    from antdsl.cli.printing.reports import exit_on_errors

    work = _FormatCommand(check, diff, edition)
    if STDIN_PATH in paths:
        work.format_standard_input()
    else:
        work.format_files(paths)
    exit_on_errors(work.report)
    if (check or diff) and work.changed_names:
        raise CommandError(ExitCode.FINDINGS)


def _empty_report() -> Report:
    from antdsl.diagnostics import Report

    return Report()


@dataclass
class _FormatCommand:
    """One run of the command, with its options and its results so far.

    `changed_names`: the files that differ from the standard layout. `skipped_count`: the number of files that could not be
    formatted. `report`: the errors in these files, without warnings, which `antdsl check` reports."""

    is_check_only: bool
    prints_diff: bool
    edition: int | None
    changed_names: list[str] = field(default_factory=list)
    skipped_count: int = 0  # files with mistakes, or files that cannot be read or written
    report: Report = field(default_factory=_empty_report)

    def format_files(self, paths: list[Path]) -> None:
        """Format all programs that `paths` select, then print how many files changed."""
        from antdsl.atomic_write import is_link
        from antdsl.files import find_files

        all_files, report = find_files(paths, lists_outer_links=True)
        self.report.extend(report)
        for path in paths:
            if path.suffix in (".yaml", ".yml"):
                self.report.error("not-an-ant-file", f"`{path}` is not an .ant file", None, "name files that end in `.ant`")
        programs = [path for path in all_files if path.suffix == ".ant"]
        for path in programs:
            if path in paths or not is_link(path) or any(path.resolve().is_relative_to(each.resolve()) for each in paths):
                self.format_file(path)
                continue
            self.skipped_count += 1
            words = f"`{path}` is a link to a file outside the folder", "name that file directly to format it"
            self.report.error("cannot-write", words[0], None, words[1])
        unchanged_count = len(programs) - len(self.changed_names) - self.skipped_count
        word = "would change" if self.is_check_only or self.prints_diff else "changed"
        counts = ((len(self.changed_names), word), (unchanged_count, "laid out well"), (self.skipped_count, "left alone"))
        summary = [f"{count} file{'' if count == 1 else 's'} {label}" for count, label in counts if count]
        print_note(", ".join(summary) or "this folder has no .ant files", to_stderr=True)

    def format_file(self, path: Path) -> None:
        """Format one file. With `--check` or `--diff`, only report that it would change."""
        from antdsl import limits, syntax
        from antdsl.safe_read import read_size_limited

        try:
            text = self.format_source(*syntax.read_program_file(path))
            data = b"" if text is None else read_size_limited(path, limits.MAX_PROGRAM_BYTES)
            if text is None:
                self.skipped_count += 1
            elif text.encode("utf-8") != data:
                if not (self.is_check_only or self.prints_diff):
                    syntax.write(path, text)
                self.report_change(str(path), data.decode("utf-8", "replace"), text)
        except OSError as problem:
            self.skipped_count += 1
            reason = (problem.strerror or "unknown reason").lower()
            self.report.error(
                "cannot-write", f"cannot write `{path}`: {reason}", None, f"{describe_recovery(problem)} {RETRY_ADVICE}"
            )

    def format_standard_input(self) -> None:
        """Format standard input and write the result to standard output. With `--check` or `--diff`, only report that it would
        change."""
        from antdsl import syntax

        data = read_standard_input()
        text = self.format_source(*syntax.decode_program("<stdin>", data))
        if text is None:
            return
        if not (self.is_check_only or self.prints_diff):
            sys.stdout.buffer.write(text.encode("utf-8"))
            sys.stdout.buffer.flush()
        elif text.encode("utf-8") != data:
            self.report_change("<stdin>", data.decode("utf-8"), text)

    def format_source(self, source: object, report: Report) -> str | None:
        """Return a source in the standard layout, or None if it cannot be formatted. Its findings are added to the command's
        report.

        `source`, `report`: the results of reading the file; `source` is None if that failed."""
        from antdsl import syntax
        from antdsl.source import Source

        self.report.extend(report)
        if not isinstance(source, Source):
            return None
        if self.edition is not None:
            from antdsl.program.upgrade import upgrade_source

            upgraded, findings = upgrade_source(source, self.edition)
            if upgraded is None:
                self.report.extend(d for d in findings.diagnostics if d.severity == "error")
                return None
            source = upgraded
        text, findings = syntax.format(source)
        self.report.extend(d for d in findings.diagnostics if d.severity == "error")
        return text

    def report_change(self, name: str, old_text: str, new_text: str) -> None:
        """Record that a file differs from the standard layout. Print its name, or with `--diff` the difference."""
        self.changed_names.append(name)
        if self.prints_diff:
            lines = difflib.unified_diff(old_text.splitlines(), new_text.splitlines(), name, name, lineterm="")
            print_result("\n".join(lines) if old_text.splitlines() != new_text.splitlines() else f"{name}: only line ends differ")
        else:
            print_result(name)
