"""Reduces a report to one finding per cause.

It drops findings that follow from an earlier error, and merges findings about one missing name. The checks in
`checks.ERROR_FREE_CHECKS` do not run for programs with errors, so their findings need no treatment here."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from antdsl.diagnostics import Diagnostic, Label, Report
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.source import Source, Span

_WORD_PATTERN = re.compile(r"[a-z_][a-z_0-9]*")
# Findings about missing names. They are dropped if an unparsed line could be the declaration.
_MISSING_NAME_CODES = frozenset(
    ("unknown-name", "unknown-state", "unknown-field", "unknown-species", "unknown-behaviour", "unknown-module")
)
# Findings about missing parts. They are dropped if a misspelling of the missing word is reported.
_MISSING_PART_CODES = frozenset(("missing-setting", "missing-start", "state-not-in-layers"))
_FIRST_WORD_PATTERN = re.compile("`([a-z_]+)[^`]*`")
# A line that ends after the word that begins a declaration.
_NAMELESS_DECLARATION_PATTERN = re.compile(rf"\s*(state|field|param|let|latch|fuzzy|{'|'.join(KIND_BY_WORD)})\s*")
_MAX_SEARCHED_WORDS = 3  # the declared name is among the first words of a line
_MAX_LISTED_LOCATIONS = 12  # locations listed in one finding


@dataclass(slots=True)
class _UnreadLines:
    """The lines of one source that could not be parsed. `lines`: their line numbers. `first_words`: their first words.

    `suppressed_codes`: the codes of findings that are dropped, because one of these lines probably declares the missing name."""

    lines: set[int] = field(default_factory=set)
    first_words: set[str] = field(default_factory=set)
    suppressed_codes: set[str] = field(default_factory=set)  # codes of findings that follow from a declaration without a name


def drop_cascading_errors(report: Report, skipped_spans: Iterable[Span]) -> Report:
    """Return the report without findings that are only consequences of unparsed text or misspelt names. `skipped_spans`: the
    spans that the parser skipped and reported."""
    doubts: dict[Source, _UnreadLines] = {}
    for span in skipped_spans:
        _add_unread_lines(doubts.setdefault(span.source, _UnreadLines()), span)
    meant = {(d.span.source, d.help) for d in report.diagnostics if d.severity == "error" and d.span is not None}
    twice = {(d.span.source, d.message.split(" `")[0]) for d in report.diagnostics if d.code == "duplicate-name" and d.span}
    return Report(
        [d for d in report.diagnostics if not _is_cascading_error(d, doubts, meant) and not _is_misspelt_declaration(d, twice)]
    )


def add_all_locations(report: Report, repeated_spans: Mapping[Span, Sequence[Span]]) -> Report:
    """Return the report with labels for all spans of each finding, not only for the first span. `repeated_spans`: all spans of a
    finding, by its first span."""
    return Report(
        [
            replace(d, labels=_make_labels_of_all_spans(d, repeated_spans)) if d.span in repeated_spans else d
            for d in report.diagnostics
        ]
    )


def merge_repeated_findings(report: Report) -> Report:
    """Return the report in which findings with the same message in the same file are merged into one, with labels for all
    locations."""
    groups: dict[tuple[str, str, str], list[Diagnostic]] = {}
    for each in report.diagnostics:
        groups.setdefault((each.code, each.message, each.span.source.path if each.span else ""), []).append(each)
    other_spans = [[each.span for each in others if each.span] for _, *others in groups.values()]
    firsts = [first for first, *_ in groups.values()]
    return Report(
        [
            replace(one, labels=(*one.labels, *_make_labels_of_repetitions(rest)))
            for one, rest in zip(firsts, other_spans, strict=True)
        ]
    )


def _make_labels_of_all_spans(diagnostic: Diagnostic, repeated_spans: Mapping[Span, Sequence[Span]]) -> tuple[Label, ...]:
    """Return the labels of a diagnostic. A finding about a missing name also gets a label for each repetition of the name."""
    spans = repeated_spans[diagnostic.span] if diagnostic.code in _MISSING_NAME_CODES and diagnostic.span else []
    others = [each for each in spans if each != diagnostic.span]
    return (*diagnostic.labels, *_make_labels_of_repetitions(others))


def _make_labels_of_repetitions(others: Sequence[Span]) -> list[Label]:
    """Return labels for the other spans of a finding. There are at most `_MAX_LISTED_LOCATIONS`. If there are more spans, the
    last label says how many are left."""
    left = len(others) - _MAX_LISTED_LOCATIONS
    labels = [Label(span, "and here") for span in others[:_MAX_LISTED_LOCATIONS]]
    if left > 0:
        labels[-1] = replace(labels[-1], text=f"and here, and at {left} more {'place' if left == 1 else 'places'}")
    return labels


def _is_misspelt_declaration(diagnostic: Diagnostic, duplicate_names: set[tuple[Source, str]]) -> bool:
    """Return whether a missing name is probably due to a duplicate declaration.

    If two declarations of one kind have the same name, one of them was probably meant to have the missing name."""
    if diagnostic.span is None or diagnostic.code not in _MISSING_NAME_CODES:
        return False
    return any(
        source is diagnostic.span.source
        and (diagnostic.code == f"unknown-{kind}" or diagnostic.message.startswith(f"no {kind} "))
        for source, kind in duplicate_names
    )


def _add_unread_lines(unread_lines: _UnreadLines, span: Span) -> None:
    """Add to `unread_lines` all lines of a span that the parser skipped."""
    first = span.source.find_line_column(span.start)[0]
    last = span.source.find_line_column(max(span.start, span.end - 1))[0]
    nameless_start = _NAMELESS_DECLARATION_PATTERN.fullmatch(
        span.source.line_text(first)[: span.source.find_line_column(span.start)[1] - 1]
    )
    if nameless_start and not span.text[:1].isidentifier():
        unread_lines.suppressed_codes.add(
            f"unknown-{nameless_start[1]}" if nameless_start[1] in ("state", "field", "species") else "unknown-name"
        )
    if _WORD_PATTERN.findall(span.source.line_text(first))[:1] == ["use"]:
        unread_lines.suppressed_codes |= {"unknown-behaviour", "unknown-module"}
    for line in range(first, last + 1):
        if line not in unread_lines.lines:
            unread_lines.lines.add(line)
            unread_lines.first_words.update(
                _WORD_PATTERN.findall(span.source.line_text(line).partition("#")[0])[:_MAX_SEARCHED_WORDS]
            )


def _is_cascading_error(
    diagnostic: Diagnostic, unread_by_source: dict[Source, _UnreadLines], suggestions: set[tuple[Source, str | None]]
) -> bool:
    """Return whether a finding is only a consequence of an unparsed line, or of a misspelling that is already reported."""
    if diagnostic.span is None:
        return False
    if diagnostic.code in _MISSING_PART_CODES and (word := _FIRST_WORD_PATTERN.search(diagnostic.help or "")):
        return (diagnostic.span.source, f"did you mean `{word[1]}`?") in suggestions
    doubt = unread_by_source.get(diagnostic.span.source)
    if doubt is None:
        return False
    if (
        diagnostic.span.source.find_line_column(diagnostic.span.start)[0] in doubt.lines
        or diagnostic.code in doubt.suppressed_codes
    ):
        return True
    return diagnostic.code in _MISSING_NAME_CODES and diagnostic.span.text in doubt.first_words
