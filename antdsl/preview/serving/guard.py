"""Who is let in: by the name that the server was called by, by the page that calls, and by a token that only the terminal shows.

The three are checked each for itself. The name is never compared with the origin: after DNS rebinding both are the attacker's."""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from enum import Enum

from antdsl.preview.serving.returning import Returning

PROTOCOL = "antdsl.1"
_TOKEN = "token."


class Verdict(Enum):
    IN = "in"
    INVITED = "invited"  # by a code that is good for this once: it has to be told the token
    STRANGER = "stranger"  # called by a wrong name, from a page of others, or by no page and without the token
    WRONG_TOKEN = "wrong token"  # our own page, from before the server was started again: it is told so


@dataclass(frozen=True, slots=True)
class Guard:
    """`names`: hosts with their port, as they stand in addresses: `localhost:8765`, `[::1]:8765`. `returning` where pages of a
    server that is started again are let in again."""

    names: frozenset[str]
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32), repr=False)
    _codes: set[str] = field(default_factory=set, repr=False)
    returning: Returning | None = None

    def invite(self) -> str:
        """A code that stands for the token once: for the address that a browser is started with, which other people on this
        machine can see in the list of processes."""
        code = secrets.token_urlsafe(32)
        self._codes.add(code)
        return code

    def host(self, given: Sequence[str]) -> bool:
        """Whether a request came by one of the names, given its `Host` headers: exactly one is in order."""
        return len(given) == 1 and given[0] in self.names

    def origin(self, given: Sequence[str]) -> bool | None:
        """Whether the page that a request comes from is this server's; None where no page is named. `null` is no name: pages out
        of files and sandboxes have it."""
        if not given:
            return None
        return len(given) == 1 and given[0].removeprefix("http://") in self.names and given[0].startswith("http://")

    def page(self, hosts: Sequence[str], origins: Sequence[str]) -> bool:
        """Whether the page may be loaded. It holds nothing that is secret, so no token is asked for."""
        return self.host(hosts) and self.origin(origins) is not False

    def socket(self, hosts: Sequence[str], origins: Sequence[str], offered: Iterable[str]) -> Verdict:
        """Whether a socket may be opened; `offered` are its `Sec-WebSocket-Protocol` headers."""
        origin = self.origin(origins)
        if not self.host(hosts) or origin is False:
            return Verdict.STRANGER
        words = [word.strip() for line in offered for word in line.split(",")]
        tokens = [word.removeprefix(_TOKEN) for word in words if word.startswith(_TOKEN)]
        if PROTOCOL in words and len(tokens) == 1:
            if _same(tokens[0], self.token):
                return Verdict.IN
            used = {code for code in self._codes if _same(tokens[0], code)}
            self._codes.difference_update(used)
            if used:
                return Verdict.INVITED
        return Verdict.STRANGER if origin is None else Verdict.WRONG_TOKEN


def _same(one: str, other: str) -> bool:
    """Compared in a time that tells nothing of where they differ."""
    return hmac.compare_digest(one.encode("utf-8", "surrogatepass"), other.encode())
