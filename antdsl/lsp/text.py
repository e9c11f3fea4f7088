"""The text of a document, with conversions between offsets and an editor's lines and columns, and between URIs and paths."""

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
    """An edit that replaces the text between the offsets `start` and `end`."""

    start: int
    end: int
    text: str


def normalise_line_ends(text: str) -> str:
    """Return a text with line ends normalised as by `syntax.read`. Lines and columns in an editor stay the same."""
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n") if "\r" in text or "\ufeff" in text[:1] else text


class DocumentText:
    """A text with LF line ends. `encoding`: the unit of the editor's columns: utf-16 (the protocol's default), utf-8 or
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
        """Return the text of a line without its line end. `number` counts from 0; beyond the last line, the result is ""."""
        if not 0 <= number < len(self.line_starts):
            return ""
        end = self.line_starts[number + 1] - 1 if number + 1 < len(self.line_starts) else len(self.text)
        return self.text[self.line_starts[number] : end]

    def find_offset(self, line: int, column: int) -> int:
        """Return the offset of a position. A column beyond the end of its line means the end of that line. A line beyond the
        last one means the end of the text."""
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
        """Return the line and column of an offset, both counted from 0. An offset outside the text is moved to its start or
        end."""
        offset = max(0, min(offset, len(self.text)))
        line = bisect_right(self.line_starts, offset) - 1
        prefix = self.text[self.line_starts[line] : offset]
        return line, len(prefix) if prefix.isascii() else self.count_columns(prefix)

    def find_range(self, start: int, end: int) -> TextRange:
        """Return the lines and columns of the text between two offsets."""
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
        """Return a document with another text and the same encoding."""
        return DocumentText(normalise_line_ends(text), self.encoding)

    def replace_range(self, start: LineColumn, end: LineColumn, text: str) -> DocumentText:
        """Return a document in which `text` replaces a range."""
        first, last = self.find_offset(*start), self.find_offset(*end)
        return DocumentText(self.text[:first] + normalise_line_ends(text) + self.text[max(first, last) :], self.encoding)


def uri_to_path(uri: str) -> Path | None:
    """Return the path of the file that a URI names, with links resolved. Return None if the URI does not name a file, such as
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
