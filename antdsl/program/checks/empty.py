"""A program in which nothing is declared that could do anything."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.checks.checked import Checked
from antdsl.source import Span
from antdsl.syntax import nodes


def empty(checked: Checked, report: Report) -> None:
    for file in checked.files:
        if not any(isinstance(item, (nodes.Species, nodes.Behaviour)) for item in file.node.items) and report.ok:
            source = file.node.source
            report.error("empty-program", "no species and no behaviour is declared", Span(source, 0, min(1, len(source.text))), "write `species ant { … }`")
