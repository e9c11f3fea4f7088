"""The page of a preview and its socket, over HTTP: who is let in, what is read, how much of it, and what waits for a slow client.

`server` needs websockets, the extra `[preview]`; the other files of this room work without it."""

from __future__ import annotations

from importlib.util import find_spec

from antdsl.diagnostics import Report


def ready() -> Report:
    """Empty where a preview can be served; else one error that names the extra."""
    report = Report()
    if find_spec("websockets") is None:
        report.error(
            "missing-extra",
            "the preview needs the extra `[preview]`, which is not installed",
            None,
            'run `pip install "antdsl[preview]"`',
        )
    return report
