"""`antdsl preview` as a person starts it: a process, an address, a page's socket; saved files, Ctrl-C, mistakes at the start."""

from __future__ import annotations

import asyncio
import json
import shutil
import signal
import socket
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from children import child_environment

pytest.importorskip("websockets")

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import InvalidStatus

from antdsl.preview.binary_packets import unpack_arrays

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 60
WALKER = (ROOT / "examples" / "minimal" / "walker.ant").read_text(encoding="utf-8")


@dataclass
class Started:
    process: Process
    address: str
    token: str
    words: str  # what else it printed

    def connect(self, address: str = "", **other: Any) -> connect:
        base = address or self.address
        options: dict[str, Any] = {"origin": base.rstrip("/"), "subprotocols": ["antdsl.1", f"token.{self.token}"], **other}
        return connect(f"{base.replace('http', 'ws', 1)}ws", max_size=None, proxy=None, close_timeout=1, **options)


@asynccontextmanager
async def started(*words: str | Path, folder: Path, open_it: bool = False) -> AsyncIterator[Started]:
    environment = child_environment(PYTHONUNBUFFERED="1")
    command = [
        sys.executable,
        "-m",
        "antdsl",
        "preview",
        *map(str, words),
        "--port",
        "0",
        "--threads",
        "2",
        *["--no-open"][open_it:],
    ]
    process = await asyncio.create_subprocess_exec(*command, cwd=folder, env=environment, stdout=PIPE, stderr=PIPE)
    assert process.stdout is not None
    try:
        async with asyncio.timeout(SECONDS):
            lines: list[str] = []
            while not lines or "Ctrl-C" not in lines[-1]:
                line = (await process.stdout.readline()).decode()
                assert line, "it ended before it was ready"
                lines.append(line)
            address, _, token = lines[0].strip().partition("#")
            yield Started(process, address, token, "".join(lines[1:]))
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()


async def ended(process: Process, number: int = signal.SIGINT) -> tuple[int, str]:
    process.send_signal(number)
    _, said = await asyncio.wait_for(process.communicate(), 10)
    return process.returncode or 0, said.decode()


