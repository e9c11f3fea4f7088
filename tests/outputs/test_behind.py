"""Writing behind the simulation: in order, nothing lost where the disk stalls, and every possible failure is reported."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import stick_bodies
from children import child_environment
from numpy.typing import NDArray

from antdsl.atomic_write import BytesParts
from antdsl.outputs.cache import frame_writer, lock
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.cache.frame_maker import FrameMaker
from antdsl.outputs.cache.frame_writer import BackgroundWorker, Measures
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, read_lines
from antdsl.outputs.cache.lock import FolderLock, FolderLocked
from antdsl.outputs.recording import Recording, begin_recording, record_frames
from antdsl.outputs.summary import summarise_run
from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, World


@pytest.fixture(autouse=True)
def no_thread_is_left() -> Iterator[None]:
    initial_threads = set(threading.enumerate())
    yield
    assert {each for each in threading.enumerate() if each.name == "cache writer"} <= initial_threads


def test_work_is_done_in_order_in_another_thread_and_reported_in_the_callers() -> None:
    executions: list[tuple[int, int]] = []
    reports: list[tuple[Any, int]] = []
    worker = BackgroundWorker(lambda result: reports.append((result["number"], threading.get_ident())))
    for number in range(60):

        def work(number: int = number) -> Measures:
            time.sleep(0.0005)
            executions.append((number, threading.get_ident()))
            return {"number": number}

        worker.submit(work)
    worker.wait_until_finished()
    worker.raise_job_error()
    assert [number for number, _ in executions] == [number for number, _ in reports] == list(range(60))
    assert {thread for _, thread in reports} == {threading.get_ident()}
    assert len({thread for _, thread in executions} | {threading.get_ident()}) == 2


def test_where_the_disk_stalls_the_caller_waits_and_nothing_is_lost() -> None:
    go, start_event, handed, executions = threading.Event(), threading.Event(), threading.Semaphore(0), []

    def work(number: int) -> Measures:
        start_event.set()
        assert go.wait(60)
        executions.append(number)
        return {}

    def hand_over_all() -> None:
        worker = BackgroundWorker(lambda result: None)
        for number in range(10):
            worker.submit(lambda number=number: work(number))  # type: ignore[misc]
            handed.release()
        worker.wait_until_finished()
        worker.raise_job_error()

    caller = threading.Thread(target=hand_over_all)
    caller.start()
    assert start_event.wait(60)
    for _ in range(3):  # one that is under way, and two that wait
        assert handed.acquire(timeout=60)
    assert not handed.acquire(timeout=0.1) and not executions
    go.set()
    caller.join(60)
    assert executions == list(range(10))


@pytest.mark.parametrize(
    "problem",
    [OSError(errno.ENOSPC, "No space left on device", "frame.npz"), KeyError("Cd"), MemoryError("of a frame"), SystemExit(3)],
    ids=["full", "bug", "memory", "exit"],
)
def test_an_error_is_raised_by_what_comes_next_and_nothing_more_is_done(problem: BaseException) -> None:
    executions: list[int] = []

    def work(number: int) -> Measures:
        if number == 2:
            raise problem
        executions.append(number)
        return {"number": number}

    results: list[Measures] = []
    worker = BackgroundWorker(results.append)
    with pytest.raises(type(problem)) as raised:
        for number in range(100):
            worker.submit(lambda number=number: work(number))  # type: ignore[misc]
    assert raised.value is problem and raised.traceback[-1].name == "work"  # where in the code it was
    with pytest.raises(type(problem)):
        worker.submit(lambda: work(0))
    worker.wait_until_finished()
    with pytest.raises(type(problem)):
        worker.raise_job_error()
    assert executions == [0, 1] == [result["number"] for result in results]


KILLED = """
import os, sys, time
from pathlib import Path
from antdsl.outputs.cache.lock import FolderLock
folder = Path(sys.argv[1])
with FolderLock(folder):
    if os.fork() == 0:
        (folder / "begun").touch()
        time.sleep(0.3)
        (folder / "done").touch()
        os._exit(0)
    while not (folder / "begun").exists():
        time.sleep(0.001)
    os.kill(os.getpid(), 9)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="what the system tells of processes is read on Linux only")
