"""Functions that all output formats use: texts without control characters, and the lines and columns of a span."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from antdsl.source import Span

# Characters that could move a cursor, change a colour, end a line or change the direction of writing.
_UNSAFE_CHARACTERS = re.compile(
    "[\x00-\x1f\x7f-\x9f\u200b-\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff\ufffe\uffff\ud800-\udfff]"
)


def escape_text(text: str) -> str:
    """Return the text with every control character escaped, such as `\\x1b`."""
    return _UNSAFE_CHARACTERS.sub(lambda match: _escape_character(match.group()), text)


def escape_line(text: str) -> str:
    """Return a source line with control characters escaped. A tab becomes one space, so that columns stay correct."""
    return escape_text(text.replace("\t", " "))


def _escape_character(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"


def count_columns(text: str) -> int:
    """Return the width of a text in terminal columns. A wide character counts as two."""
    return sum(2 if unicodedata.east_asian_width(c) in "WF" else 0 if unicodedata.combining(c) else 1 for c in text)


@dataclass(frozen=True, slots=True)
class LineRange:
    """The lines and columns of a span, counted from 1. The end column is the one after the last character."""

    path: str
    line: int
    column: int
    end_line: int
    end_column: int


def find_line_range(span: Span) -> LineRange:
    """Return the lines and columns of a span."""
    line, column = span.source.find_line_column(span.start)
    end_line, end_column = span.source.find_line_column(max(span.start, span.end))
    return LineRange(span.source.path, line, column, end_line, end_column)


def rank_severity(severity: str) -> int:
    """Return a sort key that puts errors before warnings."""
    return 0 if severity == "error" else 1
