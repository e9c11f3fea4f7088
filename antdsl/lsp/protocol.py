"""Answers of this package in the terms of the language server protocol. The only file except `server` that imports lsprotocol."""

from __future__ import annotations

from pathlib import Path

from lsprotocol import types as lsp

from antdsl.diagnostics import Diagnostic
from antdsl.lsp.features.actions import Action
from antdsl.lsp.features.hints import Hint
from antdsl.lsp.features.outline import Fold, Symbol
from antdsl.lsp.features.proposals import Item
from antdsl.lsp.text import Edit, Range, uri_of
from antdsl.lsp.workspace import Document, Workspace

SOURCE = "antdsl"
_SYMBOLS = {
    "species": lsp.SymbolKind.Class, "state": lsp.SymbolKind.EnumMember, "behaviour": lsp.SymbolKind.Function,
    "param": lsp.SymbolKind.Constant, "attribute": lsp.SymbolKind.Property, "value": lsp.SymbolKind.Variable,
    "machine": lsp.SymbolKind.Enum, "layers": lsp.SymbolKind.Array, "field": lsp.SymbolKind.Field, "thing": lsp.SymbolKind.Object,
    "world": lsp.SymbolKind.Namespace, "spec": lsp.SymbolKind.Method, "event": lsp.SymbolKind.Event, "key": lsp.SymbolKind.Key,
    "file": lsp.SymbolKind.File,
}  # fmt: skip
_ITEMS = {
    "keyword": lsp.CompletionItemKind.Keyword, "state": lsp.CompletionItemKind.EnumMember, "unit": lsp.CompletionItemKind.Unit,
    "function": lsp.CompletionItemKind.Function, "argument": lsp.CompletionItemKind.Field,
    "variable": lsp.CompletionItemKind.Variable, "property": lsp.CompletionItemKind.Property,
    "thing": lsp.CompletionItemKind.Class, "type": lsp.CompletionItemKind.TypeParameter,
    "colour": lsp.CompletionItemKind.Color, "file": lsp.CompletionItemKind.File,
}  # fmt: skip


def range_of(range: Range) -> lsp.Range:
    (line, column), (end_line, end_column) = range
    return lsp.Range(lsp.Position(line, column), lsp.Position(end_line, end_column))


def diagnostic(workspace: Workspace, document: Document, found: Diagnostic) -> lsp.Diagnostic:
    """Return a finding in the protocol's form: its message with the help, its code, and the related locations."""
    related = []
    for label in found.labels:
        place = workspace.span_of(label.span)
        if place is not None:
            related.append(lsp.DiagnosticRelatedInformation(lsp.Location(uri_of(place[0].path), range_of(place[1])), label.text))
    severity = lsp.DiagnosticSeverity.Error if found.severity == "error" else lsp.DiagnosticSeverity.Warning
    idle = found.code.startswith("unused-")
    return lsp.Diagnostic(
        range_of(document.range(found.span)) if found.span is not None else lsp.Range(lsp.Position(0, 0), lsp.Position(0, 1)),
        found.message + (f"\n{found.help}" if found.help else ""),
        severity,
        found.code,
        source=SOURCE,
        related_information=related or None,
        tags=[lsp.DiagnosticTag.Unnecessary] if idle else None,
    )


def item(found: Item, snippets: bool) -> lsp.CompletionItem:
    snippet = found.snippet and snippets
    insert = found.insert if found.insert and (snippet or not found.snippet) else None
    return lsp.CompletionItem(
        found.label,
        kind=_ITEMS[found.kind],
        detail=found.detail or None,
        documentation=lsp.MarkupContent(lsp.MarkupKind.Markdown, found.help) if found.help else None,
        insert_text=insert,
        insert_text_format=lsp.InsertTextFormat.Snippet if snippet else lsp.InsertTextFormat.PlainText,
    )


def symbol(document: Document, found: Symbol) -> lsp.DocumentSymbol:
    name = document.range(found.name_span)
    whole = document.range(found.span)
    return lsp.DocumentSymbol(
        found.name or "…",
        _SYMBOLS[found.kind],
        range_of((min(whole[0], name[0]), max(whole[1], name[1]))),
        range_of(name),
        found.detail or None,
        children=[symbol(document, each) for each in found.inner],
    )


def fold(found: Fold) -> lsp.FoldingRange:
    kind = lsp.FoldingRangeKind.Comment if found.comment else lsp.FoldingRangeKind.Region
    return lsp.FoldingRange(found.first, found.last, kind=kind)


def hint(document: Document, found: Hint) -> lsp.InlayHint:
    start, end = document.range(found.span)
    line, column = start if found.before else end
    return lsp.InlayHint(
        lsp.Position(line, column), found.text, tooltip=found.help, padding_left=not found.before, padding_right=found.before
    )


def text_edits(document: Document, edits: list[Edit]) -> list[lsp.TextEdit]:
    return [lsp.TextEdit(range_of(document.text.range(each.start, each.end)), each.text) for each in edits]


def changes(edits: dict[Path, list[lsp.TextEdit]], uris: dict[Path, str]) -> lsp.WorkspaceEdit:
    return lsp.WorkspaceEdit(changes={uris.get(path, uri_of(path)): each for path, each in edits.items()})


def action(workspace: Workspace, document: Document, found: Action, uri: str) -> lsp.CodeAction:
    return lsp.CodeAction(
        found.title,
        kind=lsp.CodeActionKind.QuickFix,
        diagnostics=[diagnostic(workspace, document, found.complaint)],
        is_preferred=True,
        edit=lsp.WorkspaceEdit(changes={uri: text_edits(document, [found.edit])}),
    )
