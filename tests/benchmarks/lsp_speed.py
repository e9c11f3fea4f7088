"""How long an editor waits for the language server: opening a program of 2,000 lines, and each edit inside one of its blocks.

`python3 tests/benchmarks/lsp_speed.py` starts `antdsl lsp`, talks with it as an editor does, and prints milliseconds from each
message to the complaints that answer it: by the clock, and of the processor's time alone, which is what a machine that does
nothing else would take. `--write FILE` writes the program instead."""

from __future__ import annotations

import argparse
import asyncio
import random
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent.parent
HEAD = """ant 1
"A long program, for measuring."
use steering

world {
  surface  ground
  obstacle stones
  items    food { load = 0 }
  items    nest { load = 0 }
}

"""
MEMBERS = """species walker_{0} {{
  param smell  = 40 mm in 0 mm .. 200 mm "How far it smells food"
  param reward = 20 /s in 0 /s .. 100 /s "Scent laid at the food"
  param faint  = 0.05 in 0 .. 1          "Weakest scent worth following"

  size   uniform(3.6 mm, 4.4 mm)
  load   = 0
  source = none of food

  let meal  = nearest(food, with: load > 0, within: smell)
  let scent = max(trail_{1}, nearest: 16)

  start s0

"""
STATE = """  state s{0} "State number {0}" amber {{
    steer {1}
    deposit trail_{2} reward * falloff(source, floor: 3 * size)
    when touching(meal) take 1 load from meal -> s{3} {{ source = meal }}
    when scent > faint + 0.{4:02}                -> s{5}
    when no meal held 0.5 s                   -> s{6}
    when after {4} s                          -> s{7} {{ give all load to nearest(nest) }}
  }}
"""
TAIL = """
  layers {
    separate(radius: 1.2 * size, fov: 260 deg)
    state
  }
}

"""


def program(lines: int = 2000, states: int = 25) -> str:
    """A program of at least so many lines: species with 25 states each."""
    text = HEAD + "".join(f"field trail_{k} on ground {{ cell 6 mm; half_life 12 s }}\n" for k in range(4)) + "\n"
    species = 0
    while text.count("\n") < lines:
        text += MEMBERS.format(species, species % 4) + "".join(_state(n, species % 4, states) for n in range(states)) + TAIL
        species += 1
    return text


def _state(n: int, trail: int, states: int) -> str:
    push = "seek(nearest(nest))" if n % 5 == 0 else f"direction(nearest(nest)) * 0.{n % 9 + 1}"
    return STATE.format(n, push, trail, (n + 1) % states, n + 1, (n + 2) % states, (n + 3) % states, (n + 5) % states)


def edits(text: str, count: int, seed: int = 1) -> list[tuple[str, int, int, str]]:
    """Edits of a user inside blocks, as (kind, line, column, text): digits, names, whole lines typed key by key, mistakes."""
    rng, changes = random.Random(seed), []
    lines = text.split("\n")
    line_numbers = [n for n, line in enumerate(lines) if line.startswith("    when no meal held")]
    typed = "    when speed < 3 mm/s -> s1\n"
    while len(changes) < count:
        line = rng.choice(line_numbers)
        kind = rng.choice(("number", "line", "mistake"))
        if kind == "number":
            column = lines[line].index("0.5") + 2
            changes += [("number", line, column, str(rng.randrange(1, 9)))]
        elif kind == "line":
            changes += [("typing", line, column, key) for column, key in enumerate(typed)]
            changes += [("undone", line, -1, "")]
        else:
            changes += [("mistake", line, lines[line].index("meal"), "x"), ("mended", line, -2, "")]
    return changes[:count]


