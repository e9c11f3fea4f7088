"""Kills commands at random times, and holds what they leave against undisturbed ones: `python tests/kills.py [COUNT] [SEED]`.

Each command runs in a fork of this process, which has imported all that it needs, so that kills land in the work. Half of them
come at a random time, half at a random call of the system on what is written. Then a reader opens what is there, and the same
command goes on. The last line says how many kills were followed by the same bytes."""

from __future__ import annotations

import importlib
import os
import random
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import chdir, suppress
from pathlib import Path

import commands
from fault_shim import Fault, Faults
from fault_shots import BESIDE, OUTPUT_FOLDER, WRITERS, Inline, assert_same, copied, files, project, same

import antdsl.executors
from antdsl.cli import _run_without_warnings
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.cache.manifest import ManifestError

IMPORTED = (
    "antdsl.outputs.recording", "antdsl.outputs.exports", "antdsl.outputs.drawing", "antdsl.outputs.pictures", "antdsl.sweep",
    "antdsl.outputs.orientation_smoothing", "antdsl.runtime", "antdsl.sweeps.measuring", "antdsl.cli.printing.progress",
    "open3d", "PIL.Image",
)  # fmt: skip
RUN = ("run", "scene.yaml", "--threads", "1", "--backend", "numpy", "--resume")
KINDS = ("run", "run", "run", "sweep", "stills", "csv", "geo", "npz", "edit", "edit")
WARM = ("run", "csv", "geo", "npz", "edit")  # what starts no threads that last


def forked(folder: Path, words: tuple[str, ...], shim: Faults | None = None) -> int:
    """The number of a process that runs a command in a folder; what it prints goes into `printed`."""
    child = os.fork()
    if child:
        return child
    code = 99
    try:
        handle = os.open(folder / "printed", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        for number in (1, 2):
            os.dup2(handle, number)
        sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
        sys.argv = ["antdsl", *words]
        with chdir(folder):
            if shim is None:
                code = _run_without_warnings()
            else:
                with shim:
                    code = _run_without_warnings()
                (folder / "calls").write_text(str(shim.count))
    finally:
        os._exit(code)


def ended(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


class Kind:
    """A command, what an undisturbed one writes, how long it takes and how many calls it makes."""

    def __init__(self, name: str, unbroken: Path, place: Path) -> None:
        self.name, self.unbroken = name, unbroken
        self.words = RUN if name == "run" else WRITERS[name]
        if name == "stills":
            self.words += ("--resume",)
        folder = self.fresh(place / f"whole {name}")
        began = time.monotonic()
        assert ended(forked(folder, self.words)) == 0, (folder / "printed").read_text()
        self.seconds = time.monotonic() - began
        self.files = files(folder, name)
        self.calls = self.counted(self.fresh(place / "count"))

    def counted(self, folder: Path) -> int:
        """How many calls the command makes on what is written."""
        shim = self.shim(folder, None)
        assert ended(forked(folder, self.words, shim)) == 0
        return int((folder / "calls").read_text())

    def fresh(self, folder: Path) -> Path:
        shutil.rmtree(folder, ignore_errors=True)
        return project(folder) if self.name == "run" else copied(self.unbroken, folder)

    def shim(self, folder: Path, at: int | None) -> Faults:
        return Faults(
            folder if self.name in BESIDE else folder / ("out" if self.name == "run" else OUTPUT_FOLDER), at, Fault(kill=True)
        )

    def killed(self, folder: Path, chance: random.Random) -> bool:
        """Kill the command in a folder; whether it was still running."""
        if chance.random() < 0.5:
            return ended(forked(folder, self.words, self.shim(folder, chance.randrange(self.calls)))) == -signal.SIGKILL
        child = forked(folder, self.words)
        time.sleep(chance.uniform(0, self.seconds))
        os.kill(child, signal.SIGKILL)
        return ended(child) == -signal.SIGKILL

    def demand_whole_files(self, folder: Path) -> None:
        """What has its name already is whole."""
        if self.name == "run":
            with suppress(ManifestError):
                cache = open_cache(folder / "out" / "scene")
                lines = cache.lines()
                for frame in cache.frames():
                    cache.frame(frame)
                    assert frame not in lines or cache.find_frame_damage(frame, lines[frame]) is None
            return
        for path, data in files(folder, self.name).items():
            hidden = Path(path).name.startswith(".")
            assert hidden or self.name == "edit" or same(self.name, path, data, self.files[path]), path

    def demand_same_end(self, folder: Path) -> None:
        """The same command again ends as an undisturbed one."""
        code = ended(forked(folder, self.words))
        assert code == 0, (code, (folder / "printed").read_text())
        if self.name == "run":
            assert_same(folder, self.unbroken)
            return
        contents = {path: data for path, data in files(folder, self.name).items() if not Path(path).name.startswith(".")}
        assert contents.keys() == self.files.keys()
        for path, data in contents.items():
            assert same(self.name, path, data, self.files[path]), path


def say(line: str) -> None:
    print(line, flush=True)


def kill(count: int, seed: int, report: Callable[[str], None] = say) -> int:
    """Kill commands so often; after how many of these kills anything was lost or damaged."""
    for name in IMPORTED:
        importlib.import_module(name)
    antdsl.executors.ProcessEngine = Inline  # type: ignore[misc]
    chance, consistent, total = random.Random(seed), 0, 0
    with tempfile.TemporaryDirectory(prefix="antdsl.kills.") as name:
        place = Path(name)
        unbroken = project(place / "unbroken")
        assert ended(forked(unbroken, RUN)) == 0, (unbroken / "printed").read_text()
        for each in WARM:  # forks find loaded what is loaded late
            commands.run(*(RUN if each == "run" else WRITERS[each]), cwd=copied(unbroken, place / f"warm {each}"))
        assert threading.active_count() == 1, threading.enumerate()
        kinds = {each: Kind(each, unbroken, place) for each in dict.fromkeys(KINDS)}
        while total < count:
            kind = kinds[chance.choice(KINDS)]
            folder = kind.fresh(place / "shot")
            kills = int(kind.killed(folder, chance))
            while kills and chance.random() < 0.2 and kind.killed(folder, chance):
                kills += 1  # the command that goes on is killed too
            if not kills:
                continue
            total += kills
            if total // 50 > (total - kills) // 50 and total < count:
                report(f"{total - kills} kills: {consistent} consistent, going on")
            try:
                kind.demand_whole_files(folder)
                kind.demand_same_end(folder)
                consistent += kills
            except Exception as why:
                report(f"{kind.name}: {why!r}"[:2000])
    report(f"{total} kills: {consistent} consistent")
    return total - consistent


if __name__ == "__main__":
    count, seed, *_ = (*map(int, sys.argv[1:]), *(500, 1)[len(sys.argv) - 1 :])
    sys.exit(kill(count, seed) != 0)
