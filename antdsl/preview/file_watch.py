"""Detection of changed files by polling, which works on every disk and with every editor.

A change is reported only once the file has stopped changing."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from threading import Event
from time import monotonic

from antdsl.safe_read import FileTooLargeError, open_regular_file, read_blocks

_UNCHANGED_SECONDS = 0.03  # a file is read after it was unchanged for this time
_MISSING_FILE_SECONDS = 0.3  # the same for a missing or empty file, which is the middle of a save in most editors
# small files are read again after this time without a sign of change, because clocks of disks can be coarse
_REREAD_SECONDS = 1.0
_SMALL_FILE_BYTES = 1 << 20
_REREAD_BYTES_PER_POLL = 1 << 20  # bytes of such files that are read per poll
_MAX_READ_BYTES = 1 << 26  # maximum number of bytes read from a file; a larger file is identified by its date and size
_UNKNOWN_HASH = b""  # differs from the hash of any contents

FileStamp = tuple[int, int, int] | None


@dataclass(slots=True)
class _WatchedFile:
    """The recorded state of one file. `contents`: a hash of the contents at the last reading; None for a missing file. `stamp`:
    the last file stamp. `read_stamp`: the file stamp at the last reading. Times are in seconds of the clock."""

    stamp: FileStamp
    contents: bytes | None  # a hash; None for a missing file
    read_stamp: FileStamp  # stamp of the file when it was read
    changed_time: float | None = None  # time at which a change was found; None without a pending change
    read_time: float = 0.0
    is_unreported: bool = False  # whether the current contents are not yet reported


class FileWatch:
    """Watches files for changes.

    `paths`: called at each poll, because an edit may add files. `opened`: returns a handle to a regular file, or raises OSError.
    `clock`: returns the time in seconds. A path that is not a regular file counts as missing."""

    def __init__(
        self,
        list_paths: Callable[[], Iterable[Path]],
        *,
        open_file: Callable[[Path], int] = open_regular_file,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._list_paths, self._open_file, self._clock = list_paths, open_file, clock
        self._files: dict[Path, _WatchedFile] = {}
        self._remaining_bytes = 0  # bytes that this poll may still read without a sign of change
        self.find_changed_files()

    def find_changed_files(self) -> tuple[Path, ...]:
        """Return the files that have stopped changing and now differ from what was last reported, or from what was first read."""
        now, paths, self._remaining_bytes = self._clock(), list(dict.fromkeys(self._list_paths())), _REREAD_BYTES_PER_POLL
        changed = [path for path in paths if path in self._files and self._is_changed(path, self._files[path], now)]
        for path in paths:
            if path not in self._files:
                self._files[path] = _WatchedFile(stamp := _read_stamp(path), self._hash_contents(path), stamp, read_time=now)
        for path in set(self._files) - set(paths):
            del self._files[path]
        return tuple(changed)

    def recheck_unstable_files(self) -> None:
        """Record that other code has just read the files.

        A file that is being written now is reported once it stops changing, even if its contents end up the same as before."""
        for path, file in self._files.items():
            if _read_stamp(path) != file.read_stamp:
                file.contents = _UNKNOWN_HASH

    def is_any_file_being_written(self) -> bool:
        """Return whether a file has changed and may still be incomplete. Each change is reported only once."""
        changed_files = [file for file in self._files.values() if file.is_unreported]
        for file in changed_files:
            file.is_unreported = False
        return any(file.stamp is not None and file.stamp[1] > 0 for file in changed_files)

    def wait_for_changes(self, stop: Event, interval: float = 0.02) -> Iterator[tuple[Path, ...]]:
        """Wait for changes, and yield the changed files, until `stop` is set. `interval`: seconds between two polls."""
        while not stop.wait(interval):
            changed = self.find_changed_files()
            if changed:
                yield changed

    def _is_changed(self, path: Path, watched_file: _WatchedFile, time: float) -> bool:
        stamp = _read_stamp(path)
        if stamp != watched_file.stamp:
            watched_file.stamp, watched_file.changed_time, watched_file.is_unreported = stamp, time, True
        elif (
            watched_file.changed_time is None
            and stamp is not None
            and stamp[1] <= _SMALL_FILE_BYTES
            and time - watched_file.read_time >= _REREAD_SECONDS
            and self._remaining_bytes > 0
        ):
            watched_file.changed_time = time
            self._remaining_bytes -= stamp[1]
        if watched_file.changed_time is None or time - watched_file.changed_time < (
            _MISSING_FILE_SECONDS if stamp is None or stamp[1] == 0 else _UNCHANGED_SECONDS
        ):
            return False
        contents = self._hash_contents(path)
        if _read_stamp(path) != stamp:  # written while it was read
            watched_file.changed_time = time
            return False
        watched_file.changed_time, watched_file.read_time, watched_file.is_unreported = None, time, False
        other, watched_file.contents, watched_file.read_stamp = contents != watched_file.contents, contents, stamp
        return other

    def _hash_contents(self, path: Path) -> bytes | None:
        """Return a hash of the contents of a regular file, or None if it is missing. For a large file, hash only its file
        stamp."""
        hashed = blake2b(digest_size=16)
        try:
            handle = self._open_file(path)
        except (OSError, ValueError):
            return None
        try:
            for block in read_blocks(handle, _MAX_READ_BYTES):
                hashed.update(block)
        except FileTooLargeError:
            return repr(_read_stamp(path)).encode()
        except OSError:
            return None
        finally:
            os.close(handle)
        return hashed.digest()


def _read_stamp(path: Path) -> FileStamp:
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino
