"""A page for tests: stores the messages and packets that it receives, and waits for later ones."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from threading import Condition
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.pipeline import open_scene, simulate
from antdsl.preview import LiveSimulation
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.requests import REQUEST_ADAPTER
from antdsl.runtime import state_hash

Message = dict[str, Any]
EXAMPLES = Path(__file__).parents[1] / "examples"
PATIENCE = 60.0  # seconds


class Page:
    """A client of a Live. `ask` takes what a browser would send."""

    def __init__(self, live: LiveSimulation) -> None:
        self.live = live
        self.told: list[Message] = []
        self.make_packets: dict[str, bytes] = {}
        self.frames: list[tuple[int, bool]] = []  # each that was shown, and whether it was a light one
        self._changed = Condition()
        live.add_client(self)

    def send_message(self, message: Message) -> None:
        with self._changed:
            self.told.append(message)
            self._changed.notify_all()

    def show_packet(self, slot: str, packet: bytes) -> None:
        with self._changed:
            self.make_packets[slot] = packet
            if slot == "frame":
                header, _ = unpack_arrays(packet)
                self.frames.append((header["frame"], header["light"]))
            self._changed.notify_all()

    def ask(self, op: str, **what: Any) -> None:
        self.live.enqueue_request(REQUEST_ADAPTER.validate_json(json.dumps({"op": op, **what})), self)

    def until(self, true: Callable[[], Any]) -> Any:
        """What `true` gives, once it gives something."""
        end = time.monotonic() + PATIENCE
        with self._changed:
            while not (value := true()):
                assert self._changed.wait(max(end - time.monotonic(), 0)), f"nothing came after {str(self.told[-3:])[:500]}"
        return value

    def last(self, op: str) -> Message | None:
        return next((message for message in reversed(self.told) if message["op"] == op), None)

    def status(self, **expected: Any) -> Message:
        """The latest status, once it says so."""

        def fits() -> Message | None:
            message = self.last("status")
            return message if message is not None and all(message[key] == value for key, value in expected.items()) else None

        return self.until(fits)

    def hash_at(self, frame: int) -> str:
        """The hash of a frame, once the session stands still there."""
        return self.until(lambda: (message := self.last("status")) and message["frame"] == frame and message["hash"])

    def frame_arrays(self, frame: int, *, light: bool = False) -> dict[str, NDArray[Any]]:
        """The arrays of a frame, once it is the one that is shown."""
        self.until(lambda: self.frames and self.frames[-1] == (frame, light))
        return unpack_arrays(self.make_packets["frame"])[1]

    def message_after(self, op: str, number: int) -> Message:
        """The first message of an op among those after the first `number` of all."""
        return self.until(lambda: next((message for message in self.told[number:] if message["op"] == op), None))

    def ask_and_wait(self, op: str, **what: Any) -> Message:
        """Ask, and what came of it."""
        number = len(self.told)
        self.ask(op, **what)
        return self.until(
            lambda: next((m for m in self.told[number:] if m["op"] in ("outcome", "refused") and m["of"] == op), None)
        )


def agent_positions(arrays: dict[str, NDArray[Any]], species: str) -> NDArray[np.float32]:
    return arrays[f"{species}/position"].reshape(-1, 3)


def hashes(scene: Path, last: int) -> dict[int, str]:
    """The hash of each frame of a run of the files as they are."""
    shot, report = open_scene(scene)
    assert shot is not None, [d.message for d in report.errors]
    hash_by_frame = {}
    for world in simulate(shot):
        hash_by_frame[world.frame] = state_hash(world)
        if world.frame == last:
            break
    return hash_by_frame
