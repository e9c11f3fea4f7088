"""Writing behind the simulation, by a process and by a thread: the same bits, and every way in which either may fail is told."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from children import child_environment

from antdsl.outputs.cache import lock
from antdsl.outputs.cache.hashes import HASHES, read_lines
from antdsl.outputs.cache.lock import FolderLock, Locked
from antdsl.outputs.recording import begin, record
from antdsl.outputs.summary import summary
from antdsl.outputs.writer import background
from antdsl.outputs.writer.background import Behind
from antdsl.outputs.writer.shared_memory import Arrays, Message
from antdsl.pipeline import Choices, open_scene
from antdsl.runtime import Options

ROOT = Path(__file__).resolve().parents[2]
forks = pytest.mark.skipif(sys.platform != "linux", reason="a process of its own is made on Linux only")
MODES = [pytest.param(True, id="process", marks=forks), pytest.param(False, id="thread")]


@pytest.fixture(params=MODES)
def own_process(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[bool]:
    monkeypatch.setattr(background, "OWN_PROCESS", request.param)
    threads, handles, children = threading.active_count(), _handles(), _children()
    yield request.param
    assert threading.active_count() == threads
    assert _handles() == handles, "a pipe or shared memory was left"
    assert _children() <= children, "a process is running or waits to be asked for its exit code"


def _handles() -> list[str]:
    """What this process has open."""
    folder = Path("/proc/self/fd")
    names = [folder / name for name in os.listdir(folder)] if folder.is_dir() else []
    return sorted(os.readlink(name) for name in names if name.is_symlink() and "memfd:antdsl" in os.readlink(name)) + sorted(
        name.name for name in names if name.is_symlink() and os.readlink(name).startswith("pipe:")
    )


def _children() -> set[str]:
    """Ids of the processes that this one began: those that run, and those whose exit code nobody has asked for."""
    found: set[str] = set()
    for tasks in Path("/proc/self/task").glob("*/children"):
        with suppress(OSError):  # a thread that has ended meanwhile
            found.update(tasks.read_text().split())
    return found


def sums(jobs: Sequence[str], arrays: Arrays) -> Message:
    """A work that takes a while and says what it saw."""
    time.sleep(0.002)
    return {"jobs": list(jobs), "sums": {name: float(array.sum()) for name, array in arrays.items()}, "process": os.getpid()}


def test_what_is_handed_over_is_copied_at_once_and_done_in_order(own_process: bool) -> None:
    told: list[Message] = []
    worker = Behind(sums, told.append)
    changing, still = np.zeros((5, 3)), np.array(7, np.int64)
    for number in range(60):
        changing[:] = number
        worker.hand_over([f"job {number}"], {"changing": changing[::-1], "still": still, "none": np.zeros((0, 3), np.float32)})
    changing[:] = -1
    worker.finish()
    worker.check()
    assert [message["jobs"] for message in told] == [[f"job {number}"] for number in range(60)]
    assert [message["sums"] for message in told] == [{"changing": 15.0 * n, "still": 7.0, "none": 0.0} for n in range(60)]
    assert {message["process"] == os.getpid() for message in told} == {not own_process}
    assert (worker.memory > 0) == own_process


def test_states_may_grow_and_shrink_and_change_what_they_are_made_of(own_process: bool) -> None:
    told: list[Message] = []
    worker = Behind(sums, told.append)
    wanted = []
    for number, size in enumerate((3, 0, 1000, 1000, 200_000, 5, 5, 400_000, 1)):
        arrays: dict[str, Any] = {"a": np.arange(size, dtype=np.int32), "b": np.ones(2 * size + 1, np.bool_)}
        if number % 2:
            arrays["c"] = np.full((size, 3), 0.5)
        wanted.append({name: float(array.sum()) for name, array in arrays.items()})
        worker.hand_over([], arrays)
    worker.finish()
    worker.check()
    assert [message["sums"] for message in told] == wanted


class Failing:
    """Writes a line for each work, and fails at the third."""

    def __init__(self, path: Path, problem: BaseException) -> None:
        self.path, self.problem = path, problem

    def work(self, jobs: Sequence[str], arrays: Arrays) -> Message:
        if int(arrays["number"]) == 2:
            raise self.problem
        with open(self.path, "a") as file:
            file.write(f"{arrays['number']}\n")
        return {}


@pytest.mark.parametrize(
    ("problem", "kind", "words"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "frame.npz"), OSError, r"\[Errno 28\] No space left .*'frame.npz'"),
        (PermissionError(errno.EACCES, "Permission denied"), PermissionError, "Permission denied"),
        (OSError("no number"), OSError, "no number"),
        (KeyError("Cd"), RuntimeError, "KeyError: 'Cd'"),
        (MemoryError("of a frame"), MemoryError, "of a frame"),
    ],
    ids=["full", "refused", "bare", "bug", "memory"],
)
def test_an_error_is_raised_by_what_comes_next_and_nothing_more_is_done(
    own_process: bool, tmp_path: Path, problem: BaseException, kind: type[Exception], words: str
) -> None:
    worker = Behind(Failing(tmp_path / "done", problem).work, lambda message: None)
    with pytest.raises(kind, match=words) as raised:
        for number in range(100):
            worker.hand_over([], {"number": np.array(number)})
    assert type(raised.value) is kind
    assert "in work" in "".join(raised.value.__notes__)  # where in the code it was
    with pytest.raises(kind, match=words):
        worker.hand_over([], {"number": np.array(0)})
    worker.finish()
    with pytest.raises(kind, match=words):
        worker.check()
    assert (tmp_path / "done").read_text() == "0\n1\n"


@forks
@pytest.mark.parametrize("own_process", [True], indirect=True)
@pytest.mark.parametrize("idle", [True, False])
def test_a_process_that_was_killed_is_an_error_and_no_waiting(own_process: bool, idle: bool) -> None:
    def work(jobs: Sequence[str], arrays: Arrays) -> Message:
        if "die" in jobs:
            os.kill(os.getpid(), signal.SIGKILL)
        return {"process": os.getpid()}

    told: list[Message] = []
    worker = Behind(work, told.append)
    worker.hand_over([], {})
    while not told:
        worker.hand_over([], {})
        time.sleep(0.001)
    if idle:
        os.kill(told[0]["process"], signal.SIGKILL)
    with pytest.raises(ChildProcessError, match="ended by signal 9"):
        for _ in range(100):
            worker.hand_over([] if idle else ["die"], {"a": np.zeros(10)})
            time.sleep(0.001)
    worker.finish()
    with pytest.raises(ChildProcessError):
        worker.check()


@forks
@pytest.mark.parametrize("own_process", [True], indirect=True)
def test_stops_that_reach_all_processes_are_for_the_caller_alone(own_process: bool) -> None:
    def work(jobs: Sequence[str], arrays: Arrays) -> Message:
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            os.kill(os.getpid(), number)
        return {"done": True}

    told: list[Message] = []
    worker = Behind(work, told.append)
    worker.hand_over([], {})
    worker.finish()
    worker.check()
    assert told == [{"done": True}]


@forks
@pytest.mark.parametrize("own_process", [True], indirect=True)
def test_where_no_process_can_be_made_a_thread_does_the_work(own_process: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> int:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(os, "fork", refuse)
    told: list[Message] = []
    worker = Behind(sums, told.append)
    worker.hand_over([], {"a": np.ones(3)})
    worker.finish()
    worker.check()
    assert told[0]["sums"] == {"a": 3.0} and told[0]["process"] == os.getpid()


@pytest.mark.parametrize("first", [0, 1])
def test_two_at_once_end_in_either_order(own_process: bool, first: int) -> None:
    """A process that was forked later must not keep the way to an earlier one open, which would wait for more for ever."""
    told: list[list[Message]] = [[], []]
    workers = [Behind(sums, told[number].append) for number in range(2)]
    for worker in (*workers, workers[first], workers[1 - first]):
        worker.hand_over([], {"a": np.ones(3)})
    waiting = threading.Timer(20, lambda: [os.kill(p, signal.SIGKILL) for p in {w._child for w in workers} if p is not None])
    waiting.start()
    try:
        for worker in (workers[first], workers[1 - first]):
            worker.finish()
            worker.check()
    finally:
        waiting.cancel()
        waiting.join()
    assert [len(messages) for messages in told] == [2, 2]


@forks
@pytest.mark.parametrize("own_process", [True], indirect=True)
@pytest.mark.parametrize("killed", [False, True])
def test_where_ended_processes_are_not_kept_for_who_asks(own_process: bool, killed: bool) -> None:
    """Some programs start others with SIGCHLD ignored: then no exit code can be asked for, and what was done counts."""
    before = signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    try:
        told: list[Message] = []
        worker = Behind(sums, told.append)
        worker.hand_over([], {"a": np.ones(3)})
        if killed:
            assert worker._child is not None
            os.kill(worker._child, signal.SIGKILL)
        worker.finish()
        if killed:
            with pytest.raises(ChildProcessError, match="the process that writes it is gone"):
                worker.check()
        else:
            worker.check()
            assert len(told) == 1
    finally:
        signal.signal(signal.SIGCHLD, before)


@forks
@pytest.mark.parametrize("own_process", [True], indirect=True)
def test_nobody_is_warned_of_a_fork_among_threads(own_process: bool) -> None:
    """Newer Pythons warn; those who have warnings shown must not see one that is not theirs."""
    done = threading.Event()
    thread = threading.Thread(target=done.wait)
    thread.start()
    try:
        with warnings.catch_warnings(record=True, action="always") as seen:
            worker = Behind(sums, lambda message: None)
            worker.finish()
            worker.check()
        assert not seen
    finally:
        done.set()
        thread.join()


KILLED = """
import os, sys, time
import numpy as np
from pathlib import Path
from antdsl.outputs.writer.background import Behind
from antdsl.outputs.cache.lock import FolderLock
folder = Path(sys.argv[1])

