"""A lock that allows only one run at a time in a cache's folder. It is released when the processes that hold it end, even if they
are killed."""

from __future__ import annotations

import errno
import os
import platform
import time
from contextlib import suppress
from pathlib import Path
from types import TracebackType

from antdsl.atomic_write import name_path_in_errors

LOCK_FILE_NAME = "lock"
_OPEN_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_NOFOLLOW", 0)
_MAX_WAIT_SECONDS = 30.0  # seconds for the writer of a killed run to finish its jobs
_RETRY_SECONDS = 0.01
_HELD_LOCK_ERRORS = (errno.EWOULDBLOCK, errno.EACCES, errno.EDEADLK)  # errors for a lock that another process holds


class FolderLocked(Exception):
    """Error if another run is writing to the folder. The message contains the process id of this run."""


class FolderLock:
    """The lock of a cache's folder, held from `__enter__` to `__exit__`.

    Processes forked in this time also hold it, until they end. Raises FolderLocked if another run holds the lock, and OSError if
    the file system does not support locks.

    The file contains the process id and the host, for people to read. The lock itself belongs to the operating system, so it
    never outlives its processes. If the run that held the lock has ended but its writer has not, `__enter__` waits for the
    writer.

    A file with other hard links is replaced instead of written to. So the lock changes neither a hard-link copy of the cache nor
    a file outside the cache."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOCK_FILE_NAME
        self._handle: int | None = None

    def __enter__(self) -> FolderLock:
        while self._handle is None:
            self._handle = self._open_locked()
        return self

    def _open_locked(self) -> int | None:
        """Return the handle of the lock file, opened and locked. None if the file had other names; then the next call
        succeeds."""
        handle = os.open(self.path, _OPEN_FLAGS, 0o644)
        try:
            self._wait_for_lock(handle)
            if not self._is_only_name(handle):
                _unlock_file(handle)
                os.close(handle)
                return None
            with name_path_in_errors(self.path):
                os.ftruncate(handle, 0)
                os.lseek(handle, 0, os.SEEK_SET)
                os.write(handle, f"{os.getpid()} {_find_host_name()}\n".encode())
        except BaseException:
            _unlock_file(handle)
            os.close(handle)
            raise
        return handle

    def _is_only_name(self, handle: int) -> bool:
        """Return whether the open file has no other name than the path. If it has, remove the path."""
        opened = os.fstat(handle)
        try:
            named = os.stat(self.path, follow_symlinks=False)
        except FileNotFoundError:
            return False
        if not os.path.samestat(opened, named):  # another run has replaced the file since
            return False
        if opened.st_nlink > 1:
            os.unlink(self.path)
            return False
        return True

    def _wait_for_lock(self, handle: int) -> None:
        """Lock the open file. If the run that held the lock has ended, wait for its writer. Raises FolderLocked if a process
        still holds it."""
        began = time.monotonic()
        while True:
            try:
                _try_lock(handle)
                return
            except OSError as error:
                if error.errno not in _HELD_LOCK_ERRORS:  # for example a network disk without its lock service
                    raise OSError(error.errno, os.strerror(error.errno or 0), str(self.path)) from None
                process, host = _read_holder(handle)
                if not _has_ended(process, host) or time.monotonic() - began > _MAX_WAIT_SECONDS:
                    where = f" of {host}" if host not in ("", _find_host_name()) else ""
                    raise FolderLocked(f"process {process or '?'}{where} is writing to `{self.path.parent}`") from None
            time.sleep(_RETRY_SECONDS)

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        if self._handle is not None:
            handle, self._handle = self._handle, None
            with suppress(OSError):  # the text in the file is for people only
                os.ftruncate(handle, 0)
            _unlock_file(handle)
            os.close(handle)


def _find_host_name() -> str:
    """Return the name of this machine or container. Process ids are only meaningful together with this name."""
    return "".join(each for each in platform.node() if each.isascii() and each.isprintable() and each != " ")[:64]


def _read_holder(handle: int) -> tuple[str, str]:
    """Return the process id and the host that the file contains. Both are empty if the system does not permit to read it
    (Windows)."""
    try:
        os.lseek(handle, 0, os.SEEK_SET)
        words = os.read(handle, 128).decode("ascii", "replace").split()
    except OSError:
        return "", ""
    return (words[0] if words and words[0].isdigit() else "", words[1] if len(words) > 1 and words[1].isprintable() else "")


def _has_ended(holder: str, host: str) -> bool:
    """Return whether a process of this host has certainly ended. A zombie process counts as ended."""
    if os.name == "nt" or host not in ("", _find_host_name()) or not (holder.isascii() and holder.isdigit()):
        return False  # Windows releases a lock when the process that holds it ends
    try:
        os.kill(int(holder), 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:
        return False
    try:
        words = Path(f"/proc/{holder}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        return False
    return words.rpartition(")")[2].split()[:1] == ["Z"]


def _try_lock(handle: int) -> None:
    """Lock an open file without waiting. Raises OSError if another process holds the lock."""
    if os.name == "nt":
        import msvcrt

        msvcrt.locking(handle, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined]
    else:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)


def _unlock_file(handle: int) -> None:
    """Unlock an open file for all processes that share it. Otherwise a process that another run forked would still hold the
    lock."""
    if os.name != "nt":
        import fcntl

        with suppress(OSError):  # some file systems have no locks
            fcntl.flock(handle, fcntl.LOCK_UN)
