"""The text of a document. Converts between offsets and an editor's lines and columns, and between URIs and paths."""

from __future__ import annotations

import os
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import unquote, urlsplit

LineColumn = tuple[int, int]  # line and column, both from 0; the column in units of the editor's encoding
TextRange = tuple[LineColumn, LineColumn]


@dataclass(frozen=True, slots=True)
class TextEdit:
    """An edit that replaces the characters from `start` to `end` by a text."""

    start: int
    end: int
    text: str


def normalise_line_ends(text: str) -> str:
    """Normalise line ends as `syntax.read` does. An editor's lines and columns are the same in both."""
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n") if "\r" in text or "\ufeff" in text[:1] else text


class DocumentText:
    """A text with LF line ends. `encoding`: the unit of the editor's columns, which is utf-16 (the protocol's default), utf-8 or
    utf-32."""

    __slots__ = ("encoding", "line_starts", "text")

    def __init__(self, text: str, encoding: str = "utf-16") -> None:
        self.text = text
        self.encoding = encoding
        starts = [0]
        position = text.find("\n")
        while position >= 0:
            starts.append(position + 1)
            position = text.find("\n", position + 1)
        self.line_starts = starts

    def get_line(self, number: int) -> str:
        """Return a line by its number, counted from 0, without its end; empty beyond the last line."""
        if not 0 <= number < len(self.line_starts):
            return ""
        end = self.line_starts[number + 1] - 1 if number + 1 < len(self.line_starts) else len(self.text)
        return self.text[self.line_starts[number] : end]

    def find_offset(self, line: int, column: int) -> int:
        """Return the offset of a position. A column beyond the end of its line means the end of the line. A line beyond the last
        line means the end of the text."""
        if line >= len(self.line_starts):
            return len(self.text)
        text, start = self.get_line(line), self.line_starts[line]
        if text.isascii() or self.encoding == "utf-32":
            return start + min(max(column, 0), len(text))
        columns = 0
        for count, character in enumerate(text):
            if columns >= column:
                return start + count
            columns += self._count_character_columns(character)
        return start + len(text)

    def find_line_column(self, offset: int) -> LineColumn:
        """Return line and column of an offset, both counted from 0. Offsets outside the text are clamped."""
        offset = max(0, min(offset, len(self.text)))
        line = bisect_right(self.line_starts, offset) - 1
        prefix = self.text[self.line_starts[line] : offset]
        return line, len(prefix) if prefix.isascii() else self.count_columns(prefix)

    def find_range(self, start: int, end: int) -> TextRange:
        """Return the lines and columns from one offset to another."""
        return self.find_line_column(start), self.find_line_column(max(start, end))

    def count_columns(self, text: str) -> int:
        """Return how many columns a text occupies in the editor."""
        return len(text) if text.isascii() else sum(map(self._count_character_columns, text))

    def _count_character_columns(self, character: str) -> int:
        """Return how many columns a character occupies in the editor."""
        if self.encoding == "utf-8":
            return len(character.encode("utf-8", "surrogatepass"))
        return 2 if self.encoding == "utf-16" and character > "\uffff" else 1

    def with_text(self, text: str) -> DocumentText:
        """Return another text with the same encoding."""
        return DocumentText(normalise_line_ends(text), self.encoding)

    def replace_range(self, start: LineColumn, end: LineColumn, text: str) -> DocumentText:
        """Return the text with a range replaced."""
        first, last = self.find_offset(*start), self.find_offset(*end)
        return DocumentText(self.text[:first] + normalise_line_ends(text) + self.text[max(first, last) :], self.encoding)


def uri_to_path(uri: str) -> Path | None:
    """Return the path of the file that a URI names, with links resolved. Return None if it is not a file, such as
    `untitled:Untitled-1`."""
    parts = urlsplit(uri)
    if parts.scheme != "file":
        return None
    name = unquote(parts.path)
    if os.name == "nt" and name[:1] == "/" and name[2:3] == ":":
        name = name[1:]
    if parts.netloc and os.name == "nt":
        name = f"//{parts.netloc}{name}"
    return None if "\0" in name else Path(os.path.realpath(name))


def path_to_uri(path: Path) -> str:
    """Return the URI of a file."""
    return path.as_uri()
