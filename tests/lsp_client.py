"""An editor for the tests: starts `antdsl lsp`, opens texts, types, and asks about the place of a `|`."""

from __future__ import annotations

import asyncio
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("pygls", reason="the language server needs the extra [lsp]")
pytest_lsp = pytest.importorskip("pytest_lsp", reason="the tests of the language server need pytest-lsp, of the extra [test]")

from lsprotocol import types as lsp  # noqa: E402

ROOT = Path(__file__).resolve().parent.parent
COMMAND = [sys.executable, "-m", "antdsl", "lsp"]


def initialize_params(root: Path, snippets: bool = True) -> lsp.InitializeParams:
    item = lsp.ClientCompletionItemOptions(snippet_support=snippets)
    capabilities = lsp.TextDocumentClientCapabilities(completion=lsp.CompletionClientCapabilities(completion_item=item))
    folder = lsp.WorkspaceFolder(root.as_uri(), root.name)
    return lsp.InitializeParams(
        lsp.ClientCapabilities(text_document=capabilities), root_uri=root.as_uri(), workspace_folders=[folder]
    )


@dataclass
class Editor:
    """`|` in a text stands for the cursor and is taken out."""

    client: Any
    version: int = 0

    async def open(self, path: Path | str, text: str) -> list[lsp.Diagnostic]:
        """Open a document; gives what the server has to say about it."""
        uri = path.as_uri() if isinstance(path, Path) else path
        self.version += 1
        document = lsp.TextDocumentItem(uri, "yaml" if uri.endswith(".yaml") else "antdsl", self.version, text)
        self.client.text_document_did_open(lsp.DidOpenTextDocumentParams(document))
        return await self.wait_for_diagnostics(uri)

    async def change(self, uri: str, changes: list[Any]) -> list[lsp.Diagnostic]:
        self.version += 1
        identifier = lsp.VersionedTextDocumentIdentifier(self.version, uri)
        self.client.text_document_did_change(lsp.DidChangeTextDocumentParams(identifier, changes))
        return await self.wait_for_diagnostics(uri)

    async def rewrite(self, uri: str, text: str) -> list[lsp.Diagnostic]:
        return await self.change(uri, [lsp.TextDocumentContentChangeWholeDocument(text)])

    async def wait_for_diagnostics(self, uri: str, seconds: float = 20) -> list[lsp.Diagnostic]:
        """The complaints about the version that was sent last."""
        async with asyncio.timeout(seconds):
            while self.known.get(uri, (0, []))[0] != self.version:
                await self.client.wait_for_notification(lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)
        return self.known[uri][1]

    @property
    def known(self) -> dict[str, tuple[int, list[lsp.Diagnostic]]]:
        if not hasattr(self.client, "antdsl_known"):
            self.client.antdsl_known = {}
            handler = self.client.protocol.fm.features[lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS]

            def keep(params: lsp.PublishDiagnosticsParams) -> Any:
                self.client.antdsl_known[params.uri] = (params.version, list(params.diagnostics))
                return handler(params)

            self.client.protocol.fm.features[lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS] = keep
        return self.client.antdsl_known

    def close(self, uri: str) -> None:
        self.client.text_document_did_close(lsp.DidCloseTextDocumentParams(lsp.TextDocumentIdentifier(uri)))


def cursor(text: str) -> tuple[str, lsp.Position]:
    """A text without its `|`, and the position of that; columns in UTF-16."""
    prefix, mark, suffix = text.partition("|")
    assert mark, "no `|` in the text"
    line = prefix.count("\n")
    column = len(prefix.rpartition("\n")[2].encode("utf-16-le")) // 2
    return prefix + suffix, lsp.Position(line, column)


def place_of(text: str, word: str, nth: int = 0, inside: int = 1) -> lsp.Position:
    """A place inside the nth occurrence of a word."""
    offset = -1
    for _ in range(nth + 1):
        offset = text.index(word, offset + 1)
    return cursor(text[: offset + inside] + "|")[1]


def ask(uri: str, position: lsp.Position) -> dict[str, Any]:
    return {"text_document": lsp.TextDocumentIdentifier(uri), "position": position}


def cut_out(text: str, where: lsp.Range) -> str:
    """The text of a range, columns in UTF-16."""
    lines = text.split("\n")

    def offset(place: lsp.Position) -> int:
        line = lines[place.line].encode("utf-16-le")
        return sum(len(each) + 1 for each in lines[: place.line]) + len(line[: place.character * 2].decode("utf-16-le"))

    return text[offset(where.start) : offset(where.end)]


def applied(text: str, edits: list[lsp.TextEdit]) -> str:
    """A text after edits that do not overlap."""
    for edit in sorted(edits, key=lambda e: (e.range.start.line, e.range.start.character), reverse=True):
        start = cursor_offset(text, edit.range.start)
        text = text[:start] + edit.new_text + text[cursor_offset(text, edit.range.end) :]
    return text


def cursor_offset(text: str, place: lsp.Position) -> int:
    lines = text.split("\n")
    if place.line >= len(lines):
        return len(text)
    line = lines[place.line].encode("utf-16-le")[: place.character * 2].decode("utf-16-le")
    return sum(len(each) + 1 for each in lines[: place.line]) + len(line)
