"""Atomic writes: a file gets its name only after it has been written completely. This module writes, syncs and moves all files.

With `sync=True`, the default, a file is on the disk before it gets its name. So a power loss leaves the old file or the new one.
`sync=False` is for files that need not wait for the disk one by one. Some are checked against a hash on every read, so a damaged
one is detected and created again. Others are the many files of one command, which a repeated command creates again. For these,
`sync_files` writes all of them to the disk before the command ends.
"""

from __future__ import annotations

import errno
import os
import re
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import lru_cache
from io import BufferedWriter, FileIO
from itertools import islice
from pathlib import Path
from typing import IO, cast

PART_SUFFIX = ".part"
BytesParts = Sequence[bytes | memoryview]
_MAX_NAME_CHARACTERS = 40  # characters of a name that are retained, so that no system rejects the new name as too long
_MAX_NAME_ATTEMPTS = 8
_UNSUPPORTED_SYNC_ERRORS = (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP)  # of file systems that cannot sync a folder
_PARTS_PER_WRITE = 1000  # parts; systems take 1024
_NEW_FILE_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
_APPEND_FLAGS = os.O_WRONLY | os.O_APPEND | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


def write_atomically(path: Path, data: bytes | BytesParts, *, sync: bool = True, mode: int = 0o666) -> None:
    """Write a file atomically.

    `data`: its bytes, or parts to be joined. `mode`: its permissions, before the system applies the umask.

    A reader, even after a crash, sees either the old file or the complete new one. Raises OSError that names `path`; the old
    file then remains.
    """
    with _open_atomic(path, sync, mode) as handle:
        write_parts(handle, [data] if isinstance(data, bytes) else data)


@contextmanager
def atomic_file(path: Path, *, sync: bool = True) -> Iterator[IO[bytes]]:
    """Yield a binary file to write piece by piece. It replaces `path` when the context ends. Other rules are as for
    `write_atomically`."""
    with _open_atomic(path, sync, 0o666) as handle, FileIO(handle, "wb", closefd=False) as raw, BufferedWriter(raw) as file:
        yield cast(IO[bytes], file)


@contextmanager
def atomic_path(path: Path, suffix: str = PART_SUFFIX, *, sync: bool = True) -> Iterator[Path]:
    """Yield a path for libraries and programs that open files by name. The file at this path replaces `path` when the context
    ends. `suffix`: the suffix of the temporary file, for programs that depend on it."""
    part = create_sibling_file(path, suffix)
    with _move_into_place(str(part), path, sync):
        yield part
        if sync:
            sync_file(part)


def create_sibling_file(path: Path, suffix: str = PART_SUFFIX) -> Path:
    """Create a new empty file next to `path`, and return its path. Raises OSError if no file can be created. Existing files,
    links or pipes are neither opened, written nor removed."""
    new, handle = _open_new_file(path, suffix, 0o666)
    os.close(handle)
    return Path(new)


def _open_new_file(path: Path, suffix: str, mode: int) -> tuple[str, int]:
    """Create a new empty file as `create_sibling_file` does, and open it for writing. Return its path and its handle."""
    place, name = os.path.split(path)
    remove_stale_parts(place)
    for left in reversed(range(_MAX_NAME_ATTEMPTS)):
        new = os.path.join(
            place, f".{name[:_MAX_NAME_CHARACTERS]}.{_compute_machine_id()}-{os.getpid():x}-{os.urandom(6).hex()}{suffix}"
        )
        try:
            return new, os.open(new, _NEW_FILE_FLAGS, mode)
        except FileExistsError:
            if not left:
                raise
        except OSError as problem:
            problem.filename = str(path)  # the name of the part says nothing to a person
            raise
    raise AssertionError


# The name that `_open_new_file` gives: which machine, which process, chance.
_PART_NAME_PATTERN = re.compile(r"\..{1,40}\.([0-9a-f]{8})-([0-9a-f]{1,8})-[0-9a-f]{12}(?:\.\w{1,8})+", re.DOTALL)
_cleaned_folders: set[tuple[int, str]] = set()


def remove_stale_parts(folder: str) -> None:
    """Remove the unfinished files that killed processes have left in a folder. Runs at most once per folder and process.

    Only regular files of this user are removed, with the name pattern of antdsl's unfinished files. Their process must have run
    on this machine and in this container, and must have ended. Clocks are not used. Does nothing on Windows, where testing for a
    process is not safe.
    """
    key = (os.getpid(), os.path.abspath(folder or "."))
    if key in _cleaned_folders or os.name == "nt":
        return
    _cleaned_folders.add(key)
    with suppress(OSError), os.scandir(folder or ".") as entries:
        for entry in entries:
            match = _PART_NAME_PATTERN.fullmatch(entry.name) if entry.name.startswith(".") else None
            if match is None or match[1] != _compute_machine_id() or _is_process_running(int(match[2], 16)):
                continue
            with suppress(OSError):
                if entry.is_file(follow_symlinks=False) and entry.stat(follow_symlinks=False).st_uid == os.geteuid():
                    os.unlink(entry.path)


