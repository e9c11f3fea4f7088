"""Source texts and locations in them. `Source` is the text of one file, and `Span` is a range of this text."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """The text of one file, with its display name.

    `part_number`: the number of a part of a file; 0 for a complete file. Each part is a separate source, so that it does not
    change when it moves within the file."""

    path: str
    text: str
    part_number: int = 0
    _line_starts: tuple[int, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        starts = [0]
        position = self.text.find("\n")
        while position >= 0:
            starts.append(position + 1)
            position = self.text.find("\n", position + 1)
        object.__setattr__(self, "_line_starts", tuple(starts))

    def find_line_column(self, offset: int) -> tuple[int, int]:
        """Return the line and column of a character offset, both counted from 1."""
        offset = max(0, min(offset, len(self.text)))
        line = bisect_right(self._line_starts, offset)
        return line, offset - self._line_starts[line - 1] + 1

    def line_text(self, line: int) -> str:
        """Return the text of a line without its line end. `line`: the number of the line, counted from 1."""
        if not 1 <= line <= len(self._line_starts):
            return ""
        start = self._line_starts[line - 1]
        end = self._line_starts[line] if line < len(self._line_starts) else len(self.text)
        return self.text[start:end].rstrip("\r\n")


@dataclass(frozen=True, slots=True)
class Span:
    """A range of characters in a source, from `start` to `end`. The character at `end` is not included."""

    source: Source
    start: int
    end: int

    @property
    def text(self) -> str:
        """Return the text of the span."""
        return self.source.text[self.start : self.end]

    def to(self, other: Span) -> Span:
        """Return the smallest span that contains this one and `other`."""
        return Span(self.source, min(self.start, other.start), max(self.end, other.end))

    def __str__(self) -> str:
        line, column = self.source.find_line_column(self.start)
        part = f"#{self.source.part_number}" if self.source.part_number else ""
        return f"{self.source.path}{part}:{line}:{column}"
