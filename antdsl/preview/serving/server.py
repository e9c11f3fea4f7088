"""The preview server: it serves the page over HTTP, and connects each client by a socket to the thread that simulates."""

from __future__ import annotations

import asyncio
import json
import logging
import secrets
import signal
import sys
import traceback
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, Final, Protocol, cast

from pydantic import ValidationError
from websockets.asyncio.server import ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.frames import CloseCode
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from antdsl import limits
from antdsl.preview.live import Client, QueueFullError
from antdsl.preview.requests import REQUEST_ADAPTER, AnyRequest
from antdsl.preview.serving.addresses import ListeningSockets
from antdsl.preview.serving.connections import ConnectionGate, TokenBucket
from antdsl.preview.serving.guard import WEBSOCKET_PROTOCOL, ConnectionVerdict, RequestGuard
from antdsl.preview.serving.mailbox import ClientMailbox
from antdsl.preview.serving.page_files import PageFiles

CONTENT_SECURITY_POLICY: Final = "; ".join(
    (
        "default-src 'none'",
        "script-src 'self'",
        "style-src 'self'",
        "connect-src 'self'",
        "img-src 'self' data:",
        "base-uri 'none'",
        "frame-ancestors 'none'",
        "form-action 'none'",
    )
)
# No Access-Control-Allow-*: no other page may read a response.
RESPONSE_HEADERS: Final = (
    ("Content-Security-Policy", CONTENT_SECURITY_POLICY),
    ("X-Content-Type-Options", "nosniff"),
    ("X-Frame-Options", "DENY"),
    ("Cache-Control", "no-store"),
    ("Referrer-Policy", "no-referrer"),
    ("Cross-Origin-Opener-Policy", "same-origin"),
    ("Cross-Origin-Resource-Policy", "same-origin"),
    ("Cross-Origin-Embedder-Policy", "require-corp"),
)
_REQUEST_TIMEOUT_SECONDS = 10.0  # for a request and its response
_CLOSE_TIMEOUT_SECONDS = 2.0  # for a client to complete the close
_SEND_TIMEOUT_SECONDS = 60.0  # for sending one packet
_PING_INTERVAL_SECONDS = 20.0  # interval between pings, and limit for their answers
_EXCESS_REQUEST_RATE_AND_BURST = (
    5,
    100,
)  # requests per second, and at once; a client with more rejected requests is disconnected

# Limits messages, so that a flood at the server does not flood the terminal.
_SILENT_LOGGER = logging.getLogger("antdsl.preview.serving")


@dataclass(frozen=True, slots=True)
class RefusedRequest:
    """A rejected request. `operation`: the `op` that it named, if this op exists."""

    operation: str
    message: str
    help: str = ""

    def make_message(self) -> dict[str, Any]:
        """Return the message that reports the rejection to the page."""
        return {"op": "refused", "of": self.operation, "message": self.message, "help": self.help}


def read_request(text: str) -> AnyRequest | RefusedRequest:
    """Return the request that a message contains, or its rejection. Errors name only ops and fields, and never repeat other
    content."""
    try:
        return REQUEST_ADAPTER.validate_json(text)
    except ValidationError as why:
        first = why.errors(include_url=False, include_context=False, include_input=False)[0]
    kind, place = first["type"], [str(part) for part in first["loc"]]
    if kind == "json_invalid":
        return RefusedRequest("", "a message is not valid JSON", "reload this page")
    if kind in ("union_tag_invalid", "union_tag_not_found") and not place:
        return RefusedRequest("", "a message has an unknown request", "reload this page")
    if not place:
        return RefusedRequest("", "a message is not a list of names and values", "reload this page")
    where = " ".join(f"`{part}`" for part in place[1:]) or "the message"
    words = first["msg"][:1].lower() + first["msg"][1:]
    return RefusedRequest(place[0], f"{where} of `{place[0]}`: {words}")


_SILENT_LOGGER.addHandler(logging.NullHandler())
_SILENT_LOGGER.propagate = False


class SimulationHost(Protocol):
    """The interface through which the server uses the simulation. `antdsl.preview.live.LiveSimulation` implements it.

    All methods are thread-safe and never block."""

    def enqueue_request(self, request: AnyRequest, client: Client) -> None: ...
    def add_client(self, client: Client) -> None: ...
    def remove_client(self, client: Client) -> None: ...


