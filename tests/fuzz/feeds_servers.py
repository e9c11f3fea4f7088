"""Feed functions of what answers others: the language server, the socket of the preview, and the messages of a page."""

from __future__ import annotations

import asyncio
import io
import json
import logging
import socket
import threading
import traceback
from collections.abc import Iterator
from contextlib import redirect_stderr
from pathlib import Path
from typing import Any

from cases.hostile.rows import PROGRAM
from fuzz.feeds_cache import PROJECT
from fuzz.oracle import Feed, Violation
from preview_served import Noted

from antdsl.preview import live as live_module
from antdsl.preview.live import LiveSimulation
from antdsl.preview.serving.addresses import ListeningSockets
from antdsl.preview.serving.guard import RequestGuard
from antdsl.preview.serving.page_files import load_pages
from antdsl.preview.serving.server import PreviewServer, RefusedRequest, read_request
from antdsl.runtime import Options

TOKEN = "t" * 43
NAME = "localhost:8765"
SECONDS = 20.0  # that a server may take to close a connection
QUIET = 60  # turns of the loop in which nothing happens
MESSAGES = 40  # of one input
REQUEST = (
    f"GET /ws HTTP/1.1\r\nHost: {NAME}\r\nOrigin: http://{NAME}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
    f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    f"Sec-WebSocket-Protocol: antdsl.1, token.{TOKEN}\r\n\r\n"
).encode()


class _Errors(logging.Handler):
    """Collects log records with a traceback that goes through the product."""

    def __init__(self, *documented: type[Exception]) -> None:
        super().__init__(logging.ERROR)
        self.documented = documented
        self.found: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info is not None and record.exc_info[1] is not None:
            self.add(record.exc_info[1])

    def add(self, why: BaseException) -> None:
        text = "".join(traceback.format_exception(why))
        if "/antdsl/" in text and not isinstance(why, self.documented):
            self.found.append(_last_line(text) + "\n" + text)

    def check(self) -> None:
        errors, self.found = self.found, []
        if errors:
            raise Violation("bug", errors[0])


def _last_line(text: str) -> str:
    """The exception and the last line of the product in a traceback: the same for inputs with the same cause."""
    own = [line.strip() for line in text.splitlines() if "/antdsl/" in line]
    place = own[-1].rpartition("/")[2] if own else ""
    return f"{text.strip().splitlines()[-1][:40]} at {place}"


# --- the socket of the preview


def feed_websocket(folder: Path) -> Feed:
    """Bytes of a client, to a server that listens at a socket of the file system. Bytes that are no request come after a good
    one."""
    sock = socket.socket(socket.AF_UNIX)
    sock.bind("s")
    sock.listen()
    noted, errors = Noted(), _Errors()
    guard = RequestGuard(frozenset({NAME}), TOKEN)
    server = PreviewServer(noted, guard, load_pages(), ListeningSockets((sock,), guard.host_names, ()))
    loop = asyncio.new_event_loop()
    loop.set_exception_handler(lambda _, context: errors.add(context["exception"]) if "exception" in context else None)
    running = server.run()
    loop.run_until_complete(running.__aenter__())
    logging.getLogger("antdsl.preview.serving").addHandler(errors)

    async def talk(data: bytes) -> bytes:
        reader, writer = await asyncio.open_unix_connection("s")
        writer.write(data)
        reading, quiet, previous_count = asyncio.create_task(reader.read()), 0, -1
        while quiet < QUIET and not reading.done():  # an end of the stream while a request is read ends it without an answer
            await asyncio.sleep(0)
            quiet, previous_count = (quiet + 1, previous_count) if previous_count == len(noted.asks) else (0, len(noted.asks))
        try:
            writer.write_eof()
            async with asyncio.timeout(SECONDS):
                return await reading
        except TimeoutError:
            raise Violation("stuck", "the server does not close the connection") from None
        except OSError:
            return b""
        finally:
            writer.close()

    def feed(data: bytes, alive: object = (running, server)) -> str:
        noted.asks.clear()
        answer = loop.run_until_complete(talk(data if data[:4] in (b"GET ", b"POST", b"HEAD") else REQUEST + data))
        errors.check()
        status = answer.partition(b"\r\n")[0].decode("latin-1")
        return "\n".join([status, *(str(ask) for ask in noted.asks[:100])])

    return feed


