"""Exit codes, and the one exception that ends a command with words instead of a traceback."""

from __future__ import annotations

from enum import IntEnum
from errno import ENOMEM


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


# What libraries say, in errors of other kinds, when the system gives them no memory.
_MEMORY_WORDS = (
    "bad_alloc",
    "can't start new thread",
    "cannot allocate memory",
    "failed to map segment",
    "out of memory",
    "unable to allocate",
    "not enough memory",
    "failed to create thread",
    "resource temporarily unavailable",
)


def is_out_of_memory(problem: BaseException | None) -> bool:
    """Whether an error, or one that led to it, says that the system gave no memory or no thread."""
    seen: set[int] = set()
    while problem is not None and id(problem) not in seen:
        seen.add(id(problem))
        if isinstance(problem, MemoryError) or (isinstance(problem, OSError) and problem.errno == ENOMEM):
            return True
        words = str(problem).lower()
        if isinstance(problem, RuntimeError | ImportError | OSError | SystemError) and any(
            each in words for each in _MEMORY_WORDS
        ):
            return True
        problem = problem.__cause__ or problem.__context__
    return False
