"""How much slower a preview simulates for a client that only reads: frames a second without and with one, in turns.

`python tests/benchmarks/preview.py` does so with 15,000 foraging ants, as fast as they go; the client is a separate process."""

from __future__ import annotations

import argparse
import asyncio
import os
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

from previewed import ROOT, joined, read, until

from antdsl.preview.live import LiveSimulation
from antdsl.preview.serving.addresses import open_listening_sockets
from antdsl.preview.serving.guard import RequestGuard
from antdsl.preview.serving.page_files import load_pages
from antdsl.preview.serving.server import PreviewServer
from antdsl.runtime import Options

FORAGING = ROOT / "examples" / "foraging"


@dataclass(frozen=True, slots=True)
class Turn:
    """What was simulated in a stretch of time; `busy` is the processor's time for this process."""

    frames: int
    seconds: float
    busy: float

    @property
    def rate(self) -> float:
        return self.frames / self.seconds

    @property
    def work(self) -> float:
        return 1000 * self.busy / self.frames


class Reader:
    """The client's process, which connects and disconnects on request."""

    def __init__(self, address: str) -> None:
        command = [sys.executable, str(Path(__file__)), "--read", address]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)

    async def say(self, word: str) -> str:
        """Have it do something; what it says when that is done."""
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write(f"{word}\n")
        self._process.stdin.flush()
        return (await asyncio.to_thread(self._process.stdout.readline)).strip()

    def end(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait()


def be_a_reader(address: str) -> None:
    """Come at the word `in`, go at the word `out`, and read whatever is sent meanwhile."""
    import threading

    for word in sys.stdin:
        if word.strip() != "in":
            continue
        client = joined(address)
        until(client, slot="frame")
        print("in", flush=True)
        stop_event, count = threading.Event(), [0]

        def drain(client: object = client, stop_event: threading.Event = stop_event, count: list[int] = count) -> None:
            while not stop_event.is_set():
                count[0] += read(client).get("slot") == "frame"  # type: ignore[arg-type]

        thread = threading.Thread(target=drain)
        thread.start()
        sys.stdin.readline()
        stop_event.set()
        thread.join()
        client.close()
        print(count[0], flush=True)


async def turn(live: LiveSimulation, seconds: float) -> Turn:
    await asyncio.sleep(0.3)
    frame, began, used = live.session.frame, perf_counter(), process_time()
    await asyncio.sleep(seconds)
    return Turn(live.session.frame - frame, perf_counter() - began, process_time() - used)


async def measured(scene: Path, threads: int, turns: int, seconds: float) -> tuple[list[Turn], list[Turn], list[int]]:
    live = LiveSimulation.open_scene(scene, options=Options(threads=threads))
    listening = open_listening_sockets(None, 0)
    guard = RequestGuard(listening.host_names)
    alone, watched, frame_counts = [], [], []
    async with PreviewServer(live, guard, load_pages(), listening).run():
        live.session.playing, live.speed = True, 0.0
        live.start()
        reader = Reader(f"{listening.addresses[0]}#{guard.token}")
        try:
            first = live.session.frame
            while live.session.frame < first + 20:  # kernels are loaded
                await asyncio.sleep(0.1)
            for _ in range(turns):
                alone.append(await turn(live, seconds))
                await reader.say("in")
                watched.append(await turn(live, seconds))
                frame_counts.append(int(await reader.say("out")))
        finally:
            reader.end()
            live.stop()
    return alone, watched, frame_counts


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=8)
    parser.add_argument("--seconds", type=float, default=3.0)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--scene", type=Path, default=FORAGING / "many.yaml")
    parser.add_argument("--read", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read:
        be_a_reader(options.read)
        return
    alone, watched, frame_counts = asyncio.run(measured(options.scene, options.threads, options.turns, options.seconds))
    ratios = [b.rate / a.rate for a, b in zip(alone, watched, strict=True)]
    work = [a.work / b.work for a, b in zip(alone, watched, strict=True)]
    print(f"{options.turns} turns of {options.seconds:g} s each way, {options.threads} threads; medians, and the least")
    print("| | frames/s | work for the processor, ms a frame |")
    print("|---|---|---|")
    for name, turns in (("nobody looks on", alone), ("a client reads", watched)):
        print(f"| {name} | {statistics.median(t.rate for t in turns):.1f} | {statistics.median(t.work for t in turns):.1f} |")
    print(f"| of it | {statistics.median(ratios):.3f} ({min(ratios):.3f}) | {statistics.median(work):.3f} ({min(work):.3f}) |")
    print(f"frames that the client was sent: {statistics.median(n / options.seconds for n in frame_counts):.1f} a second")


if __name__ == "__main__":
    main()
