"""Files that are put in their place whole: written beside it under a name that nothing has, then moved there in one go."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

PART = ".part"
_LONGEST = 40  # characters of a name that are kept, so that no system finds the new one too long
_TRIES = 8
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


def new_beside(path: Path, ending: str = PART, mode: int = 0o666) -> Path:
    """An empty file of our own beside a path. Whatever is there, also a link or a pipe, is neither opened nor written into nor
    taken away. Raises OSError where none can be made."""
    new, handle = _new(path, ending, mode)
    os.close(handle)
    return Path(new)


def _new(path: Path, ending: str, mode: int) -> tuple[str, int]:
    """The same, open to be written: its path, and its handle."""
    place, name = os.path.split(path)
    for left in reversed(range(_TRIES)):
        new = os.path.join(place, f".{name[:_LONGEST]}.{os.urandom(6).hex()}{ending}")
        try:
            return new, os.open(new, _NEW, mode)
        except FileExistsError:
            if not left:
                raise
    raise AssertionError


@contextmanager
def whole(path: Path, ending: str = PART, mode: int = 0o666) -> Iterator[Path]:
    """A file to write that takes the place of `path` at the end: a reader, or whoever comes after a crash, sees the old one or
    all of the new one. Where anything fails the old one is left as it was, and an OSError names `path`. `ending`: what the file
    that is written ends in, for those who go by it; `mode`: who may read and write it, less what the system keeps from new
    files."""
    part = new_beside(path, ending, mode)
    with _placed(str(part), path):
        yield part


@contextmanager
def whole_opened(path: Path) -> Iterator[int]:
    """The same as a handle of the file, open to be written."""
    part, handle = _new(path, PART, 0o666)
    with _placed(part, path):
        try:
            yield handle
        finally:
            os.close(handle)


def create_complete(path: Path, data: bytes, mode: int = 0o666) -> None:
    """A new file that has all of its content from the moment it has its name. FileExistsError where the name is taken; another
    OSError where it cannot be written. `mode`: as of `whole`."""
    part, handle = _new(path, PART, mode)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.link(part, path, follow_symlinks=False)
    finally:
        with suppress(OSError):
            os.unlink(part)


@contextmanager
def _placed(part: str, path: Path) -> Iterator[None]:
    """Move what has been written to its place; where anything fails remove it, and have an OSError name `path`."""
    try:
        yield
        _replace(part, path)
    except BaseException as problem:
        with suppress(OSError):
            os.unlink(part)
        if isinstance(problem, OSError) and problem.errno is not None and problem.filename in (None, part, Path(part)):
            problem.filename, problem.filename2 = str(path), None
        raise


def _replace(part: str, path: Path) -> None:
    """`os.replace`; where a reader may hold the old file open (Windows) a few more times."""
    for attempt in range(5):
        try:
            os.replace(part, path)
            return
        except PermissionError:
            if attempt == 4 or os.name != "nt":
                raise
            import time

            time.sleep(0.02 * 2**attempt)
