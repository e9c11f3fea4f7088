"""The language server. It passes each request of the protocol to the module of this package that answers it."""

from __future__ import annotations

import io
import logging
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from lsprotocol import types as lsp
from pygls.exceptions import JsonRpcInvalidParams

from antdsl.atomic_write import write_parts
from antdsl.lsp import protocol
from antdsl.lsp.features import navigation
from antdsl.lsp.features.completion import complete_program
from antdsl.lsp.features.context import is_line_start
from antdsl.lsp.features.signatures import find_signatures
from antdsl.lsp.features.symbol_help import describe_symbol
from antdsl.lsp.overviews import register_overviews
from antdsl.lsp.scene_help import complete_scene
from antdsl.lsp.session import AntLanguageServer
from antdsl.lsp.text import uri_to_path
from antdsl.lsp.word_descriptions import find_scene_key_help
from antdsl.lsp.word_help import describe_keyword
from antdsl.lsp.workspace import OpenDocument

T = TypeVar("T")


language_server = AntLanguageServer()
register_overviews(language_server)


@language_server.feature(lsp.SHUTDOWN)
def _handle_shutdown(ls: AntLanguageServer, *params: object) -> None:
    ls.is_shutdown_requested = True


@language_server.feature(lsp.EXIT)
def _handle_exit(ls: AntLanguageServer, *params: object) -> None:
    ls.exited_without_shutdown = not ls.is_shutdown_requested


# --- documents -------------------------------------------------------------------------------------------------------


@language_server.feature(lsp.INITIALIZED)
def _handle_initialized(ls: AntLanguageServer, params: lsp.InitializedParams) -> None:
    encoding = ls.workspace.position_encoding
    ls.files.encoding = encoding.value if isinstance(encoding, lsp.PositionEncodingKind) else encoding or "utf-16"
    ls.files.roots = [path for uri in ls.workspace.folders if (path := uri_to_path(uri)) is not None]
    if not ls.files.roots and ls.workspace.root_uri and (root := uri_to_path(ls.workspace.root_uri)) is not None:
        ls.files.roots = [root]


@language_server.feature(lsp.WORKSPACE_DID_CHANGE_WORKSPACE_FOLDERS)
def _handle_did_change_workspace_folders(ls: AntLanguageServer, params: lsp.DidChangeWorkspaceFoldersParams) -> None:
    removed_paths = {uri_to_path(folder.uri) for folder in params.event.removed}
    added = [path for folder in params.event.added if (path := uri_to_path(folder.uri)) is not None]
    ls.files.roots = [root for root in ls.files.roots if root not in removed_paths] + added
    ls.files.invalidate_file_list()


@language_server.feature(lsp.TEXT_DOCUMENT_DID_OPEN)
def _handle_did_open(ls: AntLanguageServer, params: lsp.DidOpenTextDocumentParams) -> None:
    path = ls.find_path(params.text_document.uri)
    ls.uris[path] = params.text_document.uri
    ls.files.put_document(path, params.text_document.text, params.text_document.version)
    ls.schedule_check(path)


@language_server.feature(lsp.TEXT_DOCUMENT_DID_CHANGE)
def _handle_did_change(ls: AntLanguageServer, params: lsp.DidChangeTextDocumentParams) -> None:
    path = ls.find_path(params.text_document.uri)
    document = ls.files.open_documents.get(path)
    if document is None:
        return
    text = document.text
    for change in params.content_changes:
        if isinstance(change, lsp.TextDocumentContentChangePartial):
            start, end = change.range.start, change.range.end
            text = text.replace_range((start.line, start.character), (end.line, end.character), change.text)
        else:
            text = text.with_text(change.text)
    ls.files.change_document(path, text, params.text_document.version)
    ls.schedule_check(path)


@language_server.feature(lsp.TEXT_DOCUMENT_DID_CLOSE)
def _handle_did_close(ls: AntLanguageServer, params: lsp.DidCloseTextDocumentParams) -> None:
    path = ls.find_path(params.text_document.uri)
    ls.files.close_document(path)
    ls.uris.pop(path, None)
    ls.text_document_publish_diagnostics(lsp.PublishDiagnosticsParams(params.text_document.uri, []))
    _recheck_open_documents(ls)


