"""Code actions: if a finding suggests a replacement text, the editor offers to apply it."""

from __future__ import annotations

import re
from dataclasses import dataclass

from antdsl.diagnostics import Diagnostic
from antdsl.lsp.text import TextEdit
from antdsl.lsp.workspace import OpenDocument, Workspace

_SUGGESTION_PATTERN = re.compile(r"did you mean `([a-z_][A-Za-z_0-9.]*)`\?")
_NAME_PATTERN = re.compile(r"[A-Za-z_][A-Za-z_0-9.]*")


@dataclass(frozen=True, slots=True)
class QuickFix:
    """An edit that corrects a finding. `title`: the description that the editor shows."""

    title: str
    edit: TextEdit
    diagnostic: Diagnostic


def find_quick_fixes(workspace: Workspace, document: OpenDocument, start: int, end: int) -> list[QuickFix]:
    """Return the edits that correct findings between two offsets."""
    fixes = []
    for complaint in workspace.find_diagnostics(document.path):
        span = complaint.span
        if span is None or document.find_start(span) > end or document.find_end(span) < start:
            continue
        edit = find_edit(document, complaint)
        if edit is not None:
            fixes.append(QuickFix(_format_title(document, edit), edit, complaint))
    return fixes


def find_edit(document: OpenDocument, diagnostic: Diagnostic) -> TextEdit | None:
    """Return the edit for a finding, or None if there is none. The edit is the fix of the finding. For a finding that marks a
    single name, the edit may also replace this name by the suggested name."""
    if diagnostic.fix is not None:
        span = diagnostic.fix.span
        return TextEdit(document.find_start(span), document.find_end(span), diagnostic.fix.text)
    suggestion = _SUGGESTION_PATTERN.search(diagnostic.help or "")
    if suggestion is None or diagnostic.span is None or not _NAME_PATTERN.fullmatch(diagnostic.span.text):
        return None
    return TextEdit(document.find_start(diagnostic.span), document.find_end(diagnostic.span), suggestion.group(1))


def _format_title(document: OpenDocument, edit: TextEdit) -> str:
    old = " ".join(document.text.text[edit.start : edit.end].split())
    new = " ".join(edit.text.split())
    if not new:
        return f"Delete `{old[:60]}`"
    return f"Write `{new[:60]}`" + (f" for `{old[:40]}`" if old else "")
