"""Detects changed contents of files by polling. So it works on every disk, however editors save
files. A change is reported once the file has stopped changing."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from threading import Event
from time import monotonic

from antdsl.bounded import TooLarge, open_regular, read_blocks

_UNCHANGED_SECONDS = 0.03  # seconds that a file has to stay as it is
_MISSING_FILE_SECONDS = 0.3  # the same for one that is not there or empty: half of a save by most editors
_REREAD_SECONDS = 1.0  # seconds after which small files are read though nothing tells of a change: clocks of disks can be coarse
_SMALL_FILE_BYTES = 1 << 20
_REREAD_BYTES_PER_POLL = 1 << 20  # bytes of such files that are read in one look
_MAX_READ_BYTES = 1 << 26  # bytes of one file that are read; a larger one is known by its date and size alone
_UNKNOWN_HASH = b""  # no hash of any contents

FileStamp = tuple[int, int, int] | None


@dataclass(slots=True)
class _WatchedFile:
    stamp: FileStamp
    contents: bytes | None  # a hash; None for a file that is not there
    held: FileStamp  # when that was read
    since: float | None = None  # when it was found other than before; None: nothing is up
    read: float = 0.0
    stirred: bool = False  # not reported yet


class FileWatch:
    """Watches files. `paths` is called at each poll, because an edit may add files. `opened` returns a handle on a regular file,
    or raises OSError. `clock` returns seconds.

    A path that is not a regular file counts as missing until a regular file replaces it.
    """

    def __init__(
        self,
        paths: Callable[[], Iterable[Path]],
        *,
        opened: Callable[[Path], int] = open_regular,
        clock: Callable[[], float] = monotonic,
    ) -> None:
        self._paths, self._opened, self._clock = paths, opened, clock
        self._files: dict[Path, _WatchedFile] = {}
        self._left = 0  # bytes that may still be read in this look without a sign of change
        self.poll()

    def poll(self) -> tuple[Path, ...]:
        """Return the files that have stopped changing and have other contents than when they were last reported or first read."""
        now, paths, self._left = self._clock(), list(dict.fromkeys(self._paths())), _REREAD_BYTES_PER_POLL
        changed = [path for path in paths if path in self._files and self._is_changed(path, self._files[path], now)]
        for path in paths:
            if path not in self._files:
                self._files[path] = _WatchedFile(stamp := _stamp(path), self._contents(path), stamp, read=now)
        for path in set(self._files) - set(paths):
            del self._files[path]
        return tuple(changed)

    def recheck_changing(self) -> None:
        """Note that other code has just read the files. A file that is changing at this time counts as changed once it stops,
        even if its contents are then the same as before."""
        for path, file in self._files.items():
            if _stamp(path) != file.held:
                file.contents = _UNKNOWN_HASH

    def is_being_written(self) -> bool:
        """Return whether a file has changed and may still be incomplete. Each change is reported once."""
        changed_files = [file for file in self._files.values() if file.stirred]
        for file in changed_files:
            file.stirred = False
        return any(file.stamp is not None and file.stamp[1] > 0 for file in changed_files)

    def wait_for_changes(self, stop: Event, every: float = 0.02) -> Iterator[tuple[Path, ...]]:
        """Wait for changes, and yield the changed files, until `stop` is set. `every`: seconds between two polls."""
        while not stop.wait(every):
            changed = self.poll()
            if changed:
                yield changed

    def _is_changed(self, path: Path, known: _WatchedFile, now: float) -> bool:
        stamp = _stamp(path)
        if stamp != known.stamp:
            known.stamp, known.since, known.stirred = stamp, now, True
        elif (
            known.since is None
            and stamp is not None
            and stamp[1] <= _SMALL_FILE_BYTES
            and now - known.read >= _REREAD_SECONDS
            and self._left > 0
        ):
            known.since = now
            self._left -= stamp[1]
        if known.since is None or now - known.since < (
            _MISSING_FILE_SECONDS if stamp is None or stamp[1] == 0 else _UNCHANGED_SECONDS
        ):
            return False
        contents = self._contents(path)
        if _stamp(path) != stamp:  # written to while it was read
            known.since = now
            return False
        known.since, known.read, known.stirred = None, now, False
        other, known.contents, known.held = contents != known.contents, contents, stamp
        return other

    def _contents(self, path: Path) -> bytes | None:
        """Return a hash of a regular file's content; for a large file, a hash of its stamp."""
        hashed = blake2b(digest_size=16)
        try:
            handle = self._opened(path)
        except (OSError, ValueError):
            return None
        try:
            for block in read_blocks(handle, _MAX_READ_BYTES):
                hashed.update(block)
        except TooLarge:
            return repr(_stamp(path)).encode()
        except OSError:
            return None
        finally:
            os.close(handle)
        return hashed.digest()


def _stamp(path: Path) -> FileStamp:
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_mtime_ns, status.st_size, status.st_ino