@language_server.feature(lsp.TEXT_DOCUMENT_DID_SAVE)
def _handle_did_save(ls: AntLanguageServer, params: lsp.DidSaveTextDocumentParams) -> None:
    _recheck_open_documents(ls)


@language_server.feature(lsp.WORKSPACE_DID_CHANGE_WATCHED_FILES)
def _handle_did_change_watched_files(ls: AntLanguageServer, params: lsp.DidChangeWatchedFilesParams) -> None:
    _recheck_open_documents(ls)


def _recheck_open_documents(ls: AntLanguageServer) -> None:
    """Check all open documents again after a file on disk has changed. This is cheap for documents that do not depend on the
    file."""
    ls.files.invalidate_file_list()
    for path in ls.files.open_documents:
        ls.schedule_check(path)


# --- questions about a place -----------------------------------------------------------------------------------------


def _answer_at_position(ls: AntLanguageServer, params: Any, answer: Callable[[OpenDocument, int], T]) -> T | None:
    """Return the result of `answer` for the document and offset of a request; None if the document cannot be read."""
    document = ls.find_document(params.text_document.uri)
    if document is None:
        return None
    return answer(document, document.text.find_offset(params.position.line, params.position.character))


@language_server.feature(lsp.TEXT_DOCUMENT_HOVER)
def _handle_hover(ls: AntLanguageServer, params: lsp.HoverParams) -> lsp.Hover | None:
    def answer(document: OpenDocument, offset: int) -> lsp.Hover | None:
        names = document.find_occurrences(offset)
        occurrence_by_text = {
            text: each.span
            for each in names
            if (text := describe_symbol(ls.files, document, navigation.resolve_key(ls.files, document, each.key))) is not None
        }
        if not occurrence_by_text:
            start, end = document.find_word_at(offset)
            word = document.text.text[start:end]
            is_first = is_line_start(document.text.text, start)
            text = describe_keyword(word, is_first) if document.is_program else find_scene_key_help(word)
            return lsp.Hover(_make_markdown(text), protocol.to_lsp_range(document.text.find_range(start, end))) if text else None
        return lsp.Hover(
            _make_markdown("\n\n---\n\n".join(occurrence_by_text)),
            protocol.to_lsp_range(document.find_range(next(iter(occurrence_by_text.values())))),
        )

    return _answer_at_position(ls, params, answer)


def _make_markdown(text: str) -> lsp.MarkupContent:
    return lsp.MarkupContent(lsp.MarkupKind.Markdown, text)


@language_server.feature(
    lsp.TEXT_DOCUMENT_COMPLETION, lsp.CompletionOptions(trigger_characters=[".", ">", "(", " ", ":", "/", ",", "{"])
)
def _handle_completion(ls: AntLanguageServer, params: lsp.CompletionParams) -> lsp.CompletionList | None:
    def answer(document: OpenDocument, offset: int) -> lsp.CompletionList:
        proposals = (
            complete_program(ls.files, document, offset) if document.is_program else complete_scene(ls.files, document, offset)
        )
        snippets = ls.has_snippet_support()
        return lsp.CompletionList(False, [protocol.to_completion_item(each, snippets) for each in proposals])

    return _answer_at_position(ls, params, answer)


@language_server.feature(lsp.TEXT_DOCUMENT_SIGNATURE_HELP, lsp.SignatureHelpOptions(trigger_characters=["(", ","]))
def _handle_signature_help(ls: AntLanguageServer, params: lsp.SignatureHelpParams) -> lsp.SignatureHelp | None:
    def answer(document: OpenDocument, offset: int) -> lsp.SignatureHelp | None:
        signatures = find_signatures(ls.files, document, offset) if document.is_program else []
        return lsp.SignatureHelp([protocol.to_signature(each) for each in signatures], 0) if signatures else None

    return _answer_at_position(ls, params, answer)


