"""Workflow commands that GitHub shows beside the changed lines. Errors come first: GitHub silently drops findings above its
limit."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.diagnostics.model import Diagnostic
from antdsl.diagnostics.places import escape_text, line_range, severity_rank


def github(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    ordered = sorted(diagnostics, key=lambda diagnostic: severity_rank(diagnostic.severity))
    lines = [_command(diagnostic) for diagnostic in ordered]
    if omitted_count:
        lines.append(f"::notice title=antdsl::{omitted_count} more, see the SARIF output")
    return "".join(f"{line}\n" for line in lines)


def _command(diagnostic: Diagnostic) -> str:
    text = escape_text(diagnostic.message) + (f"\nhelp: {escape_text(diagnostic.help)}" if diagnostic.help else "")
    properties = {"title": diagnostic.code}
    if diagnostic.span is not None:
        place = line_range(diagnostic.span)
        properties = {
            "file": escape_text(place.path),
            "line": str(place.line),
            "col": str(place.column),
            "endLine": str(place.end_line),
        }
        if place.line == place.end_line:
            properties["endColumn"] = str(place.end_column)
        properties["title"] = diagnostic.code
    written = ",".join(f"{key}={_property(value)}" for key, value in properties.items())
    return f"::{diagnostic.severity} {written}::{_data(text)}"


def _data(text: str) -> str:
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(text).replace(":", "%3A").replace(",", "%2C")
