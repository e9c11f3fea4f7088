"""A preview with files that are damaged while it runs, and pages that flood it or sleep: the ants run on, and everything
recovers once the files are complete and the pages back."""

from __future__ import annotations

import asyncio
import json
import random
import shutil
from collections.abc import Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from time import process_time

import pytest
from live_client import EXAMPLES, Page
from sampling import sampled

pytest.importorskip("websockets")

from preview_served import Served
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed

from antdsl.preview import LiveSimulation
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.serving.addresses import open_listening_sockets
from antdsl.preview.serving.guard import RequestGuard
from antdsl.preview.serving.page_files import load_pages
from antdsl.preview.serving.server import PreviewServer

SECONDS = 120  # that a test may take at most, on a machine that is busy


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    shutil.copytree(EXAMPLES / "minimal", tmp_path / "walkers", ignore=shutil.ignore_patterns("out"))
    scene = tmp_path / "walkers" / "scene.yaml"
    scene.write_text(scene.read_text().replace("1..240", "1..100000"))  # play stops at the last frame, however fast the machine
    return scene.parent


@pytest.fixture
def live(folder: Path) -> Iterator[LiveSimulation]:
    opened_live = LiveSimulation.open_scene(folder / "scene.yaml")
    opened_live.start()
    yield opened_live
    opened_live.stop()


def aliases(levels: int) -> bytes:
    """A text of a few hundred bytes that is 9 to the power of `levels` words once its aliases are put in."""
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, levels)]
    return ("antdsl: 1\n" + "\n".join(lines) + "\n").encode()


NOISE = random.Random(7).randbytes(4000)
DAMAGE: dict[str, bytes] = {
    "nothing": b"",
    "noise": NOISE,
    "zeros": bytes(100_000),
    "a picture": b"\x89PNG\r\n\x1a\n" + NOISE,
    "UTF-16": "antdsl: 1".encode("utf-16"),
    "too much": b"# " + b"x" * (2 << 20),
    "aliases": aliases(10),
    "merges": b"antdsl: 1\na: &a {b: 1}\nc: {<<: *a, <<: *a}\n",
    "an alias of itself": b"antdsl: 1\na: &a [*a]\n",
    "brackets": b"antdsl: 1\nworld: " + b"[" * 100_000,
    "braces": b"ant 1\n" + b"{" * 100_000,
    "levels": b"\n".join(b" " * k + b"a:" for k in range(400)),
    "tags": b"antdsl: 1\nworld: !!python/object/apply:os.system [touch pwned]\n",
    "a header that lies": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n",
}


@pytest.mark.parametrize("name", sampled(["scene.yaml", "walker.ant", "ground.ply"], ["walker.ant"]))
def test_whatever_is_saved_the_last_good_program_runs_on(live: LiveSimulation, folder: Path, name: str) -> None:
    page = Page(live)
    frame = page.status(frame=1)["frame"]
    good = (folder / name).read_bytes()
    for number, (kind, data) in enumerate(DAMAGE.items()):
        began, outcome_count = process_time(), sum(each["op"] == "outcome" for each in page.told)
        (folder / name).write_bytes(data)
        outcome = page.until(
            lambda outcome_count=outcome_count: (
                sum(each["op"] == "outcome" for each in page.told) > outcome_count and page.last("outcome")
            )
        )
        assert not outcome["ok"] and outcome["problems"], kind
        assert process_time() - began < 5, kind
        page.ask("step", count=1)
        frame += 1
        page.status(frame=frame)
        if number % 5 == 4:
            (folder / name).write_bytes(good)
            page.until(lambda: page.last("outcome")["ok"])
    (folder / name).write_bytes(good)
    page.until(lambda: page.last("outcome")["ok"])
    assert not [each for each in page.told if each["op"] == "refused"]
    assert not (folder / "pwned").exists()


def test_a_scene_continues_when_its_folder_returns(live: LiveSimulation, folder: Path) -> None:
    page = Page(live)
    page.status(frame=1)
    folder.rename(folder.with_name("elsewhere"))
    assert not page.until(lambda: page.last("outcome"))["ok"]
    page.ask("step", count=3)
    page.status(frame=4)
    folder.with_name("elsewhere").rename(folder)
    page.until(lambda: page.last("outcome")["ok"])
    page.ask("step", count=1)
    page.status(frame=5)


def with_live(live: LiveSimulation, test: Callable[[Served], Awaitable[None]]) -> None:
    @asynccontextmanager
    async def served():  # type: ignore[no-untyped-def]
        listening = open_listening_sockets(port=0)
        guard = RequestGuard(listening.host_names)
        server = Served(live, guard, load_pages(), listening)  # type: ignore[arg-type]
        async with asyncio.timeout(SECONDS), PreviewServer(live, guard, server.pages, listening).run():
            yield server

    async def run() -> None:
        async with served() as server:
            await test(server)

    asyncio.run(run())


async def frames(client: ClientConnection, count: int) -> list[int]:
    """The numbers of so many frames that a page is shown."""
    numbers: list[int] = []
    while len(numbers) < count:
        got = await client.recv()
        if isinstance(got, bytes):
            header, _ = unpack_arrays(got)
            if header["slot"] == "frame":
                numbers.append(header["frame"])
    return numbers


async def looks_on(server: Served) -> list[int]:
    """A page comes, hears all it has to and sees the ants go on."""
    async with server.connect(max_size=None, max_queue=None) as client:
        ops: set[str] = set()
        while not {"hello", "scene", "texts", "status"} <= ops:
            got = await client.recv()
            ops |= {json.loads(got)["op"]} if isinstance(got, str) else set()
        await client.send('{"op": "speed", "times": 0}')
        await client.send('{"op": "play"}')
        frame_numbers = await frames(client, 4)
        assert frame_numbers == sorted(frame_numbers) and frame_numbers[-1] > frame_numbers[0]
        return frame_numbers


def test_after_a_flood_pages_come_back_and_the_ants_go_on(live: LiveSimulation) -> None:
    async def flood(server: Served) -> None:
        async with server.connect(max_size=None, max_queue=None) as client:
            with suppress(ConnectionClosed):
                for _ in range(40):
                    for _ in range(200):
                        await client.send('{"op": "step", "count": 1}')
                    await asyncio.sleep(0)
                await client.wait_closed()
            assert client.close_code in (1006, 1013)

    async def test(server: Served) -> None:
        last = 0
        for _ in range(3):
            await asyncio.gather(*(flood(server) for _ in range(4)))
            frame_numbers = await looks_on(server)
            assert frame_numbers[-1] > last
            last = frame_numbers[-1]
        while live.clients:
            await asyncio.sleep(0.01)

    with_live(live, test)


def test_pages_that_read_nothing_do_not_hold_up_others_and_may_return(live: LiveSimulation) -> None:
    async def test(server: Served) -> None:
        asleep = [await server.connect(max_size=None, max_queue=1, ping_interval=None) for _ in range(8)]
        for client in asleep:
            client.transport.pause_reading()
        first = await looks_on(server)
        second = await looks_on(server)
        assert second[-1] > first[-1]
        for client in asleep:
            client.transport.abort()
        again = [await server.connect(max_size=None) for _ in range(8)]
        for client in again:
            assert json.loads(await client.recv())["op"] == "hello"
            await client.close()
        while live.clients:
            await asyncio.sleep(0.01)

    with_live(live, test)
