"""What waits for a client: messages in order, the latest packet of each slot, and never more than the budgets; and where a server
listens."""

from __future__ import annotations

import asyncio
import json
import random
import socket
from collections.abc import Awaitable, Callable
from threading import Thread
from typing import Any

import pytest

from antdsl.preview.serving import addresses
from antdsl.preview.serving.addresses import ListenError, is_loopback, open_listening_sockets
from antdsl.preview.serving.connections import TokenBucket
from antdsl.preview.serving.mailbox import ClientMailbox


def with_mailbox(test: Callable[[ClientMailbox, list[str]], Awaitable[None]], **budgets: int) -> None:
    async def go() -> None:
        full: list[str] = []
        async with asyncio.timeout(60):
            await test(ClientMailbox(asyncio.get_running_loop(), {"build": "now"}, lambda: full.append("full"), **budgets), full)

    asyncio.run(go())


async def drained(mailbox: ClientMailbox) -> list[Any]:
    items: list[Any] = []
    try:
        while True:
            got = await asyncio.wait_for(mailbox.receive_next(), 0.02)
            items.append(got if isinstance(got, bytes) else json.loads(got)["op"])
    except TimeoutError:
        return items


def test_the_latest_of_a_slot_takes_the_place_of_the_one_before() -> None:
    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        mailbox.show_packet("mesh", b"mesh")
        mailbox.show_packet("frame", b"1")
        mailbox.send_message({"op": "status"})
        mailbox.show_packet("field", b"field")
        for number in b"23456789":
            mailbox.show_packet("frame", bytes([number]))
        assert await drained(mailbox) == [b"mesh", b"9", "status", b"field"]
        mailbox.show_packet("frame", b"10")
        assert await drained(mailbox) == [b"10"] and not full

    with_mailbox(test)


def test_a_packet_after_a_scene_arrives_after_it() -> None:
    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        mailbox.show_packet("frame", b"old")
        mailbox.show_packet("mesh", b"mesh")
        mailbox.send_message({"op": "scene"})
        mailbox.show_packet("frame", b"new")
        mailbox.show_packet("frame", b"newer")
        assert await drained(mailbox) == [b"mesh", "scene", b"newer"]

    with_mailbox(test)


def test_hello_names_the_current_page() -> None:
    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        message = {"op": "hello", "build": ""}
        mailbox.send_message(message)
        assert json.loads(await mailbox.receive_next()) == {"op": "hello", "build": "now"}
        assert message["build"] == ""

    with_mailbox(test)


@pytest.mark.parametrize("what", ["words", "packets"])
def test_more_than_the_budget_is_not_stored(what: str) -> None:
    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        for _ in range(100):
            mailbox.show_packet("one", bytes(900))  # the same slot: never more than one of them
        await asyncio.sleep(0)
        assert not full
        for number in range(3):
            if what == "words":
                mailbox.send_message({"op": "texts", "text": "x" * 500})
            else:
                mailbox.show_packet(f"solid:{number}", bytes(500))
        mailbox.show_packet("one", b"late")
        await asyncio.sleep(0)
        assert full == ["full"] and await drained(mailbox) == []

    with_mailbox(test, max_message_size=1000, max_packet_size=2000)


def test_what_a_page_cannot_read_is_never_sent() -> None:
    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        with pytest.raises(ValueError):
            mailbox.send_message({"op": "curves", "values": [float("nan")]})
        assert await drained(mailbox) == []

    with_mailbox(test)


def test_nothing_is_lost_or_turned_round_between_two_threads() -> None:
    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        def fill() -> None:
            chance = random.Random(5)
            for number in range(3000):
                if chance.random() < 0.3:
                    mailbox.send_message({"op": "status", "frame": number})
                else:
                    mailbox.show_packet(chance.choice("abc"), number.to_bytes(4, "little"))
            mailbox.send_message({"op": "end"})

        thread = Thread(target=fill)
        thread.start()
        frames: list[int] = []
        slots: list[int] = []
        while True:
            got = await mailbox.receive_next()
            if isinstance(got, bytes):
                slots.append(int.from_bytes(got, "little"))
            elif (message := json.loads(got))["op"] == "end":
                break
            else:
                frames.append(message["frame"])
        thread.join()
        chance = random.Random(5)
        expected, last = [], dict.fromkeys("abc", 0)
        for number in range(3000):
            if chance.random() < 0.3:
                expected.append(number)
            else:
                last[chance.choice("abc")] = number
        assert frames == expected
        assert len(slots) == len(set(slots)) and set(last.values()) <= {
            *slots,
            *(int.from_bytes(b, "little") for b in await drained(mailbox)),
        }

    with_mailbox(test)