def websocket_inputs() -> list[bytes]:
    texts = [json.dumps(each).encode() for each in PAGE_MESSAGES[:14]]
    inputs = [b"".join(_frame(1, text) for text in texts), _frame(9, b"ping") + _frame(8, b"\x03\xe8bye"), _frame(2, b"\0\1\2")]
    inputs += [_frame(1, b'{"op":', final=False) + _frame(0, b'"play"}'), _frame(1, b"\xff\xfe"), _frame(1, b"[" * 3000)]
    inputs += [b"".join(_frame(0, b"", final=False) for _ in range(80)), REQUEST, REQUEST.replace(b"/ws", b"/app.js")]
    return [*inputs, _frame(1, b"x" * 300), b"\x81\xff" + b"\xff" * 8 + bytes(8), b"\xc1\x85" + bytes(9)]


def _frame(kind: int, data: bytes, final: bool = True) -> bytes:
    """A masked frame of a client (RFC 6455, 5.2), with a mask of zeros."""
    size = len(data)
    head = bytes([kind | 0x80 * final]) + (
        bytes([0x80 | size])
        if size < 126
        else b"\xfe" + size.to_bytes(2, "big")
        if size < 65536
        else b"\xff" + size.to_bytes(8, "big")
    )
    return head + bytes(4) + data


# --- messages of a page

PAGE_MESSAGES: list[dict[str, Any]] = [
    {"op": "play"}, {"op": "pause"}, {"op": "step", "count": 3}, {"op": "speed", "times": 2.0}, {"op": "reload"},
    {"op": "restart"},
    {"op": "seek", "frame": 3, "exact": True}, {"op": "seek", "frame": -5, "exact": False}, {"op": "profile", "on": True},
    {"op": "set", "name": "walker.swing", "value": "20 deg"}, {"op": "layer", "species": "walker", "layer": "steer", "on": False},
    {"op": "field", "name": "trail", "on": False}, {"op": "explain", "species": "walker", "agent": 2, "frame": 2},
    {"op": "look", "columns": [{"species": "walker", "name": "load"}], "fields": ["trail"]},
    {"op": "look", "follow": {"species": "walker", "agent": 1}},
    {"op": "look", "planned": [{"species": "walker", "agent": 3}], "solids": False}, {"op": "look", "planned": []},
    {"op": "breaks", "breaks": [{"kind": "state", "species": "walker", "machine": "main", "state": "rest"}]},
    {"op": "breaks", "breaks": [{"kind": "condition", "text": "count(walker) > 3"}, {"kind": "fault"}]},
    {"op": "breaks", "breaks": [], "tried": {"kind": "condition", "text": "mean(walker.speed) > 1 mm/s"}},
    {"op": "set", "name": "walker.load", "value": "3"}, {"op": "set", "name": "trail.half_life", "value": "2 s"},
]  # fmt: skip


class _Page:
    """A client that keeps the messages to it."""

    def __init__(self) -> None:
        self.messages: list[dict[str, Any]] = []

    def send_message(self, message: dict[str, Any]) -> None:
        json.dumps(message, allow_nan=False)
        self.messages.append(message)

    def show_packet(self, slot: str, packet: bytes) -> None:
        self.messages.append({"op": "packet", "slot": slot, "bytes": len(packet)})


