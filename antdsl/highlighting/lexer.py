"""A Pygments lexer made from the patterns, for `pygmentize file.ant` and every tool that gets the lexer `ant` from Pygments."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from re import Match
from typing import Any, ClassVar

from pygments.lexer import RegexLexer
from pygments.token import Text, Token

from antdsl.highlighting.patterns import SCOPE_AND_TOKEN_BY_CLASS, TOKEN_PATTERNS, TokenPattern

_TokenStream = Iterator[tuple[int, Any, str]]


def find_token_type(name: str) -> Any:
    """Return the Pygments token type for a class of text, such as keywords."""
    token: Any = Token
    for part in SCOPE_AND_TOKEN_BY_CLASS[name][1].split("."):
        token = getattr(token, part)
    return token


def _make_group_action(pattern: TokenPattern) -> Callable[[RegexLexer, Match[str]], _TokenStream]:
    """Return a lexer action that splits a match into the groups of its pattern. Text between groups has no colour."""
    types = [find_token_type(name) for name in pattern.group_classes]

    def emit_group_tokens(lexer: RegexLexer, match: Match[str]) -> _TokenStream:
        last = match.start()
        for number, kind in enumerate(types, 1 if match.re.groups else 0):
            start, end = match.span(number)
            if start < 0:  # a group that is not there
                continue
            if start > last:
                yield last, Text, match.string[last:start]
            yield start, kind, match.group(number)
            last = end

    return emit_group_tokens


class AntLexer(RegexLexer):
    """The Pygments lexer for `.ant` programs."""

    name = "antdsl"
    aliases: ClassVar[list[str]] = ["ant", "antdsl"]
    filenames: ClassVar[list[str]] = ["*.ant"]
    mimetypes: ClassVar[list[str]] = ["text/x-antdsl"]
    tokens: ClassVar[dict[str, list[Any]]] = {
        "root": [*((pattern.regex, _make_group_action(pattern)) for pattern in TOKEN_PATTERNS), (r"\n|[ \t]+", Text)]
    }
