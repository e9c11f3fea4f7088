"""Exit codes, and the one exception that ends a command with words instead of a traceback."""

from __future__ import annotations

from enum import IntEnum


class Exit(IntEnum):
    FINE = 0
    FINDINGS = 1
    USAGE = 2
    INPUT_OUTPUT = 3
    BUG = 70
    TERMINATED = 75  # by SIGTERM, all that was done is kept: sysexits' EX_TEMPFAIL, "try again later"
    INTERRUPTED = 130  # what shells expect after Ctrl-C


class Stop(Exception):
    """Ends the command: `message` goes to standard error, then `hint` if there is one."""

    def __init__(self, code: Exit, message: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.code, self.message, self.hint = code, message, hint
