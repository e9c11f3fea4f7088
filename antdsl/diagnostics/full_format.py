"""The format of findings for people: the message, the source line with its location marked, and the text to write instead."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.diagnostics.model import Diagnostic
from antdsl.diagnostics.text_positions import count_columns, escape_line, escape_text, find_line_range
from antdsl.source import Span

_MAX_LINE_WIDTH = 120  # characters of a source line; a longer one is shortened around the location


def format_full(diagnostics: Sequence[Diagnostic], omitted_count: int) -> str:
    """Return findings as text for people, each with its source line."""
    blocks = [_format_diagnostic(diagnostic) for diagnostic in diagnostics]
    if omitted_count:
        blocks.append(f"… and {omitted_count:,} more\n")
    return "\n".join(blocks)


def _format_diagnostic(diagnostic: Diagnostic) -> str:
    """Return one finding as text, with its source lines and its help."""
    lines = [f"{diagnostic.severity}[{diagnostic.code}]: {escape_text(diagnostic.message)}"]
    spans = [span for span in (diagnostic.span, *(label.span for label in diagnostic.labels)) if span is not None]
    margin = max((len(str(find_line_range(span).line)) for span in spans), default=1)
    if diagnostic.span is not None:
        lines += _format_snippet(diagnostic.span, margin, "-->", "^", "")
    for label in diagnostic.labels:
        lines += _format_snippet(label.span, margin, ":::", "-", label.text)
    if diagnostic.help:
        lines.append(f"{' ' * margin} = help: {escape_text(diagnostic.help)}")
    return "\n".join(lines) + "\n"


def _format_snippet(span: Span, margin: int, arrow: str, mark: str, text: str) -> list[str]:
    """Return lines of text that show the location of a span: the file and position, then its first line with the span
    underlined. `margin`: the width of line numbers. `arrow`: the characters before the file name. `mark`: the underlining
    character. `text`: the text after the underline."""
    place = find_line_range(span)
    bar = f"{' ' * margin} |"
    head = f"{' ' * margin}{arrow} {escape_text(place.path)}:{place.line}:{place.column}"
    line = span.source.line_text(place.line)
    if not line and not span.text:
        return [head]
    start = place.column - 1
    end = min(len(line), start + max(1, span.end - span.start))
    left_text, marked, right_text = _cut_line(line, start, end)
    marks = mark * max(1, count_columns(marked))
    mark_line = f"{bar} {' ' * count_columns(left_text)}{marks} {escape_text(text)}".rstrip()
    return [head, bar, f"{place.line:>{margin}} | {left_text}{marked}{right_text}".rstrip(), mark_line]


def _cut_line(line: str, start: int, end: int) -> tuple[str, str, str]:
    """Return the part of a line around a range of characters, as three texts: before, in and after the range."""
    if len(line) <= _MAX_LINE_WIDTH:
        return escape_line(line[:start]), escape_line(line[start:end]), escape_line(line[end:])
    low = max(0, start - _MAX_LINE_WIDTH // 3)
    high = min(len(line), low + _MAX_LINE_WIDTH)
    end = min(end, high)
    left_text = ("…" if low else "") + escape_line(line[low:start])
    return left_text, escape_line(line[start:end]), escape_line(line[end:high]) + ("…" if high < len(line) else "")
