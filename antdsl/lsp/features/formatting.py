"""Formatting of a document, with the same result as `antdsl fmt`. Only lines that differ are edited."""

from __future__ import annotations

from difflib import SequenceMatcher

from antdsl import syntax
from antdsl.lsp.text import TextEdit
from antdsl.lsp.workspace import OpenDocument
from antdsl.source import Source


def find_formatting_edits(document: OpenDocument) -> list[TextEdit] | None:
    """Return the edits that format a document; [] if it is already formatted, or None if it has errors."""
    new_text, _ = syntax.format(Source(str(document.path), document.text.text))
    if new_text is None:
        return None
    old, new = document.text.text.splitlines(keepends=True), new_text.splitlines(keepends=True)
    starts = [0]
    for line in old:
        starts.append(starts[-1] + len(line))
    edits = []
    for tag, first, last, begin, end in SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if tag != "equal":
            edits.append(TextEdit(starts[first], starts[last], "".join(new[begin:end])))
    return edits
