"""The language server: what an editor asks about `.ant` files and scenes, answered by the chain that `antdsl check` runs.

`server.start` is its door; it needs pygls, the extra `[lsp]`. All other files of this room work without it."""

from __future__ import annotations

from importlib.util import find_spec

from antdsl.diagnostics import Report


def ready() -> Report:
    """Empty where the server can be started; else one error that names the extra."""
    report = Report()
    if find_spec("pygls") is None:
        report.error(
            "missing-extra",
            "the language server needs the extra `[lsp]`, which is not installed",
            None,
            'run `pip install "antdsl[lsp]"`',
        )
    return report
