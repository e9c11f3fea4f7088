"""Widths of words, in px. They are the same on every machine, because a viewer with another font fits words into the given
width."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING
from unicodedata import east_asian_width

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

# Beyond ASCII, Pillow's own font has no accented letters except these.
_NON_ASCII_GLYPHS = frozenset("·…°“”")


def measure_text_width(text: str, size: int) -> float:
    """Return the width of a line of text, px. `size`: the font size, px. Characters of Pillow's built-in font have measured
    widths. The widths of all others are estimated from the kind of character."""
    built_in_text = "".join(character for character in text if _is_built_in_glyph(character))
    wide = sum(1.0 if east_asian_width(character) in "WF" else 0.65 for character in text if not _is_built_in_glyph(character))
    return round(load_built_in_font(size).getlength(built_in_text) + wide * size, 2)


def has_built_in_glyphs(text: str) -> bool:
    """Return whether Pillow's built-in font has every character of a text."""
    return all(_is_built_in_glyph(character) for character in text)


def _is_built_in_glyph(character: str) -> bool:
    """Return whether Pillow's built-in font has a character."""
    return " " <= character <= "~" or character in _NON_ASCII_GLYPHS


@lru_cache(maxsize=32)
def load_built_in_font(size: int) -> FreeTypeFont:
    """Return Pillow's built-in font. `size`: the font size, px."""
    from PIL import ImageFont

    return ImageFont.load_default(size)  # type: ignore[return-value]
