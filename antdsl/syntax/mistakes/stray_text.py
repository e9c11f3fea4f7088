"""A first look over a whole text: characters that do not show, marks of a merge, fences of Markdown, lines without end. Each is
reported and blanked, so that the words around it can be read."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING

from antdsl import limits

if TYPE_CHECKING:
    from antdsl.syntax.scan import Scan

_FORBIDDEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_UNSEEN = re.compile(
    "[\u00ad\u034f\u061c\u115f\u1160\u180e\u200b\u200e\u200f\u2060-\u2065\u206a-\u206f\u2800\u3164\ufeff\uffa0\ufff0-\ufffb"
    "\U000e0000-\U000e007f]"
)
_SAID = re.compile(r'"[^"\n]*"?|#[^\n]*')
_CONFLICT = re.compile(r"^(<{7}|\|{7}|={7}|>{7})(?=[ \r\n]|$).*$", re.MULTILINE)
_FENCE = re.compile(r"^[ \t]*(```|~~~).*$", re.MULTILINE)


def look_over(found: Scan) -> None:
    """Complain about what no text may hold, wherever it stands."""
    _forbidden(found)
    _unseen(found)
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


def _unseen(found: Scan) -> None:
    """Complain about characters of comments and texts that do not show. Those that join letters or keep them apart belong to the
    spelling of some languages."""
    text = found.source.text
    for said in _SAID.finditer(text) if not text.isascii() else ():
        for match in _UNSEEN.finditer(text, said.start(), said.end()):
            name = unicodedata.name(match.group(), "character").lower()
            message = f"{name} (U+{ord(match.group()):04X}), which does not show"
            found.error("control-character", message, match.start(), match.end(), "delete it", "")


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
