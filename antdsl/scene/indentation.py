"""Explains why a scene's text is not YAML: it finds a line with a wrong indent or without a colon, and suggests what to write.

YAML itself only reports where it stopped reading, which is often a line or a word after the mistake."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

from antdsl.diagnostics import Diagnostic, Fix
from antdsl.source import Source, Span

_DIAGNOSTIC_CODE = "scene-syntax"
# A plain key must end with a non-blank character. A class that includes blanks before `\s*` would take quadratic time.
_KEY_PATTERN = re.compile(r"""("[^"]*"|'[^']*'|[^\s#:\[\]{},&*!|>%@`"'-](?:[^#:\[\]{},]*[^\s#:\[\]{},])?)\s*:(?=\s|$)""")
_MISSING_SPACE_PATTERN = re.compile(r"(?:- +)?([A-Za-z_][\w.]*):(?=[^\s:/\\])(.+)")
_MISSING_COLON_PATTERN = re.compile(r"(?:- +)?([A-Za-z_][\w.]*)[ \t]+([^\s:#=].*|[=] ?.*)")
_DISPLAY_WIDTH = 40


@dataclass(slots=True)
class _IndentedLine:
    """A line of a block: its indent, its text without a comment, and the location of the text."""

    start: int
    indent: int
    text: str

    @property
    def is_item(self) -> bool:
        """Return whether the line is an item of a list."""
        return self.text == "-" or self.text.startswith("- ")


@dataclass(slots=True)
class _IndentLevel:
    """One level of indentation in a block. `is_list`: whether its lines are list items. `line`: its last line; `text`: the rest
    of this line."""

    indent: int
    is_list: bool
    line: _IndentedLine | None
    text: str = ""


@dataclass(slots=True)
class _MisindentedLine:
    """A line with an indent that matches no level of indentation. `level`: the level with the nearest indent."""

    line: _IndentedLine
    level: _IndentLevel


def explain_indentation(source: Source, stop: int) -> Diagnostic | None:
    """Return the error about the first line with a wrong indent, or None if all are right. Lines after the offset `stop` are
    ignored.

    If shifting the previous line would solve the problem, the error is about the previous line."""
    odd = _find_misindented_line(source.text, stop)
    if odd is None:
        return None
    line, level, shift = odd.line, odd.level, odd.level.indent - odd.line.indent
    start, end, text = _shift_line(source.text, line, shift)
    previous_line = level.line
    if (
        previous_line is not None
        and _find_misindented_line(source.text[:start] + text + source.text[end:])
        and previous_line.indent >= shift
    ):
        other = _shift_line(source.text, previous_line, -shift, only_line=True)
        if _find_misindented_line(source.text[: other[0]] + other[2] + source.text[other[1] :]) is None:
            line, level, shift, (start, end, text) = (
                previous_line,
                _IndentLevel(previous_line.indent - shift, previous_line.is_item, None),
                -shift,
                other,
            )
    where = "at the left edge" if not level.indent else f"with {_format_blank_count(level.indent)}"
    beside = level.text if len(level.text) <= _DISPLAY_WIDTH else level.text[: _DISPLAY_WIDTH - 1] + "…"
    own, others = _format_blank_count(line.indent), _format_blank_count(level.indent)
    message = f"this line begins with {own}, but the lines around it with {others}"
    help = f"begin it {where}" + (f", below `{beside}`" if beside else "")
    span = Span(source, line.start, line.start + len(line.text))
    return Diagnostic(_DIAGNOSTIC_CODE, message, span, help=help, fix=Fix(Span(source, start, end), text))


def _find_misindented_line(text: str, stop: int | None = None) -> _MisindentedLine | None:
    """Return the first line with an indent that matches no level, or None. Lines after the offset `stop` are ignored."""
    levels: list[_IndentLevel] = []
    opened = False  # the previous line has a key without a value
    for line in _iterate_lines(text, len(text) if stop is None else stop):
        if "\t" in text[line.start - line.indent : line.start]:
            return None
        expected_level = _find_level(levels, line, opened)
        if expected_level is not None:
            return _MisindentedLine(line, expected_level)
        while levels and (
            levels[-1].indent > line.indent or (levels[-1].indent == line.indent and levels[-1].is_list > line.is_item)
        ):
            levels.pop()
        opened = _enter_line(levels, line)
    return None


def _enter_line(levels: list[_IndentLevel], line: _IndentedLine) -> bool:
    """Add a line to the levels of indentation. Return whether the last key of the line has no value, because then a block may
    follow."""
    indent, text = line.indent, line.text
    while True:
        dash = text == "-" or text.startswith("- ")
        if levels and levels[-1].indent == indent and levels[-1].is_list == dash:
            levels[-1].line, levels[-1].text = line, text
        else:
            levels.append(_IndentLevel(indent, dash, line, text))
        if not dash:
            break
        rest = text[1:].lstrip()
        indent += len(text) - len(rest)
        text = rest
        if not text or not (_KEY_PATTERN.match(text) or text.startswith("- ")):
            return not text
    key = _KEY_PATTERN.match(text)
    return key is not None and not text[key.end() :].strip()


