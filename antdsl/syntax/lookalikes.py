"""Letters and digits of other scripts that look like ones on the keyboard."""

from __future__ import annotations

import unicodedata

_CYRILLIC = dict(zip("\u0430\u0435\u043e\u0440\u0441\u0443\u0445\u0456\u0458\u0455\u04bb\u0501\u051b\u051d\u043a\u043c\u043d\u0442\u0432\u0433", "aeopcyxijshdqwkmhtbr", strict=True))
_GREEK = dict(zip("\u03b1\u03bf\u03c1\u03bd\u03b9\u03ba\u03c4\u03c5\u03c7\u03b5\u03b7\u03bc\u03c9", "aopviktuxenuw", strict=True))
_LOOKALIKES = {**_CYRILLIC, **_GREEK, "\u0131": "i", "\u0261": "g", "\u00b5": "u", "\u017f": "s"}


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
