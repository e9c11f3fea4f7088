"""A first look over a whole text: characters that do not show, marks of a merge, fences of Markdown, lines without end. Each is
reported and blanked, so that the words around it can be read."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from antdsl import limits

if TYPE_CHECKING:
    from antdsl.syntax.scan import Scan

_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_CONFLICT = re.compile(r"^(<{7}|\|{7}|={7}|>{7})(?=[ \r\n]|$).*$", re.MULTILINE)
_FENCE = re.compile(r"^[ \t]*(```|~~~).*$", re.MULTILINE)


def look_over(found: Scan) -> None:
    """Complain about what no text may hold, wherever it stands."""
    _forbidden(found)
    _markers(found)
    _long_lines(found)


def _forbidden(found: Scan) -> None:
    for match in _FORBIDDEN.finditer(found.source.text):
        character = match.group()
        name = f"U+{ord(character):04X}"
        if "\u202a" <= character <= "\u2069" and character not in "\u2028\u2029":
            message, help = f"hidden text direction mark {name}", "delete it: it can make text look like something else"
            found.error("hidden-direction", message, match.start(), match.end(), help, "")
        else:
            found.error("control-character", f"control character {name}", match.start(), match.end(), "delete it", "")
        found.blank(match.start(), match.end())


def _markers(found: Scan) -> None:
    """Of a merge conflict the first side is kept, so that the rest of the file can be checked."""
    if "<<<<<<<" in found.source.text or ">>>>>>>" in found.source.text:
        drop_from = -1
        for match in _CONFLICT.finditer(found.source.text):
            sign = match.group()[0]
            if sign in "<" or (sign == ">" and drop_from < 0):
                help = "keep one of the two versions and delete the lines with `<<<<<<<`, `=======` and `>>>>>>>`"
                found.error("merge-conflict", "merge conflict left in the file", match.start(), match.end(), help)
            elif sign in "|=" and drop_from < 0:
                drop_from = match.start()
            elif sign == ">":
                blank_lines(found, drop_from, match.end())
                drop_from = -1
            blank_lines(found, match.start(), match.end())
    for index, match in enumerate(_FENCE.finditer(found.source.text)):
        if index == 0:
            found.error("markdown-fence", "markdown code fence in the file", match.start(), match.end(), "delete this line", "")
        blank_lines(found, match.start(), match.end())


def blank_lines(found: Scan, start: int, end: int) -> None:
    """Blanks, with the line ends left where they are."""
    for offset in range(start, end):
        if found.clean[offset] != "\n":
            found.clean[offset] = " "


def _long_lines(found: Scan) -> None:
    if len(found.source.text) <= limits.LINE_CHARACTERS:
        return
    start = 0
    for line in found.source.text.split("\n"):
        if len(line) > limits.LINE_CHARACTERS:
            message = f"line of {len(line)} characters, at most {limits.LINE_CHARACTERS} are allowed"
            end = start + len(line)
            found.error("line-too-long", message, end - 1, end, "break the line inside parentheses, or at `;`")
            return
        start += len(line) + 1
