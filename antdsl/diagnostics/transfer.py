"""Encoding of reports as JSON for another process. Each source text is stored once; a location is the index of its text and two
offsets."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from antdsl.diagnostics.model import Diagnostic, Fix, Label, Report
from antdsl.source import Source, Span


def encode_reports(reports: Mapping[Path, Report], sources: Iterable[Source]) -> bytes:
    """Return reports encoded as JSON in UTF-8. `sources`: further source texts, which are stored after those of the reports."""
    numbers: dict[Source, int] = {}
    texts = [_index_source(source, numbers) for source in sources]
    entries = [
        [
            str(file),
            *(
                [_encode_diagnostic(diagnostic, numbers) for diagnostic in part]
                for part in (report.diagnostics, report.dropped_warnings)
            ),
        ]
        for file, report in reports.items()
    ]
    table = [[source.path, source.text, source.part_number] for source in numbers]
    return json.dumps({"table": table, "sources": texts, "reports": entries}).encode()


def decode_reports(data: bytes) -> tuple[dict[Path, Report], list[Source]]:
    """Return the reports and the source texts from data that `encode_reports` wrote. Raises ValueError if the data is
    incomplete."""
    try:
        document = json.loads(data)
        table = [Source(*entry) for entry in document["table"]]
        reports = {
            Path(file): Report(*([_decode_diagnostic(entry, table) for entry in entries] for entries in parts))
            for file, *parts in document["reports"]
        }
        return reports, [table[index] for index in document["sources"]]
    except (KeyError, IndexError, TypeError) as problem:
        raise ValueError("the document has no valid reports") from problem


def _index_source(source: Source, numbers: dict[Source, int]) -> int:
    """Return the index of a source text in the table `numbers`. A new text is added to the table."""
    return numbers.setdefault(source, len(numbers))


def _encode_diagnostic(diagnostic: Diagnostic, numbers: dict[Source, int]) -> list[Any]:
    d = diagnostic
    labels = [[_encode_span(label.span, numbers), label.text] for label in d.labels]
    fix = d.fix and [_encode_span(d.fix.span, numbers), d.fix.text]
    return [d.code, d.message, d.span and _encode_span(d.span, numbers), d.severity, d.help, labels, fix]


def _encode_span(span: Span, numbers: dict[Source, int]) -> list[int]:
    return [_index_source(span.source, numbers), span.start, span.end]


def _decode_diagnostic(entry: list[Any], table: list[Source]) -> Diagnostic:
    code, message, place, severity, help_, labels, fix = entry
    return Diagnostic(
        code,
        message,
        place and _decode_span(place, table),
        severity,
        help_,
        tuple(Label(_decode_span(label_place, table), text) for label_place, text in labels),
        fix and Fix(_decode_span(fix[0], table), fix[1]),
    )


def _decode_span(place: list[int], table: list[Source]) -> Span:
    index, start, end = place
    return Span(table[index], start, end)