def _find_level(levels: list[_IndentLevel], line: _IndentedLine, can_nest: bool) -> _IndentLevel | None:
    """Return the level to which a line with a wrong indent should belong, or None if its indent is correct."""
    if not levels:
        return _IndentLevel(0, line.is_item, None) if line.indent else None
    last = levels[-1]
    if can_nest and (line.indent > last.indent or (line.is_item and line.indent == last.indent)):
        return None
    fitting = [level for level in levels if level.is_list == line.is_item] or levels
    if any(level.indent == line.indent for level in fitting if level.is_list == line.is_item):
        return None
    return min(reversed(fitting), key=lambda level: abs(level.indent - line.indent))


def _shift_line(text: str, line: _IndentedLine, shift: int, *, only_line: bool = False) -> tuple[int, int, str]:
    """Return the change that shifts a line by `shift` blanks: the start and end of the text to replace, and the replacement.

    Lines below it with a larger indent are also shifted, unless `only_line` is true."""
    start = line.start - line.indent
    hangs = not only_line and (shift < 0 or line.is_item or line.text.endswith(":"))
    end = _find_block_end(text, line) if hangs else _find_line_end(text, line.start)
    lines = text[start:end].split("\n")
    moved = [" " * shift + each if shift > 0 and each.strip() else each[max(0, -shift) :] for each in lines]
    return start, end, "\n".join(moved)


def _find_block_end(text: str, line: _IndentedLine) -> int:
    """Return the offset at which a block ends. The block consists of a line and all following lines with a larger indent."""
    last = _find_line_end(text, line.start)
    while last < len(text):
        stop = _find_line_end(text, last + 1)
        following = text[last + 1 : stop]
        if following.strip() and len(following) - len(following.lstrip(" ")) <= line.indent:
            break
        if not following.strip():
            break
        last = stop
    return last


def _format_blank_count(count: int) -> str:
    return "no blank" if not count else f"{count} space{'s' if count > 1 else ''}"


def _find_line_end(text: str, start: int) -> int:
    end = text.find("\n", start)
    return len(text) if end < 0 else end


def _iterate_lines(text: str, stop: int) -> Iterator[_IndentedLine]:
    """Yield the non-empty lines up to the offset `stop`. Lines inside brackets, quoted texts or text blocks that began earlier
    are omitted."""
    position, depth, quote, block = 0, 0, "", -1
    while position < len(text) and position <= stop:
        end = _find_line_end(text, position)
        line = text[position:end].rstrip("\r")
        bare = line.lstrip(" \t")
        indent = len(line) - len(bare)
        inside = depth > 0 or quote or (block >= 0 and (indent > block or not bare))
        if not inside:
            block = -1
        content, depth, quote = _strip_comment(line, depth, quote) if block < 0 else (line, 0, "")
        content = content.strip(" \t")
        if not inside and content and content not in ("---", "..."):
            yield _IndentedLine(position + indent, indent, content)
            if re.search(r"[:-]\s+[|>][+-]?[0-9]?$", content):
                block = indent
        position = end + 1


def _strip_comment(line: str, depth: int, quote: str) -> tuple[str, int, str]:
    """Return a line without its comment, the number of brackets that are open at its end, and the quote that is open at its
    end."""
    previous_character = " "
    for place, character in enumerate(line):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'" and previous_character in " \t[{,:-":
            quote = character
        elif character == "#" and previous_character in " \t":
            return line[:place], depth, quote
        elif character in "[{":
            depth += 1
        elif character in "]}":
            depth = max(0, depth - 1)
        previous_character = character
    return line, depth, quote


def explain_missing_colon(source: Source, start: int) -> Diagnostic | None:
    """Return the error about a line without a colon between key and value, such as `fps 24`. Return None if there is no such
    line.

    YAML joins such a line with the next one. `start`: the offset of YAML's own error. Its line and the line above are examined.
    """
    line, _ = source.find_line_column(start)
    for number in (line, line - 1):
        text = source.line_text(number)
        bare = text.lstrip()
        begin = _find_line_start(source, number) + len(text) - len(bare)
        for pattern, lack in ((_MISSING_SPACE_PATTERN, "no space after `{}:`"), (_MISSING_COLON_PATTERN, "no `:` behind `{}`")):
            match = pattern.fullmatch(bare)
            if match is None or _KEY_PATTERN.match(bare.removeprefix("- ").lstrip()):
                continue
            better = f"{match[1]}: {match[2].lstrip('= ')}"
            span = Span(source, begin + match.start(1), begin + len(bare.rstrip()))
            return Diagnostic(
                _DIAGNOSTIC_CODE, f"there is {lack.format(match[1])}", span, help=f"write `{better}`", fix=Fix(span, better)
            )
    return None


def _find_line_start(source: Source, line: int) -> int:
    """Return the offset at which a line begins. `line`: the number of the line, from 1."""
    low, high = 0, len(source.text)
    while low < high:
        middle = (low + high) // 2
        low, high = (middle + 1, high) if source.find_line_column(middle)[0] < line else (low, middle)
    return low