async def hear(client: ClientConnection, fits: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """The next message that fits; a packet counts as its header, with the number of rows of its first array."""
    while True:
        got = await asyncio.wait_for(client.recv(), 10)
        if isinstance(got, bytes):
            header, arrays = unpack_arrays(got)
            message = {"op": "", **header, "rows": max((len(each) for each in arrays.values()), default=0)}
        else:
            message = json.loads(got)
        if fits(message):
            return message


def is_frame(message: dict[str, Any]) -> bool:
    return message.get("slot") == "frame"


def example(folder: Path) -> Path:
    example_folder = folder / "minimal"
    shutil.copytree(ROOT / "examples" / "minimal", example_folder)
    return example_folder


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def go(test: Callable[[], Awaitable[None]]) -> None:
    async def limited() -> None:
        async with asyncio.timeout(SECONDS):
            await test()

    asyncio.run(limited())


def test_a_scene_is_watched_edited_and_left(tmp_path: Path) -> None:
    folder = example(tmp_path)

    async def test() -> None:
        async with started("scene.yaml", folder=folder) as preview, preview.connect() as page:
            assert preview.address.startswith("http://127.0.0.1:")
            assert (await hear(page, lambda m: m["op"] == "hello"))["build"]
            scene = await hear(page, lambda m: m["op"] == "scene")
            assert [each["name"] for each in scene["species"]] == ["walker"]
            texts = await hear(page, lambda m: m["op"] == "texts")
            assert WALKER in [each["text"] for each in texts["texts"]]
            assert str(tmp_path) not in json.dumps([scene, texts])  # paths of the user stay private
            await page.send('{"op": "play"}')
            frames = [(await hear(page, is_frame))["frame"] for _ in range(10)]
            assert frames == sorted(frames) and frames[-1] > frames[0]
            (folder / "walker.ant").write_text(WALKER.replace("30 mm/s", "60 mm/s"), encoding="utf-8")
            assert (await hear(page, lambda m: m["op"] == "outcome"))["of"] == "saved"
            (folder / "walker.ant").write_text(WALKER.replace("wander()", "wonder()"), encoding="utf-8")
            message = await hear(page, lambda m: m["op"] == "problems" and bool(m["problems"]))
            assert "wonder" in message["problems"][0]["message"]
            later = [(await hear(page, is_frame))["frame"] for _ in range(3)]
            assert later[0] > frames[-1] and later == sorted(later)  # the last good program runs on
            (folder / "walker.ant").write_text(WALKER, encoding="utf-8")
            await hear(page, lambda m: m["op"] == "problems" and not m["problems"])
            await page.send('{"op": "seek", "frame": 4, "exact": true}')
            assert (await hear(page, lambda m: is_frame(m) and m["frame"] <= 4))["frame"] == 4
            await page.send('{"op": "seek", "frame": 9007199254740992, "exact": true}')
            assert (await hear(page, lambda m: is_frame(m) and m["frame"] > 4))["frame"] < 10_000  # the last that there is
            initial_files = files(folder)
            await page.send('{"op": "restart"}')
            assert (await hear(page, lambda m: m["op"] == "outcome"))["ok"]
            assert await ended(preview.process) == (0, "")
            assert page.close_code is None or page.close_code in (1001, 1006)
        assert files(folder) == initial_files == files(ROOT / "examples" / "minimal")

    go(test)


def test_mistakes_at_the_start_are_shown_and_the_ants_come_once_they_are_mended(tmp_path: Path) -> None:
    folder = example(tmp_path)
    (folder / "walker.ant").write_text(WALKER.replace("wander()", "wonder()"), encoding="utf-8")

    async def test() -> None:
        async with started("scene.yaml", folder=folder) as preview, preview.connect() as page:
            assert "scene.yaml has errors" in preview.words
            message = await hear(page, lambda m: m["op"] == "problems")
            assert "wonder" in message["problems"][0]["message"]
            await page.send('{"op": "play"}')
            assert (await hear(page, lambda m: m["op"] == "refused"))["help"]
            (folder / "walker.ant").write_text(WALKER, encoding="utf-8")
            assert (await hear(page, lambda m: m["op"] == "scene" and bool(m["species"])))["species"]
            assert (await hear(page, is_frame))["rows"] > 0
            code, said = await ended(preview.process, signal.SIGTERM)
            assert code == 0 and "wonder" in said  # the terminal reported it too

    go(test)


def known(name: str) -> bool:
    """Whether this machine knows a name: a bare one may have no list of hosts."""
    try:
        return bool(socket.getaddrinfo(name, None))
    except OSError:
        return False


def test_others_are_let_in_only_where_it_is_said_and_only_with_the_token(tmp_path: Path) -> None:
    folder = example(tmp_path)

    async def test() -> None:
        async with started("scene.yaml", "--host", "0.0.0.0", "--let-others-in", folder=folder) as preview:
            assert "Other machines can reach this" in preview.words and "not encrypted" in preview.words
            port = preview.address.rstrip("/").rsplit(":", 1)[1]
            names = ["127.0.0.1", *(["localhost"] if known("localhost") else [])]
            for address in (preview.address, *(f"http://{name}:{port}/" for name in names)):
                async with preview.connect(address) as page:
                    assert json.loads(str(await page.recv()))["op"] == "hello"
                async with preview.connect(address, subprotocols=["antdsl.1"]) as page:
                    await page.wait_closed()
                    assert page.close_code == 1008
            with pytest.raises(InvalidStatus):
                async with preview.connect(origin="http://evil.example"):
                    pass
            with pytest.raises(InvalidStatus):
                async with preview.connect(origin=None, subprotocols=["antdsl.1", "token.wrong"]):
                    pass

    go(test)


@pytest.mark.skipif(sys.platform == "win32", reason="a script stands for the browser")
def test_the_browser_is_started_with_an_address_that_is_good_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, browser = example(tmp_path), tmp_path / "browser"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" > {tmp_path}/opened.part && mv {tmp_path}/opened.part {tmp_path}/opened\n')
    browser.chmod(0o755)
    monkeypatch.setenv("BROWSER", f"{browser} %s")

    async def test() -> None:
        async with started("scene.yaml", folder=folder, open_it=True) as preview:
            while not (tmp_path / "opened").is_file():
                await asyncio.sleep(0.02)
            address, _, code = (tmp_path / "opened").read_text().partition("#")
            assert address == preview.address and code and preview.token not in code
            async with preview.connect(subprotocols=["antdsl.1", f"token.{code}"]) as page:
                assert (await hear(page, lambda m: m["op"] == "hello"))["token"] == preview.token
            async with preview.connect(subprotocols=["antdsl.1", f"token.{code}"]) as page:
                await page.wait_closed()
                assert page.close_code == 1008

    go(test)


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["scene.yaml", "--host", "0.0.0.0"], 2, "--let-others-in"),
        (["scene.yaml", "--host", "::"], 2, "--let-others-in"),
        (["scene.yaml", "--host", "192.0.2.7", "--let-others-in"], 3, "this machine has no address"),
        (["scene.yaml", "--host", "no such host"], 3, "there is no host"),
        (["walker.ant"], 2, "is a program"),
        (["nowhere.yaml"], 3, "nowhere.yaml"),
        (["scene.yaml", "--port", "65536"], 2, "65535"),
        (["scene.yaml", "--set", "pace"], 2, "NAME=VALUE"),
        (["scene.yaml", "--set", "walker.pace=3 mm/s"], 1, "no program has a param `walker.pace`"),
    ],
)
def test_wrong_use_is_reported(words: list[str], code: int, said: str, tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from antdsl.cli import app
    from antdsl.cli.exits import CommandError

    words[0] = str(ROOT / "examples" / "minimal" / words[0])
    result = CliRunner().invoke(app, ["preview", *words, "--no-open"])
    if isinstance(result.exception, CommandError):
        assert result.exception.code == code
        assert said in f"{result.exception.message}{result.exception.hint}{result.output}"
    else:
        assert result.exit_code == code and said in result.output
