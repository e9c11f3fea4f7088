"""Limits of connections before and after a client is admitted: the number of connections, the rate of frames, the fragments of a
message, and the requests of one client in a given time."""

from __future__ import annotations

from collections.abc import Callable
from time import monotonic
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame, Opcode

from antdsl import limits


class ConnectionGate:
    """All connections of a server. Only the newest connections that are not admitted yet stay open. So a client that opens
    thousands displaces its own connections, not a page that authenticates in time."""

    def __init__(self) -> None:
        self._waiting: dict[GatedConnection, None] = {}
        self._in: dict[GatedConnection, bool] = {}  # with whether it came by a code that is good once

    def make_connection(self, *args: Any, **options: Any) -> GatedConnection:
        """Return a new connection, for `serve` to create connections with."""
        return GatedConnection(self, *args, **options)

    def let_in(self, connection: ServerConnection, *, invited: bool) -> None:
        """Admit a connection. `invited`: whether it used a code that is valid once."""
        assert isinstance(connection, GatedConnection)
        self._waiting.pop(connection, None)
        self._in[connection] = invited

    def is_in(self, connection: ServerConnection) -> bool:
        """Return whether a connection is admitted."""
        return connection in self._in

    def is_invited(self, connection: ServerConnection) -> bool:
        """Return whether an admitted connection used a code that is valid once."""
        return isinstance(connection, GatedConnection) and self._in.get(connection, False)

    def add(self, connection: GatedConnection) -> None:
        """Add a connection that is not admitted yet. Close the oldest such connections above the limit."""
        self._waiting[connection] = None
        if len(self._waiting) > limits.MAX_UNADMITTED_CONNECTIONS:
            oldest = next(iter(self._waiting))
            del self._waiting[oldest]
            oldest.transport.abort()

    def close_all(self) -> None:
        """Close all connections."""
        for each in (*self._waiting, *self._in):
            each.transport.abort()

    def remove(self, connection: GatedConnection) -> None:
        """Remove a closed connection."""
        self._waiting.pop(connection, None)
        self._in.pop(connection, None)


class GatedConnection(ServerConnection):
    """A connection that is closed if the client sends too many frames per second or too many fragments of a message.

    Pings count as frames. A limit of bytes is not enough, because fragments may be empty."""

    def __init__(self, gate: ConnectionGate, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        self._door = gate
        self._frames = TokenBucket(limits.MAX_PREVIEW_FRAMES_PER_SECOND, 2 * limits.MAX_PREVIEW_FRAMES_PER_SECOND)
        self._pieces = 0

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._door.add(self)

    def connection_lost(self, exc: Exception | None) -> None:
        self._door.remove(self)
        super().connection_lost(exc)

    def process_event(self, event: Any) -> None:
        if isinstance(event, Frame) and not self._is_within_limits(event):
            self.transport.abort()
            return
        super().process_event(event)

    def _is_within_limits(self, frame: Frame) -> bool:
        """Count a frame. Return whether the client is within its rate and its number of fragments."""
        if frame.opcode in (Opcode.TEXT, Opcode.BINARY):
            self._pieces = 0
        elif frame.opcode is Opcode.CONT:
            self._pieces += 1
        return self._pieces < limits.MAX_PREVIEW_FRAGMENTS and self._frames.take()


class TokenBucket:
    """A rate limiter. It holds up to `most` tokens and gains `rate` tokens per second; each event takes one. `clock` returns
    seconds."""

    def __init__(self, rate: float, most: float, clock: Callable[[], float] = monotonic) -> None:
        self._rate, self._most, self._clock = rate, most, clock
        self._holds, self._at = most, clock()

    def take(self) -> bool:
        """Take one token and return True; return False if there is none."""
        now = self._clock()
        self._holds = min(self._most, self._holds + (now - self._at) * self._rate)
        self._at = now
        if self._holds < 1:
            return False
        self._holds -= 1
        return True
