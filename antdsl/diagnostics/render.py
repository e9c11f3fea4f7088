"""Formatting of reports as text, in the format that a user or a program has requested."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from antdsl import limits
from antdsl.diagnostics.exchange_formats import format_github, format_json, format_junit, format_sarif
from antdsl.diagnostics.full_format import format_full
from antdsl.diagnostics.model import Diagnostic, Report
from antdsl.diagnostics.text_positions import escape_text, find_line_range


def format_concise(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    """Return findings as text, with one line per finding."""
    lines = [_format_line(diagnostic) for diagnostic in diagnostics]
    if omitted_count:
        lines.append(f"… and {omitted_count:,} more")
    return "".join(f"{line}\n" for line in lines)


def _format_line(diagnostic: Diagnostic) -> str:
    text = f"{diagnostic.severity}[{diagnostic.code}]: {escape_text(diagnostic.message)}"
    if diagnostic.span is None:
        return text
    place = find_line_range(diagnostic.span)
    return f"{escape_text(place.path)}:{place.line}:{place.column}: {text}"


# Each formatter takes the findings to display, in order, and the number of omitted findings.
FORMATTERS: dict[str, Callable[[Sequence[Diagnostic], int], str]] = {
    "full": format_full,
    "concise": format_concise,
    "json": format_json,
    "github": format_github,
    "sarif": format_sarif,
    "junit": format_junit,
}


def render(report: Report, format: str = "full") -> str:
    """Return the report as text in one of `FORMATS`, ordered by location. Raises KeyError for any other format. The text has at
    most 50 findings, with errors before warnings if some must be omitted. It gives the number of omitted findings."""
    diagnostics = choose_visible_diagnostics(report)
    return FORMATTERS[format](diagnostics, len(report.diagnostics) - len(diagnostics))


def choose_visible_diagnostics(report: Report) -> list[Diagnostic]:
    """Return at most 50 findings, ordered by location. If some must be omitted, warnings are omitted first."""
    ordered = report.sort_by_place()
    if len(ordered) <= limits.MAX_SHOWN_DIAGNOSTICS:
        return ordered
    most_severe = sorted(ordered, key=lambda diagnostic: diagnostic.severity != "error")[: limits.MAX_SHOWN_DIAGNOSTICS]
    chosen = {id(diagnostic) for diagnostic in most_severe}
    return [diagnostic for diagnostic in ordered if id(diagnostic) in chosen]
