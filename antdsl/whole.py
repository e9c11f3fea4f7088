"""Files that are put in their place whole: written beside it under a name that nothing has, then moved there in one go."""

from __future__ import annotations

import os
import re
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
    remove_stale(place)
    for left in reversed(range(_TRIES)):
        new = os.path.join(place, f".{name[:_LONGEST]}.{_machine()}-{os.getpid():x}-{os.urandom(6).hex()}{ending}")
        try:
            return new, os.open(new, _NEW, mode)
        except FileExistsError:
            if not left:
                raise
    raise AssertionError


# The name that `_new` gives: which machine, which process, chance.
_STALE = re.compile(r"\..{1,40}\.([0-9a-f]{8})-([0-9a-f]{1,8})-[0-9a-f]{12}(?:\.\w{1,8})+", re.DOTALL)
_cleaned: set[tuple[int, str]] = set()


def remove_stale(folder: str) -> None:
    """Remove files from a folder that a process began to write here and was killed. Once for each folder and process.

    Only regular files of this user with a name of ours are removed, whose process ran on this machine (in this container) and
    is gone. No clock is looked at. Not on Windows, where a process cannot be looked for without harm."""
    key = (os.getpid(), os.path.abspath(folder or "."))
    if key in _cleaned or os.name == "nt":
        return
    _cleaned.add(key)
    with suppress(OSError), os.scandir(folder or ".") as entries:
        for entry in entries:
            found = _STALE.fullmatch(entry.name) if entry.name.startswith(".") else None
            if found is None or found[1] != _machine() or _is_running(int(found[2], 16)):
                continue
            with suppress(OSError):
                if entry.is_file(follow_symlinks=False) and entry.stat(follow_symlinks=False).st_uid == os.geteuid():
                    os.unlink(entry.path)


def _is_running(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _machine() -> str:
    """Eight digits for this machine, and for the container whose process numbers are seen here."""
    from zlib import crc32

    space = ""
    with suppress(OSError):
        space = os.readlink("/proc/self/ns/pid")
    node = os.uname().nodename if hasattr(os, "uname") else ""
    return f"{crc32(f'{node} {space}'.encode()):08x}"


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