def feed_page(folder: Path) -> Feed:
    """Lines, each a message of a page, to a session of a small scene. The clock advances automatically, the same in each run."""
    for name, data in PROJECT.items():
        (folder / name).write_bytes(data)
    ticks: Iterator[float] = iter(())

    def clock() -> float:
        return next(ticks)

    live_module.monotonic = clock  # type: ignore[assignment]

    def feed(data: bytes) -> str:
        nonlocal ticks
        ticks = (0.002 * k for k in range(1 << 40))
        page, errors = _Page(), io.StringIO()
        with redirect_stderr(errors):
            live = LiveSimulation.open_scene(folder / "scene.yaml", None, Options(backend="numpy"), watch=False)
            live._process_item("join", page)
            for line in data.split(b"\n")[:MESSAGES]:
                request = read_request(line.decode("utf-8", "replace"))
                if isinstance(request, RefusedRequest):
                    page.send_message(request.make_message())
                    continue
                live._process_item(request, page)
                for _ in range(3):
                    live._advance_once(live.session)
                live.screen.send_due_updates(clock())
        if errors.getvalue():
            raise Violation("bug", _last_line(errors.getvalue()) + "\n" + errors.getvalue())
        messages = [each for each in page.messages if each.get("op") in ("refused", "outcome", "explained", "breaks")]
        return "\n".join(
            [
                *(json.dumps(each, sort_keys=True)[:300] for each in messages),
                f"frame {live.session.frame} {live.session.state_hash}",
            ]
        )

    return feed


def page_inputs() -> list[bytes]:
    lines = [json.dumps(each).encode() for each in PAGE_MESSAGES]
    return [b"\n".join(lines), *lines, *(b"\n".join(lines[k : k + 4]) for k in range(0, len(lines), 4))]


# --- the language server


def feed_lsp(folder: Path) -> Feed:
    """Lines, each a JSON message of an editor, or a stream with its headers where the input begins with one."""
    from pygls import io_
    from pygls.exceptions import JsonRpcException

    from antdsl.lsp import server as module
    from antdsl.lsp.workspace import Workspace

    server, protocol, errors = module.language_server, module.language_server.protocol, _Errors(JsonRpcException)
    (folder / "a.ant").write_bytes(PROGRAM)
    for name, data in PROJECT.items():
        (folder / name).write_bytes(data)
    for name in ("pygls", "antdsl.lsp"):
        logger = logging.getLogger(name)
        logger.addHandler(errors)
        logger.propagate = False
    server.report_server_error = lambda why, source: errors.add(why)  # type: ignore[method-assign]

    class Output:
        def __init__(self) -> None:
            self.text: list[bytes] = []

        def write(self, data: bytes) -> None:
            self.text.append(data)

        def close(self) -> None:
            pass

    class Input:
        """Lets what waits be done before each message, as a pipe does."""

        def __init__(self, data: bytes) -> None:
            self.stream = io.BytesIO(data)

        async def readline(self) -> bytes:
            await asyncio.sleep(0)
            await asyncio.sleep(0)
            return self.stream.readline()

        async def readexactly(self, count: int) -> bytes:
            return self.stream.read(min(count, 1 << 40))

    def feed(data: bytes) -> str:
        server.files, server.uris, server.pending_paths = Workspace(), {}, set()
        server.exited_without_shutdown = server.is_shutdown_requested = False
        protocol._shutdown, protocol._workspace = False, None
        protocol._request_futures.clear()
        protocol._result_types.clear()
        output = Output()
        protocol.set_writer(output, include_headers=False)
        stream = data if data.startswith(b"Content-Length") else _stream(data, folder)
        try:
            asyncio.run(io_.run_async(threading.Event(), Input(stream), protocol, None, server.report_server_error))
        except SystemExit:  # the message `exit`
            output.text.append(b"exit")
        errors.check()
        return b"\n".join(output.text).decode("utf-8", "replace").replace(str(folder), "FOLDER")

    return feed


def _stream(data: bytes, folder: Path) -> bytes:
    """Messages with headers. `FOLDER` stands for the folder; a URI that leads elsewhere is an editor's own right, not a bug, so
    that it is led into the folder."""
    parts = []
    for line in data.split(b"\n")[:MESSAGES]:
        body = line.replace(b"FOLDER", str(folder).encode())
        try:
            message = _within(json.loads(body), folder.as_uri())
            body = json.dumps(message).encode("utf-8", "surrogatepass")
        except (ValueError, RecursionError):
            pass
        parts.append(b"Content-Length: %d\r\n\r\n%b" % (len(body), body))
    return b"".join(parts)


