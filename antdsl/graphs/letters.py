"""How wide words are, in px. The same on every machine: whoever has other letters fits them into the width said here."""

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
    """Width of a line at a letter size in px: measured where Pillow's own letters have the sign, else guessed from its kind."""
    known = "".join(sign for sign in text if _built_in_has(sign))
    wide = sum(1.0 if east_asian_width(sign) in "WF" else 0.65 for sign in text if not _built_in_has(sign))
    return round(_built_in(size).getlength(known) + wide * size, 2)


def face(text: str, size: int) -> FreeTypeFont:
    """Letters that have every sign of the text, as far as this machine has any; Pillow's own for plain ones."""
    if all(_built_in_has(sign) for sign in text):
        return _built_in(size)
    return _installed(size) or _built_in(size)


def _built_in_has(sign: str) -> bool:
    return " " <= sign <= "~" or sign in _OWN


@lru_cache(maxsize=32)
def _built_in(size: int) -> FreeTypeFont:
    from PIL import ImageFont

    return ImageFont.load_default(size)  # type: ignore[return-value]


@lru_cache(maxsize=32)
def _installed(size: int) -> FreeTypeFont | None:
    from PIL import ImageFont

    for name in _OTHERS:
        try:
            return ImageFont.truetype(name, size)
        except OSError:
            continue
    return None