class PreviewServer:
    """The server of one preview. `async with PreviewServer(...).running():` serves until the block ends."""

    def __init__(self, live: SimulationHost, guard: RequestGuard, pages: PageFiles, listening: ListeningSockets) -> None:
        self._live, self._guard, self._pages, self._listening = live, guard, pages, listening
        self._gate = ConnectionGate()
        self._clients: set[ServerConnection] = set()
        self._closing_tasks: set[asyncio.Task[None]] = set()

    @asynccontextmanager
    async def run(self) -> AsyncIterator[None]:
        """Serve while the context is active. On exit, close all connections."""
        async with AsyncExitStack() as stack:
            for each in self._listening.sockets:
                await stack.enter_async_context(
                    serve(
                        self._serve_client,
                        sock=each,
                        create_connection=cast("type[ServerConnection]", self._gate.make_connection),
                        process_request=self._answer_request,
                        process_response=_add_headers,
                        subprotocols=[Subprotocol(WEBSOCKET_PROTOCOL)],
                        server_header=None,
                        # no compression: compressed data could expand to gigabytes, and loopback does not need it
                        compression=None,
                        max_size=limits.MAX_PREVIEW_MESSAGE_BYTES,
                        open_timeout=_REQUEST_TIMEOUT_SECONDS,
                        close_timeout=_CLOSE_TIMEOUT_SECONDS,
                        ping_interval=_PING_INTERVAL_SECONDS,
                        ping_timeout=_PING_INTERVAL_SECONDS,
                        logger=_SILENT_LOGGER,
                    )
                )
            try:
                yield
            finally:
                # the library sends a close frame and waits for it, which never completes if the client does not read
                asyncio.get_running_loop().call_later(_CLOSE_TIMEOUT_SECONDS, self._gate.close_all)

    # --- requests ------------------------------------------------------------------------------------------------------

    def _answer_request(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the HTTP response to a request, or None if the request may open a socket."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if getattr(request, "method", "GET") != "GET":  # earlier versions of websockets read no other method
            return _make_response(HTTPStatus.METHOD_NOT_ALLOWED, extra_headers=[("Allow", "GET")])
        if not self._guard.may_load_page(hosts, origins):
            return _make_response(HTTPStatus.FORBIDDEN)
        if request.path == "/ws":
            verdict = self._guard.judge_socket(hosts, origins, request.headers.get_all("Sec-WebSocket-Protocol"))
            if verdict is ConnectionVerdict.STRANGER:
                return _make_response(HTTPStatus.FORBIDDEN)
            if verdict in (ConnectionVerdict.ADMITTED, ConnectionVerdict.INVITED):
                self._gate.admit_connection(connection, is_invited=verdict is ConnectionVerdict.INVITED)
            return None
        route = self._pages.routes.get(request.path)
        return _make_response(HTTPStatus.NOT_FOUND) if route is None else _make_response(HTTPStatus.OK, *route)

    # --- sockets -------------------------------------------------------------------------------------------------------

    async def _serve_client(self, connection: ServerConnection) -> None:
        if not self._gate.is_admitted(connection) and await self._is_returning(connection):
            self._gate.admit_connection(connection, is_invited=True)
        if not self._gate.is_admitted(connection):
            # only a page can read the reason: a browser hides the content of a response that is not a socket
            await _close_connection(connection, CloseCode.POLICY_VIOLATION, "wrong token")
            return
        if len(self._clients) >= limits.MAX_PREVIEW_CLIENTS:
            await _close_connection(connection, CloseCode.TRY_AGAIN_LATER, "too many pages are open")
            return
        hello = {"build": self._pages.build}
        if self._gate.is_invited(connection):
            hello["token"] = self._guard.token
        if self._guard.returning_pages is not None:
            hello["key"] = self._guard.returning_pages.key
        mailbox = ClientMailbox(asyncio.get_running_loop(), hello, lambda: self._drop_slow_client(connection))
        self._clients.add(connection)
        self._live.add_client(mailbox)
        sender = asyncio.create_task(_send_messages(connection, mailbox))
        try:
            await self._read_requests(connection, mailbox)
        finally:
            self._live.remove_client(mailbox)
            self._clients.discard(connection)
            mailbox.close()
            sender.cancel()
            with suppress(asyncio.CancelledError):
                await sender

    async def _is_returning(self, connection: ServerConnection) -> bool:
        """Return whether a page with an outdated token proves that it was admitted before the server restarted."""
        returning = self._guard.returning_pages
        if returning is None or not returning.previous_keys or connection.request is None:
            return False
        nonce = secrets.token_urlsafe(32)
        try:
            async with asyncio.timeout(_REQUEST_TIMEOUT_SECONDS):
                await connection.send(json.dumps({"op": "return", "nonce": nonce}))
                return returning.is_proof(await connection.recv(), connection.request.headers["Host"], nonce)
        except (TimeoutError, ConnectionClosed):
            return False

    async def _read_requests(self, connection: ServerConnection, mailbox: ClientMailbox) -> None:
        """Read requests until the client disconnects, or until the server must disconnect it."""
        bucket = TokenBucket(limits.MAX_PREVIEW_REQUESTS_PER_SECOND, 2 * limits.MAX_PREVIEW_REQUESTS_PER_SECOND)
        patience, tell = TokenBucket(*_EXCESS_REQUEST_RATE_AND_BURST), TokenBucket(1, 1)
        with suppress(ConnectionClosed):
            async for message in connection:
                if not isinstance(message, str):
                    await _close_connection(connection, CloseCode.UNSUPPORTED_DATA, "only text is accepted")
                    return
                if bucket.take_token():
                    self._forward_request(message, mailbox)
                elif not patience.take_token():
                    await _close_connection(connection, CloseCode.TRY_AGAIN_LATER, "too many requests")
                    return
                elif tell.take_token():
                    mailbox.send_message(
                        RefusedRequest("", "this page sends too many requests at once: the last one was ignored").make_message()
                    )

    def _forward_request(self, message: str, mailbox: ClientMailbox) -> None:
        request = read_request(message)
        if isinstance(request, RefusedRequest):
            mailbox.send_message(request.make_message())
            return
        try:
            self._live.enqueue_request(request, mailbox)
        except QueueFullError:
            mailbox.send_message(
                RefusedRequest(request.op, "too many requests are pending", "try again in a moment").make_message()
            )
        except Exception:
            traceback.print_exc(file=sys.stderr)
            mailbox.send_message(
                RefusedRequest(request.op, "this is a bug in antdsl: see the terminal for details").make_message()
            )

    def _drop_slow_client(self, connection: ServerConnection) -> None:
        closing = asyncio.create_task(
            _close_connection(connection, CloseCode.TRY_AGAIN_LATER, "too many messages are pending for this page")
        )
        self._closing_tasks.add(closing)
        closing.add_done_callback(self._closing_tasks.discard)


async def _send_messages(connection: ServerConnection, mailbox: ClientMailbox) -> None:
    """Send the waiting messages one by one. The next one is chosen only after the previous one was sent, so a slow client gets
    the latest packets."""
    try:
        while True:
            item = await mailbox.receive_next()
            async with asyncio.timeout(_SEND_TIMEOUT_SECONDS):
                await connection.send(item)
    except ConnectionClosed:
        return
    except TimeoutError:  # for example after the machine slept
        connection.transport.abort()


async def _close_connection(connection: ServerConnection, code: CloseCode, reason: str) -> None:
    """Close a connection with a code and a reason. Do not wait long if the client does not respond."""
    with suppress(TimeoutError):
        async with asyncio.timeout(_CLOSE_TIMEOUT_SECONDS):
            await connection.close(code, reason)
    connection.transport.abort()


def _make_response(
    status: HTTPStatus,
    kind: str = "text/plain; charset=utf-8",
    body: bytes | None = None,
    *,
    extra_headers: Sequence[tuple[str, str]] = (),
) -> Response:
    body = f"{status.phrase}\n".encode() if body is None else body
    headers = Headers([("Content-Type", kind), ("Content-Length", str(len(body))), ("Connection", "close"), *extra_headers])
    return Response(status.value, status.phrase, headers, body)


def _add_headers(connection: ServerConnection, request: Request, response: Response) -> None:
    """Add the common headers to a response, including responses that the websockets library creates."""
    for name, value in RESPONSE_HEADERS:
        response.headers[name] = value


def run_server(server: PreviewServer, on_ready: Callable[[], None]) -> None:
    """Run the server until Ctrl-C or a termination signal. `on_ready`: called once pages can be loaded."""
    asyncio.run(_serve_until_stopped(server, on_ready))


async def _serve_until_stopped(server: PreviewServer, on_ready: Callable[[], None]) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        with suppress(NotImplementedError):  # on Windows, Ctrl-C is an exception that cancels this
            asyncio.get_running_loop().add_signal_handler(number, stop.set)
    async with server.run():
        on_ready()
        await stop.wait()
