"""A preview's server with a session that only records requests, and calls that no browser makes."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.frames import Opcode

from antdsl.preview.live import Client, QueueFullError
from antdsl.preview.requests import AnyRequest
from antdsl.preview.serving.addresses import ListeningSockets, open_listening_sockets
from antdsl.preview.serving.guard import RequestGuard
from antdsl.preview.serving.page_files import PageFiles, load_pages
from antdsl.preview.serving.server import PreviewServer

SECONDS = 20  # that a test may take at most


@dataclass
class Noted:
    """Answers each ask with a separate outcome; `busy` answers none."""

    asks: list[AnyRequest] = field(default_factory=list)
    clients: list[Client] = field(default_factory=list)
    joined: int = 0
    busy: bool = False

    def enqueue_request(self, request: AnyRequest, client: Client) -> None:
        if self.busy:
            raise QueueFullError
        self.asks.append(request)
        client.send_message({"op": "outcome", "of": request.op, "number": len(self.asks)})

    def add_client(self, client: Client) -> None:
        self.joined += 1
        self.clients.append(client)
        client.send_message({"op": "hello", "build": ""})

    def remove_client(self, client: Client) -> None:
        self.clients.remove(client)


@dataclass
class Served:
    live: Noted
    guard: RequestGuard
    pages: PageFiles
    listening: ListeningSockets

    @property
    def port(self) -> int:
        return int(self.listening.sockets[0].getsockname()[1])

    @property
    def origin(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def connect(self, **other: Any) -> connect:
        """A client as the page is one; `other` has what is different."""
        options: dict[str, Any] = {
            "origin": self.origin,
            "subprotocols": ["antdsl.1", f"token.{self.guard.token}"],
            "open_timeout": SECONDS,
            "close_timeout": 1,
            "proxy": None,
            **other,
        }
        return connect(f"ws://127.0.0.1:{self.port}/ws", **options)

    async def say(self, *lines: str, wait: float = SECONDS) -> tuple[int, dict[str, str], bytes]:
        """Send lines as they are; status (0 for none), headers and body of what comes back before the server hangs up."""
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        writer.write("".join(f"{line}\r\n" for line in (*lines, "")).encode("latin-1"))
        try:
            got = await asyncio.wait_for(reader.read(), wait)
        except ConnectionResetError:
            got = b""
        writer.close()
        head, _, body = got.partition(b"\r\n\r\n")
        status, *headers = head.decode("latin-1").split("\r\n")
        named = dict(line.split(": ", 1) for line in headers)
        return int(status.split(" ")[1]) if status else 0, named, body

    async def get(self, path: str, *headers: str, method: str = "GET") -> tuple[int, dict[str, str], bytes]:
        return await self.say(f"{method} {path} HTTP/1.1", f"Host: 127.0.0.1:{self.port}", *headers)

    async def open_socket(
        self, hosts: Sequence[str], origins: Sequence[str], protocols: Sequence[str] | None = None, wait: float = SECONDS
    ) -> int:
        """The status that a request for a socket gets with just these headers; 101 means that it is open."""
        protocols = ["antdsl.1", f"token.{self.guard.token}"] if protocols is None else protocols
        reader, writer = await asyncio.open_connection("127.0.0.1", self.port)
        lines = [
            "GET /ws HTTP/1.1",
            *(f"Host: {host}" for host in hosts),
            *(f"Origin: {origin}" for origin in origins),
            *(f"Sec-WebSocket-Protocol: {each}" for each in protocols),
            "Connection: Upgrade",
            "Upgrade: websocket",
            "Sec-WebSocket-Version: 13",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
        ]
        writer.write("".join(f"{line}\r\n" for line in (*lines, "")).encode("latin-1"))
        status = await asyncio.wait_for(reader.readline(), wait)
        writer.close()
        return int(status.split(b" ")[1])


@asynccontextmanager
async def served(**live: Any) -> AsyncIterator[Served]:
    listening = open_listening_sockets(port=0)
    server = Served(Noted(**live), RequestGuard(listening.host_names), load_pages(), listening)
    async with asyncio.timeout(SECONDS), PreviewServer(server.live, server.guard, server.pages, listening).run():
        yield server


def frame(opcode: Opcode, data: bytes = b"", *, last: bool = True, packed: bool = False, masked: bool = True) -> bytes:
    """One frame as it goes over the wire, in order or not. Its mask is zero, which leaves the data as they are."""
    first, mask = opcode | last << 7 | packed << 6, masked << 7
    if len(data) < 126:
        head = bytes([first, mask | len(data)])
    elif len(data) < 1 << 16:
        head = bytes([first, mask | 126]) + len(data).to_bytes(2, "big")
    else:
        head = bytes([first, mask | 127]) + len(data).to_bytes(8, "big")
    return head + (bytes(4) if masked else b"") + data


async def raw(client: ClientConnection, *frames: bytes) -> int:
    """Send frames past all that the client's library checks; the code that the server closes with, 1006 when it hangs up."""
    for each in frames:
        if client.transport.is_closing():
            break
        client.transport.write(each)
        await asyncio.sleep(0)
    await client.wait_closed()
    return client.close_code or 0
