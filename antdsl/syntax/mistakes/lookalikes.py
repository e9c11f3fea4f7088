"""Letters, digits, quotes and signs that people type or paste in place of the ones of the language."""

from __future__ import annotations

import re
import unicodedata

# Letter and what it looks like, one after the other.
_PAIRS = (
    "\u0430a\u0435e\u043eo\u0440p\u0441c\u0443y\u0445x\u0456i\u0458j\u0455s\u04bbh\u0501d\u051bq\u051dw"  # Cyrillic
    "\u043ak\u043cm\u043dh\u0442t\u0432b\u0433r"
    "\u03b1a\u03bfo\u03c1p\u03bdv\u03b9i\u03bak\u03c4t\u03c5u\u03c7x\u03b5e\u03b7n\u03bcu\u03c9w"  # Greek
    "\u0131i\u0261g\u00b5u\u017fs"
)
_LOOKALIKES = dict(zip(_PAIRS[::2], _PAIRS[1::2], strict=True))

DOUBLE_QUOTES = "\u201c\u201d\u201e\u201f\u00ab\u00bb\u2033\uff02"
SINGLE_QUOTES = "'\u2018\u2019\u201a\u201b\u00b4\u2032`"

# Signs of other languages and of mathematics: what to write, and the text that takes their place where the meaning is plain.
WRONG_SIGNS = {
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


def ascii_for(character: str) -> str | None:
    """The ASCII letter, digit or `_` that a character looks like, or None. Accents are not look-alikes: they are meant."""
    if character < "\x80":
        return character
    digit = unicodedata.decimal(character, None)
    if digit is not None:
        return str(digit)
    found = _LOOKALIKES.get(character) or _LOOKALIKES.get(character.lower())
    if found:
        return found
    wide = unicodedata.normalize("NFKC", character)
    return wide if len(wide) == 1 and wide < "\x80" and (wide.isalnum() or wide == "_") else None


_WORD = re.compile("write `([a-z]+)`")


def word_instead(help: str, before: str, after: str) -> str | None:
    """For a sign in place of which a word is to be written: the word, with a blank where the character beside it is part of a
    word."""
    found = _WORD.fullmatch(help)
    if found is None:
        return None
    left, right = (" " if each.isalnum() or each in ("_", ")") else "" for each in (before, after))
    return f"{left}{found[1]}{right}"