@language_server.feature(lsp.TEXT_DOCUMENT_DEFINITION)
def _handle_definition(ls: AntLanguageServer, params: lsp.DefinitionParams) -> list[lsp.Location] | None:
    return _answer_at_position(
        ls,
        params,
        lambda document, offset: [ls.make_location(each) for each in navigation.find_definition(ls.files, document, offset)],
    )


@language_server.feature(lsp.TEXT_DOCUMENT_REFERENCES)
def _handle_references(ls: AntLanguageServer, params: lsp.ReferenceParams) -> list[lsp.Location] | None:
    declaration = params.context.include_declaration
    return _answer_at_position(
        ls,
        params,
        lambda document, offset: [
            ls.make_location(each) for each in navigation.find_references(ls.files, document, offset, declaration)
        ],
    )


@language_server.feature(lsp.TEXT_DOCUMENT_DOCUMENT_HIGHLIGHT)
def _handle_document_highlights(ls: AntLanguageServer, params: lsp.DocumentHighlightParams) -> list[lsp.DocumentHighlight] | None:
    def make_highlights(document: OpenDocument, offset: int) -> list[lsp.DocumentHighlight]:
        locations = navigation.find_references(ls.files, document, offset)
        return [lsp.DocumentHighlight(protocol.to_lsp_range(each.range)) for each in locations if each.document is document]

    return _answer_at_position(ls, params, make_highlights)


@language_server.feature(lsp.TEXT_DOCUMENT_PREPARE_RENAME)
def _handle_prepare_rename(ls: AntLanguageServer, params: lsp.PrepareRenameParams) -> lsp.Range | None:
    def find_rename_range(document: OpenDocument, offset: int) -> lsp.Range:
        try:
            return protocol.to_lsp_range(document.find_range(navigation.find_renamable_name(ls.files, document, offset).span))
        except navigation.RenameRejected as error:
            raise JsonRpcInvalidParams(str(error)) from None

    return _answer_at_position(ls, params, find_rename_range)


@language_server.feature(lsp.TEXT_DOCUMENT_RENAME, lsp.RenameOptions(prepare_provider=True))
def _handle_rename(ls: AntLanguageServer, params: lsp.RenameParams) -> lsp.WorkspaceEdit | None:
    def answer(document: OpenDocument, offset: int) -> lsp.WorkspaceEdit:
        try:
            locations = navigation.rename_symbol(ls.files, document, offset, params.new_name)
        except navigation.RenameRejected as error:
            raise JsonRpcInvalidParams(str(error)) from None
        edits: dict[Path, list[lsp.TextEdit]] = {}
        for each in locations:
            edits.setdefault(each.document.path, []).append(lsp.TextEdit(protocol.to_lsp_range(each.range), params.new_name))
        return protocol.to_workspace_edit(edits, ls.uris)

    return _answer_at_position(ls, params, answer)


class _MessageOutput(io.RawIOBase):
    """The output stream of messages to the editor. After a write fails, it writes nothing more.

    `problem`: why the write failed; None if all messages were written, or if the editor has exited."""

    def __init__(self, handle: int) -> None:
        self._handle: int | None = handle
        self.problem: OSError | None = None

    def write(self, data: Any) -> int:
        if self._handle is not None:
            try:
                write_parts(self._handle, [bytes(data)])
            except OSError as problem:
                self._handle = None
                self.problem = None if isinstance(problem, BrokenPipeError) else problem
        return len(data)


def run_server() -> bool:
    """Serve an editor over standard input and output until it ends the session. Return False if the editor left without a
    shutdown request. Raises OSError if messages could not be written."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")  # to standard error
    output = _MessageOutput(os.dup(1))
    with os.fdopen(os.dup(0), "rb") as reader:
        os.dup2(2, 1)  # output of libraries must not get between the messages
        language_server.start_io(reader, output)  # type: ignore[arg-type]
    if output.problem is not None:
        raise output.problem
    return not language_server.exited_without_shutdown
