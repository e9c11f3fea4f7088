"""The session of an editor: its documents, and the findings that are published to it."""

from __future__ import annotations

import logging
from pathlib import Path

from lsprotocol import types as lsp
from pygls.lsp.server import LanguageServer

from antdsl import __version__
from antdsl.lsp import protocol
from antdsl.lsp.features import navigation
from antdsl.lsp.text import path_to_uri, uri_to_path
from antdsl.lsp.workspace import OpenDocument, Workspace

_log = logging.getLogger(__name__)


class AntLanguageServer(LanguageServer):
    """The pygls server, with the documents of the session. `uris`: the URI of each open document exactly as the editor sent it,
    because editors expect the same URI in answers."""

    def __init__(self) -> None:
        super().__init__("antdsl", __version__)
        self.files = Workspace()
        self.uris: dict[Path, str] = {}
        self.exited_without_shutdown = False  # whether the editor exited without a shutdown request
        self.is_shutdown_requested = False
        self.pending_paths: set[Path] = set()  # documents with findings to report when no other message waits

    def find_path(self, uri: str) -> Path:
        """Return the path of the file that a URI names. A document that was never saved gets a path in the current folder."""
        file_path = uri_to_path(uri)
        if file_path is None:
            name = "".join(c if c.isalnum() or c in "._-" else "_" for c in uri)
            file_path = Path.cwd() / (name if name.endswith((".ant", ".yaml", ".yml")) else f"{name}.ant")
        return file_path

    def find_document(self, uri: str) -> OpenDocument | None:
        """Return the document behind a URI; None if it cannot be read."""
        return self.files.find_document(self.find_path(uri))

    def make_location(self, target: navigation.NameLocation) -> lsp.Location:
        """Return a location in the form that the protocol requires."""
        return lsp.Location(self.find_uri(target.document.path), protocol.to_lsp_range(target.range))

    def find_uri(self, path: Path) -> str:
        """Return the URI of a file. For an open file, this is the URI that the editor sent."""
        return self.uris.get(path, path_to_uri(path))

    def has_snippet_support(self) -> bool:
        """Return whether the editor accepts snippets in completions."""
        capabilities = self.client_capabilities.text_document
        completion = capabilities.completion if capabilities is not None else None
        item = completion.completion_item if completion is not None else None
        return bool(item is not None and item.snippet_support)

    # --- findings ---

    def schedule_check(self, path: Path) -> None:
        """Schedule a check of a file for when no messages are waiting, so that several quick key presses cause only one check."""
        import asyncio

        self.pending_paths.add(path)
        asyncio.get_running_loop().call_soon(self._check_pending)

    def _check_pending(self) -> None:
        """Check all files with a scheduled check, then the scenes that use them."""
        waiting, self.pending_paths = self.pending_paths, set()
        for path in sorted(waiting):
            self.publish_findings(path)
        for path in sorted({scene for each in waiting for scene in self.files.find_scenes_using(each)} - waiting):
            self.publish_findings(path)

    def publish_findings(self, path: Path) -> None:
        """Send the findings in an open document to the editor."""
        document = self.files.open_documents.get(path)
        if document is None or path not in self.uris:
            return
        try:
            diagnostics = [protocol.to_lsp_diagnostic(self.files, document, each) for each in self.files.find_diagnostics(path)]
        except Exception:  # an internal error must not end an editor's session
            _log.exception("cannot check %s", path)
            return
        self.text_document_publish_diagnostics(lsp.PublishDiagnosticsParams(self.uris[path], diagnostics, document.version))
