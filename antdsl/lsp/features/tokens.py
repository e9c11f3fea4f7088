"""Semantic tokens: the words of a program with their meanings, for editors that colour words by meaning."""

from __future__ import annotations

import re
from functools import lru_cache

from antdsl.lsp.workspace import OpenDocument
from antdsl.resources import grammar_file
from antdsl.syntax.words import NUMBER_REGEX, UNITS_REGEX

TOKEN_TYPES = (
    "keyword", "comment", "string", "number", "operator", "class", "enumMember", "function", "parameter", "property", "variable",
    "type", "namespace", "event",
)  # fmt: skip
TOKEN_MODIFIERS = ("declaration", "readonly", "defaultLibrary")

_TOKEN_BY_NAME_KIND: dict[str, tuple[str, int]] = {
    "thing": ("class", 0), "species": ("class", 0), "field": ("class", 0), "state": ("enumMember", 0), "machine": ("class", 0),
    "behaviour": ("function", 0), "builtin": ("function", 4), "inner": ("parameter", 0), "element": ("parameter", 0),
    "builtin-argument": ("parameter", 4), "own": ("property", 0), "attribute": ("property", 0), "given": ("property", 4),
    "item-given": ("property", 4), "hit-given": ("property", 4), "let": ("variable", 2), "measure": ("variable", 2),
    "word": ("variable", 4),
    "steered": ("variable", 4), "setting": ("property", 4), "kind": ("keyword", 0), "type": ("type", 4),
    "alias": ("namespace", 0), "library": ("namespace", 4), "event": ("event", 0), "motion": ("property", 4),
    "colour": ("variable", 4), "body": ("property", 0),
}  # fmt: skip
_PIECE_PATTERN = re.compile(
    r'(?P<string>"[^"\n]*"?)|(?P<comment>\#[^\n]*)|(?P<word>[A-Za-z_][A-Za-z_0-9]*)'
    rf"|(?P<number>{NUMBER_REGEX}(?:[ \t]*{UNITS_REGEX})?)"
    r"|(?P<operator>->|\.\.|[-+<>=!]=|[-+*/^<>=])"
)


@lru_cache(maxsize=1)
def list_keywords() -> frozenset[str]:
    """Return all words that are keywords of the grammar."""
    text = grammar_file("antdsl.lark").read_text(encoding="utf-8")
    return frozenset(re.findall(r"^_?[A-Z]+\.1: /([a-z]+)\(", text, re.MULTILINE))


def encode_tokens(document: OpenDocument, first_line: int = 0, last_line: int | None = None) -> list[int]:
    """Return the tokens of the lines from `first_line` to `last_line`, encoded as the protocol requires. Each token is five
    numbers. Its position is relative to the previous token."""
    text, words = document.text, list_keywords()
    begin = text.line_starts[min(first_line, len(text.line_starts) - 1)]
    end = len(text.text) if last_line is None or last_line + 1 >= len(text.line_starts) else text.line_starts[last_line + 1]
    meaning_by_offset = document.index.meaning_by_offset
    data: list[int] = []
    line, column = 0, 0
    for piece in _PIECE_PATTERN.finditer(text.text, begin, end):
        kind, modifiers = piece.lastgroup or "", 0
        if kind == "word":
            meaning = meaning_by_offset.get(piece.start())
            if meaning is not None and meaning[0] in _TOKEN_BY_NAME_KIND:
                kind, modifiers = _TOKEN_BY_NAME_KIND[meaning[0]]
                modifiers |= int(meaning[1])
            elif piece.group() in words:
                kind = "keyword"
            else:
                continue
        token_line, token_column = text.find_line_column(piece.start())
        data += [
            token_line - line,
            token_column - column if token_line == line else token_column,
            text.count_columns(piece.group()),
            TOKEN_TYPES.index(kind),
            modifiers,
        ]
        line, column = token_line, token_column
    return data
