"""Access control of the server, by the host name, the origin of the page, and a token that only the terminal displays.

The three are checked separately. The host name is never compared with the origin, because after DNS rebinding both are names of
the attacker.

After a restart, a server has a new token. It still admits the pages of the previous server of the same scene on the same port. An
admitted page receives a key. The page never sends the key, but only signs challenges with it. So another program that listens at
the port in between learns nothing useful. The keys of the last few starts are in a file that only the user may read. If no such
file is possible, no keys are stored, and the user has to open the page again."""

from __future__ import annotations

import hmac
import json
import os
import re
import secrets
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from hashlib import sha256
from pathlib import Path

from antdsl.atomic_write import write_atomically
from antdsl.user_folders import make_private_folder, read_private, state_folder

_MAX_STORED_KEYS = 4  # keys per file
_MAX_KEY_FILES = 64  # files for scenes and ports; the oldest are removed
_MAX_KEY_FILE_BYTES = 4096
_KEY_PATTERN = re.compile(r"[A-Za-z0-9_-]{43}")
WEBSOCKET_PROTOCOL = "antdsl.1"
_TOKEN_PREFIX = "token."


@dataclass(frozen=True, slots=True)
class ReturningPages:
    """Keys that admit known pages again after the server has restarted.

    `key`: given to pages that are admitted now. `previous_keys`: keys of earlier starts."""

    key: str = field(repr=False)
    previous_keys: tuple[str, ...] = field(default=(), repr=False)

    @classmethod
    def open_for_server(cls, scene: Path, port: int, folder: Path | None = None) -> ReturningPages | None:
        """Return the keys for a server that starts now; None if they cannot be stored in a private file."""
        try:
            name = sha256(f"{os.path.realpath(scene)}|{port}".encode("utf-8", "surrogateescape")).hexdigest()[:32]
            folder = folder or state_folder() / "antdsl" / "preview"
            make_private_folder(folder)
            place = folder / f"{name}.json"
            returning = cls(secrets.token_urlsafe(32), _read_keys(place))
            _write_keys(place, [returning.key, *returning.previous_keys][:_MAX_STORED_KEYS])
        except OSError:  # no such folder, a folder of other users, or no home
            return None
        return returning

    def is_proof(self, answer: str | bytes, host: str, nonce: str) -> bool:
        """Return whether `answer` is a signature of `nonce` with a key of an earlier start. The signature includes the server's
        name and port, so another server cannot pass it on."""
        if not isinstance(answer, str):
            return False
        answer_bytes = answer.encode("utf-8", "replace")
        words = f"antdsl return\n{host}\n{nonce}".encode()
        proofs = [hmac.new(key.encode(), words, "sha256").hexdigest().encode() for key in self.previous_keys]
        # all of them, so that the time does not depend on the result
        return any([hmac.compare_digest(answer_bytes, proof) for proof in proofs])


def _read_keys(path: Path) -> tuple[str, ...]:
    """Return the keys in a file; an empty tuple if it is not a small private file of keys."""
    try:
        keys = list(json.loads(read_private(path, _MAX_KEY_FILE_BYTES))["keys"])
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return ()
    return tuple(key for key in keys if isinstance(key, str) and _KEY_PATTERN.fullmatch(key))[:_MAX_STORED_KEYS]


def _write_keys(path: Path, keys: Sequence[str]) -> None:
    """Write the keys atomically, readable by the file's owner only."""
    write_atomically(path, json.dumps({"keys": list(keys)}).encode("ascii"), mode=0o600)
    with suppress(OSError):
        files = sorted(path.parent.glob("*.json"), key=lambda path: path.lstat().st_mtime)
        for old in files[:-_MAX_KEY_FILES]:
            old.unlink()


class ConnectionVerdict(Enum):
    """The decision about a client's request to open a socket."""

    ADMITTED = "admitted"
    INVITED = "invited"  # by a code that is valid once; the client must receive the token
    STRANGER = "stranger"  # a wrong host name, another page, or no page and no token
    WRONG_TOKEN = "wrong token"  # this server's page from before a restart; it gets a message


@dataclass(frozen=True, slots=True)
class RequestGuard:
    """Checks the hosts, origins and tokens of requests.

    `host_names`: hosts with port, as in addresses: `localhost:8765`, `[::1]:8765`.
    `returning_pages`: if set, pages are admitted again after the server has restarted.
    """

    host_names: frozenset[str]
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)
    _invitation_codes: set[str] = field(default_factory=set, repr=False)
    returning_pages: ReturningPages | None = None

    def make_invitation_code(self) -> str:
        """Return a one-time code that replaces the token in the address with which a browser is started.

        The token itself would be unsafe there, because other users can read the address in the list of processes."""
        code = secrets.token_urlsafe(32)
        self._invitation_codes.add(code)
        return code

    def is_own_host(self, headers: Sequence[str]) -> bool:
        """Return whether a request has exactly one `Host` header, and this is one of the server's names."""
        return len(headers) == 1 and headers[0] in self.host_names

    def check_origin(self, headers: Sequence[str]) -> bool | None:
        """Return whether a request's origin is this server's page; None if the request has no origin.

        The origin `null` does not count as this server's, because pages from files and sandboxes send it."""
        if not headers:
            return None
        return len(headers) == 1 and headers[0].removeprefix("http://") in self.host_names and headers[0].startswith("http://")

    def may_load_page(self, hosts: Sequence[str], origins: Sequence[str]) -> bool:
        """Return whether the page may be loaded. No token is needed, because the page contains no secret."""
        return self.is_own_host(hosts) and self.check_origin(origins) is not False

    def judge_socket(self, hosts: Sequence[str], origins: Sequence[str], protocols: Iterable[str]) -> ConnectionVerdict:
        """Return whether a client may open a socket. `protocols`: the `Sec-WebSocket-Protocol` headers of the request."""
        origin = self.check_origin(origins)
        if not self.is_own_host(hosts) or origin is False:
            return ConnectionVerdict.STRANGER
        words = [word.strip() for line in protocols for word in line.split(",")]
        tokens = [word.removeprefix(_TOKEN_PREFIX) for word in words if word.startswith(_TOKEN_PREFIX)]
        if WEBSOCKET_PROTOCOL in words and len(tokens) == 1:
            if _is_equal(tokens[0], self.token):
                return ConnectionVerdict.ADMITTED
            used = {code for code in self._invitation_codes if _is_equal(tokens[0], code)}
            self._invitation_codes.difference_update(used)
            if used:
                return ConnectionVerdict.INVITED
        return ConnectionVerdict.STRANGER if origin is None else ConnectionVerdict.WRONG_TOKEN


def _is_equal(first: str, second: str) -> bool:
    """Return whether two texts are equal. The time that this takes does not reveal where they differ."""
    return hmac.compare_digest(first.encode("utf-8", "surrogatepass"), second.encode())
