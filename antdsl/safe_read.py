"""Size-limited reads of files that a user names. Only this module opens such files.

It opens only regular files, never waits, and reads at most a given number of bytes."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import IO

_READ_BLOCK_BYTES = 1 << 20
_READ_FLAGS = os.O_RDONLY | sum(getattr(os, flag, 0) for flag in ("O_NONBLOCK", "O_CLOEXEC", "O_BINARY", "O_NOCTTY"))
_SUPPORTS_FOLDER_HANDLE = os.open in os.supports_dir_fd and os.stat in os.supports_dir_fd

PathName = str | os.PathLike[str]


class NotRegularFileError(OSError):
    """Error for a folder, a pipe, a socket or a device. The message names the kind of file, so that it can follow `FILE is`."""

    def __init__(self, kind: str) -> None:
        super().__init__(errno.EINVAL, f"it is {kind}")
        self.kind = kind

    def __str__(self) -> str:
        return self.kind


class FileTooLargeError(OSError):
    """Error for a file that is larger than allowed. `size`: the size of the file in bytes. `cap`: the largest allowed size."""

    def __init__(self, size: int, cap: int) -> None:
        super().__init__(errno.EFBIG, f"it has {size:,} bytes; the limit is {cap:,}")
        self.size, self.cap = size, cap


def resolve_path(path: PathName) -> Path:
    """Return a path with all links resolved. This never raises: a link that points to itself is resolved as far as possible."""
    return Path(os.path.realpath(path))


def open_regular_file(path: PathName, *, follows_links: bool = True, folder: int | None = None) -> int:
    """Return a handle on a regular file. The caller must close it. Raises NotRegularFileError or another OSError.

    `follows_links`: whether to follow a link at the end of the path.
    `folder`: the handle of an open folder, to which the path is relative.

    Other kinds of files are not even opened, because opening alone can wake the writer of a pipe or start a device. If the file
    is replaced after the check, O_NONBLOCK prevents waiting, and the type of the opened file is checked again."""
    below = {"dir_fd": folder} if folder is not None and _SUPPORTS_FOLDER_HANDLE else {}
    try:
        _require_regular_file(os.stat(path, follow_symlinks=follows_links, **below))
        handle = os.open(path, _READ_FLAGS | (0 if follows_links else getattr(os, "O_NOFOLLOW", 0)), **below)
    except ValueError:  # a name with a zero character
        raise OSError(errno.EINVAL, "no file can have this name") from None
    try:
        _require_regular_file(os.fstat(handle))
    except BaseException:
        os.close(handle)
        raise
    return handle


def _require_regular_file(status: os.stat_result) -> None:
    if stat.S_ISLNK(status.st_mode):
        raise OSError(errno.ELOOP, "it is a link")
    if not stat.S_ISREG(status.st_mode):
        raise NotRegularFileError("a folder" if stat.S_ISDIR(status.st_mode) else "not a regular file")


def read_checked_size(file_handle: int, cap: int) -> int:
    """Return the size of an open file in bytes. Raises FileTooLargeError if it exceeds `cap` bytes."""
    size = os.fstat(file_handle).st_size
    if size > cap:
        raise FileTooLargeError(size, cap)
    return size


def read_blocks(handle: int, cap: int) -> Iterator[bytes]:
    """Yield the contents of an open file in blocks. The handle stays open.

    Raises FileTooLargeError if the file has more than `cap` bytes: before any read, or as soon as a growing file exceeds the
    limit."""
    read_checked_size(handle, cap)
    left = cap + 1
    while part := os.read(handle, min(left, _READ_BLOCK_BYTES)):
        left -= len(part)
        if left <= 0:
            raise FileTooLargeError(max(os.fstat(handle).st_size, cap + 1), cap)
        yield part


def read_handle(handle: int, cap: int) -> bytes:
    """Read an open file to its end, close it, and return its bytes. Raises FileTooLargeError if it has more than `cap` bytes."""
    try:
        return b"".join(read_blocks(handle, cap))
    finally:
        os.close(handle)


def read_size_limited(path: PathName, cap: int, *, follows_links: bool = True) -> bytes:
    """Return all bytes of a regular file. Raises NotRegularFileError, FileTooLargeError if the file has more than `cap` bytes,
    or another OSError. `follows_links`: as in `open_regular_file`."""
    return read_handle(open_regular_file(path, follows_links=follows_links), cap)


def read_first_bytes(path: PathName, count: int) -> bytes:
    """Return the first `count` bytes of a regular file, or all if it has fewer. Links are followed. Raises OSError if there is
    no such file."""
    handle = open_regular_file(path)
    try:
        return os.read(handle, count)
    finally:
        os.close(handle)


def open_size_limited(path: PathName, cap: int, *, follows_links: bool = True) -> IO[bytes]:
    """Open a regular file of at most `cap` bytes for random access. Raises NotRegularFileError, FileTooLargeError or another
    OSError.

    `follows_links`: as in `open_regular_file`."""
    handle = open_regular_file(path, follows_links=follows_links)
    try:
        read_checked_size(handle, cap)
        return os.fdopen(handle, "rb")
    except BaseException:
        os.close(handle)
        raise