def work(jobs, arrays):
    (folder / "begun").touch()
    time.sleep(0.3)
    (folder / f"done {int(arrays['number'])}").write_text(str(os.getpid()))
    return {}

with FolderLock(folder):
    worker = Behind(work, lambda message: None)
    for number in range(2):
        worker.hand_over([], {"number": np.array(number)})
    while not (folder / "begun").exists():
        time.sleep(0.001)
    os.kill(os.getpid(), 9)
"""


@forks
def test_what_was_handed_over_is_finished_when_the_caller_is_killed_and_a_run_at_once_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], env=child_environment())
    os.waitid(os.P_PID, run.pid, os.WEXITED | os.WNOWAIT)  # it has ended, and is still known to the system
    with monkeypatch.context() as patch, pytest.raises(Locked, match=str(run.pid)):
        patch.setattr(lock, "_PATIENCE", 0.0)
        with FolderLock(tmp_path):
            pass
    with FolderLock(tmp_path):
        done = [(tmp_path / f"done {number}").read_text() for number in range(2)]
    assert run.wait() == -9 and done[0] == done[1] != str(run.pid)
    ended = time.monotonic() + 60
    while Path(f"/proc/{done[0]}").exists():  # whoever inherits it may take a moment to ask for its exit code
        if Path(f"/proc/{done[0]}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
            break
        assert time.monotonic() < ended
        time.sleep(0.005)


# --- whole runs ----------------------------------------------------------------------------------------------------------


GROWING = """ant 1
use steering
species walker {
  size 4 mm
  max_speed 25 mm/s
  start stroll
  state stroll amber {
    steer wander(swing: 40 deg)
    when chance 300 %/s -> bear { spawn walker }
    when chance 100 %/s -> gone
  }
  state bear blue { when after 0.2 s -> stroll }
  state gone { enter { die }; when false -> stroll }
  layers { separate(radius: 2 * size); state }
}
"""
SCENE = """antdsl: 1
frames: 1..40
seed: 1
crowd: [{species: walker, from: walker.ant, count: 40, place: {radius: 60 mm}}]
output: {checkpoint: 7}
"""


def run(folder: Path, out: str, **options: Any) -> Any:
    (folder / "walker.ant").write_text(GROWING)
    (folder / "scene.yaml").write_text(SCENE)
    shot, report = open_scene(folder / "scene.yaml", Choices())
    assert shot is not None and report.ok, report.errors
    recording = begin(shot, folder / out, Options(**options), resume=False, force=False)
    crowd = [len(recording.world) for _ in record(recording)]
    assert max(crowd) > 2 * crowd[0]
    return recording


@forks
def test_a_growing_crowd_is_the_same_to_the_byte_by_a_process_and_by_a_thread(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = run(tmp_path, "process")
    monkeypatch.setattr(background, "OWN_PROCESS", False)
    two = run(tmp_path, "thread", shuffle_rows=3, chunk=7)
    assert one.writer_memory > 0 == two.writer_memory
    mine, other = summary(one), summary(two)
    for name in ("agents", "frames", "states", "state_hash", "max_surface_error", "transitions"):
        assert mine[name] == other[name], name
    assert mine["max_surface_error"] > 0 and {"measure", "hash", "frame", "write", "sync", "checkpoint"} <= set(mine["seconds"])
    names = sorted(str(path.relative_to(tmp_path / "process")) for path in (tmp_path / "process").rglob("*.*"))
    assert len([name for name in names if name.startswith("frames")]) == 40
    assert len([name for name in names if name.startswith("checkpoints")]) == 7  # 1 8 15 22 29 36, and the last
    for name in names:
        if not name.startswith(("checkpoints", HASHES)):  # checkpoints have their rows in the order that the run had them in
            assert (tmp_path / "process" / name).read_bytes() == (tmp_path / "thread" / name).read_bytes(), name
    lines = [read_lines(tmp_path / way / HASHES) for way in ("process", "thread")]
    of_frames = [{frame: (line.hash, line.file) for frame, line in found.items()} for found in lines]
    assert len(of_frames[0]) == 40 and of_frames[0] == of_frames[1]
    assert sum(bool(line.checkpoint) for line in lines[0].values()) == 7


def test_an_error_behind_a_run_ends_it_and_frees_the_folder(
    own_process: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from antdsl.outputs.writer import frame_writer

    written = frame_writer.write_whole

    def full(path: Path, data: bytes, *, sync: bool) -> None:
        if path.name == "frame.0005.npz":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        written(path, data, sync=sync)

    monkeypatch.setattr(frame_writer, "write_whole", full)
    with pytest.raises(OSError, match="No space left"):
        run(tmp_path, "out")
    with FolderLock(tmp_path / "out"):
        pass
    assert [path.name for path in sorted((tmp_path / "out" / "frames").iterdir())] == [f"frame.000{n}.npz" for n in range(1, 5)]
