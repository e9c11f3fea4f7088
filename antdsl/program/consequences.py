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
# Complaints that something is left out: dropped where a slip of the pen is told for which that very word is meant.
_LEFT_OUT = frozenset(("missing-setting", "missing-start", "state-not-in-layers"))
_FIRST_WORD = re.compile("`([a-z_]+)[^`]*`")
# A line that has come no further than the word that declares something.
_NAMELESS = re.compile(r"\s*(state|field|species|param|let|latch|fuzzy|surface|obstacle|solid|items|curve|flow|map)\s*")
_HEAD = 3  # words of a line among which the name that it declares stands


@dataclass(slots=True)
class _Doubt:
    """Lines of one source that were not understood as they stand: their numbers, and the words in them."""

    lines: set[int] = field(default_factory=set)
    words: set[str] = field(default_factory=set)
    heads: set[str] = field(default_factory=set)
    missing: set[str] = field(default_factory=set)  # codes of what follows where a line declares something without its name
    beside_missing: dict[str, set[int]] = field(default_factory=dict)  # words beside a missing name, and their lines

    def beside(self, found: Diagnostic) -> None:
        """A complaint about a missing name: the words beside it are used, and a missing state may be any other,
        unless one was meant: then the checks have gone on with that one."""
        assert found.span is not None
        line = found.span.source.line_column(found.span.start)[0]
        for word in _WORDS.findall(found.span.source.line_text(line).partition("#")[0]):
            self.beside_missing.setdefault(word, set()).add(line)
        if found.code == "unknown-state" and not (found.help or "").startswith("did you mean"):
            self.missing.add("unreachable-state")


def without_consequences(report: Report, doubtful: Iterable[Span]) -> Report:
    """The same report less what follows from `doubtful` places, of which parsing has told, and from names that are misspelt."""
    doubts: dict[Source, _Doubt] = {}
    for span in doubtful:
        _doubt(doubts.setdefault(span.source, _Doubt()), span)
    meant = {(d.span.source, d.help) for d in report.diagnostics if d.severity == "error" and d.span is not None}
    twice = {(d.span.source, d.message.split(" `")[0]) for d in report.diagnostics if d.code == "duplicate-name" and d.span}
    for found in report.diagnostics:  # what a name that is missing was to be used with is perhaps not idle
        if found.code in _MISSING and found.severity == "error" and found.span is not None:
            doubts.setdefault(found.span.source, _Doubt()).beside(found)
    return Report([d for d in report.diagnostics if not _follows(d, doubts, meant) and not _renamed(d, twice)])


def _renamed(found: Diagnostic, twice: set[tuple[Source, str]]) -> bool:
    """Whether a name is missing, and two others of its kind are alike: one of them was to have it."""
    if found.span is None or found.code not in _MISSING | _IDLE:
        return False
    return any(
        source is found.span.source
        and (found.code in (f"unknown-{kind}", f"unreachable-{kind}") or found.message.startswith(f"no {kind} "))
        for source, kind in twice
    )


def _doubt(doubt: _Doubt, span: Span) -> None:
    first = span.source.line_column(span.start)[0]
    last = span.source.line_column(max(span.start, span.end - 1))[0]
    begun = _NAMELESS.fullmatch(span.source.line_text(first)[: span.source.line_column(span.start)[1] - 1])
    if begun and not span.text[:1].isidentifier():
        doubt.missing.add(f"unknown-{begun[1]}" if begun[1] in ("state", "field", "species") else "unknown-name")
    if _WORDS.findall(span.source.line_text(first))[:1] == ["use"]:
        doubt.missing |= {"unknown-behaviour", "unknown-module"}
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
    if found.code in _LEFT_OUT and (word := _FIRST_WORD.search(found.help or "")):
        return (found.span.source, f"did you mean `{word[1]}`?") in meant
    doubt = doubts.get(found.span.source)
    if doubt is None:
        return False
    line = found.span.source.line_column(found.span.start)[0]
    if line in doubt.lines:
        return True
    if idle and doubt.beside_missing.get(name, set()) - {line}:
        return True
    if found.code in doubt.missing:
        return True
    return (idle and name in doubt.words) or (found.code in _MISSING and name in doubt.heads)
