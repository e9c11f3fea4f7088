"""Limits on connections, before and after the server admits a client.

They limit the number of connections, the rate of WebSocket frames, the fragments per message, and the requests per client and
time."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame, Opcode

from antdsl import limits


class ConnectionGate:
    """All connections of a server. Among connections that are not admitted yet, only the newest stay open.

    So a client that opens thousands of connections displaces its own, not a page that authenticates in time."""

    def __init__(self) -> None:
        self._unadmitted: dict[GatedConnection, None] = {}
        self._admitted: dict[GatedConnection, bool] = {}  # whether each used a code that is valid once

    def make_connection(self, *args: Any, **options: Any) -> GatedConnection:
        """Return a new connection. This is the factory that `serve` uses to create connections."""
        return GatedConnection(self, *args, **options)

    def admit_connection(self, connection: ServerConnection, *, is_invited: bool) -> None:
        """Admit a connection. `is_invited`: whether the client used a one-time code."""
        assert isinstance(connection, GatedConnection)
        self._unadmitted.pop(connection, None)
        self._admitted[connection] = is_invited

    def is_admitted(self, connection: ServerConnection) -> bool:
        """Return whether a connection is admitted."""
        return connection in self._admitted

    def is_invited(self, connection: ServerConnection) -> bool:
        """Return whether an admitted connection used a one-time code."""
        return isinstance(connection, GatedConnection) and self._admitted.get(connection, False)

    def add_connection(self, connection: GatedConnection) -> None:
        """Add a connection that is not admitted yet. If there are too many of these, close the oldest ones."""
        self._unadmitted[connection] = None
        if len(self._unadmitted) > limits.MAX_UNADMITTED_CONNECTIONS:
            oldest = next(iter(self._unadmitted))
            del self._unadmitted[oldest]
            oldest.transport.abort()

    def close_all(self) -> None:
        """Close all connections."""
        for each in (*self._unadmitted, *self._admitted):
            each.transport.abort()

    def remove_connection(self, connection: GatedConnection) -> None:
        """Remove a closed connection."""
        self._unadmitted.pop(connection, None)
        self._admitted.pop(connection, None)


class GatedConnection(ServerConnection):
    """A connection that is closed if the client sends too many frames per second, or too many fragments per message.

    Pings count as frames. A limit on bytes would not suffice, because fragments may be empty."""

    def __init__(self, gate: ConnectionGate, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._gate = gate
        self._frame_bucket = TokenBucket(limits.MAX_PREVIEW_FRAMES_PER_SECOND, 2 * limits.MAX_PREVIEW_FRAMES_PER_SECOND)
        self._fragment_count = 0

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._gate.add_connection(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._gate.remove_connection(self)
        super().connection_lost(exc)

    def process_event(self, event: Any) -> None:
        if isinstance(event, Frame) and not self._is_within_limits(event):
            self.transport.abort()
            return
        super().process_event(event)

    def _is_within_limits(self, frame: Frame) -> bool:
        """Count a WebSocket frame. Return whether the client is still within its limits of rate and fragments."""
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY):
            self._fragment_count = 0
        elif frame.opcode is Opcode.CONT:
            self._fragment_count += 1
        return self._fragment_count < limits.MAX_PREVIEW_FRAGMENTS and self._frame_bucket.take_token()


class TokenBucket:
    """A rate limiter. Each event takes one token.

    It holds up to `most` tokens and gains `rate` tokens per second. `clock`: returns the time in seconds."""

    def __init__(self, rate: float, capacity: float, clock: Callable[[], float] = monotonic) -> None:
        self._rate, self._capacity, self._clock = rate, capacity, clock
        self._tokens, self._updated_time = capacity, clock()

    def take_token(self) -> bool:
        """Take one token and return True; return False if there is none."""
        now = self._clock()
        self._tokens = min(self._capacity, self._tokens + (now - self._updated_time) * self._rate)
        self._updated_time = now
        if self._tokens < 1:
            return False
        self._tokens -= 1
        return True