def test_what_a_killed_run_still_does_is_waited_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A thread that the system has not ended yet, in the midst of writing, or a process that the run had forked."""
    run = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], env=child_environment())
    os.waitid(os.P_PID, run.pid, os.WEXITED | os.WNOWAIT)  # it has ended, and is still known to the system
    with monkeypatch.context() as patch, pytest.raises(FolderLocked, match=str(run.pid)):
        patch.setattr(lock, "_MAX_WAIT_SECONDS", 0.0)
        with FolderLock(tmp_path):
            pass
    with FolderLock(tmp_path):
        assert (tmp_path / "done").exists()
    assert run.wait() == -9


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


def run(folder: Path, out: str, **options: Any) -> Recording:
    (folder / "walker.ant").write_text(GROWING)
    (folder / "scene.yaml").write_text(SCENE)
    shot, report = open_scene(folder / "scene.yaml", RunChoices())
    assert shot is not None and report.ok, report.errors
    recording = begin_recording(shot, folder / out, Options(**options), resume=False, force=False)
    crowd = [len(recording.world) for _ in record_frames(recording)]
    assert max(crowd) > 2 * crowd[0]
    return recording


def contents(folder: Path) -> dict[str, bytes]:
    """The files of a cache, without those that differ by the order of rows."""
    files = [path for path in folder.rglob("*") if path.is_file() and path.parent.name != "checkpoints"]
    return {str(path.relative_to(folder)): path.read_bytes() for path in files if path.name not in (HASHES_FILE_NAME, "lock")}


def test_a_growing_crowd_is_written_the_same_to_the_byte_where_the_disk_stalls_and_rows_are_shuffled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    one = run(tmp_path, "plain")
    written, under_way = frame_writer.write_atomically, []

    def stalling(path: Path, data: bytes | BytesParts, *, sync: bool = True) -> None:
        if path.name in ("frame.0003.npz", "checkpoint.0008.npz"):
            under_way.append(path.name)
            time.sleep(0.2)
        written(path, data, sync=sync)

    monkeypatch.setattr(frame_writer, "write_atomically", stalling)
    two = run(tmp_path, "stalled", shuffle_rows=3, chunk=7)
    assert under_way == ["frame.0003.npz", "checkpoint.0008.npz"]
    mine, other = summarise_run(one), summarise_run(two)
    for name in ("agents", "frames", "states", "state_hash", "max_surface_error", "transitions"):
        assert mine[name] == other[name], name
    assert mine["max_surface_error"] > 0 and {"measure", "hash", "frame", "write", "sync", "checkpoint"} <= set(mine["seconds"])
    files = contents(tmp_path / "plain")
    assert files == contents(tmp_path / "stalled")
    assert len([name for name in files if name.startswith("frames")]) == 40
    assert (
        open_cache(tmp_path / "plain").checkpoints()
        == open_cache(tmp_path / "stalled").checkpoints()
        == [1, 8, 15, 22, 29, 36, 40]
    )
    lines = [read_lines(tmp_path / run_name / HASHES_FILE_NAME) for run_name in ("plain", "stalled")]
    of_frames = [{frame: (line.hash, line.file) for frame, line in frame_lines.items()} for frame_lines in lines]
    assert len(of_frames[0]) == 40 and of_frames[0] == of_frames[1]
    assert sum(bool(line.checkpoint) for line in lines[0].values()) == 7


def test_an_error_behind_a_run_ends_it_and_frees_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written = frame_writer.write_atomically

    def full(path: Path, data: bytes | BytesParts, *, sync: bool = True) -> None:
        if path.name == "frame.0005.npz":
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        written(path, data, sync=sync)

    monkeypatch.setattr(frame_writer, "write_atomically", full)
    with pytest.raises(OSError, match="No space left"):
        run(tmp_path, "out")
    with FolderLock(tmp_path / "out"):
        pass
    assert [path.name for path in sorted((tmp_path / "out" / "frames").iterdir())] == [f"frame.000{n}.npz" for n in range(1, 5)]


def test_nothing_that_is_handed_over_is_memory_of_the_world(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The world goes on while a frame is written: an array that both had would be written as it is later."""
    make_frame = FrameMaker.frame
    array_names: set[str] = set()

    def watched(self: FrameMaker, world: World) -> dict[str, NDArray[Any]]:
        arrays = make_frame(self, world)
        for name, array in arrays.items():
            array_names.add(name)
            assert not any(np.shares_memory(array, own) for own in held(world)), name
        return arrays

    monkeypatch.setattr(FrameMaker, "frame", watched)
    shot = stick_bodies.opened(stick_bodies.write_scene(tmp_path, 6, "hill", count=16))
    recording = begin_recording(shot, tmp_path / "out", Options(), resume=False, force=False)
    frames = record_frames(recording)
    for _ in range(2):
        next(frames)
    frames.close()
    assert {"P", "id", "orient"} <= array_names and any(name.startswith("feet.") for name in array_names)


def held(world: World) -> Iterator[NDArray[Any]]:
    """The arrays of a world that change."""
    tables: list[Mapping[str, Any]] = []
    for population in world.populations.values():
        tables += [population.now, population.start, population.events, population.footing.columns]
        tables.append({"ids": population.ids, "born": population.born, "position": population.position})
    tables += [items.amounts for items in world.items.values()]
    tables += [feet.get_stored_arrays() for feet in world.feet.values()]
    tables.append({name: field.amounts for name, field in world.fields.items()})
    tables += [flow.get_state() for flow in world.flows.values()]
    for table in tables:
        yield from table.values()
