"""Divides tokens with paired brackets into lines and, recursively, the content of braces into lines. Also makes the text of a
line for the parser."""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, field

from antdsl.diagnostics.model import Fix
from antdsl.source import Source, Span
from antdsl.syntax.brackets import get_token_text
from antdsl.syntax.scan import ScannedToken, TokenScan


@dataclass(slots=True)
class BraceGroup:
    """A pair of braces and the lines between them. `is_choice`: whether the braces follow the word `choose`."""

    opening: ScannedToken
    closing_brace: ScannedToken
    lines: list[SourceLine]
    is_choice: bool


@dataclass(slots=True)
class SourceLine:
    """One statement: its tokens, which include braces but not the content of braces, and its brace groups in text order."""

    tokens: list[ScannedToken] = field(default_factory=list)
    groups: list[BraceGroup] = field(default_factory=list)

    @property
    def start(self) -> int:
        return self.tokens[0].start

    @property
    def end(self) -> int:
        return self.tokens[-1].end


class MappedText:
    """The text of a line for the parser, and the mapping from positions in this text to offsets in the source."""

    def __init__(self, source: Source, parts: list[tuple[str, int, int]]) -> None:
        self.source = source
        self.parts = parts  # text, offset and length in the source
        self.text = "".join(part[0] for part in parts)
        self.part_starts: list[int] = []
        begin = 0
        for text, _, _ in parts:
            self.part_starts.append(begin)
            begin += len(text)

    def find_source_offset(self, position: int) -> int:
        """Return the source offset of a position in the text. The end of the text maps to the end of its last part."""
        part = max(0, bisect_right(self.part_starts, position) - 1)
        _, offset, length = self.parts[part]
        return offset + min(position - self.part_starts[part], length)

    def make_source_span(self, start: int, end: int) -> Span:
        """Return the source span of the text between the positions `start` and `end`."""
        first = self.find_source_offset(start)
        if end <= start:
            return Span(self.source, first, first)
        part = max(0, bisect_right(self.part_starts, end - 1) - 1)
        _, offset, length = self.parts[part]
        return Span(self.source, first, max(first, offset + min(end - self.part_starts[part], length)))

    def find_position(self, offset: int) -> int:
        """Return the first position in the text that maps to the source offset `offset` or a later one."""
        for (text, start, length), begin in zip(self.parts, self.part_starts, strict=True):
            if offset < start:
                return begin
            if offset < start + length:
                return min(begin + offset - start, begin + len(text))
        return len(self.text)

    def replace_range(self, start: int, end: int, text: str) -> MappedText:
        """Return a copy in which `text` replaces the part between the positions `start` and `end`."""
        span = self.make_source_span(start, end)
        previous_parts, next_parts = self._cut_pieces(0, start), self._cut_pieces(end, len(self.text))
        return MappedText(self.source, [*previous_parts, (text, span.start, span.end - span.start), *next_parts])

    def _cut_pieces(self, start: int, end: int) -> list[tuple[str, int, int]]:
        """Return the parts between two positions. Each part is its text, its source offset and its length in the source."""
        cut = []
        for (text, offset, length), begin in zip(self.parts, self.part_starts, strict=True):
            low, high = max(start, begin) - begin, min(end, begin + len(text)) - begin
            if low < high:
                cut.append((text[low:high], offset + min(low, length), max(0, min(high, length) - low)))
        return cut


def map_text(scan: TokenScan, line: SourceLine) -> MappedText:
    """Return the text of a line without the content of its braces, as the parser reads it."""
    opens = {group.opening.start for group in line.groups}
    parts: list[tuple[str, int, int]] = []
    begin: int | None = None
    end = 0
    for token in line.tokens:
        if token.inserted_text:
            if begin is not None:
                parts.append(("".join(scan.clean_characters[begin:end]), begin, end - begin))
            parts.append((token.inserted_text, token.start, 0))
            begin = None
            continue
        begin = token.start if begin is None else begin
        end = token.end
        if token.kind == "open" and token.start in opens:
            parts.append(("".join(scan.clean_characters[begin:end]), begin, end - begin))
            begin = None
    if begin is not None:
        parts.append(("".join(scan.clean_characters[begin:end]), begin, end - begin))
    return MappedText(scan.source, parts)


def _make_brace_fix(scan: TokenScan, line_end: int, brace: ScannedToken) -> Fix | None:
    """Return the fix that moves `brace` to the end of the line above, which ends at `line_end`. Return None if a comment is
    between them."""
    text = scan.source.text[line_end : brace.start]
    return None if text.strip() else Fix(Span(scan.source, line_end, brace.end), " {")


def cut_lines(scan: TokenScan, tokens: list[ScannedToken]) -> list[SourceLine]:
    """Return the lines of a complete text. All braces must already be paired."""
    top: list[SourceLine] = [SourceLine()]
    stack: list[
        tuple[list[SourceLine], ScannedToken, bool]
    ] = []  # enclosing groups: their lines, their opening brace, and whether `choose` precedes it
    lines = top
    for token in tokens:
        sign = get_token_text(scan, token) if token.kind in ("open", "close") else ""
        line = lines[-1]
        if sign == "{":
            if not line.tokens and len(lines) > 1 and not lines[-2].groups:
                lines.pop()
                line = lines[-1]
                if not token.inserted_text:
                    line_end = line.tokens[-1].end
                    scan.report.error(
                        "brace-on-own-line", "`{` is on a separate line", Span(scan.source, token.start, token.end),
                        "write `{` at the end of the line above", fix=_make_brace_fix(scan, line_end, token),
                    )  # fmt: skip
                    scan.replace_by_blanks(line_end, token.start)
            chooses = bool(line.tokens) and get_token_text(scan, line.tokens[-1]) == "choose"
            line.tokens.append(token)
            stack.append((lines, token, chooses))
            lines = [SourceLine()]
        elif sign == "}":
            inner = [each for each in lines if each.tokens]
            lines, opening, chooses = stack.pop()
            lines[-1].tokens.append(token)
            lines[-1].groups.append(BraceGroup(opening, token, inner, chooses))
        elif token.kind == "end":
            if line.tokens:
                lines.append(SourceLine())
        else:
            if token.kind == "word" and line.groups and line.tokens[-1] is line.groups[-1].closing_brace:
                word = get_token_text(scan, token)
                scan.report_error(
                    "missing-line-end",
                    f"`{word}` is on the same line after `}}`",
                    token.start,
                    token.end,
                    "begin a new line, or write `;`",
                )
                lines.append(SourceLine())
                line = lines[-1]
            line.tokens.append(token)
    return [line for line in top if line.tokens]
