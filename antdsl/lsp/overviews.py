"""Handlers of requests about complete documents and the workspace.

They answer with symbols, folding ranges, colours, links, hints, corrections and formatting."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from lsprotocol import types as lsp

from antdsl.lsp import protocol
from antdsl.lsp.features import tokens
from antdsl.lsp.features.actions import find_quick_fixes
from antdsl.lsp.features.colours import find_colours, find_nearest_colour_names
from antdsl.lsp.features.formatting import find_formatting_edits
from antdsl.lsp.features.hints import find_hints
from antdsl.lsp.features.links import find_links
from antdsl.lsp.features.outline import find_folding_ranges, find_workspace_symbols, list_symbols
from antdsl.lsp.features.spec_runs import RUN_SPEC_COMMAND, run_spec
from antdsl.lsp.session import AntLanguageServer
from antdsl.syntax import nodes


def _handle_document_symbols(ls: AntLanguageServer, params: lsp.DocumentSymbolParams) -> list[lsp.DocumentSymbol]:
    document = ls.find_document(params.text_document.uri)
    return [protocol.to_document_symbol(document, each) for each in list_symbols(document)] if document is not None else []


def _handle_folding_ranges(ls: AntLanguageServer, params: lsp.FoldingRangeParams) -> list[lsp.FoldingRange]:
    document = ls.find_document(params.text_document.uri)
    return [protocol.to_folding_range(each) for each in find_folding_ranges(document)] if document is not None else []


def _handle_semantic_tokens(ls: AntLanguageServer, params: lsp.SemanticTokensParams) -> lsp.SemanticTokens:
    document = ls.find_document(params.text_document.uri)
    return lsp.SemanticTokens(tokens.encode_tokens(document) if document is not None and document.is_program else [])


def _handle_semantic_range_tokens(ls: AntLanguageServer, params: lsp.SemanticTokensRangeParams) -> lsp.SemanticTokens:
    document = ls.find_document(params.text_document.uri)
    if document is None or not document.is_program:
        return lsp.SemanticTokens([])
    return lsp.SemanticTokens(tokens.encode_tokens(document, params.range.start.line, params.range.end.line))


def _handle_inlay_hints(ls: AntLanguageServer, params: lsp.InlayHintParams) -> list[lsp.InlayHint]:
    document = ls.find_document(params.text_document.uri)
    if document is None or not document.is_program:
        return []
    all_hints = [protocol.to_inlay_hint(document, each) for each in find_hints(ls.files, document)]
    return [each for each in all_hints if params.range.start.line <= each.position.line <= params.range.end.line]


def _handle_code_actions(ls: AntLanguageServer, params: lsp.CodeActionParams) -> list[lsp.CodeAction]:
    document = ls.find_document(params.text_document.uri)
    if document is None:
        return []
    start, end = params.range.start, params.range.end
    text = document.text
    fixes = find_quick_fixes(
        ls.files, document, text.find_offset(start.line, start.character), text.find_offset(end.line, end.character)
    )
    return [protocol.to_code_action(ls.files, document, each, params.text_document.uri) for each in fixes]


def _handle_formatting(ls: AntLanguageServer, params: lsp.DocumentFormattingParams) -> list[lsp.TextEdit] | None:
    document = ls.find_document(params.text_document.uri)
    edits = find_formatting_edits(document) if document is not None and document.is_program else None
    return protocol.to_text_edits(document, edits) if document is not None and edits is not None else None


def _handle_workspace_symbols(ls: AntLanguageServer, params: lsp.WorkspaceSymbolParams) -> list[lsp.WorkspaceSymbol]:
    return [
        protocol.to_workspace_symbol(document, symbol, ls.find_uri(document.path))
        for document, symbol in find_workspace_symbols(ls.files, params.query)
    ]


def _handle_document_links(ls: AntLanguageServer, params: lsp.DocumentLinkParams) -> list[lsp.DocumentLink]:
    document = ls.find_document(params.text_document.uri)
    if document is None:
        return []
    return [
        lsp.DocumentLink(protocol.to_lsp_range(document.find_range(link.span)), ls.find_uri(link.path))
        for link in find_links(document)
    ]


def _handle_document_colours(ls: AntLanguageServer, params: lsp.DocumentColorParams) -> list[lsp.ColorInformation]:
    document = ls.find_document(params.text_document.uri)
    if document is None or not document.is_program:
        return []
    return [
        lsp.ColorInformation(protocol.to_lsp_range(document.find_range(each.span)), protocol.to_lsp_colour(each.rgb))
        for each in find_colours(document)
    ]


def _handle_colour_presentations(ls: AntLanguageServer, params: lsp.ColorPresentationParams) -> list[lsp.ColorPresentation]:
    return [lsp.ColorPresentation(name) for name in find_nearest_colour_names(protocol.to_rgb(params.color))]


def _handle_code_lenses(ls: AntLanguageServer, params: lsp.CodeLensParams) -> list[lsp.CodeLens]:
    document = ls.find_document(params.text_document.uri)
    if document is None or not document.is_program:
        return []
    return [
        lsp.CodeLens(
            protocol.to_lsp_range(document.find_range(spec.name.span)),
            lsp.Command("run spec", RUN_SPEC_COMMAND, arguments=[str(document.path), spec.name.text]),
        )
        for spec in document.parsed[0].items
        if isinstance(spec, nodes.Spec)
    ]


async def _run_spec(ls: AntLanguageServer, path: str, name: str) -> None:
    """Run a spec of the saved file, and show the user whether it passed. The code lens supplies `path` and `name`."""
    failed, text = await run_spec(Path(path), name)
    kind = lsp.MessageType.Warning if failed else lsp.MessageType.Info
    ls.window_show_message(lsp.ShowMessageParams(kind, text))


_TOKEN_LEGEND = lsp.SemanticTokensLegend(list(tokens.TOKEN_TYPES), list(tokens.TOKEN_MODIFIERS))
# The method of the protocol, its options, and the function that answers.
_HANDLERS: tuple[tuple[str, Any, Any], ...] = (
    (lsp.TEXT_DOCUMENT_DOCUMENT_SYMBOL, None, _handle_document_symbols),
    (lsp.TEXT_DOCUMENT_FOLDING_RANGE, None, _handle_folding_ranges),
    (lsp.TEXT_DOCUMENT_SEMANTIC_TOKENS_FULL, _TOKEN_LEGEND, _handle_semantic_tokens),
    (lsp.TEXT_DOCUMENT_SEMANTIC_TOKENS_RANGE, _TOKEN_LEGEND, _handle_semantic_range_tokens),
    (lsp.TEXT_DOCUMENT_INLAY_HINT, None, _handle_inlay_hints),
    (lsp.TEXT_DOCUMENT_CODE_ACTION, lsp.CodeActionOptions([lsp.CodeActionKind.QuickFix]), _handle_code_actions),
    (lsp.TEXT_DOCUMENT_FORMATTING, None, _handle_formatting),
    (lsp.WORKSPACE_SYMBOL, None, _handle_workspace_symbols),
    (lsp.TEXT_DOCUMENT_DOCUMENT_LINK, None, _handle_document_links),
    (lsp.TEXT_DOCUMENT_DOCUMENT_COLOR, None, _handle_document_colours),
    (lsp.TEXT_DOCUMENT_COLOR_PRESENTATION, None, _handle_colour_presentations),
    (lsp.TEXT_DOCUMENT_CODE_LENS, None, _handle_code_lenses),
)


def register_overviews(server: AntLanguageServer) -> None:
    """Register the functions that answer requests about complete documents and the workspace."""
    for method, options, handler in _HANDLERS:
        server.feature(method, options)(handler)
    server.command(RUN_SPEC_COMMAND)(_run_spec)
