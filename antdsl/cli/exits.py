"""Exit codes, and the errors that end a command with a message instead of a traceback.

For disk and memory failures, the message gives the operation, the file, and how to continue."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from errno import EAGAIN, ENOMEM
from math import inf
from pathlib import Path

from antdsl import limits

RETRY_ADVICE = "run the same command again"
_ADVICE_BY_ERRNO = {
    errno.ENOSPC: "make room, then",
    errno.EDQUOT: "make room, then",
    errno.EACCES: "allow writing there, then",
    errno.EPERM: "allow writing there, then",
    errno.ENOLCK: "name a folder on a disk that supports file locks, then",
    errno.EROFS: "make the disk writable, then",
}


class ExitCode(IntEnum):
    """Exit codes of commands."""

    SUCCESS = 0
    FINDINGS = 1
    USAGE = 2
    INPUT_OUTPUT = 3
    BUG = 70
    TERMINATED = 75  # after SIGTERM, with all completed work stored: sysexits' EX_TEMPFAIL, "try again later"
    INTERRUPTED = 130  # what shells expect after Ctrl-C


class CommandError(Exception):
    """An error that ends a command with the exit code `code`. `message` is printed to standard error, followed by `hint` if
    there is one."""

    def __init__(self, code: ExitCode, message: str = "", hint: str = "") -> None:
        super().__init__(message)
        self.code, self.message, self.hint = code, message, hint


# Messages of libraries, in various kinds of errors, when the system has no memory left.
_OUT_OF_MEMORY_PHRASES = (
    "bad_alloc",
    "cannot allocate memory",
    "failed to map segment",
    "out of memory",
    "unable to allocate",
    "not enough memory",
)
# Messages when the system has no thread left. Errors of files and sockets may contain the last of these, but are OSErrors.
_OUT_OF_THREADS_PHRASES = ("can't start new thread", "failed to create thread", "resource temporarily unavailable")
_PROCESS_STARTING_MODULES = frozenset(
    ["subprocess", "multiprocessing.popen_fork", "multiprocessing.util", "antdsl.checking"]
)  # limits the number of processes


def is_out_of_memory(problem: BaseException | None) -> bool:
    """Return whether an error, or one of its causes, means that the system could not provide memory, a thread or a process."""
    visited: set[int] = set()
    while problem is not None and id(problem) not in visited:
        visited.add(id(problem))
        words = str(problem).lower()
        if isinstance(problem, MemoryError) or (isinstance(problem, OSError) and is_out_of_process_memory(problem)):
            return True
        if isinstance(problem, RuntimeError | ImportError | OSError | SystemError) and _contains_phrase(
            words, _OUT_OF_MEMORY_PHRASES
        ):
            return True
        if isinstance(problem, RuntimeError) and _contains_phrase(words, _OUT_OF_THREADS_PHRASES):
            return True
        problem = problem.__cause__ or (None if problem.__suppress_context__ else problem.__context__)
    return False


def _contains_phrase(words: str, phrases: tuple[str, ...]) -> bool:
    return any(part in words for part in phrases)


def is_out_of_process_memory(problem: OSError) -> bool:
    """Return whether the system could not provide memory, or could not start a process for lack of memory."""
    if problem.errno != EAGAIN:
        return problem.errno == ENOMEM
    place = problem.__traceback__
    while place is not None and place.tb_next is not None:
        place = place.tb_next
    return place is not None and place.tb_frame.f_globals.get("__name__") in _PROCESS_STARTING_MODULES


@contextmanager
def report_failures(operation: str, retry_advice: str = RETRY_ADVICE) -> Iterator[None]:
    """While the context is active, a disk or memory failure ends the command with exit code 3.

    `operation`: the operation that failed, for the message. `retry_advice`: how to continue."""
    try:
        yield
    except (BrokenPipeError, CommandError):  # the reader of standard output has closed it; this is not a disk error
        raise
    except Exception as problem:
        cause = find_machine_failure(problem)
        if cause is None:
            raise
        raise make_failure_error(cause, operation, retry_advice) from None


@contextmanager
def explain_cache_errors(cache: Path | None = None, retry_purpose: str = "to recompute damaged frames") -> Iterator[None]:
    """While the context is active, end the command with advice if a cache cannot be read or written.

    `cache`: the cache; None if damaged frames cannot be recomputed. `retry_purpose`: words to print before the command that
    recomputes them."""
    try:
        yield
    except Exception as error:
        code, advice = _find_cache_advice(error)
        if code is ExitCode.BUG:
            raise
        if cache is not None and not advice:
            from antdsl.outputs.provenance import make_resume_command

            advice = f"{retry_purpose}: {make_resume_command(cache)}"
        raise CommandError(code, f"error: {error}", advice) from None


def _find_cache_advice(error: Exception) -> tuple[ExitCode, str]:
    """Return the exit code and the advice for an error of a cache. If `error` is of another kind, the code is BUG.

    There is no advice about damaged frames, because the caller adds the command that recomputes them."""
    from antdsl.outputs.cache.cache_reader import CacheError
    from antdsl.outputs.cache.cache_writer import DifferentHashes, DifferentInputs, ForeignFolder, PathBlocked
    from antdsl.outputs.cache.lock import FolderLocked
    from antdsl.outputs.cache.manifest import ManifestError
    from antdsl.outputs.edits.edit_layer import NotEditable
    from antdsl.outputs.gallery import PictureUnavailable
    from antdsl.outputs.recording import NothingToResume

    attribute = "add it to the scene's `output: {attributes: …}` and run again"
    rows: dict[type[Exception], tuple[ExitCode, str]] = {
        ManifestError: (ExitCode.INPUT_OUTPUT, "name the folder that `antdsl run` printed"),
        CacheError: (ExitCode.INPUT_OUTPUT, ""),
        NotEditable: (ExitCode.FINDINGS, attribute),
        PictureUnavailable: (ExitCode.FINDINGS, attribute),
        ForeignFolder: (ExitCode.INPUT_OUTPUT, "name another folder with `--out`, or write into it anyway with `--force`"),
        PathBlocked: (ExitCode.INPUT_OUTPUT, "move it away, or name another folder with `--out`"),
        FolderLocked: (ExitCode.INPUT_OUTPUT, "wait for it, or name another folder with `--out`"),
        DifferentInputs: (ExitCode.FINDINGS, "restore the same inputs, or run without `--resume` to start again"),
        DifferentHashes: (ExitCode.FINDINGS, "run without `--resume` to begin again"),
        NothingToResume: (ExitCode.INPUT_OUTPUT, "run without `--resume` to begin again"),
    }
    return rows.get(type(error), (ExitCode.BUG, ""))


def find_machine_failure(problem: Exception) -> OSError | MemoryError | None:
    """Return the disk or memory error that caused an error of any library, or None if there is none."""
    if is_out_of_memory(problem):
        return MemoryError()
    return problem if isinstance(problem, OSError) else None


def make_failure_error(problem: OSError | MemoryError, operation: str = "", retry_advice: str = RETRY_ADVICE) -> CommandError:
    """Return the exception that ends a command after a disk or memory failure, with a message about it."""
    if isinstance(problem, MemoryError):
        words = "error: out of memory; use fewer agents, larger cells or a lighter mesh"
        return CommandError(ExitCode.INPUT_OUTPUT, words, f"once there is more, {retry_advice}")
    if problem.errno == errno.ENOENT and not problem.filename and not _has_working_directory():
        return CommandError(
            ExitCode.INPUT_OUTPUT, "error: the working directory was removed", f"change to another folder, then {retry_advice}"
        )
    place = f": `{problem.filename}`" if problem.filename else ""
    words = f"error: {operation}{': ' if operation else ''}{(problem.strerror or str(problem)).lower()}{place}"
    return CommandError(ExitCode.INPUT_OUTPUT, words, f"{describe_recovery(problem)} {retry_advice}")


def make_missing_package_error(problem: Exception) -> CommandError | None:
    """Return the error for a command that needs a package which is not installed; None for any other problem."""
    from antdsl.packages import INSTALL_ADVICE, find_missing_distribution

    if (distribution := find_missing_distribution(problem)) is not None:
        words = f"error: this command needs the package {distribution}, which is not installed"
        return CommandError(ExitCode.INPUT_OUTPUT, words, INSTALL_ADVICE)
    if isinstance(problem, ImportError) and problem.name == "open3d":  # installed, but the system lacks a library
        return CommandError(ExitCode.INPUT_OUTPUT, f"error: {problem}", "`antdsl doctor` lists everything that is missing")
    return None


def limit_threads() -> None:
    """Limit the threads of NumPy's linear algebra if the address space of this process is limited. Call this before importing
    NumPy.

    That library reserves memory for each thread, and ends the process if this fails. Raises CommandError if the limit is too low
    even for one thread."""
    from antdsl.numerics.processor.host import get_address_space_limit

    memory_limit = get_address_space_limit()
    if memory_limit == inf:
        return
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if memory_limit < limits.COMMAND_MEMORY_BYTES:
        needed, have = (f"{size / limits.MIB:,.0f} MiB" for size in (limits.COMMAND_MEMORY_BYTES, memory_limit))
        words = f"error: out of memory: this process may have {have} of address space, and needs {needed}"
        raise CommandError(ExitCode.INPUT_OUTPUT, words, f"allow more (`ulimit -v`), then {RETRY_ADVICE}")


def _has_working_directory() -> bool:
    try:
        os.getcwd()
    except OSError:
        return False
    return True


def describe_recovery(problem: OSError) -> str:
    """Return the start of a sentence that says what the user must do before the command can continue."""
    return _ADVICE_BY_ERRNO.get(problem.errno or 0, "once that is corrected,")
