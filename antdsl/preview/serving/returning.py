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
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path

from antdsl.user_folders import make_private_folder, read_private, state_folder
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
            folder = folder or state_folder() / "antdsl" / "preview"
            make_private_folder(folder)
            place = folder / f"{name}.json"
            made = cls(secrets.token_urlsafe(32), _read(place))
            _write(place, [made.key, *made.before][:_STARTS])
        except OSError:  # no such folder, not ours alone, or no home
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


def _read(place: Path) -> tuple[str, ...]:
    """The keys in a file; none of one that is anything but a small private file of keys."""
    try:
        found = list(json.loads(read_private(place, _BYTES))["keys"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return ()
    return tuple(key for key in found if isinstance(key, str) and _KEY.fullmatch(key))[:_STARTS]


def _write(place: Path, keys: Sequence[str]) -> None:
    """Whole or not at all. Who makes the file is the only one to read it."""
    write_whole(place, json.dumps({"keys": list(keys)}).encode("ascii"), mode=0o600)
    with suppress(OSError):
        files = sorted(place.parent.glob("*.json"), key=lambda each: each.lstat().st_mtime)
        for old in files[:-_FILES]:
            old.unlink()
