"""A program that declares nothing that could act."""

from __future__ import annotations

import re

from antdsl.diagnostics import Report
from antdsl.program.checks.analysis.checked import CheckContext
from antdsl.syntax import nodes

_DECLARING = re.compile(r"\b(species|behaviour)\b")


def check_empty(checked: CheckContext, report: Report) -> None:
    for file in checked.files:
        source, items = file.node.source, file.node.items
        if not items or any(isinstance(item, (nodes.Species, nodes.Behaviour)) for item in items):
            continue
        # if the word is there, a declaration could not be read, which was reported already
        if not any(_DECLARING.search(line.partition("#")[0]) for line in source.text.splitlines()):
            report.error("empty-program", "no species and no behaviour is declared", items[0].span, "write `species ant { … }`")