def test_a_mailbox_accepts_messages_after_the_end_of_its_loop() -> None:
    mailboxes: list[ClientMailbox] = []

    async def test(mailbox: ClientMailbox, full: list[str]) -> None:
        mailboxes.append(mailbox)

    with_mailbox(test)
    mailboxes[0].send_message({"op": "status"})
    mailboxes[0].show_packet("frame", b"")


def test_a_bucket_gives_what_it_holds_and_then_by_the_second() -> None:
    now = [0.0]
    bucket = TokenBucket(10, 5, lambda: now[0])
    assert [bucket.take_token() for _ in range(7)] == [True] * 5 + [False] * 2
    now[0] = 0.25
    assert [bucket.take_token() for _ in range(3)] == [True, True, False]
    now[0] = 1000.0
    assert [bucket.take_token() for _ in range(6)] == [True] * 5 + [False]


# --- addresses ---------------------------------------------------------------------------------------------------------


def test_a_port_that_is_taken_leads_to_the_next() -> None:
    one = open_listening_sockets()
    two = open_listening_sockets()
    try:
        ports = [each.sockets[0].getsockname()[1] for each in (one, two)]
        assert addresses.DEFAULT_PORT <= ports[0] < ports[1]
        assert two.addresses == (f"http://127.0.0.1:{ports[1]}/",)
        assert two.host_names == {f"{name}:{ports[1]}" for name in ("localhost", "127.0.0.1", "[::1]")}
        with pytest.raises(ListenError, match=f"port {ports[0]} is in use"):
            open_listening_sockets(port=ports[0])
    finally:
        one.close()
        two.close()


def has_six() -> bool:
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        return False
    return True


@pytest.mark.skipif(not has_six(), reason="this machine has no IPv6")
def test_a_port_taken_at_the_other_loopback_is_refused() -> None:
    """`localhost` would lead to them, and the token with it."""
    with socket.socket(socket.AF_INET6) as other:
        other.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        other.bind(("::1", 0))
        with pytest.raises(ListenError, match="is in use"):
            open_listening_sockets(port=other.getsockname()[1])


def test_without_one_of_the_loopbacks_the_other_does(monkeypatch: pytest.MonkeyPatch) -> None:
    if not has_six():
        pytest.skip("this machine has no IPv6")
    monkeypatch.setattr(addresses, "_LOOPBACK_ADDRESSES", ("192.0.2.7", "::1"))  # an address for documents: no machine has it
    listener = open_listening_sockets(port=0)
    listener.close()
    assert len(listener.sockets) == 1 and listener.addresses[0].startswith("http://[::1]:")


def test_which_hosts_are_this_machine_only() -> None:
    assert is_loopback(None) and is_loopback("127.0.0.1") and is_loopback("::1") and is_loopback("127.8.8.8")
    assert not is_loopback("0.0.0.0") and not is_loopback("::") and not is_loopback("192.0.2.7")
    for unknown in ("no such host", "a..b", "x" * 300, ""):
        with pytest.raises(ListenError):
            is_loopback(unknown) or open_listening_sockets(unknown)
    with pytest.raises(ListenError, match=r"has no address `192\.0\.2\.7`"):
        open_listening_sockets("192.0.2.7")


def test_at_every_address_the_names_are_the_machines_own() -> None:
    listener = open_listening_sockets("0.0.0.0", 0)
    listener.close()
    port = next(iter(listener.host_names)).rsplit(":", 1)[1]
    assert {f"localhost:{port}", f"127.0.0.1:{port}", f"{socket.gethostname().lower()}:{port}"} <= listener.host_names
    assert not any(name.startswith(("0.0.0.0:", "*", "[::]")) for name in listener.host_names)
    assert all(address.split("/")[2] in listener.host_names for address in listener.addresses)
