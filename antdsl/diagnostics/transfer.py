"""Reports as JSON, for another process: each text once, and every place as the number of its text with two offsets."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from antdsl.diagnostics.model import Diagnostic, Fix, Label, Report
from antdsl.source import Source, Span


def encode_reports(reports: Mapping[Path, Report], sources: Iterable[Source]) -> bytes:
    """Return the reports of files, and further texts, in order."""
    numbers: dict[Source, int] = {}
    texts = [_number(source, numbers) for source in sources]
    entries = [
        [str(file), *([_encode(diagnostic, numbers) for diagnostic in part] for part in (report.diagnostics, report.answered))]
        for file, report in reports.items()
    ]
    table = [[source.path, source.text, source.part] for source in numbers]
    return json.dumps({"table": table, "sources": texts, "reports": entries}).encode()


def decode_reports(data: bytes) -> tuple[dict[Path, Report], list[Source]]:
    """Return the reports and texts that were encoded. Raises ValueError if the data is incomplete."""
    try:
        document = json.loads(data)
        table = [Source(*entry) for entry in document["table"]]
        reports = {
            Path(file): Report(*([_decode(entry, table) for entry in entries] for entries in parts))
            for file, *parts in document["reports"]
        }
        return reports, [table[index] for index in document["sources"]]
    except (KeyError, IndexError, TypeError) as problem:
        raise ValueError("these are no reports") from problem


def _number(source: Source, numbers: dict[Source, int]) -> int:
    """The index of a text in the table. A new text is added."""
    return numbers.setdefault(source, len(numbers))


def _encode(diagnostic: Diagnostic, numbers: dict[Source, int]) -> list[Any]:
    d = diagnostic
    labels = [[_place(label.span, numbers), label.text] for label in d.labels]
    fix = d.fix and [_place(d.fix.span, numbers), d.fix.text]
    return [d.code, d.message, d.span and _place(d.span, numbers), d.severity, d.help, labels, fix]


def _place(span: Span, numbers: dict[Source, int]) -> list[int]:
    return [_number(span.source, numbers), span.start, span.end]


def _decode(entry: list[Any], table: list[Source]) -> Diagnostic:
    code, message, place, severity, help_, labels, fix = entry
    return Diagnostic(
        code,
        message,
        place and _span(place, table),
        severity,
        help_,
        tuple(Label(_span(label_place, table), text) for label_place, text in labels),
        fix and Fix(_span(fix[0], table), fix[1]),
    )


def _span(place: list[int], table: list[Source]) -> Span:
    index, start, end = place
    return Span(table[index], start, end)
