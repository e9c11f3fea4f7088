"""Shots and stills as tasks: the same bytes as in this process, fetched from a worker that does not see the folder."""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import Future
from pathlib import Path

import commands
import pytest
from executed import InThisProcess

from antdsl.executors import Task, TaskRejectedError, WorkerContext, WorkersLostError, run_tasks
from antdsl.executors.input_bundle import FileBundle, VisibleFile, find_unpacked_path, hash_files, pack_files
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.drawing import DrawRequest, FrameDrawer, StillStore
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.pipeline import RunChoices, open_scene
from antdsl.scene.paths import record_requested_paths
from antdsl.scene.values import FrameRange
from antdsl.shots import exports, stills
from antdsl.shots.caches import make_cache_task, remove_other_frames
from antdsl.shots.task_destination import Destination, mark_folder

OPTIONS = {"backend": "numpy", "chunk": 16_384, "shuffle_rows": None, "on_fault": "stop", "resume": False, "force": False}


class Afar(InThisProcess):
    """A worker that has the files of an input bundle, and sees no folder of the requester. `lost`: so many files cannot be
    had."""

    def __init__(self, bundle: FileBundle, folder: Path, lost: int = 0) -> None:
        super().__init__()
        self.lost, self.made = lost, folder / "made"
        bundle.unpack(folder / "files")
        self.made.mkdir(parents=True)
        self._worker = WorkerContext(
            1, find_local_path=lambda path: find_unpacked_path(folder / "files", path), scratch_folder=self.made, name="afar"
        )

    def submit(self, task: Task) -> Future[str]:
        document = {**task.document, "token": "nobody sees this"}
        return super().submit(Task(task.key, task.function, document))

    def fetch_file(self, worker: str, file: str, size: int) -> Iterator[bytes]:
        if self.lost:
            self.lost -= 1
            raise WorkersLostError("it is gone")
        yield (self.made / file).read_bytes()

    def remove_task_files(self, worker: str, folder: str) -> None:
        assert (self.made / folder).is_dir() and worker == "afar"


@pytest.fixture
def walkers(tmp_path: Path) -> Path:
    assert commands.run("new", "walkers", cwd=tmp_path).returncode == 0
    return tmp_path


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_shot_on_another_machine_is_the_same_cache_and_nothing_of_an_earlier_one_stays(walkers: Path) -> None:
    scene = walkers / "walkers" / "scene.yaml"
    process = commands.run(
        "run", str(scene), "--frames", "1..3", "--out", "here/walk", "--quiet", "--backend", "numpy", cwd=walkers
    )
    assert process.returncode == 0, process.stderr
    choices = RunChoices(frames=FrameRange(1, 3))
    with record_requested_paths() as read:
        shot, report = open_scene(scene, choices)
    assert shot is not None and report.ok
    afar = Afar(pack_files(path for path in read if path.is_file()), walkers / "afar", lost=1)
    remote_folder = walkers / "there"
    (remote_folder / "walk" / "frames").mkdir(parents=True)
    (remote_folder / "walk" / "frames" / "frame.0009.npz").write_bytes(b"of an earlier run")
    with mark_folder(remote_folder) as to:
        (answered,) = run_tasks(
            [make_cache_task(shot, scene, choices, OPTIONS, to, "walk")], afar, choose_folder=lambda task: remote_folder
        )
    assert answered.answer is not None and len(afar.tasks) == 2, "done again, since its files could not be had"
    remove_other_frames(remote_folder / "walk", answered.answer["files"], "walk")
    assert files(remote_folder) == {name: data for name, data in files(walkers / "here").items()}


def test_files_that_have_changed_are_reported_and_nothing_is_mixed(walkers: Path) -> None:
    scene = walkers / "walkers" / "scene.yaml"
    shot, _ = open_scene(scene)
    assert shot is not None
    with mark_folder(walkers) as to:
        shot_task = make_cache_task(shot, scene, RunChoices(), OPTIONS, to, "walk")
        program = walkers / "walkers" / "walker.ant"
        program.write_text(program.read_text(encoding="utf-8") + "\n# another\n", encoding="utf-8")
        (answered,) = run_tasks([shot_task], InThisProcess())
    assert answered.answer is None and "have changed" in answered.problem and not (walkers / "walk").exists()


@pytest.mark.parametrize("name", ["../out.png", "/tmp/out.png"])
def test_a_worker_cannot_put_a_file_anywhere_else(tmp_path: Path, name: str) -> None:
    answer = {"files": [[name, 3, "0"]], "worker": "w", "made": "m"}
    (outcome,) = run_tasks([Task("k", lambda document, worker: answer, {})], InThisProcess(), choose_folder=lambda task: tmp_path)
    assert outcome.answer is None and "too large or leads out" in outcome.problem and not list(tmp_path.iterdir())


