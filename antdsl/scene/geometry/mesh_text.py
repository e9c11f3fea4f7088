"""Splits text meshes (.obj, .ply and .stl files) into blocks of words with their line numbers.

Only this module handles line ends, byte order marks, indentation, comments and continued lines. NumPy finds the words of a
block, so a reader gets the columns of numbers of thousands of lines at once."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics.model import replace_unprintable

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

MAX_LINE_BYTES = limits.MIB
MAX_VERTICES = 3 * limits.MAX_MESH_FACES
_READ_BLOCK_BYTES = 64 * limits.KIB
_MAX_NUMBER_BYTES = 40  # of a number
_MAX_INTEGER_DIGITS = 10  # the pattern of an integer
_EXPORT_AGAIN_HELP = "export it again, as triangles or polygons in a .ply, .obj or .stl file"
_UTF16_BYTE_ORDER_MARKS = (b"\xff\xfe", b"\xfe\xff", b"\x00\x00\xfe\xff")
_IS_BLANK_BYTE = np.zeros(256, np.bool_)
_IS_BLANK_BYTE[[9, 10, 11, 12, 13, 32]] = True
_CONTINUATION_BYTE = b"\x0b"  # replaces the line end of a continued line
_COMMENT_REGEX = rb"(?:(?<=[\t\n\x0b\x0c ])|\A)#[^\n]*"
_COMMENT_PATTERN = re.compile(_COMMENT_REGEX)
_COMMENT_OR_NAME_PATTERN = re.compile(
    rb"(^[\t\x0c ]*[go][\t\x0c ]+#[^\n\t\x0c ]+)|" + _COMMENT_REGEX, re.MULTILINE | re.IGNORECASE
)
_ADJACENT_COMMENT_PATTERN = re.compile(rb"^([\t\x0c ]*[vflpVFLP][nNtT]?[\t\x0c ][^\n#]*)#[^\n]*", re.MULTILINE)
_CONTINUATION_PATTERN = re.compile(rb"\\[\t\x0c ]*(?:\n|\Z)")
# after these words, `\` at the end is part of a name
_NAME_KEYWORDS = [[word] for word in b"mtllib usemtl o g maplib usemap".split()]


class MeshError(Exception):
    """Error for a file that is not a usable mesh. The message is a reason that fits after the file's name. `help`: what to do."""

    def __init__(self, message: str, help: str | None = _EXPORT_AGAIN_HELP) -> None:
        super().__init__(message)
        self.help = help


def format_word(word: bytes, max_characters: int = 20) -> str:
    """Return a word of an untrusted file in a form that is safe in a message, with at most `max_characters` characters."""
    text = word[:max_characters].decode("ascii", "replace")
    return replace_unprintable(text)


def check_count(count: int, max_count: int, plural: str) -> None:
    """Raise MeshError if `count` is larger than `max_count`. `plural`: what is counted, in the plural."""
    if count > max_count:
        raise MeshError(f"has more than {max_count:,} {plural}", "use a lighter mesh")


