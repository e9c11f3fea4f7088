"""The queue of data to send to one client: all messages in order, but only the latest packet of each slot.

The simulation thread fills the queue and the server's thread empties it; neither waits for the other."""

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
    """An entry of the queue: a packet, or None if a later packet of the same slot, further back in the queue, has replaced it."""

    slot: str
    packet: bytes | None


class ClientMailbox:
    """The queue of data to send to one client. Once the queue exceeds its budget, `full` is called on the event loop, and the
    queue accepts nothing more."""

    def __init__(
        self,
        loop: asyncio.AbstractEventLoop,
        hello_fields: dict[str, str],
        on_full: Callable[[], None],
        *,
        max_message_size: int = limits.MAX_QUEUED_MESSAGE_CHARACTERS,
        max_packet_size: int = limits.MAX_QUEUED_PACKET_BYTES,
    ) -> None:
        self._loop, self._hello_fields, self._on_full = loop, hello_fields, on_full
        self._max_message_size, self._max_packet_size = max_message_size, max_packet_size
        self._queue: deque[str | _QueuedPacket] = deque()
        self._packet_by_slot: dict[str, _QueuedPacket] = {}  # packets that a later packet of their slot replaces in place
        self._earlier_packets: dict[str, _QueuedPacket] = {}  # packets from before the last scene: replaced, but not in place
        self._message_size = self._packet_size = 0  # bytes
        self._lock, self._item_ready = Lock(), asyncio.Event()
        self._is_woken = self._is_closed = False

    def send_message(self, message: dict[str, Any]) -> None:
        """Append a message. The build number of the page, which only the server knows, is added to a `hello` message."""
        if message.get("op") == "hello":
            message = {**message, **self._hello_fields}
        text = json.dumps(message, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
        with self._lock:
            if self._is_closed:
                return
            self._queue.append(text)
            self._message_size += len(text)
            if message.get("op") == "scene":
                # A packet of the new scene must not replace an earlier one in place: it would arrive before the scene.
                self._earlier_packets.update(self._packet_by_slot)
                self._packet_by_slot.clear()
            self._wake_or_close()

    def show_packet(self, slot: str, packet: bytes) -> None:
        """Replace the waiting packet of the same slot, or append the packet if there is none. So at most one packet per slot
        waits, and frequent packets of one slot do not delay other slots."""
        with self._lock:
            if self._is_closed:
                return
            self._packet_size += len(packet)
            waiting, past = self._packet_by_slot.get(slot), self._earlier_packets.pop(slot, None)
            if past is not None:
                self._packet_size -= len(past.packet or b"")
                past.packet = None
            if waiting is not None:
                self._packet_size -= len(waiting.packet or b"")
                waiting.packet = packet
            else:
                self._packet_by_slot[slot] = new_item = _QueuedPacket(slot, packet)
                self._queue.append(new_item)
            self._wake_or_close()

    async def receive_next(self) -> str | bytes:
        """Return the next message or packet to send; wait if there is none. Only one task on the event loop may call this."""
        while True:
            with self._lock:
                item = self._take_item()
                if item is None:
                    self._is_woken = False
                    self._item_ready.clear()
            if item is not None:
                return item
            await self._item_ready.wait()

    def close(self) -> None:
        """Drop all waiting messages and packets, and accept no more."""
        with self._lock:
            self._close()

    def _take_item(self) -> str | bytes | None:
        while self._queue:
            first = self._queue.popleft()
            if isinstance(first, str):
                self._message_size -= len(first)
                return first
            for held in (self._packet_by_slot, self._earlier_packets):
                if held.get(first.slot) is first:
                    del held[first.slot]
            if first.packet is not None:
                self._packet_size -= len(first.packet)
                return first.packet
        return None

    def _wake_or_close(self) -> None:
        """Wake the reader, or close the queue if it exceeds its budget. The caller holds the lock."""
        over = self._message_size > self._max_message_size or self._packet_size > self._max_packet_size
        if over:
            self._close()
        elif self._is_woken:
            return
        self._is_woken = True
        with suppress(RuntimeError):  # the loop has ended, and the client with it
            self._loop.call_soon_threadsafe(self._on_full if over else self._item_ready.set)

    def _close(self) -> None:
        self._is_closed = True
        self._queue.clear()
        self._packet_by_slot.clear()
        self._earlier_packets.clear()
        self._message_size = self._packet_size = 0
