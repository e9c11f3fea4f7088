"""Widths of words, in px. The same on every machine: a viewer with other letters fits them into the given width."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING
from unicodedata import east_asian_width

if TYPE_CHECKING:
    from PIL.ImageFont import FreeTypeFont

# Beyond ASCII Pillow's own letters have no accents, but these.
_OWN = frozenset("·…°“”")
# Where the built-in letters end. A search by these names goes through the system's own folders.
_OTHERS = ("DejaVuSans.ttf", "Arial.ttf", "arial.ttf", "NotoSans-Regular.ttf", "Arial Unicode.ttf")


def width(text: str, size: int) -> float:
    """Return the width of a line at a font size in px: measured where Pillow's font has the character, else estimated from its
    kind."""
    known = "".join(sign for sign in text if _built_in_has(sign))
    wide = sum(1.0 if east_asian_width(sign) in "WF" else 0.65 for sign in text if not _built_in_has(sign))
    return round(_built_in_font(size).getlength(known) + wide * size, 2)


def find_font(text: str, size: int) -> FreeTypeFont:
    """Return a font that has every character of the text, if this machine has one; Pillow's own font for plain text."""
    if all(_built_in_has(sign) for sign in text):
        return _built_in_font(size)
    return _installed_font(size) or _built_in_font(size)


def _built_in_has(sign: str) -> bool:
    return " " <= sign <= "~" or sign in _OWN


@lru_cache(maxsize=32)
def _built_in_font(size: int) -> FreeTypeFont:
    from PIL import ImageFont

    return ImageFont.load_default(size)  # type: ignore[return-value]


@lru_cache(maxsize=32)
def _installed_font(size: int) -> FreeTypeFont | None:
    from PIL import ImageFont

    for name in _OTHERS:
        try:
            return ImageFont.truetype(name, size)
        except OSError:
            continue
    return None
