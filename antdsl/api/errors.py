"""The exception of the interface for Python."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.diagnostics.render import render


class AntdslError(Exception):
    """The error for a mistake in a scene, a program, a name or a value.

    `report`: the findings, each with its location; empty if the error has none. `help`: what to write instead, or None."""

    def __init__(self, message: str, help: str | None = None, report: Report | None = None) -> None:
        super().__init__(message if help is None else f"{message}; {help}")
        self.help, self.report = help, Report() if report is None else report

    @classmethod
    def from_report(cls, report: Report) -> AntdslError:
        """Return the error of a report with errors. Its text is the text of `antdsl check`."""
        return cls(render(report).rstrip("\n"), report=report)
