"""The server admits only the page that the terminal named, and an admitted page can only send the requests of a page."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Awaitable, Callable
from contextlib import suppress
from ipaddress import ip_address

import pytest

pytest.importorskip("websockets")

from preview_served import SECONDS, Served, frame, raw, served
from websockets.exceptions import ConnectionClosed
from websockets.frames import Opcode

from antdsl import limits
from antdsl.preview.serving import server as serving
from antdsl.resources import preview_page_file

FILES = {"/": "index.html", "/index.html": "index.html", "/app.js": "app.js", "/app.css": "app.css"}


def with_server(test: Callable[[Served], Awaitable[None]], **live: object) -> None:
    async def go() -> None:
        async with served(**live) as server:
            await test(server)

    asyncio.run(go())


async def still_well(server: Served) -> None:
    """Whatever was done to the server, a page comes in and is answered."""
    async with server.connect() as client:
        assert json.loads(await client.recv())["op"] == "hello"
        await client.send('{"op": "pause"}')
        assert json.loads(await client.recv())["of"] == "pause"


# --- the page ----------------------------------------------------------------------------------------------------------


def test_the_page_is_served_with_a_policy_and_is_not_cached() -> None:
    async def test(server: Served) -> None:
        for path, name in FILES.items():
            status, headers, body = await server.get(path)
            assert status == 200
            if name == "index.html":
                assert f'<meta name="build" content="{server.pages.build}" />'.encode() in body
            else:
                assert body == preview_page_file(name).read_bytes()
            policy = headers["Content-Security-Policy"].split("; ")
            assert {"default-src 'none'", "script-src 'self'", "connect-src 'self'", "frame-ancestors 'none'"} <= set(policy)
            assert "unsafe" not in headers["Content-Security-Policy"] and "*" not in headers["Content-Security-Policy"]
            assert headers["X-Content-Type-Options"] == "nosniff" and headers["Cache-Control"] == "no-store"
            assert headers["Referrer-Policy"] == "no-referrer" and headers["Cross-Origin-Resource-Policy"] == "same-origin"
            assert not any(key.lower().startswith("access-control") for key in headers)

    with_server(test)


@pytest.mark.parametrize(
    "path",
    [
        "/../../etc/passwd", "/%2e%2e/%2e%2e/etc/passwd", "/..%2f..%2fetc/passwd", "/app.js%00.html", "/app.js%00", "//app.js",
        "//etc/passwd", "/\\app.js", "\\..\\..\\etc\\passwd", "/./app.js", "/app.js/", "/app.js?x", "/@fs/etc/passwd", "*",
        "/src/main.ts", "/sources.sha256", "/page/index.html", "/session.py", "file:///etc/passwd", "/ws/../app.js", "/APP.JS",
        "http://127.0.0.1/app.js", "http://evil.example/",
    ],
)  # fmt: skip
def test_there_are_no_other_paths(path: str) -> None:
    async def test(server: Served) -> None:
        for each in (path, path.replace("127.0.0.1", f"127.0.0.1:{server.port}")):
            status, headers, body = await server.get(each)
            assert (status, body) == (404, b"Not Found\n"), each
            assert headers["X-Content-Type-Options"] == "nosniff"

    with_server(test)


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "HEAD", "PATCH", "TRACE"])
def test_a_page_can_only_be_got(method: str) -> None:
    async def test(server: Served) -> None:
        status, headers, _ = await server.get("/", f"Origin: {server.origin}", method=method)
        assert status in (0, 400, 405)  # 0: earlier versions of websockets hang up
        assert not any(key.lower().startswith("access-control") for key in headers)

    with_server(test)


def test_requests_that_are_none_get_no_page() -> None:
    async def test(server: Served) -> None:
        for lines in (
            ["GET /"],
            ["GET / HTTP/3"],
            [""],
            ["\x16\x03\x01"],
            [f"GET /{'a' * 100_000} HTTP/1.1"],
            ["GET / HTTP/1.1", "no"],
        ):
            status, _, body = await server.say(*lines)
            assert status != 200 and b"<html" not in body, lines
        many = [f"X-{n}: {n}" for n in range(1000)]
        status, _, body = await server.get("/", *many)
        assert status != 200 and b"<html" not in body
        await still_well(server)

    with_server(test)


# --- who is let in -----------------------------------------------------------------------------------------------------


def test_other_names_of_the_host_are_refused() -> None:
    """After DNS rebinding a foreign page has our address, and says its own name as the host; its origin is the same name."""

    async def test(server: Served) -> None:
        port, good = server.port, f"127.0.0.1:{server.port}"
        for hosts in (
            ["evil.example"], [f"evil.example:{port}"], [f"localhost:{port + 1}"], ["localhost"], [f"localhost.:{port}"], [],
            [good, good], [f"{good}.evil.example"], [f"evil.example@{good}"], [f"127.0.0.2:{port}"], [f"0.0.0.0:{port}"],
            [f"127.1:{port}"], [f"[::ffff:127.0.0.1]:{port}"], [""],
        ):  # fmt: skip
            lines = [f"Host: {host}" for host in hosts]
            status, _, body = await server.say("GET / HTTP/1.1", *lines)
            assert status in (0, 400, 403) and b"<html" not in body, hosts
            assert await server.open_socket(hosts, [server.origin]) != 101, hosts
            assert await server.open_socket(hosts, [f"http://{host}" for host in hosts]) != 101, hosts
        for host in (good, f"localhost:{port}", f"[::1]:{port}"):
            assert (await server.say("GET / HTTP/1.1", f"Host: {host}"))[0] == 200
            assert await server.open_socket([host], [f"http://{host}"]) == 101
        assert server.live.joined <= 3

    with_server(test)


def test_pages_of_others_are_refused_though_they_have_the_token() -> None:
    async def test(server: Served) -> None:
        good = [f"127.0.0.1:{server.port}"]
        for origins in (
            ["http://evil.example"], ["null"], ["file://"], [f"https://127.0.0.1:{server.port}"],
            [f"http://127.0.0.1:{server.port + 1}"], ["http://127.0.0.1"],
            [f"http://evil.example:{server.port}"], [server.origin, server.origin], [server.origin, "null"], [""],
            [server.origin + "/"], [f"127.0.0.1:{server.port}"], [f"http://http://127.0.0.1:{server.port}"], ["chrome-extension://abc"],
        ):  # fmt: skip
            assert await server.open_socket(good, origins) == 403, origins
            if len(origins) == 1:
                assert (await server.get("/", f"Origin: {origins[0]}"))[0] == 403
        assert server.live.joined == 0
        assert await server.open_socket(good, []) == 101  # no browser: the token is what counts
        assert await server.open_socket(good, [], ["antdsl.1", "token.wrong"]) == 403
        assert await server.open_socket(good, [], ["antdsl.1"]) == 403
        await still_well(server)

    with_server(test)


def test_a_wrong_token_is_reported_and_nothing_else() -> None:
    async def test(server: Served) -> None:
        token = server.guard.token
        assert len(token) >= 43  # 32 random bytes
        for protocols in (
            ["antdsl.1", "token.wrong"], ["antdsl.1", "token."], ["antdsl.1"], ["antdsl.1", f"token.{token[:-1]}"],
            ["antdsl.1", f"token.{token}x"], ["antdsl.1", f"token.{token}", "token.wrong"], ["antdsl.1", token],
            ["antdsl.1", f"token.{token.swapcase()}"],
        ):  # fmt: skip
            async with server.connect(subprotocols=protocols) as client:
                with pytest.raises(ConnectionClosed):
                    await client.recv()
                assert client.close_code == 1008, protocols
        assert server.live.joined == 0 and not server.live.asks
        await still_well(server)

    with_server(test)


def test_a_code_opens_once_and_is_changed_for_the_token() -> None:
    async def test(server: Served) -> None:
        code = server.guard.make_invitation_code()
        assert code != server.guard.token and code not in repr(server.guard)
        good = [f"127.0.0.1:{server.port}"]
        assert await server.open_socket(good, ["http://evil.example"], ["antdsl.1", f"token.{code}"]) == 403
        for round_ in range(2):
            async with server.connect(subprotocols=["antdsl.1", f"token.{code}"]) as client:
                if round_ == 0:
                    assert json.loads(await client.recv())["token"] == server.guard.token
                else:
                    await client.wait_closed()
                    assert client.close_code == 1008
        async with server.connect() as client:
            assert "token" not in json.loads(await client.recv())

    with_server(test)


def test_each_server_has_a_token_of_its_own() -> None:
    async def test(server: Served) -> None:
        async with served() as other:
            assert other.guard.token != server.guard.token and other.guard.token not in repr(other.guard)

    with_server(test)


# --- what is read ------------------------------------------------------------------------------------------------------

MESSAGES = {
    "nothing": "",
    "no JSON": "{",
    "a number": "3",
    "a list": "[]",
    "nested": "[" * 60_000,
    "nested objects": '{"op":' * 10_000,
    "nested in a part": '{"op": "set", "name": "a", "value": ' + "[" * 30_000 + "]" * 30_000 + "}",
    "no number": '{"op": "speed", "times": NaN}',
    "endless": '{"op": "speed", "times": Infinity}',
    "endless by digits": '{"op": "speed", "times": 1e999}',
    "too fast": '{"op": "speed", "times": 65}',
    "backwards": '{"op": "speed", "times": -1}',
    "another op": '{"op": "save", "file": "forager.ant", "text": ""}',
    "no op": '{"frame": 3}',
    "an op that is none": '{"op": {"op": "play"}}',
    "too far": '{"op": "seek", "frame": 1e18, "exact": true}',
    "too far as a whole number": '{"op": "seek", "frame": 1000000000000000000, "exact": true}',
    "thousands of digits": '{"op": "seek", "frame": ' + "9" * 60_000 + ', "exact": true}',
    "a half": '{"op": "seek", "frame": 0.5, "exact": true}',
    "words for a number": '{"op": "seek", "frame": "3", "exact": true}',
    "words for yes": '{"op": "seek", "frame": 3, "exact": "true"}',
    "an agent below none": '{"op": "explain", "species": "walker", "agent": -1, "frame": 3}',
    "too many steps": '{"op": "step", "count": 1001}',
    "parts that nobody knows": '{"op": "play", "path": "/etc/passwd"}',
    "a part of all objects": '{"op": "play", "__proto__": {"x": 1}}',
    "a long name": '{"op": "set", "name": "' + "a" * 201 + '", "value": "1 mm"}',
    "a long value": '{"op": "set", "name": "a", "value": "' + "1" * 2001 + '"}',
    "too many columns": json.dumps({"op": "look", "columns": [{"species": "a", "name": "b"}] * 65}),
    "another break": '{"op": "breaks", "breaks": [{"kind": "code", "text": "1"}]}',
    "half a character": '{"op": "set", "name": "\\ud800", "value": "1 mm"}',
}


def test_messages_that_mean_nothing_are_refused_in_words_and_the_page_stays() -> None:
    async def test(server: Served) -> None:
        async with server.connect() as client:
            await client.recv()
            for what, text in MESSAGES.items():
                await client.send(text)
                said = json.loads(await client.recv())
                assert said["op"] == "refused", what
                assert said["message"] and len(said["message"]) < 200 and "\n" not in said["message"], what
                assert said["of"] in ("", "speed", "seek", "set", "explain", "step", "play", "look", "breaks"), what
            assert not server.live.asks
            await client.send('{"op": "seek", "frame": -3, "exact": true}')  # a scene may begin before frame 0
            assert json.loads(await client.recv())["of"] == "seek"
        await still_well(server)

    with_server(test)


def test_markup_in_a_name_is_a_name() -> None:
    async def test(server: Served) -> None:
        async with server.connect() as client:
            await client.recv()
            name = '</script><img src=x onerror="alert(1)">'
            await client.send(json.dumps({"op": "field", "name": name, "on": True}))
            assert json.loads(await client.recv())["of"] == "field"
            assert server.live.asks[0].name == name  # type: ignore[union-attr]
            await client.send(json.dumps({"op": name}))
            assert name not in await client.recv()  # the reply does not repeat the rejected text

    with_server(test)


def test_a_busy_server_says_so() -> None:
    async def test(server: Served) -> None:
        async with server.connect() as client:
            await client.recv()
            await client.send('{"op": "restart"}')
            said = json.loads(await client.recv())
            assert (said["op"], said["of"]) == ("refused", "restart") and said["help"]

    with_server(test, busy=True)


FRAMES = {
    "more than 64 KiB": (1009, lambda: [frame(Opcode.TEXT, b" " * (limits.MAX_PREVIEW_MESSAGE_BYTES + 1))]),
    "a gigabyte, says its header": (1009, lambda: [b"\x81\xff" + (1 << 30).to_bytes(8, "big") + b"mask"]),
    "exabytes, says its header": (1009, lambda: [b"\x81\xff" + ((1 << 63) - 1).to_bytes(8, "big") + b"mask"]),
    "more than 64 KiB in pieces": (
        1009,
        lambda: [frame(Opcode.TEXT, b" " * 30_000, last=False), *[frame(Opcode.CONT, b" " * 30_000, last=False)] * 2],
    ),
    "empty pieces for ever": (1006, lambda: [frame(Opcode.TEXT, last=False), *[frame(Opcode.CONT, last=False)] * 2000]),
    "packed": (1002, lambda: [frame(Opcode.TEXT, b"\x00" * 99, packed=True)]),
    "not masked": (1002, lambda: [frame(Opcode.TEXT, b"{}", masked=False)]),
    "no UTF-8": (1007, lambda: [frame(Opcode.TEXT, b'{"op": "pl\xffay"}')]),
    "binary": (1003, lambda: [frame(Opcode.BINARY, b'{"op": "play"}')]),
    "a flood of pings": (1006, lambda: [frame(Opcode.PING, b"x" * 125)] * 20_000),
    "a long ping": (1002, lambda: [b"\x89\xfe\x00\x7e" + b"mask" + b"x" * 126]),
    "a kind of frame that is none": (1002, lambda: [b"\x83\x80mask"]),
    "a piece of nothing": (1002, lambda: [frame(Opcode.CONT, b"{}")]),
}


@pytest.mark.parametrize("what", FRAMES)
def test_frames_out_of_order_end_their_own_connection_only(what: str) -> None:
    async def test(server: Served) -> None:
        code, frames = FRAMES[what]
        async with server.connect() as other, server.connect(ping_interval=None) as client:
            await client.recv()
            assert await raw(client, *frames()) == code
            assert not server.live.asks
            await other.send('{"op": "play"}')
            assert [json.loads(await other.recv())["op"] for _ in range(2)] == ["hello", "outcome"]
        await still_well(server)
        while server.live.clients:  # until the server knows of all that left
            await asyncio.sleep(0.01)

    with_server(test)


def test_compression_is_refused() -> None:
    async def test(server: Served) -> None:
        async with server.connect(compression="deflate") as client:
            assert client.response is not None and "Sec-WebSocket-Extensions" not in client.response.headers

    with_server(test)


# --- how much ----------------------------------------------------------------------------------------------------------


def test_who_asks_too_fast_loses_asks_and_then_the_connection() -> None:
    async def test(server: Served) -> None:
        async with server.connect(max_queue=None) as client:  # else who does not read hears of no end
            await client.recv()
            began = asyncio.get_running_loop().time()
            with pytest.raises(ConnectionClosed):
                for _ in range(50):
                    for _ in range(100):
                        await client.send('{"op": "pause"}')
                    await asyncio.sleep(0)
                await client.wait_closed()
                await client.send("")
            took = asyncio.get_running_loop().time() - began
            assert client.close_code in (1006, 1013)
            assert 0 < len(server.live.asks) <= limits.MAX_PREVIEW_REQUESTS_PER_SECOND * (took + 2) + 1
        await still_well(server)

    with_server(test)


def test_who_asks_too_much_all_the_time_has_to_go_as_well() -> None:
    """Though every so often an ask is in order."""

    async def test(server: Served) -> None:
        async with server.connect(max_queue=None) as client:
            with pytest.raises(ConnectionClosed):
                while True:
                    for _ in range(5):
                        await client.send('{"op": "pause"}')
                    await asyncio.sleep(0.01)
            said = []
            with suppress(ConnectionClosed):
                while True:
                    said.append(json.loads(await client.recv()))
            assert client.close_code == 1013
            assert 1 <= sum(each["op"] == "refused" for each in said) <= 5
            assert len(said) - 10 < len(server.live.asks)
        await still_well(server)

    with_server(test)


def test_a_slider_that_is_dragged_is_not_too_fast() -> None:
    async def test(server: Served) -> None:
        async with server.connect() as client:
            await client.recv()
            for _ in range(200):
                await client.send('{"op": "set", "name": "a.b", "value": "1 mm"}')
            assert [json.loads(await client.recv())["op"] for _ in range(200)] == ["outcome"] * 200

    with_server(test)


def test_sixteen_pages_look_on_and_the_next_has_to_wait() -> None:
    async def test(server: Served) -> None:
        clients = [await server.connect() for _ in range(limits.MAX_PREVIEW_CLIENTS)]
        for client in clients:
            await client.recv()
        async with server.connect() as late:
            await late.wait_closed()
            assert late.close_code == 1013
        await clients[0].close()
        await still_well(server)
        for client in clients[1:]:
            await client.close()

    with_server(test)


def test_ten_thousand_silent_connections_keep_no_page_out() -> None:
    async def test(server: Served) -> None:
        async with server.connect() as first:
            await first.recv()
            held: list[socket.socket] = []
            for count in range(10_000):
                held.append(socket.create_connection(("127.0.0.1", server.port)))
                if count % 50 == 0:
                    await asyncio.sleep(0)
                if len(held) > 400:
                    held.pop(0).close()
            status, _, _ = await server.get("/")
            assert status == 200
            await still_well(server)
            await first.send('{"op": "play"}')
            assert json.loads(await first.recv())["of"] == "play"
            closed_count = 0
            for each in held:
                each.settimeout(0.01)
                try:
                    closed_count += each.recv(1) == b""
                except TimeoutError:
                    continue
                except ConnectionResetError:
                    closed_count += 1
                finally:
                    each.close()
            assert closed_count >= len(held) - limits.MAX_UNADMITTED_CONNECTIONS

    with_server(test)


def test_a_request_that_takes_for_ever_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_REQUEST_TIMEOUT_SECONDS", 0.4)

    async def test(server: Served) -> None:
        reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
        began = asyncio.get_running_loop().time()
        with pytest.raises(ConnectionError):
            writer.write(b"GET / HTTP/1.1\r\nX: ")
            while not reader.at_eof():
                writer.write(b"a")
                await writer.drain()
                await asyncio.sleep(0.02)
            raise ConnectionResetError
        assert asyncio.get_running_loop().time() - began < SECONDS / 4
        await still_well(server)

    with_server(test)


def test_only_this_machine_is_heard() -> None:
    async def test(server: Served) -> None:
        for each in server.listening.sockets:
            assert ip_address(each.getsockname()[0]).is_loopback
        assert server.guard.host_names == {f"{name}:{server.port}" for name in ("localhost", "127.0.0.1", "[::1]")}

    with_server(test)


def test_a_slow_page_gets_the_latest_packet_of_each_slot_and_every_message() -> None:
    async def test(server: Served) -> None:
        async with server.connect(max_size=None, max_queue=1) as client:
            await client.recv()
            mailbox = server.live.clients[0]
            for number in range(300):
                mailbox.show_packet("frame", number.to_bytes(4, "little") * 250_000)
                if number % 10 == 0:
                    mailbox.send_message({"op": "status", "frame": number})
                await asyncio.sleep(0.001)
            packets, messages = [], []
            while not packets or packets[-1] != 299 or len(messages) < 30:
                got = await client.recv()
                if isinstance(got, bytes):
                    packets.append(int.from_bytes(got[:4], "little"))
                else:
                    messages.append(json.loads(got)["frame"])
            assert packets == sorted(set(packets)) and len(packets) < 100
            assert messages == list(range(0, 300, 10))

    with_server(test)


def test_a_page_that_takes_nothing_is_let_go_and_may_come_back(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serving, "_CLOSE_TIMEOUT_SECONDS", 0.3)

    async def test(server: Served) -> None:
        client = await server.connect(max_size=None, max_queue=1, ping_interval=None)
        client.transport.pause_reading()
        while not server.live.clients:
            await asyncio.sleep(0.01)
        mailbox = server.live.clients[0]
        text = "x" * (1 << 20)
        for _ in range(60):
            mailbox.send_message({"op": "texts", "text": text})
            await asyncio.sleep(0.001)
        while server.live.clients:
            await asyncio.sleep(0.01)
        await still_well(server)
        client.transport.abort()

    with_server(test)


@pytest.mark.parametrize("seconds", ["_SEND_TIMEOUT_SECONDS", "_CLOSE_TIMEOUT_SECONDS"])
def test_a_page_that_sleeps_is_given_up_and_keeps_no_server_from_ending(monkeypatch: pytest.MonkeyPatch, seconds: str) -> None:
    monkeypatch.setattr(serving, seconds, 0.3)

    async def test(server: Served) -> None:
        client = await server.connect(max_size=None, max_queue=1, ping_interval=None)
        client.transport.pause_reading()
        while not server.live.clients:
            await asyncio.sleep(0.01)
        server.live.clients[0].show_packet("mesh", bytes(20 << 20))
        await asyncio.sleep(0.05)
        while seconds == "_SEND_TIMEOUT_SECONDS" and server.live.clients:
            await asyncio.sleep(0.01)

    with_server(test)