def _within(value: Any, uri: str) -> Any:
    if isinstance(value, dict):
        return {key: _within(each, uri) for key, each in value.items()}
    if isinstance(value, list):
        return [_within(each, uri) for each in value]
    if isinstance(value, str) and value.startswith("file:") and (not value.startswith(uri) or ".." in value or "%" in value):
        return uri + "/b.ant"
    return value


_DOCUMENT = {"uri": "file://FOLDER/a.ant"}
_QUESTIONS = (
    "hover", "completion", "definition", "references", "documentHighlight", "prepareRename", "rename", "documentSymbol",
    "foldingRange", "semanticTokens/full", "semanticTokens/range", "inlayHint", "codeAction", "formatting",
)  # fmt: skip


def lsp_inputs() -> list[bytes]:
    """Sessions of an editor: open, ask everything, change, ask again, close."""
    sessions = []
    programs = {"a.ant": PROJECT["walker.ant"].decode(), "b.ant": PROGRAM.decode(), "scene.yaml": PROJECT["scene.yaml"].decode()}
    for number, (name, text) in enumerate(programs.items()):
        document = {"uri": f"file://FOLDER/{name}"}
        item = {**document, "languageId": "antdsl", "version": 1, "text": text}
        lines = [_request(0, "initialize", {"processId": None, "rootUri": "file://FOLDER", "capabilities": {}})]
        lines += [_notice("initialized", {}), _notice("textDocument/didOpen", {"textDocument": item})]
        lines += _questions(document, 9, 10 + number)
        change = {"range": {"start": {"line": 3, "character": 2}, "end": {"line": 3, "character": 9}}, "text": "steer wander"}
        both = {**document, "version": 2}
        lines += [_notice("textDocument/didChange", {"textDocument": both, "contentChanges": [change, {"text": text + "\n"}]})]
        lines += _questions(document, 4, 6)
        lines += [
            _notice("textDocument/didSave", {"textDocument": document}),
            _notice("textDocument/didClose", {"textDocument": document}),
        ]
        sessions.append(b"\n".join([*lines, _request(99, "shutdown", None), _notice("exit", None)]))
    return [b"\n".join(sessions[0].split(b"\n")[:6]), *sessions, b"Content-Length: 20\r\n\r\n" + b'{"jsonrpc":"2.0"}   ']


def _questions(document: dict[str, str], line: int, character: int) -> list[bytes]:
    place = {"line": line, "character": character}
    area = {"start": {"line": 0, "character": 0}, "end": {"line": 30, "character": 0}}
    params = {"textDocument": document, "position": place, "range": area, "newName": "other"}
    params |= {"context": {"includeDeclaration": True, "diagnostics": []}, "options": {"tabSize": 2, "insertSpaces": True}}
    return [_request(number + 1, f"textDocument/{each}", params) for number, each in enumerate(_QUESTIONS)]


def _request(number: int, method: str, params: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params}).encode()


def _notice(method: str, params: Any) -> bytes:
    return json.dumps({"jsonrpc": "2.0", "method": method, "params": params}).encode()


def json_words() -> list[str]:
    """What mutation inserts into messages: ops, methods, keys and values at edges."""
    keys = [f'"{key}"' for each in PAGE_MESSAGES for key in each]
    ops = [f'"op": "{each["op"]}"' for each in PAGE_MESSAGES]
    methods = [f'"method": "textDocument/{each}"' for each in _QUESTIONS]
    edges = ["null", "true", "[]", "{}", "-1", "1e999", "NaN", '"__proto__"', '"\\ud800"', '"\\u0000"', "9007199254740993", '""']
    edges += ['"character": 99999', '"line": -1', '"line": 99999', '"use \\"/etc/passwd\\"\\n"', '"walker"', '"swing"', '"load"']
    return [*keys, *ops, *methods, *edges]
