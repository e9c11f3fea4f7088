"""Why the reader does not read something, in words for the artist."""

from __future__ import annotations

from typing import Any

from antdsl.diagnostics.model import printable

_CHARACTERS = 2000


class Refusal(Exception):
    """`code` is a diagnostic's code, the text its message, `help` what to do instead, `key` the key of the scene it is about.
    `about`: what the message speaks of, "" for the whole file, or a word on which the requester and the function agree."""

    def __init__(self, code: str, message: str, help: str | None = None, key: str = "", about: str = "") -> None:
        super().__init__(message)
        self.code, self.help, self.key, self.about = code, help, key, about

    def as_document(self) -> dict[str, Any]:
        """As it goes through the pipe."""
        return {"code": self.code, "message": str(self), "help": self.help, "key": self.key, "about": self.about}

    @classmethod
    def of_document(cls, document: Any, codes: Any) -> Refusal | None:
        """The refusal that a process sent; None where it is none, or its code is not one of `codes`."""
        if not isinstance(document, dict):
            return None
        texts = {name: document.get(name) for name in ("code", "message", "key", "about")}
        help = document.get("help")
        if not all(isinstance(text, str) for text in texts.values()) or not isinstance(help, str | None):
            return None
        if texts["code"] not in codes:
            return None
        return cls(
            str(texts["code"]), shown(str(texts["message"])), None if help is None else shown(help), str(texts["key"])[:80],
            str(texts["about"])[:80],
        )  # fmt: skip


def shown(text: str) -> str:
    """A text of the process as it can stand in a message: printable, and not too long."""
    line = printable(text[: _CHARACTERS + 1])
    return line if len(line) <= _CHARACTERS else line[: _CHARACTERS - 1] + "…"
