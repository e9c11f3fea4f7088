"""The folders of the user who runs this process, and private files in them.

The home folder comes from the password database or, on Windows, from the system's known folders. `HOME` and `XDG_*` are not
read, because they may point into an untrusted project, while antdsl trusts the contents of these folders.
"""

from __future__ import annotations

import os
import stat
import sys
from pathlib import Path

from antdsl.safe_read import open_regular_file, read_handle

_LOCAL_APP_DATA_FOLDER_ID = "f1b32785-6fba-4fcf-9d55-7b8e7f157091"  # the known folder for data of one user on one machine


class NotPrivateError(PermissionError):
    """Error for a file or folder that another user could have read or written. The message gives the reason."""


def home_folder() -> Path:
    """Return the home folder of the effective user. Raises OSError if the system knows none, or if it does not exist."""
    try:
        import pwd

        home = pwd.getpwuid(os.geteuid()).pw_dir
    except (ImportError, KeyError):
        raise FileNotFoundError(0, "the password database has no home folder for this user") from None
    if not os.path.isabs(home) or not os.path.isdir(home):
        raise FileNotFoundError(0, "this user's home folder does not exist")
    return Path(home)


def cache_folder() -> Path:
    """Return the user's cache folder, for data that programs can compute again. Raises OSError if the user has no home folder."""
    if sys.platform == "win32":
        return _find_local_app_data()
    return home_folder() / ("Library/Caches" if sys.platform == "darwin" else ".cache")


def config_folder() -> Path:
    """Return the user's configuration folder. Raises OSError if the user has no home folder."""
    if sys.platform == "win32":
        return _find_local_app_data()
    return home_folder() / ("Library/Application Support" if sys.platform == "darwin" else ".config")


def state_folder() -> Path:
    """Return the user's state folder, for data that must survive a restart. Raises OSError if the user has no home folder."""
    return _find_local_app_data() if sys.platform == "win32" else home_folder() / ".local" / "state"


def make_private_folder(path: Path) -> None:
    """Create a folder and its parents, unless they exist. Raises OSError if this fails.

    Raises NotPrivateError if the folder is a link, belongs to another user, or can be written by others."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.mkdir(mode=0o700, exist_ok=True)
    _require_private(os.lstat(path), stat.S_IWGRP | stat.S_IWOTH)


def read_private(path: Path, cap: int) -> bytes:
    """Return the content of a file that only this user can read. `cap`: its largest allowed size in bytes.

    Raises OSError if there is no such file, or if it is a link or not a regular file. Raises NotPrivateError if the file has two
    names, belongs to another user, or is readable or writable by others."""
    _require_private(os.lstat(path.parent), stat.S_IWGRP | stat.S_IWOTH)
    handle = open_regular_file(path, follows_links=False)
    try:
        _require_private(os.fstat(handle), stat.S_IRWXG | stat.S_IRWXO)
    except BaseException:
        os.close(handle)
        raise
    return read_handle(handle, cap)


def _require_private(status: os.stat_result, forbidden_mode_bits: int) -> None:
    """Raise NotPrivateError for a file that others may access. `forbidden_mode_bits`: permission bits that a private file must
    not have. On Windows, access lists control this; those of a user's own folders exclude others."""
    if stat.S_ISLNK(status.st_mode) or getattr(status, "st_reparse_tag", False):
        raise NotPrivateError(0, "it is a link")
    if stat.S_ISREG(status.st_mode) and status.st_nlink > 1:
        raise NotPrivateError(0, "it has another hard link")
    if sys.platform == "win32":
        return
    if status.st_uid != os.geteuid():
        raise NotPrivateError(0, "it belongs to another user")
    if status.st_mode & forbidden_mode_bits:
        raise NotPrivateError(
            0, "others may read or write it" if forbidden_mode_bits & stat.S_IROTH else "others may write to it"
        )


def _find_local_app_data() -> Path:
    if sys.platform != "win32":
        raise FileNotFoundError(0, "only Windows has this folder")
    import ctypes
    from uuid import UUID

    folder_pointer = ctypes.c_wchar_p()
    name = (ctypes.c_char * 16).from_buffer_copy(UUID(_LOCAL_APP_DATA_FOLDER_ID).bytes_le)
    failed = ctypes.windll.shell32.SHGetKnownFolderPath(name, 0, None, ctypes.byref(folder_pointer))
    try:
        if failed or not folder_pointer.value:
            raise FileNotFoundError(0, "Windows has no data folder for this user")
        return Path(folder_pointer.value)
    finally:
        ctypes.windll.ole32.CoTaskMemFree(folder_pointer)
