"""The outgoing queue of one client: messages in order, and only the latest packet of each slot.

The simulation thread fills it and the server's thread empties it; neither waits for the other."""

from __future__ import annotations

import asyncio
import json
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Lock
from typing import Any

from antdsl import limits


@dataclass(slots=True, eq=False)
class _QueuedPacket:
    """A packet in the queue; None if a later packet of the slot replaced it at another position."""

    slot: str
    packet: bytes | None


class ClientMailbox:
    """The outgoing queue of one client. Once the queue exceeds its budget, `full` is called on the event loop, and nothing more
    is accepted."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        hello: dict[str, str],
        full: Callable[[], None],
        *,
        words: int = limits.MAX_QUEUED_MESSAGE_CHARACTERS,
        packets: int = limits.MAX_QUEUED_PACKET_BYTES,
    ) -> None:
        self._loop, self._hello, self._full = loop, hello, full
        self._most_words, self._most_packets = words, packets
        self._queue: deque[str | _QueuedPacket] = deque()
        self._waiting: dict[str, _QueuedPacket] = {}  # packets that a later one of their slot replaces in place
        self._before: dict[str, _QueuedPacket] = {}  # the same from before the last scene: replaced, but not in place
        self._words = self._packets = 0  # bytes
        self._lock, self._there = Lock(), asyncio.Event()
        self._woken = self._closed = False

    def tell(self, message: dict[str, Any]) -> None:
        """Append a message. A `hello` message also gets the build of the page, which only the server knows."""
        if message.get("op") == "hello":
            message = {**message, **self._hello}
        text = json.dumps(message, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        with self._lock:
            if self._closed:
                return
            self._queue.append(text)
            self._words += len(text)
            if message.get("op") == "scene":
                # a packet of the new scene must not take the place of one from before: it would arrive ahead of the scene
                self._before.update(self._waiting)
                self._waiting.clear()
            self._wake_or_close()

    def show(self, slot: str, packet: bytes) -> None:
        """Replace the waiting packet of the same slot, or append the packet. So each slot waits at most once, and frequent
        packets of one slot do not delay another."""
        with self._lock:
            if self._closed:
                return
            self._packets += len(packet)
            waiting, past = self._waiting.get(slot), self._before.pop(slot, None)
            if past is not None:
                self._packets -= len(past.packet or b"")
                past.packet = None
            if waiting is not None:
                self._packets -= len(waiting.packet or b"")
                waiting.packet = packet
            else:
                self._waiting[slot] = new_item = _QueuedPacket(slot, packet)
                self._queue.append(new_item)
            self._wake_or_close()

    async def next(self) -> str | bytes:
        """Return the next message or packet to send; wait if there is none. For one reader, on the event loop."""
        while True:
            with self._lock:
                item = self._take()
                if item is None:
                    self._woken = False
                    self._there.clear()
            if item is not None:
                return item
            await self._there.wait()

    def close(self) -> None:
        """Drop all waiting messages and packets, and accept no more."""
        with self._lock:
            self._close()

    def _take(self) -> str | bytes | None:
        while self._queue:
            first = self._queue.popleft()
            if isinstance(first, str):
                self._words -= len(first)
                return first
            for held in (self._waiting, self._before):
                if held.get(first.slot) is first:
                    del held[first.slot]
            if first.packet is not None:
                self._packets -= len(first.packet)
                return first.packet
        return None

    def _wake_or_close(self) -> None:
        """Wake the reader, or close the queue if it exceeds its budget. The caller holds the lock."""
        over = self._words > self._most_words or self._packets > self._most_packets
        if over:
            self._close()
        elif self._woken:
            return
        self._woken = True
        with suppress(RuntimeError):  # the loop has ended, and with it the client
            self._loop.call_soon_threadsafe(self._full if over else self._there.set)

    def _close(self) -> None:
        self._closed = True
        self._queue.clear()
        self._waiting.clear()
        self._before.clear()
        self._words = self._packets = 0
