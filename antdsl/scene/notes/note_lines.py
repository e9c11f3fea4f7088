"""Notes in addition to those in a scene's file. They are lines of text, and each line is a separate source of locations."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from antdsl.diagnostics import Report
from antdsl.scene.document import MappingNode, SequenceNode, decode_source, read_document

NOTES_KEY = "notes"
_SOURCE_PREFIX = "<note "
_EXAMPLE = "write a line such as `{hold: guards, frames: 10..20}`"


def format_note_source(number: int) -> str:
    """Return the name of the source of an additional note."""
    return f"{_SOURCE_PREFIX}{number + 1}>"


def is_note_source(path: str) -> bool:
    """Return whether the source `path` is an additional note rather than a file."""
    return path.startswith(_SOURCE_PREFIX)


def read_note_line(text: str, number: int = 0) -> tuple[MappingNode | None, Report]:
    """Return the tree of a line such as `{hold: guards, frames: 10..20}`, and a report. The tree is None if there are errors."""
    source, report = decode_source(text.encode("utf-8", "replace"), format_note_source(number), "a note")
    return read_document(source, "the note", _EXAMPLE) if report.ok else (None, report)


def append_notes(document: MappingNode, lines: Iterable[str], report: Report) -> MappingNode | None:
    """Return the tree of a scene with the notes in `lines` after its own. Return None after errors, which are added to the
    report."""
    nodes = []
    for number, text in enumerate(lines):
        node, findings = read_note_line(text, number)
        report.extend(findings)
        nodes += [node] if node is not None else []
    if not report.ok:
        return None
    own = document.entries.get(NOTES_KEY)
    if not nodes or (own is not None and not isinstance(own, SequenceNode)):
        return document
    span = nodes[0].span if own is None else own.span
    notes = SequenceNode((*(() if own is None else own.items), *nodes), span)
    return replace(document, entries={**document.entries, NOTES_KEY: notes}, keys={NOTES_KEY: span, **document.keys})
