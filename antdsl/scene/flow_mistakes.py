"""Explains mistakes in YAML's flow style (`{…}` and `[…]`), and suggests what to write instead. Examples are calls with commas,
such as `{kill: all(ant, within: 9 mm)}`, and keys without a value, such as `{kill:guards}`."""

from __future__ import annotations

import re

_CALL_PATTERN = re.compile(r"\s*([A-Za-z_]\w*)\s*\((.*)\)\s*", re.ASCII | re.DOTALL)
_NAME_PATTERN = re.compile(r"[A-Za-z_][\w.]*", re.ASCII)
_CONDITION_PATTERN = re.compile(r"(within|most)\s*:\s*\S.*", re.ASCII)
_NO_SPACE_PATTERN = re.compile(r"([A-Za-z_]\w*):(?!//)(\S.*)", re.ASCII | re.DOTALL)
_NO_COLON_PATTERN = re.compile(r"([A-Za-z_]\w*)\s+(\S.*)", re.ASCII | re.DOTALL)
_MAX_CALL_CHARACTERS = 1000


def find_closing_parenthesis(text: str, start: int, end: int) -> int | None:
    """Return the index after the parenthesis that matches the first opening one after `start`. Return None if a brace ends the
    value before it."""
    depth = 0
    for position in range(start, min(end, start + _MAX_CALL_CHARACTERS)):
        character = text[position]
        if character in "{}":
            return None
        depth += (character == "(") - (character == ")")
        if character == ")" and depth == 0:
            return position + 1
    return None


def suggest_flow_mapping(call: str) -> str:
    """Return advice on what to write instead of a call such as `all(ant, within: 9 mm)`. It is a selector if one fits, otherwise
    the call in quotes."""
    quote = "'" if '"' in call else '"'
    return suggest_selector(call) or f"put it in quotes: `{quote}{call}{quote}`"


def suggest_selector(call: str) -> str | None:
    """Return the selector that replaces a call such as `all(ant, within: 9 mm)`, or None if no selector fits."""
    match = _CALL_PATTERN.fullmatch(call)
    parts = [part.strip() for part in match[2].split(",")] if match is not None else []
    conditions = [part for part in parts[1:] if _CONDITION_PATTERN.fullmatch(part)]
    if match is not None and parts and _NAME_PATTERN.fullmatch(parts[0]) and "(" not in match[2]:
        if len(parts) == 1 and match[1] != "nearest":
            return f"write `{parts[0]}`"
        if match[1] == "nearest" or conditions:
            conditions += ["most: 1"] if match[1] == "nearest" and not any(each.startswith("most") for each in conditions) else []
            return f"write a mapping: `{{of: {parts[0]}, near: [0, 0, 0], {', '.join(conditions)}}}`"
    return None


def explain_joined_entry(text: str) -> tuple[str, str] | None:
    """Return the message and the advice for a text such as `kill:guards` or `kill guards` in place of an entry `kill: guards`.
    Return None for other texts."""
    for pattern, message in ((_NO_SPACE_PATTERN, "a space is missing after `:`"), (_NO_COLON_PATTERN, "a `:` is missing here")):
        match = pattern.fullmatch(text)
        if match is not None:
            return message, f"write `{match[1]}: {match[2]}`"
    return None


def explain_key_without_value(text: str, previous: tuple[str, str] | None) -> tuple[str, str]:
    """Return the message and the advice for an entry of `{…}` without a value. `previous`: the key and the value of the
    preceding entry, or None."""
    joined = explain_joined_entry(text)
    if joined is not None:
        return joined
    as_list = f", or several values as a list, `{previous[0]}: [{previous[1]}, {text}]`" if previous is not None else ""
    return f"`{text[:60]}` has no value", f"write `{text[:60]}: VALUE`{as_list}"
