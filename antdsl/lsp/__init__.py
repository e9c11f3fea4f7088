"""The language server: answers an editor's requests about `.ant` files and scenes, with the checks that `antdsl check` runs.

`server.start` runs it; it needs pygls, the extra `[lsp]`. All other files of this package work without it."""

from __future__ import annotations

from importlib.util import find_spec

from antdsl.diagnostics import Report


def check_server_available() -> Report:
    """Return an empty report if the server can start. Otherwise return one error that names the missing extra."""
    report = Report()
    if find_spec("pygls") is None:
        message = "the language server needs the extra `[lsp]`, which is not installed"
        report.error("missing-extra", message, None, 'run `pip install "antdsl[lsp]"`')
    return report
