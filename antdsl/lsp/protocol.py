"""Conversion of this package's results to messages of the language server protocol.

Only this module and `server` import lsprotocol."""

from __future__ import annotations

from pathlib import Path

from lsprotocol import types as lsp

from antdsl.diagnostics import Diagnostic
from antdsl.lsp.features.actions import QuickFix
from antdsl.lsp.features.expression_completion import CompletionItem
from antdsl.lsp.features.hints import InlayHint
from antdsl.lsp.features.outline import FoldedRange, OutlineSymbol
from antdsl.lsp.features.signatures import Signature
from antdsl.lsp.text import TextEdit, TextRange, path_to_uri
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.tables.colours import RgbTriple

DIAGNOSTIC_SOURCE = "antdsl"
_SYMBOL_KINDS = {
    "species": lsp.SymbolKind.Class, "state": lsp.SymbolKind.EnumMember, "behaviour": lsp.SymbolKind.Function,
    "param": lsp.SymbolKind.Constant, "attribute": lsp.SymbolKind.Property, "value": lsp.SymbolKind.Variable,
    "machine": lsp.SymbolKind.Enum, "layers": lsp.SymbolKind.Array, "field": lsp.SymbolKind.Field, "thing": lsp.SymbolKind.Object,
    "world": lsp.SymbolKind.Namespace, "spec": lsp.SymbolKind.Method, "event": lsp.SymbolKind.Event, "key": lsp.SymbolKind.Key,
    "file": lsp.SymbolKind.File,
}  # fmt: skip
_COMPLETION_KINDS = {
    "keyword": lsp.CompletionItemKind.Keyword, "state": lsp.CompletionItemKind.EnumMember, "unit": lsp.CompletionItemKind.Unit,
    "function": lsp.CompletionItemKind.Function, "argument": lsp.CompletionItemKind.Field,
    "variable": lsp.CompletionItemKind.Variable, "property": lsp.CompletionItemKind.Property,
    "thing": lsp.CompletionItemKind.Class, "type": lsp.CompletionItemKind.TypeParameter,
    "colour": lsp.CompletionItemKind.Color, "file": lsp.CompletionItemKind.File,
}  # fmt: skip


def to_lsp_range(range: TextRange) -> lsp.Range:
    """Convert a range of lines and columns to the protocol's range."""
    (line, column), (end_line, end_column) = range
    return lsp.Range(lsp.Position(line, column), lsp.Position(end_line, end_column))


def to_lsp_diagnostic(workspace: Workspace, document: OpenDocument, complaint: Diagnostic) -> lsp.Diagnostic:
    """Convert a finding to the protocol's form: message with help, code, and related locations."""
    related = []
    for label in complaint.labels:
        place = workspace.locate_span(label.span)
        if place is not None:
            related.append(
                lsp.DiagnosticRelatedInformation(lsp.Location(path_to_uri(place[0].path), to_lsp_range(place[1])), label.text)
            )
    severity = lsp.DiagnosticSeverity.Error if complaint.severity == "error" else lsp.DiagnosticSeverity.Warning
    idle = complaint.code.startswith("unused-")
    return lsp.Diagnostic(
        to_lsp_range(document.find_range(complaint.span))
        if complaint.span is not None
        else lsp.Range(lsp.Position(0, 0), lsp.Position(0, 1)),
        complaint.message + (f"\n{complaint.help}" if complaint.help else ""),
        severity,
        complaint.code,
        source=DIAGNOSTIC_SOURCE,
        related_information=related or None,
        tags=[lsp.DiagnosticTag.Unnecessary] if idle else None,
    )


def to_completion_item(proposal: CompletionItem, allow_snippets: bool) -> lsp.CompletionItem:
    """Convert a completion proposal. `allow_snippets`: whether the editor supports snippets."""
    snippet = proposal.is_snippet and allow_snippets
    insert = proposal.insert_text if proposal.insert_text and (snippet or not proposal.is_snippet) else None
    return lsp.CompletionItem(
        proposal.label,
        kind=_COMPLETION_KINDS[proposal.kind],
        detail=proposal.detail or None,
        documentation=lsp.MarkupContent(lsp.MarkupKind.Markdown, proposal.help) if proposal.help else None,
        insert_text=insert,
        insert_text_format=lsp.InsertTextFormat.Snippet if snippet else lsp.InsertTextFormat.PlainText,
    )


