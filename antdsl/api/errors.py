"""The exception that the Python interface raises."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.diagnostics.render import render


class AntdslError(Exception):
    """The error for a mistake in a scene, a program, a name or a value.

    `report`: the findings, each with its location; empty if there are none. `help`: what to write instead, or None."""

    def __init__(self, message: str, help: str | None = None, report: Report | None = None) -> None:
        super().__init__(message if help is None else f"{message}; {help}")
        self.help, self.report = help, Report() if report is None else report

    @classmethod
    def from_report(cls, report: Report) -> AntdslError:
        """Return the error for a report that contains errors. Its text is what `antdsl check` prints."""
        return cls(render(report).rstrip("\n"), report=report)
