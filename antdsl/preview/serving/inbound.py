"""Reads what a page asks: an `Ask`, or a refusal in words. JSON is read by pydantic's own reader, which stops at deep nesting."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from antdsl.preview.requests import ASK, Ask


@dataclass(frozen=True, slots=True)
class Refused:
    """`of`: the op, as far as there is one that exists."""

    of: str
    message: str
    help: str = ""

    def message_out(self) -> dict[str, Any]:
        return {"op": "refused", "of": self.of, "message": self.message, "help": self.help}


def read(text: str) -> Ask | Refused:
    """The ask in a message. What a message says is never repeated, but for names of ops and of their parts."""
    try:
        return ASK.validate_json(text)
    except ValidationError as why:
        first = why.errors(include_url=False, include_context=False, include_input=False)[0]
    kind, place = first["type"], [str(part) for part in first["loc"]]
    if kind == "json_invalid":
        return Refused("", "a message was no JSON that can be read", "load this page again")
    if kind in ("union_tag_invalid", "union_tag_not_found") and not place:
        return Refused("", "a message asks for nothing that a preview does", "load this page again")
    if not place:
        return Refused("", "a message is not a list of names and values", "load this page again")
    where = " ".join(f"`{part}`" for part in place[1:]) or "the message"
    words = first["msg"][:1].lower() + first["msg"][1:]
    return Refused(place[0], f"{where} of `{place[0]}`: {words}")
