"""Signs stored machine code with a secret key of the user, so that code from any other source is never run.

The secret is 32 random bytes in a file that only the user may read, in the home folder that the password database names. The
signing key is derived from these bytes, the user's number and the machine's identifier. So copies of secret and cache are
useless on other machines."""

from __future__ import annotations

import os
import secrets
import sys
import time
from contextlib import suppress
from functools import cache
from hashlib import blake2b
from hmac import compare_digest
from pathlib import Path

from antdsl.atomic_write import create_file_atomically
from antdsl.safe_read import read_size_limited
from antdsl.user_folders import NotPrivateError, cache_folder, make_private_folder, read_private

SIGNATURE_BYTES = 32
_KEY_BYTES = 32
_MAX_KEY_ATTEMPTS = 50  # attempts to read or create the key
_RETRY_PAUSE_SECONDS = 0.01  # pause between attempts, while another process creates the key
_MACHINE_ID_FILES = ("/etc/machine-id", "/var/lib/dbus/machine-id", "/etc/hostid")


class Signer:
    """A signer that makes and checks signatures, with a key derived from `secret`, this user and this machine."""

    def __init__(self, secret: bytes) -> None:
        user = os.geteuid() if hasattr(os, "geteuid") else os.environ.get("USERNAME", "")
        self._key = blake2b(f"{user}\n{find_machine_id()}".encode(), key=secret, person=b"antdsl code").digest()

    def make_file_name(self, key: str) -> str:
        """Return the file name for `key`: 64 hexadecimal digits that differ for each user and machine."""
        return blake2b(key.encode(), key=self._key, digest_size=32, person=b"name").hexdigest()

    def sign(self, key: str, data: bytes) -> bytes:
        """Return the signature of data that is stored under a key."""
        hashed = blake2b(key.encode() + b"\0", key=self._key, digest_size=SIGNATURE_BYTES, person=b"content")
        hashed.update(data)
        return hashed.digest()

    def is_signed(self, key: str, data: bytes, signature: bytes) -> bool:
        """Return whether `signature` is the one that `sign` gives for this key and data. The comparison takes constant time."""
        return compare_digest(self.sign(key, data), signature)


def find_key_path() -> Path:
    """Return the path of the key file. Raises OSError if there is no home folder."""
    return cache_folder() / "antdsl" / "key"


def get_signer(*, create: bool) -> Signer | None:
    """Return the signer of this user, or None if there is no usable key and `create` is false.

    With `create`, a missing key is created. A key of wrong length, or one that other users could have read, is replaced.
    Raises OSError with the reason if no key can be created."""
    path = find_key_path()
    for attempt in range(_MAX_KEY_ATTEMPTS):
        try:
            return Signer(_read_key(path))
        except OSError as problem:
            if not create:
                return None
            make_private_folder(path.parent)
            if isinstance(problem, NotPrivateError) and _has_hard_links(path) and attempt < _MAX_KEY_ATTEMPTS // 2:
                time.sleep(_RETRY_PAUSE_SECONDS)  # another process is just creating it
                continue
            if not isinstance(problem, FileNotFoundError):
                with suppress(FileNotFoundError):
                    os.unlink(path)
        with suppress(FileExistsError):
            create_file_atomically(path, secrets.token_bytes(_KEY_BYTES), mode=0o600)
    raise NotPrivateError(0, f"no private key can be stored in `{path}`")


def _read_key(path: Path) -> bytes:
    """Return the bytes of the key file. Raises OSError if the file is not private or the key does not have the required
    length."""
    secret = read_private(path, _KEY_BYTES)
    if len(secret) != _KEY_BYTES:
        raise OSError(0, "the key has the wrong length")
    return secret


def _has_hard_links(path: Path) -> bool:
    """Return whether a file has more than one name (hard link). A file has two names while another process is creating it."""
    with suppress(OSError):
        return os.lstat(path).st_nlink == 2
    return False


@cache
def find_machine_id() -> str:
    """Return an identifier of this machine that stays the same after a restart; empty if there is none."""
    if sys.platform == "win32":
        import winreg

        with suppress(OSError), winreg.OpenKey(winreg.HKEY_LOCAL_MACHINE, r"SOFTWARE\Microsoft\Cryptography") as opened:
            return str(winreg.QueryValueEx(opened, "MachineGuid")[0])
        return ""
    if sys.platform == "darwin":
        import ctypes

        number, wait = (ctypes.c_ubyte * 16)(), (ctypes.c_long * 2)()
        with suppress(OSError, AttributeError):
            if ctypes.CDLL(None).gethostuuid(number, wait) == 0:
                return bytes(number).hex()
        return ""
    for path in _MACHINE_ID_FILES:
        with suppress(OSError):
            if identifier := read_size_limited(path, 4096).decode("ascii", "replace").strip():
                return identifier
    return ""
