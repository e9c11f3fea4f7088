"""After a restart, a server admits only pages that prove a key of an earlier start."""

from __future__ import annotations

import asyncio
import hmac
import json
import os
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("websockets")

from preview_served import SECONDS, Noted
from websockets.exceptions import ConnectionClosed

from antdsl.preview.serving.addresses import open_listening_sockets
from antdsl.preview.serving.guard import RequestGuard, ReturningPages
from antdsl.preview.serving.page_files import load_pages
from antdsl.preview.serving.server import PreviewServer

SCENE = Path("scene.yaml")


def proof(key: str, host: str, nonce: str) -> str:
    return hmac.new(key.encode(), f"antdsl return\n{host}\n{nonce}".encode(), "sha256").hexdigest()


def test_keys_of_the_last_starts_are_known_to_this_scene_and_port_alone(tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    starts = [ReturningPages.open_for_server(SCENE, 8765, folder) for _ in range(6)]
    assert all(starts) and len({each.key for each in starts if each}) == 6
    last = starts[-1]
    assert last is not None
    assert last.previous_keys == tuple(each.key for each in reversed(starts[1:5]) if each)
    known, forgotten, other = (starts[4], starts[0], ReturningPages.open_for_server(SCENE, 8766, folder))
    assert known is not None and forgotten is not None and other is not None and other.previous_keys == ()
    host = "127.0.0.1:8765"
    assert last.is_proof(proof(known.key, host, "n"), host, "n")
    for wrong in (proof(forgotten.key, host, "n"), proof(last.key, host, "n"), proof(known.key, host, "m"), known.key, "", "é"):
        assert not last.is_proof(wrong, host, "n")
    assert not last.is_proof(proof(known.key, "127.0.0.1:9999", "n"), host, "n"), "nor what was signed for another port"
    assert not last.is_proof(proof(known.key, host, "n").encode(), host, "n")


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system has other ways to keep files private")
def test_only_private_files_of_keys_are_read(tmp_path: Path) -> None:
    folder = tmp_path / "kept"
    first = ReturningPages.open_for_server(SCENE, 1, folder)
    assert first is not None
    [place] = folder.iterdir()
    assert place.stat().st_mode & 0o777 == 0o600 and folder.stat().st_mode & 0o777 == 0o700
    original_text = place.read_text()
    for text in ("", "{", "[]", '{"keys": 3}', '{"keys": ["short", 5, null]}', "[" * 3000):
        place.write_text(text)
        assert (returning := ReturningPages.open_for_server(SCENE, 1, folder)) is not None and returning.previous_keys == ()
    place.write_text(original_text)
    place.chmod(0o644)  # others may have read it
    assert (returning := ReturningPages.open_for_server(SCENE, 1, folder)) is not None and returning.previous_keys == ()
    place.unlink()
    elsewhere = tmp_path / "elsewhere.json"
    elsewhere.write_text(original_text)
    elsewhere.chmod(0o600)
    place.symlink_to(elsewhere)
    assert (returning := ReturningPages.open_for_server(SCENE, 1, folder)) is not None and returning.previous_keys == ()
    assert elsewhere.read_text() == original_text, "what a link leads to is left alone"
    place.unlink()
    os.mkfifo(place)
    assert (returning := ReturningPages.open_for_server(SCENE, 1, folder)) is not None and returning.previous_keys == ()
    folder.chmod(0o777)
    assert ReturningPages.open_for_server(SCENE, 1, folder) is None, "a folder that others may write to keeps nothing"


def test_a_server_lets_in_who_proves_a_key_and_tells_the_token(tmp_path: Path) -> None:
    """As a page with an old token, which is not let in else."""
    from websockets.asyncio.client import connect

    async def test() -> None:
        listening = open_listening_sockets(port=0)
        previous_returning = ReturningPages.open_for_server(SCENE, listening.port, tmp_path / "kept")
        now = ReturningPages.open_for_server(SCENE, listening.port, tmp_path / "kept")
        assert previous_returning is not None and now is not None
        guard = RequestGuard(listening.host_names, returning_pages=now)
        live = Noted()
        host = f"127.0.0.1:{listening.port}"

        async def come(answer: str | None, origin: str | None = f"http://{host}") -> list[dict[str, str]]:
            """The reply to a client that answers so; `{nonce}` stands for a right proof."""
            messages = []
            try:
                options: dict[str, Any] = {"origin": origin, "subprotocols": ["antdsl.1", "token.old"], "proxy": None}
                async with connect(f"ws://{host}/ws", **options) as client:
                    messages.append(json.loads(await client.recv()))
                    if answer is not None:
                        await client.send(answer.replace("{nonce}", proof(previous_returning.key, host, messages[0]["nonce"])))
                    messages.append(json.loads(await client.recv()))
            except ConnectionClosed as why:
                messages.append({"op": "closed", "reason": why.rcvd.reason if why.rcvd else ""})
            return messages

        async with asyncio.timeout(SECONDS), PreviewServer(live, guard, load_pages(), listening).run():
            challenge, hello = await come("{nonce}")
            assert challenge["op"] == "return" and hello["op"] == "hello"
            assert (hello["token"], hello["key"]) == (guard.token, now.key)
            for wrong in ("", "{nonce}0", proof(previous_returning.key, host, "another"), '{"op": "play"}'):
                assert (await come(wrong))[-1] == {"op": "closed", "reason": "wrong token"}
            assert live.joined == 1 and not live.asks
            with pytest.raises(Exception, match="403"):
                await come("{nonce}", origin="http://example.com")
            with pytest.raises(Exception, match="403"):
                await come("{nonce}", origin=None)

    asyncio.run(test())
