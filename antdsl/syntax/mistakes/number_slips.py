"""Makes messages about numbers and units that are not in the language's notation: commas, unnecessary signs, wrong units."""

from __future__ import annotations

import re

from antdsl import limits
from antdsl.diagnostics.model import Diagnostic, Fix
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.source import Source, Span
from antdsl.syntax.words import UNIT_NAMES, UNIT_SLIP_HELP

# Digits with commas between them; a dot may follow. Not the end of a name or of a number with a dot.
COMMA_NUMBER_PATTERN = re.compile(r"[0-9]+(?:,[0-9]+)+(?:\.[0-9]+)?(?![0-9.]*\.[0-9])")
LEADING_ZERO_PATTERN = re.compile(r",0[0-9]")  # a second number cannot begin with such a zero
_GLUED_TEXT_PATTERN = re.compile(r"[A-Za-z_][A-Za-z_0-9]*|\.[0-9][0-9.]*|\.(?!\.)")
_DIGITS_BEFORE_PATTERN = re.compile(r"(?<![A-Za-z0-9_.])[0-9]+\Z")
_DIGITS_AFTER_PATTERN = re.compile(r"[0-9]+(?!\.?[0-9])")
_THOUSANDS_PATTERN = re.compile(r"[1-9][0-9]{0,2}(?:,[0-9]{3})+(?:\.[0-9]+)?")
_MAX_QUOTED_CHARACTERS = 60  # longer numbers are shortened in messages


def find_comma_number(source: Source, comma: int) -> Span | None:
    """Return the span of the number around a comma without blanks. Return None if the comma can only separate two values."""
    left = _DIGITS_BEFORE_PATTERN.search(source.text, max(0, comma - _MAX_QUOTED_CHARACTERS), comma)
    right = _DIGITS_AFTER_PATTERN.match(source.text, comma + 1)
    return Span(source, left.start(), right.end()) if left and right and source.text[comma : comma + 1] == "," else None


def make_comma_diagnostic(span: Span, *, is_single_number: bool = True) -> Diagnostic:
    """Return the error about a number with commas. `is_single_number`: whether the text can only be a single number, not two
    numbers with a comma between them."""
    text = span.text
    plain_number, dotted = text.replace(",", ""), text.replace(",", ".")
    thousands, is_single = _THOUSANDS_PATTERN.fullmatch(text), text.count(",") == 1 and "." not in text
    fix: str | None = None
    two = text.replace(",", ", ")
    if is_single and not thousands:
        help = f"write a dot: `{dotted}`" + ("" if is_single_number else f"; separate two values with a space: `{two}`")
        fix = dotted if is_single_number else None
    elif is_single:
        help = f"write `{plain_number}`, or `{dotted}` with a dot" + ("" if is_single_number else f", or `{two}` for two values")
    elif thousands:
        help, fix = f"write `{plain_number}`", plain_number
    else:
        help = "write the number with digits and at most one dot, as in `1200` or `1.25`"
    message = (
        f"number `{text if len(text) <= _MAX_QUOTED_CHARACTERS else text[: _MAX_QUOTED_CHARACTERS - 1] + '…'}` has a comma in it"
    )
    return Diagnostic("bad-number", message, span, help=help, fix=None if fix is None else Fix(span, fix))


def find_number_problem(piece: str, characters: str, end: int) -> tuple[str, int, str] | None:
    """Return what is wrong with a number that ends at the offset `end`: the message, the offset at which the number should end,
    and the help. Return None for a valid number."""
    glued = _GLUED_TEXT_PATTERN.match(characters, end)
    rest = glued.group() if glued else ""
    complete_text = f"{piece}{rest}"[:80]
    stop = end + len(rest)
    if rest[:1] == "." and rest[1:2].isdigit():
        return f"number `{complete_text}` has two dots", stop, "write one dot at most, as in `1.25`"
    if rest == ".":
        return f"number `{complete_text}` ends in a dot", stop, f"write `{piece}`"
    if rest[:1] == "_" or (piece == "0" and rest[:1] in ("x", "X", "o", "O", "b", "B")):
        return (
            f"`{complete_text}` is not a number",
            stop,
            "write the number with digits and at most one dot, as in `1200` or `1.25`",
        )
    if len(piece) > 1 and piece[0] == "0" and piece[1].isdigit():
        return f"number `{piece[:80]}` has a needless leading 0", end, f"write `{piece.lstrip('0') or '0'}`"[:80]
    if sum(character.isdigit() for character in piece) > limits.MAX_NUMBER_DIGITS:
        return f"number has {len(piece)} digits", end, f"write at most {limits.MAX_NUMBER_DIGITS} digits"
    value = float(piece)
    if value > 1e38 or (value < 1e-38 and re.search(r"[1-9]", re.split("[eE]", piece)[0])):
        return f"number `{piece[:80]}` cannot be represented", end, "write a number between 1e-38 and 1e38"
    return None


def find_unit_help(word: str) -> str:
    """Return the help text for a word that is not a unit."""
    near = UNIT_SLIP_HELP.get(word.lower())
    if near is None and (name := find_nearest_name(word, UNIT_NAMES)) is not None:
        near = f"did you mean `{name}`?"
    return near or f"units are {' '.join(UNIT_NAMES)} and %; to multiply, write `*`"
