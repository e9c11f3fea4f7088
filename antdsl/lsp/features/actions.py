"""Code actions: a finding that suggests a replacement, as an edit."""

from __future__ import annotations

import re
from dataclasses import dataclass

from antdsl.diagnostics import Diagnostic
from antdsl.lsp.text import Edit
from antdsl.lsp.workspace import Document, Workspace

_MEANT = re.compile(r"did you mean `([a-z_][A-Za-z_0-9.]*)`\?")
_NAME = re.compile(r"[A-Za-z_][A-Za-z_0-9.]*")


@dataclass(frozen=True, slots=True)
class Action:
    title: str
    edit: Edit
    complaint: Diagnostic


def actions(workspace: Workspace, document: Document, start: int, end: int) -> list[Action]:
    """Return the edits that correct findings between two offsets."""
    fixes = []
    for complaint in workspace.complaints(document.path):
        span = complaint.span
        if span is None or document.start(span) > end or document.end(span) < start:
            continue
        edit = edit_of(document, complaint)
        if edit is not None:
            fixes.append(Action(_title(document, edit), edit, complaint))
    return fixes


def edit_of(document: Document, complaint: Diagnostic) -> Edit | None:
    """Return the edit for a finding: its fix, or the suggested name if the finding covers a single name."""
    if complaint.fix is not None:
        span = complaint.fix.span
        return Edit(document.start(span), document.end(span), complaint.fix.text)
    meant = _MEANT.search(complaint.help or "")
    if meant is None or complaint.span is None or not _NAME.fullmatch(complaint.span.text):
        return None
    return Edit(document.start(complaint.span), document.end(complaint.span), meant.group(1))


def _title(document: Document, edit: Edit) -> str:
    old = " ".join(document.text.text[edit.start : edit.end].split())
    new = " ".join(edit.text.split())
    if not new:
        return f"Delete `{old[:60]}`"
    return f"Write `{new[:60]}`" + (f" for `{old[:40]}`" if old else "")
