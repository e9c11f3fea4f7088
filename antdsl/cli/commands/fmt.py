"""`antdsl fmt PATH…`: formats .ant files in one style. Files with errors are reported and not changed."""

from __future__ import annotations

import difflib
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.arguments import STDIN_PATH, read_standard_input
from antdsl.cli.exits import RETRY_ADVICE, CommandError, ExitCode, recovery_advice
from antdsl.cli.printing.messages import print_note, print_result
from antdsl.syntax.editions import EDITIONS

if TYPE_CHECKING:
    from antdsl.diagnostics import Report


def fmt(
    paths: list[Path] = typer.Argument(
        None, help="Files (.ant), folders or patterns; - reads standard input and writes to standard output."
    ),
    check: bool = typer.Option(False, "--check", help="Change nothing; name the files that would change, with exit code 1."),
    diff: bool = typer.Option(False, "--diff", help="Change nothing; show what would change, with exit code 1."),
    edition: int | None = typer.Option(
        None, "--edition", help="Rewrite files for this edition of the language, and write the old defaults that they rely on."
    ),
) -> None:
    """Format .ant files: blanks, columns and line breaks. Meaning and comments stay the same."""
    if edition is not None and edition not in EDITIONS:
        known = " or ".join(str(each) for each in EDITIONS)
        raise typer.BadParameter(f"no edition {edition}; write {known}", param_hint="--edition")
    if not paths:
        raise typer.BadParameter("name a file or a folder, or - for standard input", param_hint="PATH")
    if STDIN_PATH in paths and len(paths) > 1:
        raise typer.BadParameter("standard input goes alone", param_hint="-")
    from antdsl.cli.printing.reports import exit_on_errors

    work = _Formatting(check, diff, edition)
    if STDIN_PATH in paths:
        work.format_standard_input()
    else:
        work.files(paths)
    exit_on_errors(work.report)
    if (check or diff) and work.changed:
        raise CommandError(ExitCode.FINDINGS)


def _empty_report() -> Report:
    from antdsl.diagnostics import Report

    return Report()


@dataclass
class _Formatting:
    """The results so far. `report`: the errors of files that were not changed. Their warnings are left to `antdsl check`."""

    check: bool
    diff: bool
    edition: int | None
    changed: list[str] = field(default_factory=list)
    left: int = 0  # files with mistakes, or that could not be read or written
    report: Report = field(default_factory=_empty_report)

    def files(self, paths: list[Path]) -> None:
        """Format all programs that paths select, then print how many changed."""
        from antdsl.files import find_files
        from antdsl.whole import is_link

        all_files, report = find_files(paths)
        self.report.extend(report)
        for path in paths:
            if path.suffix in (".yaml", ".yml"):
                self.report.error("not-an-ant-file", f"`{path}` is not an .ant file", None, "name files that end in `.ant`")
        programs = [path for path in all_files if path.suffix == ".ant"]
        for path in programs:
            if path in paths or not is_link(path) or any(path.resolve().is_relative_to(each.resolve()) for each in paths):
                self.file(path)
                continue
            self.left += 1
            words = f"`{path}` is a link to a file outside the folder", "name that file to format it"
            self.report.error("cannot-write", words[0], None, words[1])
        same = len(programs) - len(self.changed) - self.left
        word = "would change" if self.check or self.diff else "changed"
        counts = ((len(self.changed), word), (same, "laid out well"), (self.left, "left alone"))
        summary = [f"{count} file{'' if count == 1 else 's'} {what}" for count, what in counts if count]
        print_note(", ".join(summary) or "no .ant files here", err=True)

    def file(self, path: Path) -> None:
        """Format one file, or only report the change with `--check` or `--diff`."""
        from antdsl import limits, syntax
        from antdsl.bounded import read_bounded

        try:
            text = self.format_source(*syntax.read(path))
            data = b"" if text is None else read_bounded(path, limits.MAX_PROGRAM_BYTES)
            if text is None:
                self.left += 1
            elif text.encode("utf-8") != data:
                if not (self.check or self.diff):
                    syntax.write(path, text)
                self.tell(str(path), data.decode("utf-8", "replace"), text)
        except OSError as problem:
            self.left += 1
            reason = (problem.strerror or "unknown reason").lower()
            self.report.error(
                "cannot-write", f"cannot write `{path}`: {reason}", None, f"{recovery_advice(problem)} {RETRY_ADVICE}"
            )

    def format_standard_input(self) -> None:
        """Format standard input to standard output, or only report the change with `--check` or `--diff`."""
        from antdsl import syntax

        data = read_standard_input()
        text = self.format_source(*syntax.read_bytes("<stdin>", data))
        if text is None:
            return
        if not (self.check or self.diff):
            sys.stdout.buffer.write(text.encode("utf-8"))
            sys.stdout.buffer.flush()
        elif text.encode("utf-8") != data:
            self.tell("<stdin>", data.decode("utf-8"), text)

    def format_source(self, source: object, report: Report) -> str | None:
        """Return the text of a source in the standard layout, or None if it cannot be formatted. Then `report` has the
        findings."""
        from antdsl import syntax
        from antdsl.source import Source

        self.report.extend(report)
        if not isinstance(source, Source):
            return None
        if self.edition is not None:
            from antdsl.program.upgrade import upgrade

            upgraded, findings = upgrade(source, self.edition)
            if upgraded is None:
                self.report.extend(d for d in findings.diagnostics if d.severity == "error")
                return None
            source = upgraded
        text, findings = syntax.format(source)
        self.report.extend(d for d in findings.diagnostics if d.severity == "error")
        return text

    def tell(self, name: str, old_text: str, new_text: str) -> None:
        """Record a file that differs from the standard layout. Print its name, or its difference with `--diff`."""
        self.changed.append(name)
        if self.diff:
            lines = difflib.unified_diff(old_text.splitlines(), new_text.splitlines(), name, name, lineterm="")
            print_result("\n".join(lines) if old_text.splitlines() != new_text.splitlines() else f"{name}: only line ends differ")
        else:
            print_result(name)