async def measured(text: str, count: int, folder: Path) -> dict[str, list[tuple[float, float]]]:
    """Seconds (by the clock, of the processor) of opening and of each kind of edit."""
    from lsprotocol import types as lsp
    from pygls.lsp.client import BaseLanguageClient

    client = BaseLanguageClient("measure", "1")
    versions: asyncio.Queue[int | None] = asyncio.Queue()
    client.feature(lsp.TEXT_DOCUMENT_PUBLISH_DIAGNOSTICS)(lambda params: versions.put_nowait(params.version))
    await client.start_io(sys.executable, "-m", "antdsl", "lsp", env={**_environment()})
    await client.initialize_async(lsp.InitializeParams(lsp.ClientCapabilities(), root_uri=folder.as_uri()))
    client.initialized(lsp.InitializedParams())
    uri, version, process = (folder / "long.ant").as_uri(), 0, client._server.pid

    async def waited(send: Any) -> tuple[float, float]:
        spent, start = _processor(process), time.perf_counter()
        send()
        while await asyncio.wait_for(versions.get(), 60) != version:
            pass
        return time.perf_counter() - start, _processor(process) - spent

    item = lsp.TextDocumentItem(uri, "antdsl", 0, text)
    times_by_kind = {"open": [await waited(lambda: client.text_document_did_open(lsp.DidOpenTextDocumentParams(item)))]}
    for kind, line, column, typed in edits(text, count):
        version += 1
        change = _change(lsp, kind, line, column, typed)
        params = lsp.DidChangeTextDocumentParams(lsp.VersionedTextDocumentIdentifier(version, uri), [change])
        times_by_kind.setdefault(kind, []).append(await waited(lambda params=params: client.text_document_did_change(params)))
        await asyncio.sleep(0.01)
    await client.shutdown_async(None)
    client.exit(None)
    await client.stop()
    return times_by_kind


def _change(lsp: Any, kind: str, line: int, column: int, typed: str) -> Any:
    first, last = lsp.Position(line, max(column, 0)), lsp.Position(line, max(column, 0) + (kind == "number"))
    if kind == "undone":
        first, last = lsp.Position(line, 0), lsp.Position(line + 1, 0)
    elif kind == "mended":
        first = lsp.Position(line, len("    when no "))
        last = lsp.Position(line, first.character + 1)
    return lsp.TextDocumentContentChangePartial(lsp.Range(first, last), typed)


def _environment() -> dict[str, str]:
    import os

    return {**os.environ, "PYTHONPATH": str(ROOT)}


def _processor(process: int) -> float:
    """Seconds of processor time that a process has had (Linux; elsewhere 0)."""
    try:
        fields = Path(f"/proc/{process}/schedstat").read_text(encoding="ascii").split()
        return int(fields[0]) * 1e-9
    except OSError:
        return 0.0


def quantile(values: list[float], share: float) -> float:
    """In milliseconds."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))] * 1e3


def main() -> None:
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--edits", type=int, default=300)
    options.add_argument("--lines", type=int, default=2000)
    options.add_argument("--states", type=int, default=25)
    options.add_argument("--write", type=Path)
    chosen = options.parse_args()
    text = program(chosen.lines, chosen.states)
    if chosen.write is not None:
        chosen.write.write_text(text, encoding="utf-8")
        return
    with tempfile.TemporaryDirectory() as folder:
        times_by_kind = asyncio.run(measured(text, chosen.edits, Path(folder)))
    print(f"{text.count(chr(10))} lines, milliseconds")
    print(f"{'':10} {'times':>5} {'p50':>8} {'p95':>8} {'processor p50':>14} {'p95':>8}")
    times_by_kind["all edits"] = [each for kind, times in times_by_kind.items() if kind != "open" for each in times]
    for kind, times in times_by_kind.items():
        clock, spent = [a for a, _ in times], [b for _, b in times]
        quantiles = [quantile(values, share) for values in (clock, spent) for share in (0.5, 0.95)]
        print(f"{kind:10} {len(times):5} {quantiles[0]:8.1f} {quantiles[1]:8.1f} {quantiles[2]:14.1f} {quantiles[3]:8.1f}")


if __name__ == "__main__":
    main()
