"""Checks a complete text for invisible and control characters, merge conflict markers, Markdown fences, and lines that are too
long.

Each of these is reported and replaced by blanks, so that the words around it can be read. The module also lists letters, digits,
quotes and signs that people type or paste instead of the language's own characters."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING

from antdsl import limits

if TYPE_CHECKING:
    from antdsl.syntax.scan import TokenScan

# Each letter is followed by its ASCII look-alike.
_LOOKALIKE_PAIRS = (
    "\u0430a\u0435e\u043eo\u0440p\u0441c\u0443y\u0445x\u0456i\u0458j\u0455s\u04bbh\u0501d\u051bq\u051dw"  # Cyrillic
    "\u043ak\u043cm\u043dh\u0442t\u0432b\u0433r"
    "\u03b1a\u03bfo\u03c1p\u03bdv\u03b9i\u03bak\u03c4t\u03c5u\u03c7x\u03b5e\u03b7n\u03bcu\u03c9w"  # Greek
    "\u0131i\u0261g\u00b5u\u017fs"
)
_LATIN_BY_LOOKALIKE = dict(zip(_LOOKALIKE_PAIRS[::2], _LOOKALIKE_PAIRS[1::2], strict=True))

DOUBLE_QUOTES = "\u201c\u201d\u201e\u201f\u00ab\u00bb\u2033\uff02"
SINGLE_QUOTES = "'\u2018\u2019\u201a\u201b\u00b4\u2032`"

# Signs of other languages and of mathematics: help, and the replacement if the meaning is clear.
WRONG_SIGN_HELP = {
    "&&": ("write `and`", None),
    "||": ("write `or`", None),
    "//": ("begin a comment with `#`", "comment"),
    "/*": ("begin each line of a comment with `#`", "comment"),
    "=>": ("write `->`", "->"),
    ":=": ("write `=`", " ="),
    "===": ("write `==`", "== "),
    "++": ("write `+= 1`", None),
    "**": ("write `^` for a power", "^ "),
    "!": ("write `not`", None),
    "%": ("a percent sign follows a number, as in `20 %`", None),
    "\u00d7": ("write `*`", "*"),
    "\u00b7": ("write `*`", "*"),
    "\u00f7": ("write `/`", "/"),
    "\u2212": ("write `-`", "-"),
    "\u2013": ("write `-`", "-"),
    "\u2014": ("write `-`", "-"),
    "\u2192": ("write `->`", "->"),
    "\u2264": ("write `<=`", "<="),
    "\u2265": ("write `>=`", ">="),
    "\u2260": ("write `!=`", "!="),
    "\u2026": ("write `..` for a range", ".."),
    "\u00b0": ("write `deg`", None),
    "\u00b2": ("write `^ 2`", None),
    "\u00b3": ("write `^ 3`", None),
}
_FORBIDDEN_CHARACTERS = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_INVISIBLE_CHARACTERS = re.compile(
    "[\u00ad\u034f\u061c\u115f\u1160\u180e\u200b\u200e\u200f\u2060-\u2065\u206a-\u206f\u2800\u3164\ufeff\uffa0\ufff0-\ufffb"
    "\U000e0000-\U000e007f]"
)
_TEXT_OR_COMMENT_PATTERN = re.compile(r'"[^"\n]*"?|#[^\n]*')
_MERGE_CONFLICT_PATTERN = re.compile(r"^(<{7}|\|{7}|={7}|>{7})(?=[ \r\n]|$).*$", re.MULTILINE)
_CODE_FENCE_PATTERN = re.compile(r"^[ \t]*(```|~~~).*$", re.MULTILINE)


def check_stray_text(scan: TokenScan) -> None:
    """Report text that is not allowed anywhere in a program, such as control characters or merge conflict markers."""
    _report_forbidden(scan)
    _report_invisible(scan)
    _report_conflicts_and_fences(scan)
    _report_long_lines(scan)


def _report_forbidden(scan: TokenScan) -> None:
    for match in _FORBIDDEN_CHARACTERS.finditer(scan.source.text):
        character = match.group()
        name = f"U+{ord(character):04X}"
        if "\u202a" <= character <= "\u2069" and character not in "\u2028\u2029":
            message, help = (
                f"the file contains a hidden text direction mark, {name}",
                "delete this character: it can make text look like something else",
            )
            scan.report_error("hidden-direction", message, match.start(), match.end(), help, "")
        else:
            scan.report_error(
                "control-character",
                f"the file contains the control character {name}",
                match.start(),
                match.end(),
                "delete it",
                "",
            )
        scan.replace_by_blanks(match.start(), match.end())


def _report_invisible(scan: TokenScan) -> None:
    """Report invisible characters in comments and quoted texts. Characters that join or separate letters in some languages are
    allowed."""
    text = scan.source.text
    for passage in _TEXT_OR_COMMENT_PATTERN.finditer(text) if not text.isascii() else ():
        for match in _INVISIBLE_CHARACTERS.finditer(text, passage.start(), passage.end()):
            name = unicodedata.name(match.group(), "character").lower()
            message = f"the file contains an invisible character, {name} (U+{ord(match.group()):04X})"
            scan.report_error("control-character", message, match.start(), match.end(), "delete it", "")


def _report_conflicts_and_fences(scan: TokenScan) -> None:
    """Report the lines of merge conflicts and Markdown fences, and replace them by blanks.

    Of the two versions in a conflict, the first one remains. The second one is replaced by blanks too, so that the rest of the
    file can be checked."""
    if "<<<<<<<" in scan.source.text or ">>>>>>>" in scan.source.text:
        drop_from = -1
        for match in _MERGE_CONFLICT_PATTERN.finditer(scan.source.text):
            sign = match.group()[0]
            if sign in "<" or (sign == ">" and drop_from < 0):
                help = "keep one of the two versions and delete the lines with `<<<<<<<`, `=======` and `>>>>>>>`"
                scan.report_error(
                    "merge-conflict", "the file contains a merge conflict that is not resolved", match.start(), match.end(), help
                )
            elif sign in "|=" and drop_from < 0:
                drop_from = match.start()
            elif sign == ">":
                replace_text_by_blanks(scan, drop_from, match.end())
                drop_from = -1
            replace_text_by_blanks(scan, match.start(), match.end())
    for index, match in enumerate(_CODE_FENCE_PATTERN.finditer(scan.source.text)):
        if index == 0:
            scan.report_error(
                "markdown-fence", "the file contains a Markdown code fence", match.start(), match.end(), "delete this line", ""
            )
        replace_text_by_blanks(scan, match.start(), match.end())


def replace_text_by_blanks(scan: TokenScan, start: int, end: int) -> None:
    """Replace text by blanks, but leave line ends unchanged."""
    for offset in range(start, end):
        if scan.clean_characters[offset] != "\n":
            scan.clean_characters[offset] = " "


def _report_long_lines(scan: TokenScan) -> None:
    if len(scan.source.text) <= limits.MAX_LINE_CHARACTERS:
        return
    start = 0
    for line in scan.source.text.split("\n"):
        if len(line) > limits.MAX_LINE_CHARACTERS:
            message = f"this line has {len(line)} characters, but at most {limits.MAX_LINE_CHARACTERS} are allowed"
            end = start + len(line)
            scan.report_error("line-too-long", message, end - 1, end, "break the line inside parentheses, or at `;`")
            return
        start += len(line) + 1


def find_ascii_lookalike(character: str) -> str | None:
    """Return the ASCII letter, digit or `_` that a character looks like, or None. Accented letters also give None, because
    authors use them on purpose."""
    if character < "\x80":
        return character
    digit = unicodedata.decimal(character, None)
    if digit is not None:
        return str(digit)
    ascii_character = _LATIN_BY_LOOKALIKE.get(character) or _LATIN_BY_LOOKALIKE.get(character.lower())
    if ascii_character:
        return ascii_character
    wide = unicodedata.normalize("NFKC", character)
    return wide if len(wide) == 1 and wide < "\x80" and (wide.isalnum() or wide == "_") else None


_SUGGESTED_WORD_PATTERN = re.compile("write `([a-z]+)`")


def make_replacement_word(help: str, previous_character: str, next_character: str) -> str | None:
    """Return the word that replaces a sign. On each side, a blank is added if the character there is part of a word."""
    match = _SUGGESTED_WORD_PATTERN.fullmatch(help)
    if match is None:
        return None
    left, right = (" " if each.isalnum() or each in ("_", ")") else "" for each in (previous_character, next_character))
    return f"{left}{match[1]}{right}"
