"""How a state gets from the simulation to who writes it: its arrays through memory that both see, words through a channel."""

from __future__ import annotations

import json
import mmap
import os
import select
from collections.abc import Mapping
from math import prod
from queue import Empty, SimpleQueue
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Arrays = Mapping[str, NDArray[Any]]
Layout = list[list[Any]]  # of each array its name, type and shape
Message = dict[str, Any]  # what JSON can say
_ALIGNED = 64  # bytes; what a processor reads at once


class Slot:
    """Room for the arrays of one state. `shared`: a process that is forked later sees them too, however the room grows.

    One side fills it, tells the other what `fill` gave, and leaves it alone until the other has told that it is done."""

    def __init__(self, *, shared: bool) -> None:
        # memory that has a handle and no name: it is gone with the last process that holds it, however that ends
        self._handle = os.memfd_create("antdsl", os.MFD_CLOEXEC) if shared else None
        self._room: NDArray[np.uint8] = np.empty(0, np.uint8)
        self._layout: Layout = []
        self._views: dict[str, NDArray[Any]] = {}

    def fill(self, arrays: Arrays) -> Layout | None:
        """Copy arrays into it. Gives how they lie, None when they lie as before."""
        layout: Layout = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
        known = layout == self._layout
        if not known:
            self._lay_out(layout)
        for view, array in zip(self._views.values(), arrays.values(), strict=True):
            np.copyto(view, array)
        return None if known else layout

    def read(self, layout: Layout | None) -> Arrays:
        """What the other side filled in; not copies. `layout` is what `fill` gave there."""
        if layout is not None and layout != self._layout:
            self._lay_out(layout)
        return self._views

    def close(self) -> None:
        """Give the room back."""
        self._views, self._room, self._layout = {}, np.empty(0, np.uint8), []
        if self._handle is not None:
            os.close(self._handle)
            self._handle = None

    def _lay_out(self, layout: Layout) -> None:
        places, end = [], 0
        for _, kind, shape in layout:
            size = np.dtype(kind).itemsize * prod(shape)
            places.append(slice(end, end + size))
            end += -(-size // _ALIGNED) * _ALIGNED
        if end > len(self._room):
            self._views = {}
            self._grow(end)
        self._views = {
            name: self._room[place].view(kind).reshape(shape) for (name, kind, shape), place in zip(layout, places, strict=True)
        }
        self._layout = layout

    def _grow(self, needed: int) -> None:
        """Both sides come by here; the one that fills is the first and says how far it grows."""
        wanted = needed + needed // 4
        if self._handle is None:
            self._room = np.empty(wanted, np.uint8)
            return
        size = os.fstat(self._handle).st_size
        if size < needed:
            os.ftruncate(self._handle, wanted)
            size = wanted
        self._room = np.frombuffer(mmap.mmap(self._handle, size), np.uint8)


class Channel(Protocol):
    """One end of a way for messages, in order, both ways."""

    def send(self, message: Message) -> None:
        """Raises BrokenPipeError when nobody is at the other end."""

    def receive(self, *, wait: bool = True) -> Message | None:
        """The next message; None when there is none yet and `wait` is false. EOFError after the last."""

    def close(self) -> None:
        """Tell the other end that nothing more will be sent."""


class Pipes:
    """Between processes: a line of JSON a message."""

    def __init__(self, reading: int, writing: int) -> None:
        self._reading, self._writing = reading, writing
        self._read = b""

    def send(self, message: Message) -> None:
        data = json.dumps(message).encode() + b"\n"
        while data:
            data = data[os.write(self._writing, data) :]

    def receive(self, *, wait: bool = True) -> Message | None:
        while b"\n" not in self._read:
            if not wait and not self._waiting():
                return None
            part = os.read(self._reading, 1 << 16)
            if not part:
                raise EOFError
            self._read += part
        line, _, self._read = self._read.partition(b"\n")
        found: Message = json.loads(line)
        return found

    def _waiting(self) -> bool:
        asked = select.poll()
        asked.register(self._reading, select.POLLIN)
        return bool(asked.poll(0))

    def close(self) -> None:
        if self._writing >= 0:
            os.close(self._writing)
            self._writing = -1

    def drop(self) -> None:
        """Close both ways."""
        self.close()
        if self._reading >= 0:
            os.close(self._reading)
            self._reading = -1


class Queues:
    """Between threads."""

    def __init__(self, taken: SimpleQueue[Message | None], given: SimpleQueue[Message | None]) -> None:
        self._taken, self._given = taken, given

    def send(self, message: Message) -> None:
        self._given.put(message)

    def receive(self, *, wait: bool = True) -> Message | None:
        try:
            message = self._taken.get(block=wait)
        except Empty:
            return None
        if message is None:
            raise EOFError
        return message

    def close(self) -> None:
        self._given.put(None)


def two_pipes() -> tuple[Pipes, Pipes]:
    """Both ends of a channel between a process and one that it is about to fork."""
    to_there, from_here = os.pipe()
    try:
        to_here, from_there = os.pipe()
    except OSError:
        os.close(to_there)
        os.close(from_here)
        raise
    return Pipes(to_here, from_here), Pipes(to_there, from_there)


def two_queues() -> tuple[Queues, Queues]:
    """Both ends of a channel between threads."""
    there: SimpleQueue[Message | None] = SimpleQueue()
    here: SimpleQueue[Message | None] = SimpleQueue()
    return Queues(here, there), Queues(there, here)