def _is_process_running(process: int) -> bool:
    """Return whether a process with this id is running."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _compute_machine_id() -> str:
    """Return eight digits that identify this machine, for the names of temporary files.

    In a container, they identify the container, because it has its own process numbers."""
    return _cached_machine_id(os.getpid())


@lru_cache(1)
def _cached_machine_id(process: int) -> str:
    """Return the result of `_compute_machine_id`, cached for this process. `process`: the id of this process."""
    from hashlib import blake2b

    space = ""
    with suppress(OSError):
        space = os.readlink("/proc/self/ns/pid")
    node = os.uname().nodename if hasattr(os, "uname") else ""
    return blake2b(f"{node} {space}".encode(), digest_size=4).hexdigest()


@contextmanager
def _open_atomic(path: Path, sync: bool, mode: int) -> Iterator[int]:
    """Yield the handle of a temporary file that replaces `path` when the context ends."""
    part, handle = _open_new_file(path, PART_SUFFIX, mode)
    with _move_into_place(part, path, sync):
        try:
            # The file is emptied before anything is written. Ext4 then treats it as rewritten, and begins writing it to disk on
            # close. Syncing many such files later takes two thirds of the time.
            os.ftruncate(handle, 0)
            yield handle
            if sync:
                os.fsync(handle)
        finally:
            os.close(handle)


def create_file_atomically(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Create a file that has its complete content as soon as it has its name. Raises FileExistsError if the name is taken, and
    another OSError if the file cannot be written. `mode`: as in `write_atomically`."""
    part, handle = _open_new_file(path, PART_SUFFIX, mode)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
        os.link(part, path, follow_symlinks=False)
    finally:
        with suppress(OSError):
            os.unlink(part)


@contextmanager
def _move_into_place(part: str, path: Path, sync: bool) -> Iterator[None]:
    """Move the file `part` to `path` when the context ends. If anything fails, remove `part`; an OSError then names `path`."""
    try:
        yield
        _replace_file(part, path)
    except BaseException as problem:
        with suppress(OSError):
            os.unlink(part)
        if isinstance(problem, OSError) and os.path.basename(str(problem.filename or "")) == os.path.basename(part):
            problem.filename = None
        with name_path_in_errors(path):
            raise
    if sync:
        try:
            sync_folder(Path(path).parent)
        except OSError as problem:  # the folder may be `.`, which would not identify the file
            raise OSError(problem.errno, problem.strerror, str(path)) from None


def _replace_file(part: str, path: Path) -> None:
    """Rename `part` to `path` as `os.replace` does. Retry a few times, because on Windows a reader may hold the old file open."""
    for attempt in range(5):
        try:
            os.replace(part, path)
            return
        except PermissionError:
            if attempt == 4 or os.name != "nt":
                raise
            import time

            time.sleep(0.02 * 2**attempt)


@contextmanager
def name_path_in_errors(path: Path) -> Iterator[None]:
    """While the context is active, add `path` to each OSError that does not name a file."""
    try:
        yield
    except OSError as problem:
        if problem.errno is not None and problem.filename is None:
            problem.filename, problem.filename2 = str(path), None
        raise


class AppendOnlyFile:
    """A file that grows at its end. Its errors are OSErrors that name the file. The caller must close it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._handle = os.open(path, _APPEND_FLAGS, 0o666)

    def write(self, parts: BytesParts) -> None:
        """Append data. It is on the disk after the next `sync`; until then, possibly only its beginning is."""
        with name_path_in_errors(self._path):
            write_parts(self._handle, parts)

    def sync(self) -> None:
        """Write all appended data to the disk."""
        with name_path_in_errors(self._path):
            os.fsync(self._handle)

    def close(self) -> None:
        """Close the file. Call this once."""
        os.close(self._handle)


def write_parts(handle: int, parts: BytesParts) -> None:
    """Write parts into an open file, one after the other. If the system supports it, one call writes all parts, because
    allocating one large piece takes half the time of many small ones."""
    left = deque(parts)
    while left:
        batch = list(islice(left, _PARTS_PER_WRITE))
        written_count = os.writev(handle, batch) if hasattr(os, "writev") else os.write(handle, batch[0])
        while left and written_count >= len(left[0]):
            written_count -= len(left.popleft())
        if written_count:
            left[0] = left[0][written_count:]


def sync_file(path: Path) -> None:
    """Make sure that the data already written to a file is on the disk."""
    handle = os.open(path, os.O_RDWR)
    try:
        with name_path_in_errors(path):
            os.fsync(handle)
    finally:
        os.close(handle)


def sync_files(paths: Iterable[Path]) -> None:
    """Make sure that the data and the names of existing files are on the disk. Raises OSError if this fails."""
    folders: dict[Path, None] = {}
    for path in paths:
        sync_file(path)
        folders[path.parent] = None
    for folder in folders:
        sync_folder(folder)


def sync_folder(folder: Path) -> None:
    """Make sure that the names of files in a folder are on the disk, if the system supports this."""
    if os.name == "nt":
        return
    try:
        handle = os.open(folder, os.O_RDONLY)
    except PermissionError:  # a folder that may be written into and not be listed
        return
    try:
        with name_path_in_errors(folder):
            os.fsync(handle)
    except OSError as problem:
        if problem.errno not in _UNSUPPORTED_SYNC_ERRORS:
            raise
    finally:
        os.close(handle)


def create_folder_durably(folder: Path) -> None:
    """Create a folder and its missing parents, and make sure that they are on the disk. Raises OSError if this fails."""
    missing = [each for each in (folder, *folder.parents) if not each.exists()]
    for each in reversed(missing):
        each.mkdir(exist_ok=True)
        sync_folder(each.parent)
    if not missing and not folder.is_dir():
        raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(folder))


def is_link(path: Path) -> bool:
    """Return whether a path itself is a link (on Windows, also a junction); False if nothing exists at the path."""
    try:
        status = os.lstat(path)
    except OSError:
        return False
    return os.path.islink(path) or bool(getattr(status, "st_reparse_tag", False))


def find_first_link(base: Path, *names: str) -> Path | None:
    """Return the first of `base/NAME`, `base/NAME/NAME`, … that is a link, or None. Links in `base` itself are not checked,
    because the caller has chosen this path."""
    path = base
    for name in names:
        path /= name
        if is_link(path):
            return path
    return None