def check_text(data: bytes) -> None:
    """Raise MeshError if a file is text in UTF-16 or UTF-32, or is not text."""
    if data.startswith(_UTF16_BYTE_ORDER_MARKS) or (data[1:2] == b"\0" and data[:4096].count(0) > len(data[:4096]) // 4):
        raise MeshError("is text in UTF-16 or UTF-32", "save it as UTF-8 or plain ASCII text")
    if b"\0" in data[:4096]:
        raise MeshError("is not a text file")


def normalise_text(data: bytes, wavefront: bool = False) -> bytes:
    """Return text with line feeds as line ends, without byte order mark and comments.

    A comment starts with `#` at the beginning of a word. After the numbers of a vertex or face, it may also start within a word.
    If `wavefront` is true, continued lines are joined, and the first word of a name may begin with `#`."""
    data = data.removeprefix(b"\xef\xbb\xbf").removesuffix(b"\x1a")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\xa0" in data:
        data = data.replace(b"\xc2\xa0", b"  ")
    if _CONTINUATION_BYTE in data:
        data = data.replace(_CONTINUATION_BYTE, b" ")
    if b"#" in data:
        data = _COMMENT_OR_NAME_PATTERN.sub(rb"\1", data) if wavefront else _COMMENT_PATTERN.sub(b"", data)
        data = _ADJACENT_COMMENT_PATTERN.sub(rb"\1", data) if b"#" in data else data
    if wavefront and b"\\" in data:
        data = _CONTINUATION_PATTERN.sub(_replace_continuation, data)
    return data


def _replace_continuation(end: re.Match[bytes]) -> bytes:
    """Return the replacement for a backslash at the end of a line. Such a backslash continues the line, except in lines with a
    name, where it is part of the name and remains."""
    line = end.string[end.string.rfind(b"\n", 0, end.start()) + 1 : end.start()]
    return end[0] if line.lstrip()[:8].lower().split(None, 1)[:1] in _NAME_KEYWORDS else _CONTINUATION_BYTE


@dataclass(frozen=True, slots=True, eq=False)
class TextBlock:
    """The lines of a text that contain words.

    `line_numbers` int64[L]: the number of each line in the file, from 1.
    `first_words`, `word_counts` int64[L]: for each line, the index of its first word, and how many words it has.
    `word_starts`, `word_ends` int64[W]: the start and end offsets of each word in the bytes `data`."""

    line_numbers: Integers
    first_words: Integers
    word_counts: Integers
    word_starts: Integers
    word_ends: Integers
    data: NDArray[np.uint8]
    _words: list[list[bytes]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.line_numbers)

    @property
    def words(self) -> list[bytes]:
        """Return all words of the block, by line."""
        if not self._words:
            self._words.append(self.data.tobytes().split())
        return self._words[0]

    def select_lines(self, begin: int, stop: int) -> TextBlock:
        """Return a block with the lines from `begin` up to, but not including, `stop`."""
        part = slice(begin, stop)
        return TextBlock(
            self.line_numbers[part],
            self.first_words[part],
            self.word_counts[part],
            self.word_starts,
            self.word_ends,
            self.data,
            self._words,
        )

    def get_line_words(self, k: int) -> list[bytes]:
        """Return the words of line `k` of the block."""
        return self.words[self.first_words[k] : self.first_words[k] + self.word_counts[k]]

    def find_line_keywords(self) -> NDArray[np.bytes_]:
        """Return the first word of each line in lower case, cut to 8 letters."""
        start, stop = self.word_starts[self.first_words], self.word_ends[self.first_words]
        found = np.zeros((len(self), 8), np.uint8)
        for k in range(min(8, int((stop - start).max(initial=0)))):
            char = self.data[np.minimum(start + k, len(self.data) - 1)]
            found[:, k] = np.where(start + k < stop, char, 0)
        found[(found >= 65) & (found <= 90)] += 32
        return found.view("S8")[:, 0]

    def read_floats(self, word_indices: Integers, noun: str) -> Floats:
        """Return the words with the indices `word_indices` as numbers, in the same shape. Raises MeshError with the line of the
        first invalid number."""
        flat = word_indices.ravel()
        longest = int((self.word_ends[flat] - self.word_starts[flat]).max(initial=0))
        words = self.words
        if len(flat) and flat[-1] - flat[0] == len(flat) - 1 and (np.diff(flat) == 1).all():
            chosen = words[int(flat[0]) : int(flat[-1]) + 1]
        else:
            chosen = [words[k] for k in flat.tolist()]
        try:
            if longest > _MAX_NUMBER_BYTES or ((self.data == 95).any() and any(b"_" in word for word in chosen)):
                raise ValueError  # a number that only Python accepts
            numbers = np.fromiter(map(float, chosen), np.float64, len(chosen))
        except ValueError:
            numbers = np.array([self._read_number(word, int(k), noun) for word, k in zip(chosen, flat.tolist(), strict=True)])
        return numbers.reshape(word_indices.shape)

    def _read_number(self, word: bytes, word_index: int, noun: str) -> float:
        try:
            if len(word) > _MAX_NUMBER_BYTES or b"_" in word:
                raise ValueError
            return float(word)
        except ValueError:
            decimal = re.fullmatch(rb"[+-]?[0-9]+,[0-9]+(?:[eE][+-]?[0-9]+)?", word)
            help = f"write decimal points, such as `{format_word(word.replace(b',', b'.'))}`" if decimal else _EXPORT_AGAIN_HELP
            words = f"has in line {self.find_line_number(word_index):,} `{format_word(word)}` for {noun}, which is not a number"
            raise MeshError(words, help) from None

    def find_line_number(self, word_index: int) -> int:
        """Return the line number of the word with the index `word_index`."""
        return int(self.line_numbers[np.searchsorted(self.first_words, word_index, side="right") - 1])

    def read_integers(self, word_indices: Integers, slash: bool = False) -> tuple[Integers, NDArray[np.bool_]]:
        """Return the words with the indices `word_indices` as integers, and for each word whether it is an integer.

        If `slash` is true, only the part before the first slash is read, as in `1/2/3`."""
        start, end = self.word_starts[word_indices], self.word_ends[word_indices]
        negative = self.data[start] == 45
        start = start + negative
        value = np.zeros(word_indices.shape, np.int64)
        running, length = start < end, np.zeros(word_indices.shape, np.int64)
        for k in range(_MAX_INTEGER_DIGITS + 1):
            digit = self.data[np.minimum(start + k, len(self.data) - 1)].astype(np.int64) - 48
            running = running & (start + k < end) & (digit >= 0) & (digit <= 9)
            if not running.any():
                break
            value = np.where(running, value * 10 + digit, value)
            length += running
        stop = start + length
        is_integer = stop >= end
        if slash and (slashes := self.data == 47).any():
            slash_counts = np.concatenate(([0], np.cumsum(slashes)))
            is_integer |= slashes[np.minimum(stop, len(self.data) - 1)] & (
                slash_counts[end] - slash_counts[self.word_starts[word_indices]] <= 2
            )
        return np.where(negative, -value, value), (length > 0) & (length <= _MAX_INTEGER_DIGITS) & is_integer


def read_blocks(text: bytes, number: int = 1) -> Iterator[TextBlock]:
    """Yield blocks of lines of a text that `normalise_text` returned. Raises MeshError for a line that is too long.

    `number`: the line number of the first line in the file."""
    at = 0
    while at < len(text):
        stop = text.rfind(b"\n", at, at + _READ_BLOCK_BYTES) + 1
        if stop <= at:
            stop = text.find(b"\n", at) + 1 or len(text)
            if stop - at > MAX_LINE_BYTES + 1:
                raise MeshError(f"has a line {number:,} of more than {MAX_LINE_BYTES:,} bytes")
        data = np.frombuffer(text, np.uint8, stop - at, at)
        blank = _IS_BLANK_BYTE[data]
        start = np.flatnonzero(~blank & np.concatenate(([True], blank[:-1])))
        end = np.flatnonzero(~blank & np.concatenate((blank[1:], [True]))) + 1
        ends = np.flatnonzero(data == 10)
        line = np.searchsorted(ends, start)
        first = np.flatnonzero(np.concatenate(([True], line[1:] != line[:-1]))) if len(line) else np.empty(0, np.int64)
        breaks = np.flatnonzero(data == 11)
        numbers = number + line[first] + (np.searchsorted(breaks, start[first]) if len(breaks) else 0)
        yield TextBlock(numbers, first, np.diff(np.append(first, len(line))), start, end, data)
        number += len(ends) + len(breaks)
        at = stop
