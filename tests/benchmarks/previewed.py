"""A preview as people start it, in a separate process, and a client that reads all that it sends."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 60.0  # that anything may take at most


@contextmanager
def previewed(scene: Path, *words: str) -> Iterator[str]:
    """The address of a preview of a scene."""
    command = [sys.executable, "-m", "antdsl", "preview", str(scene), "--no-open", "--port", "0", *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    server = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert server.stdout is not None
        yield server.stdout.readline().strip()
    finally:
        server.terminate()
        server.wait(SECONDS)


def joined(address: str) -> ClientConnection:
    """A client of the preview at an address."""
    origin, token = address.split("/#")
    return connect(
        f"{origin.replace('http', 'ws', 1)}/ws",
        origin=origin,  # type: ignore[arg-type]
        subprotocols=["antdsl.1", f"token.{token}"],  # type: ignore[list-item]
        compression=None,
        max_size=None,
        max_queue=None,
        open_timeout=SECONDS,
        proxy=None,
    )


def header(packet: bytes) -> dict[str, Any]:
    """The header of a binary message."""
    contents: dict[str, Any] = json.loads(packet[8 : 8 + int.from_bytes(packet[4:8], "little")])
    return contents


def read(client: ClientConnection) -> dict[str, Any]:
    """The next message, or the header of the next packet; a packet has a `slot`."""
    message = client.recv(SECONDS)
    contents: dict[str, Any] = json.loads(message) if isinstance(message, str) else header(message)
    return contents


def until(client: ClientConnection, **expected: Any) -> dict[str, Any]:
    """The next message or header that says so."""
    while True:
        message = read(client)
        if all(message.get(key) == value for key, value in expected.items()):
            return message
