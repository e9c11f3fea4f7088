"""From a saved edit to the first frame of the new program, in milliseconds, with 15,000 foraging ants that play.

`python tests/benchmarks/reload.py` saves a file beside the program and puts it in its place, as editors do, and waits as a page
does: for the frame after the last that the old program made, from a preview in another process. `--inside` measures the work
only: a reload and a step in this process. `--edits` says how many."""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import statistics
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter, process_time

from previewed import ROOT, joined, previewed, read, until

from antdsl.preview import PreviewSession

FORAGING = ROOT / "examples" / "foraging"
EDITS = (
    ("30 mm/s", "36 mm/s"),
    ("when scent > faint ", "when scent > 2 * faint "),
    ("wander(swing: swing)", "wander(swing: 0.9 * swing)"),
    ("state set_out", "state turn"),
    ("zeal   = uniform(0.5, 1.5)", "zeal   = uniform(0.6, 1.6)\n  weight = 3 mg"),
    ("separate(radius: 1.2 * size", "separate(radius: 1.4 * size"),
)


def texts(text: str, count: int) -> Iterator[str]:
    """So many other texts of a program, each an edit of the one before: there and back."""
    for number in range(count):
        old, new = EDITS[number // 2 % len(EDITS)]
        edited = text.replace(old, new).replace("-> set_out", "-> turn") if new == "state turn" else text.replace(old, new)
        yield text if number % 2 else edited


def save(program: Path, text: str) -> float:
    """Put another text in place at once; when that was."""
    beside = program.with_suffix(".saved")
    beside.write_text(text)
    began = perf_counter()
    os.replace(beside, program)
    return began


def served(scene: Path, program: Path, count: int) -> None:
    taken: list[float] = []
    with previewed(scene) as address, joined(address) as client:
        until(client, op="status")
        client.send(json.dumps({"op": "play"}))
        last = 0
        while last < 30:  # kernels are loaded
            last = until(client, slot="frame")["frame"]
        for text in texts(program.read_text(), count):
            pause = perf_counter() + random.uniform(0.4, 0.8)  # at any time between two looks at the files
            while perf_counter() < pause:
                last = read(client).get("frame", last)
            began = save(program, text)
            while (message := read(client)).get("op") != "outcome":
                last = message.get("frame", last)
            if not message["ok"] or message["line"] == "nothing has changed":
                sys.exit(f"an edit was not taken: {message}")
            while until(client, slot="frame")["frame"] <= last:
                continue
            taken.append(1000 * (perf_counter() - began))
    print("| edits | from the save to a frame of the new program, median, ms | worst, ms |")
    print("|---|---|---|")
    print(f"| {len(taken)} | {statistics.median(taken):.0f} | {max(taken):.0f} |")


def inside(scene: Path, program: Path, count: int) -> None:
    session, report = PreviewSession.open(scene)
    if session is None:
        sys.exit("\n".join(d.message for d in report.errors))
    for _ in range(3):
        session.step()
    session.reload()
    wall, busy = [], []
    for text in texts(program.read_text(), count):
        program.write_text(text)
        started, used = perf_counter(), process_time()
        outcome = session.reload()
        session.step()
        wall.append(1000 * (perf_counter() - started))
        busy.append(1000 * (process_time() - used))
        if not outcome.is_successful or outcome.line == "nothing has changed":
            sys.exit(f"an edit was not taken: {[d.message for d in outcome.report.errors]}")
        session.step()
    print("| agents | edits | median, ms | worst, ms | of it at work, median, ms |")
    print("|---|---|---|---|---|")
    print(
        f"| {len(session.world):,} | {len(wall)} | {statistics.median(wall):.0f} | {max(wall):.0f} | "
        f"{statistics.median(busy):.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edits", type=int, default=24)
    parser.add_argument("--scene", default="many.yaml")
    parser.add_argument("--inside", action="store_true")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "foraging")
        shutil.copytree(FORAGING, place)
        (inside if options.inside else served)(place / options.scene, place / "forager.ant", options.edits)


if __name__ == "__main__":
    main()
