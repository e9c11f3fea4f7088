"""Why a file of a body cannot be used."""

from __future__ import annotations


class BodyError(Exception):
    """Words that fit after the file's name, such as `has no meshes`; `code` is a diagnostic's code, `help` what to do instead."""

    def __init__(self, message: str, help: str | None = None, code: str = "bad-body") -> None:
        super().__init__(message)
        self.help, self.code = help, code
