"""One cause, one complaint: drops what the checks say only because of something that was complained about already."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

from antdsl.diagnostics import Diagnostic, Report
from antdsl.source import Source, Span

_WORDS = re.compile(r"[a-z_][a-z_0-9]*")
# Complaints about a name that is missing: dropped where a line that was not understood could be its declaration.
_MISSING = frozenset(("unknown-name", "unknown-state", "unknown-field", "unknown-species", "unknown-behaviour", "unknown-module"))
# Complaints about a name that is not used: dropped where such a line, or a slip of the pen, could be the use.
_IDLE = frozenset(("unreachable-state", "unheard-event", "silent-event", "trap"))
_HEAD = 3  # words of a line among which the name that it declares stands


@dataclass(slots=True)
class _Doubt:
    """Lines of one source that were not understood as they stand: their numbers, and the words in them."""

    lines: set[int] = field(default_factory=set)
    words: set[str] = field(default_factory=set)
    heads: set[str] = field(default_factory=set)


def without_consequences(report: Report, doubtful: Iterable[Span]) -> Report:
    """The same report less what follows from `doubtful` places, of which parsing has told, and from names that are misspelt."""
    doubts: dict[Source, _Doubt] = {}
    for span in doubtful:
        _doubt(doubts.setdefault(span.source, _Doubt()), span)
    meant = {(d.span.source, d.help) for d in report.diagnostics if d.severity == "error" and d.span is not None}
    return Report([d for d in report.diagnostics if not _follows(d, doubts, meant)])


def _doubt(doubt: _Doubt, span: Span) -> None:
    first = span.source.line_column(span.start)[0]
    last = span.source.line_column(max(span.start, span.end - 1))[0]
    for line in range(first, last + 1):
        if line not in doubt.lines:
            words = _WORDS.findall(span.source.line_text(line).partition("#")[0])
            doubt.lines.add(line)
            doubt.words.update(words)
            doubt.heads.update(words[:_HEAD])


def _follows(found: Diagnostic, doubts: dict[Source, _Doubt], meant: set[tuple[Source, str | None]]) -> bool:
    if found.span is None:
        return False
    name = found.span.text
    idle = found.code in _IDLE or found.code.startswith("unused-")
    if idle and (found.span.source, f"did you mean `{name}`?") in meant:
        return True
    doubt = doubts.get(found.span.source)
    if doubt is None:
        return False
    if found.span.source.line_column(found.span.start)[0] in doubt.lines:
        return True
    return (idle and name in doubt.words) or (found.code in _MISSING and name in doubt.heads)