def test_a_task_with_files_that_cannot_be_fetched_is_given_up(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    afar = Afar(pack_files([]), tmp_path / "afar", lost=9)
    answer = {"files": [["a", 3, "0"]], "worker": "afar", "made": "m"}
    task = Task("k", lambda document, worker: answer, {})
    (outcome,) = run_tasks([task], afar, choose_folder=lambda task: tmp_path / "there")
    assert (outcome.answer, outcome.problem, len(afar.tasks)) == (None, "it is gone", 3)


def test_stills_of_another_machine_are_those_of_this_one(walkers: Path) -> None:
    process = commands.run("run", "walkers/scene.yaml", "--frames", "1..6", "--out", "walk", "--quiet", cwd=walkers)
    assert process.returncode == 0, process.stderr
    cache, still_options = walkers / "walk", DrawRequest(160, 90, "scene", ("trail",))
    afar = Afar(pack_files(path for path in cache.rglob("*") if path.is_file()), walkers / "afar")
    remote_folder = walkers / "there"
    remote_folder.mkdir()
    with mark_folder(remote_folder) as to:
        jobs = list(stills.make_still_tasks(cache, still_options, range(1, 7), range(1, 7), to))
        assert [job.document["frames"] for job in jobs] == [[1, 2, 3, 4], [5, 6]]
        assert all(answered.answer is not None for answered in run_tasks(jobs, afar, choose_folder=lambda task: remote_folder))
    drawer = FrameDrawer(still_options.gallery(open_cache(cache)), still_options, range(1, 7), 1)
    local_folder = walkers / "here"
    local_folder.mkdir()
    local_stills = StillStore.build(local_folder, open_cache(cache), still_options, range(1, 7))
    for frame in range(1, 7):
        local_stills.write_still(frame, drawer.draw(frame))
    assert files(remote_folder) == files(local_folder) and len(files(local_folder)) == 6
    assert all(
        StillStore.build(remote_folder, open_cache(cache), still_options, range(1, 7)).read_still(frame) is not None
        for frame in range(1, 7)
    )


def test_exports_of_another_machine_are_those_of_this_one(walkers: Path) -> None:
    assert commands.run("run", "walkers/scene.yaml", "--frames", "1..10", "--out", "walk", "--quiet", cwd=walkers).returncode == 0
    assert commands.run("export", "walk", "--to", "here/w.geo", "--ids", "3..9", cwd=walkers).returncode == 0
    cache, remote_folder = walkers / "walk", walkers / "there"
    afar = Afar(pack_files(path for path in cache.rglob("*") if path.is_file()), walkers / "afar")
    remote_folder.mkdir()
    with mark_folder(remote_folder) as to:
        keys = frozenset(agent * SPECIES_PER_KEY for agent in range(3, 10))
        jobs = exports.make_export_tasks(cache, "w.geo", "points", keys, range(1, 11), to)
        assert all(answered.answer is not None for answered in run_tasks(jobs, afar, choose_folder=lambda task: remote_folder))
    assert files(remote_folder) == files(walkers / "here") and len(files(remote_folder)) == 10


def test_a_bundle_is_known_by_its_hash_and_stays_in_its_folder(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "x.txt").write_bytes(b"one")
    bundle = pack_files([tmp_path / "a" / "x.txt", tmp_path / "a" / ".." / "a" / "x.txt"])
    bundle.unpack(tmp_path / "to")
    assert find_unpacked_path(tmp_path / "to", str(tmp_path / "a" / "x.txt")).read_bytes() == b"one"
    with pytest.raises(TaskRejectedError, match="were changed during the transfer"):
        FileBundle(dict.fromkeys(bundle.files, b"two"), bundle.digest).unpack(tmp_path / "other")
    outside = {"../x": b"1"}
    with pytest.raises(TaskRejectedError, match="out of the project's folder"):
        FileBundle(outside, hash_files(outside)).unpack(tmp_path / "third")
    visible_file = VisibleFile.from_path(tmp_path / "a" / "x.txt")
    assert visible_file.is_visible() and os.path.isabs(visible_file.path)
    (tmp_path / "a" / "x.txt").write_bytes(b"two")
    assert not visible_file.is_visible()


def test_a_destination_is_known_by_its_mark(tmp_path: Path) -> None:
    worker = WorkerContext(1, scratch_folder=tmp_path / "scratch")
    (tmp_path / "scratch").mkdir()
    with mark_folder(tmp_path) as to:
        assert to.choose_task_folder(worker, "k") == tmp_path and to.describe_files(worker, tmp_path, "k")["files"] == []
    assert (
        to.choose_task_folder(worker, "k") == tmp_path / "scratch" / "k"
        and Destination(str(tmp_path), "").choose_task_folder(WorkerContext(1), "k") == tmp_path
    )
