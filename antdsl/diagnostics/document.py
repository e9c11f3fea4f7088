"""JSON for other programs. `format_version` increases by a minor step when keys are added, by a major one when they change."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from antdsl.diagnostics.model import Diagnostic
from antdsl.source import Source, Span

FORMAT_VERSION = "1.0"


def document(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    errors = sum(diagnostic.severity == "error" for diagnostic in diagnostics)
    content = {
        "format_version": FORMAT_VERSION,
        "valid": errors == 0,
        "error_count": errors,
        "warning_count": len(diagnostics) - errors,
        "left_out": omitted_count,
        "diagnostics": [_entry(diagnostic) for diagnostic in diagnostics],
    }
    return json.dumps(content, indent=2, ensure_ascii=True) + "\n"


def _entry(diagnostic: Diagnostic) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "severity": diagnostic.severity,
        "code": diagnostic.code,
        "summary": diagnostic.message,
        "detail": diagnostic.help or "",
    }
    if diagnostic.span is not None:
        entry["range"] = _range(diagnostic.span)
        line = entry["range"]["start"]["line"]
        entry["snippet"] = {"code": diagnostic.span.source.line_text(line), "start_line": line}
    if diagnostic.labels:
        entry["labels"] = [{"text": label.text, "range": _range(label.span)} for label in diagnostic.labels]
    if diagnostic.fix is not None:
        entry["fix"] = {"range": _range(diagnostic.fix.span), "text": diagnostic.fix.text}
    return entry


def _range(span: Span) -> dict[str, Any]:
    return {"filename": span.source.path, "start": _position(span.source, span.start), "end": _position(span.source, span.end)}


def _position(source: Source, offset: int) -> dict[str, int]:
    """Return line and column, in characters from 1, and byte, in UTF-8 bytes from 0."""
    line, column = source.line_column(offset)
    byte = offset if source.text.isascii() else len(source.text[:offset].encode("utf-8", "surrogatepass"))
    return {"line": line, "column": column, "byte": byte}
