"""Parses default values in the vocabulary. They are texts in the language, such as `360 deg`, `0 .. 1`, `mass * max_speed /
response` or `max(90 deg * max_speed / size, 600 deg/s)`."""

from __future__ import annotations

import re

from antdsl.program.model import Expr
from antdsl.program.names.scope import NameScope
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.words import QUANTITY_PATTERN

_NAME_PATTERN = re.compile("[a-z_]+")
_CALL_PATTERN = re.compile(r"([a-z_]+)\((.+)\)")


def parse_default_values(scope: NameScope, text: str, span: Span) -> tuple[Expr, ...]:
    """Return the expression of a default value, or two expressions for the ends of a range. `span`: the location for errors."""
    return tuple(scope.type_expression(parse_product(part.strip(), span)) for part in text.split(".."))


def parse_default(text: str, span: Span) -> nodes.Expr:
    """Return the syntax tree of a default value: a product, or a call of a built-in function with products as arguments."""
    call = _CALL_PATTERN.fullmatch(text)
    if call is None:
        return parse_product(text, span)
    arguments = tuple(nodes.Argument(None, parse_product(part, span), span) for part in call[2].split(", "))
    return nodes.Call(nodes.NameRef(nodes.Name(call[1], span), span), arguments, span)


def parse_product(text: str, span: Span) -> nodes.Expr:
    """Return the syntax tree of terms that are joined by `*` and `/`, evaluated from left to right. Each `*` or `/` must have a
    blank on both sides."""
    words = re.split(r" ([*/]) ", text)
    node = parse_term(words[0], span)
    for sign, term in zip(words[1::2], words[2::2], strict=True):
        node = nodes.Binary(sign, node, parse_term(term, span), span, span)
    return node


def parse_term(text: str, span: Span) -> nodes.Expr:
    if _NAME_PATTERN.fullmatch(text):
        return nodes.NameRef(nodes.Name(text, span), span)
    match = QUANTITY_PATTERN.fullmatch(text)
    if match is None:
        raise ValueError(f"a default that cannot be read: {text!r}")
    value = float(match[1])
    return nodes.Quantity(value, match[2], span, span) if match[2] else nodes.Number(value, span)
