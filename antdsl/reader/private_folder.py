"""The private folder of a process, with the files that its reader may open.

It is removed when the process ends. If the process was killed, the next process of antdsl removes it."""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path

_FOLDER_PREFIX = "antdsl-reader-"
_LOCK_FILE_NAME = "lock"
_FILES_FOLDER_NAME = "files"


class PrivateFolder:
    """A new folder that only the user can open, in the system's folder for temporary files. Raises OSError if it cannot be
    created."""

    def __init__(self) -> None:
        remove_stale_folders()
        self._root_folder = Path(
            os.path.abspath(tempfile.mkdtemp(prefix=_FOLDER_PREFIX))
        )  # the child has another working directory
        self._owner_process_id = os.getpid()
        self._lock = _try_lock(self._root_folder / _LOCK_FILE_NAME, os.O_CREAT)
        self.path = self._root_folder / _FILES_FOLDER_NAME
        self.path.mkdir(mode=0o700)
        self._folder_count = 0

    def create_folder(self) -> Path:
        """Return a new empty folder in the private folder."""
        self._folder_count += 1
        folder = self.path / str(self._folder_count)
        folder.mkdir(mode=0o700)
        return folder

    def remove(self) -> None:
        """Remove the folder with all its contents. In a process that was forked from its owner, do nothing."""
        if self._owner_process_id == os.getpid():
            shutil.rmtree(self._root_folder, ignore_errors=True)
            if self._lock is not None:
                with suppress(OSError):
                    os.close(self._lock)
                self._lock = None


def remove_stale_folders() -> None:
    """Remove the private folders of this user's processes that have ended."""
    with suppress(OSError):
        for entry in os.scandir(tempfile.gettempdir()):
            if entry.name.startswith(_FOLDER_PREFIX) and entry.is_dir(follow_symlinks=False):
                with suppress(OSError):
                    _remove_if_stale(Path(entry.path))


def _remove_if_stale(folder: Path) -> None:
    """Remove a private folder of this user if no process holds the lock of the folder."""
    if hasattr(os, "getuid") and folder.lstat().st_uid != os.getuid():
        return
    lock = _try_lock(folder / _LOCK_FILE_NAME, 0)
    if lock is not None:
        shutil.rmtree(folder, ignore_errors=True)
        os.close(lock)


def _try_lock(path: Path, flags: int) -> int | None:
    """Return a handle that locks a folder until this process ends; None if another process holds the lock or the folder is
    missing."""
    try:
        import fcntl
    except ImportError:  # Windows: an open file cannot be removed, which also acts as a lock
        return os.open(path, os.O_RDWR | flags, 0o600) if flags else None
    try:
        handle = os.open(path, os.O_RDWR | os.O_CLOEXEC | os.O_NOFOLLOW | flags, 0o600)
    except OSError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(handle)
        return None
    return handle
