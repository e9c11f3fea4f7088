"""One line for each complaint, in the form that editors and compilers know: `path:line:column: error[code]: message`."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.diagnostics.model import Diagnostic
from antdsl.diagnostics.places import area, safe


def concise(diagnostics: Sequence[Diagnostic], more: int) -> str:
    lines = [_line(diagnostic) for diagnostic in diagnostics]
    if more:
        lines.append(f"… and {more:,} more")
    return "".join(f"{line}\n" for line in lines)


def _line(diagnostic: Diagnostic) -> str:
    text = f"{diagnostic.severity}[{diagnostic.code}]: {safe(diagnostic.message)}"
    if diagnostic.span is None:
        return text
    place = area(diagnostic.span)
    return f"{safe(place.path)}:{place.line}:{place.column}: {text}"
