"""Serves the page of a preview and its socket over HTTP: access control, input limits, and queues for slow clients.

`server` needs websockets, the extra `[preview]`; the other files of this package work without it."""

from __future__ import annotations

from importlib.util import find_spec

from antdsl.diagnostics import Report


def check_preview_support() -> Report:
    """Return an empty report if a preview can be served, else one error that names the missing extra."""
    report = Report()
    if find_spec("websockets") is None:
        message = "the preview needs the extra `[preview]`, which is not installed"
        report.error("missing-extra", message, None, 'run `pip install "antdsl[preview]"`')
    return report
