"""Help for calls in flow mappings of YAML such as `{kill: all(ant, within: 9 mm)}`, where the comma ends the value."""

from __future__ import annotations

import re

_CALL_PATTERN = re.compile(r"\s*(?:[A-Za-z_]\w*)\s*\((.*)\)\s*", re.ASCII | re.DOTALL)
_NAME_PATTERN = re.compile(r"[A-Za-z_][\w.]*", re.ASCII)
_MAX_CALL_CHARACTERS = 1000


def find_closing_parenthesis(text: str, start: int, end: int) -> int | None:
    """Return the position behind the parenthesis that closes the first one after `start`; None if a brace ends first."""
    depth = 0
    for position in range(start, min(end, start + _MAX_CALL_CHARACTERS)):
        character = text[position]
        if character in "{}":
            return None
        depth += (character == "(") - (character == ")")
        if character == ")" and depth == 0:
            return position + 1
    return None


def suggest_mapping(call: str) -> str:
    """Return what to write instead of a call such as `all(ant, within: 9 mm)`: a mapping if it fits, else the text in quotes."""
    match = _CALL_PATTERN.fullmatch(call)
    parts = [part.strip() for part in match[1].split(",")] if match is not None else []
    keys = [part for part in parts[1:] if _NAME_PATTERN.match(part) and ":" in part]
    if parts and _NAME_PATTERN.fullmatch(parts[0]) and len(keys) == len(parts) - 1 and not any("(" in part for part in parts):
        return "write a mapping: `{of: " + ", ".join(parts) + "}`"
    quote = "'" if '"' in call else '"'
    return f"put it in quotes: `{quote}{call}{quote}`"