def to_document_symbol(document: OpenDocument, entry: OutlineSymbol) -> lsp.DocumentSymbol:
    """Convert a symbol of the outline together with the symbols inside it."""
    name = document.find_range(entry.name_span)
    full_range = document.find_range(entry.span)
    return lsp.DocumentSymbol(
        entry.name or "…",
        _SYMBOL_KINDS[entry.kind],
        to_lsp_range((min(full_range[0], name[0]), max(full_range[1], name[1]))),
        to_lsp_range(name),
        entry.detail or None,
        children=[to_document_symbol(document, each) for each in entry.children],
    )


def to_workspace_symbol(document: OpenDocument, entry: OutlineSymbol, uri: str) -> lsp.WorkspaceSymbol:
    """Convert a symbol for the results of a search in all files. `uri`: the URI of its document."""
    place = lsp.Location(uri, to_lsp_range(document.find_range(entry.name_span)))
    return lsp.WorkspaceSymbol(place, entry.name or "…", _SYMBOL_KINDS[entry.kind], container_name=document.path.name)


def to_signature(signature: Signature) -> lsp.SignatureInformation:
    """Convert a signature together with its active parameter."""
    parameters = [lsp.ParameterInformation(label) for label in signature.parameters]
    help = lsp.MarkupContent(lsp.MarkupKind.Markdown, signature.help) if signature.help else None
    return lsp.SignatureInformation(signature.label, help, parameters, signature.active_parameter)


def to_lsp_colour(rgb: RgbTriple) -> lsp.Color:
    """Convert a colour with channels from 0 to 255 to one with channels from 0 to 1."""
    return lsp.Color(rgb[0] / 255, rgb[1] / 255, rgb[2] / 255, 1.0)


def to_rgb(colour: lsp.Color) -> RgbTriple:
    """Convert a colour with channels from 0 to 1 to one with channels from 0 to 255."""
    return round(colour.red * 255), round(colour.green * 255), round(colour.blue * 255)


def to_folding_range(region: FoldedRange) -> lsp.FoldingRange:
    """Convert a range of lines that can be folded."""
    kind = lsp.FoldingRangeKind.Comment if region.is_comment else lsp.FoldingRangeKind.Region
    return lsp.FoldingRange(region.first, region.last, kind=kind)


def to_inlay_hint(document: OpenDocument, inlay: InlayHint) -> lsp.InlayHint:
    """Convert an inlay hint."""
    start, end = document.find_range(inlay.span)
    line, column = start if inlay.is_before else end
    return lsp.InlayHint(
        lsp.Position(line, column),
        inlay.text,
        tooltip=inlay.help,
        padding_left=not inlay.is_before,
        padding_right=inlay.is_before,
    )


def to_text_edits(document: OpenDocument, edits: list[TextEdit]) -> list[lsp.TextEdit]:
    """Convert edits of a document."""
    return [lsp.TextEdit(to_lsp_range(document.text.find_range(each.start, each.end)), each.text) for each in edits]


def to_workspace_edit(edits: dict[Path, list[lsp.TextEdit]], uris: dict[Path, str]) -> lsp.WorkspaceEdit:
    """Return edits of several files as a single change. `uris`: the URIs of open documents."""
    return lsp.WorkspaceEdit(changes={uris.get(path, path_to_uri(path)): each for path, each in edits.items()})


def to_code_action(workspace: Workspace, document: OpenDocument, fix: QuickFix, uri: str) -> lsp.CodeAction:
    """Convert a quick fix to a code action for the document `uri`."""
    return lsp.CodeAction(
        fix.title,
        kind=lsp.CodeActionKind.QuickFix,
        diagnostics=[to_lsp_diagnostic(workspace, document, fix.diagnostic)],
        is_preferred=True,
        edit=lsp.WorkspaceEdit(changes={uri: to_text_edits(document, [fix.edit])}),
    )
