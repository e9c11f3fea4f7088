"""Report → text, in the format that a person or a program asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from antdsl import limits
from antdsl.diagnostics.concise import concise
from antdsl.diagnostics.document import document
from antdsl.diagnostics.full import full
from antdsl.diagnostics.github import github
from antdsl.diagnostics.junit import junit
from antdsl.diagnostics.model import Diagnostic, Report
from antdsl.diagnostics.sarif import sarif

# Each takes the complaints to show, in order, and the number of those that are left out.
FORMATS: dict[str, Callable[[Sequence[Diagnostic], int], str]] = {
    "full": full,
    "concise": concise,
    "json": document,
    "github": github,
    "sarif": sarif,
    "junit": junit,
}


def render(report: Report, format: str = "full") -> str:
    """The report in one of `FORMATS`, by place, at most 50 complaints and the number of the rest. KeyError for another format.

    Errors are kept before warnings where not all can be shown.
    """
    ordered = report.sorted()
    shown = ordered
    if len(ordered) > limits.DIAGNOSTICS_SHOWN:
        kept = sorted(ordered, key=lambda diagnostic: diagnostic.severity != "error")[: limits.DIAGNOSTICS_SHOWN]
        chosen = {id(diagnostic) for diagnostic in kept}
        shown = [diagnostic for diagnostic in ordered if id(diagnostic) in chosen]
    return FORMATS[format](shown, len(ordered) - len(shown))
