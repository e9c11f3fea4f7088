"""Failures of the disk and of memory: what could not be done, with which file, and how to continue."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager

from antdsl.cli.exits import Exit, Stop, is_out_of_memory

AGAIN = "run the same command again"
_FIRST = {
    errno.ENOSPC: "make room, then",
    errno.EDQUOT: "make room, then",
    errno.EACCES: "allow writing there, then",
    errno.EPERM: "allow writing there, then",
    errno.ENOLCK: "name a folder on a disk that has file locks, then",
    errno.EROFS: "make the disk writable, then",
}


@contextmanager
def report_failures(what: str, again: str = AGAIN) -> Iterator[None]:
    """End the command with exit code 3 where the disk or memory fails. `what` could not be done; `again`: how to continue."""
    try:
        yield
    except (BrokenPipeError, Stop):  # the reader of standard output is gone: that is not the disk
        raise
    except Exception as problem:
        found = machine_failure(problem)
        if found is None:
            raise
        raise failure(found, what, again) from None


def machine_failure(problem: Exception) -> OSError | MemoryError | None:
    """The error as one of the disk or of memory, whatever library reports it; None where it is of neither."""
    if is_out_of_memory(problem):
        return MemoryError()
    return problem if isinstance(problem, OSError) else None


def failure(problem: OSError | MemoryError, what: str = "", again: str = AGAIN) -> Stop:
    """The end of a command for a failure of the disk or of memory."""
    if isinstance(problem, MemoryError):
        words = "error: out of memory; fewer agents, larger cells or a lighter mesh need less"
        return Stop(Exit.INPUT_OUTPUT, words, f"once there is more, {again}")
    if problem.errno == errno.ENOENT and not problem.filename and not _has_working_directory():
        return Stop(Exit.INPUT_OUTPUT, "error: the working directory was removed", f"change to another folder, then {again}")
    place = f": `{problem.filename}`" if problem.filename else ""
    words = f"error: {what}{': ' if what else ''}{(problem.strerror or str(problem)).lower()}{place}"
    return Stop(Exit.INPUT_OUTPUT, words, f"{advice(problem)} {again}")


def _has_working_directory() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def advice(problem: OSError) -> str:
    """What to do before a command continues: the beginning of a sentence."""
    return _FIRST.get(problem.errno or 0, "once that is mended,")
