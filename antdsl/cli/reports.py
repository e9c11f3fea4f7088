"""Prints what the stages had to say, in the format asked for."""

from __future__ import annotations

import sys

from antdsl.cli.exits import Exit, Stop
from antdsl.diagnostics import Report


def show(report: Report, format: str = "full", *, to_stderr: bool = False) -> None:
    """Print the complaints; machine formats are printed even when there is none, so that a reader always gets its document."""
    from antdsl.diagnostics.render import render

    if not report.diagnostics and format in ("full", "concise", "github"):
        return
    text = render(report, format)
    if text:
        stream = sys.stderr if to_stderr else sys.stdout
        encoding = getattr(stream, "encoding", None) or "utf-8"
        print(text.rstrip("\n").encode(encoding, "replace").decode(encoding), file=stream)


def demand(report: Report) -> None:
    """Print warnings and errors to standard error; leave with exit code 1 when there is an error."""
    show(report, to_stderr=True)
    if not report.ok:
        raise Stop(Exit.FINDINGS)
