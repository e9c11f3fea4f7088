"""Exit codes, and the one exception that ends a command with words instead of a traceback."""

from __future__ import annotations

from enum import IntEnum
from errno import EAGAIN, ENOMEM


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
    "cannot allocate memory",
    "failed to map segment",
    "out of memory",
    "unable to allocate",
    "not enough memory",
)
# What they say when it gives them no thread. An error of a file or a socket says the last of these too, but is an OSError.
_THREAD_WORDS = ("can't start new thread", "failed to create thread", "resource temporarily unavailable")
_STARTS = frozenset(["subprocess", "multiprocessing.popen_fork", "multiprocessing.util", "antdsl.checking"])  # of processes


def is_out_of_memory(problem: BaseException | None) -> bool:
    """Whether an error, or one that led to it, says that the system gave no memory, no thread or no process."""
    seen: set[int] = set()
    while problem is not None and id(problem) not in seen:
        seen.add(id(problem))
        words = str(problem).lower()
        if isinstance(problem, MemoryError) or (isinstance(problem, OSError) and _has_no_process(problem)):
            return True
        if isinstance(problem, RuntimeError | ImportError | OSError | SystemError) and _has(words, _MEMORY_WORDS):
            return True
        if isinstance(problem, RuntimeError) and _has(words, _THREAD_WORDS):
            return True
        problem = problem.__cause__ or (None if problem.__suppress_context__ else problem.__context__)
    return False


def _has(words: str, parts: tuple[str, ...]) -> bool:
    return any(part in words for part in parts)


def _has_no_process(problem: OSError) -> bool:
    """Whether the system gave no memory, or refused to start a process for want of it."""
    if problem.errno != EAGAIN:
        return problem.errno == ENOMEM
    place = problem.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return place is not None and place.tb_frame.f_globals.get("__name__") in _STARTS
