"""Lets a page in again that a server of the same scene, on the same port, had let in before it was started again.

The token is a new one each time. What lasts is a key that a page is given once it is in, and that it never sends: it only signs
what it is asked for, so that whoever listens at the port meanwhile learns nothing that is of use later. The keys of the last few
starts lie in a file that nobody but the user may read; where that cannot be had, none are kept, and a page has to be opened
anew."""

from __future__ import annotations

import hmac
import json
import os
import re
import secrets
import stat
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from antdsl.whole import write_whole

_STARTS = 4  # whose keys are kept
_FILES = 64  # of scenes and ports; the oldest go
_BYTES = 4096
_KEY = re.compile(r"[A-Za-z0-9_-]{43}")


@dataclass(frozen=True, slots=True)
class Returning:
    """`key` is for pages that are let in now, `before` has those of earlier starts."""

    key: str = field(repr=False)
    before: tuple[str, ...] = field(default=(), repr=False)

    @classmethod
    def of(cls, scene: Path, port: int, folder: Path | None = None) -> Returning | None:
        """Of a server of a scene that begins now; None where nothing can be kept in private."""
        try:
            name = sha256(f"{os.path.realpath(scene)}|{port}".encode("utf-8", "surrogateescape")).hexdigest()[:32]
            place = _private(folder or state_folder()) / f"{name}.json"
            made = cls(secrets.token_urlsafe(32), _read(place))
            _write(place, [made.key, *made.before][:_STARTS])
        except (OSError, RuntimeError):  # no such folder, not ours alone, or no home
            return None
        return made

    def proves(self, answer: str | bytes, host: str, nonce: str) -> bool:
        """Whether an answer to `nonce` comes from a page that was let in before, at this very name and port: another server
        cannot hand it on."""
        if not isinstance(answer, str):
            return False
        given = answer.encode("utf-8", "replace")
        words = f"antdsl return\n{host}\n{nonce}".encode()
        proofs = [hmac.new(key.encode(), words, "sha256").hexdigest().encode() for key in self.before]
        return any([hmac.compare_digest(given, proof) for proof in proofs])  # all of them, in the same time


def state_folder() -> Path:
    """Where a user's programs keep what is to last, by the platform's custom."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return base / "antdsl" / "preview"


def _private(folder: Path) -> Path:
    """A folder that is there and the user's own. OSError for one that others may look into or write to."""
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _own(os.lstat(folder), stat.S_ISDIR):
        raise PermissionError(f"{folder} is not the user's own")
    return folder


def _own(status: os.stat_result, kind: Callable[[int], bool]) -> bool:
    if sys.platform == "win32":
        return True  # a user's folder has an access list of its own there
    return kind(status.st_mode) and status.st_uid == os.geteuid() and not status.st_mode & 0o077


def _read(place: Path) -> tuple[str, ...]:
    """The keys in a file; none of one that is anything but a small private file of keys."""
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    try:
        handle = os.open(place, flags)
    except OSError:
        return ()
    with os.fdopen(handle, "rb") as file:
        data = file.read(_BYTES) if _own(os.fstat(file.fileno()), stat.S_ISREG) else b""
    try:
        found = list(json.loads(data)["keys"])
    except (ValueError, TypeError, KeyError, RecursionError):
        return ()
    return tuple(key for key in found if isinstance(key, str) and _KEY.fullmatch(key))[:_STARTS]


def _write(place: Path, keys: Sequence[str]) -> None:
    """Whole or not at all. Who makes the file is the only one to read it."""
    write_whole(place, json.dumps({"keys": list(keys)}).encode("ascii"), mode=0o600)
    with suppress(OSError):
        files = sorted(place.parent.glob("*.json"), key=lambda each: each.lstat().st_mtime)
        for old in files[:-_FILES]:
            old.unlink()
