"""Faults of the disk while exports, pictures, tables and edited caches are written: there is the old file or the new one."""

from __future__ import annotations

import json
import os
import random
import shutil
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from fault_shim import FAULTS, STYLES, Disk, Fault, Faults
from fault_shots import BESIDE, OUTPUT_FOLDER, WRITERS, Inline, copied, files, project, ran, same, written
from kills import kill
from sampling import sampled

from antdsl.cli import _run_without_warnings
from antdsl.outputs.pictures import write_film
from antdsl.sweeps.finished_runs import FinishedRunStore

SAMPLE = ("csv", "geo", "edit", "golden", "fmt")


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = project(tmp_path_factory.mktemp("writers") / "p")
    assert ran(folder).returncode == 0
    return folder


def broken(unbroken: Path, folder: Path, name: str, at: int, fault: Fault, expected_files: dict[str, bytes]) -> str | None:
    """Run a writer with a fault, see that each file is the old one or the new one, and run it again. What was failed."""
    copied(unbroken, folder)
    old = {path: b"old" for path in expected_files if "/" in path and path.count("/") == 1}
    for path, data in old.items():
        (folder / path).write_bytes(data)
    old |= {path: (unbroken / path).read_bytes() for path in BESIDE.get(name, ()) if (unbroken / path).exists()}
    root = folder if name in BESIDE else folder / OUTPUT_FOLDER
    with Faults(root, at, fault) as calls:
        code, words = written(folder, name)
    context = (name, at, str(fault), calls.hit, words)
    is_unread = (calls.hit or "").startswith("open ") and "error[" in words  # what a scene names has its place in the scene
    assert code in ((0, 3) if calls.hit else (0,)) or (is_unread and code == 1), context
    if code:
        first, *rest = words[words.index("error") :].splitlines()
        names = ("scene.yaml`", "walker.ant`", "walker.svg`", "scene.golden.json`", f"{OUTPUT_FOLDER}`", f"{OUTPUT_FOLDER}/")
        assert any(word in first for word in names), context
        if not first.startswith("error["):  # of a file that could not be read
            assert any(word in rest[0] for word in ("again", "`--", "--resume", "goes on", "check the name")), context
    for path, data in files(folder, name).items():
        if name != "edit" and "/runs/" not in path and not os.path.basename(path).startswith("."):
            assert data == old.get(path) or same(name, path, data, expected_files[path]), (path, *context)
    if name == "new" and (folder / OUTPUT_FOLDER / "project").exists():
        shutil.rmtree(folder / OUTPUT_FOLDER / "project")  # it writes into empty folders only
    code, words = written(folder, name)
    assert code == 0, (*context, words)
    final_files = files(folder, name)
    if (calls.hit or "").startswith("unlink "):  # a file that could not be removed then: the next process removes it
        final_files = {path: data for path, data in final_files.items() if not os.path.basename(path).startswith(".")}
    assert final_files.keys() == expected_files.keys(), context
    for path, data in final_files.items():
        assert same(name, path, data, expected_files[path]), (path, *context)
    return calls.hit


def expected(unbroken: Path, folder: Path, name: str) -> tuple[dict[str, bytes], int]:
    """The files of an undisturbed writer, and how many calls it makes."""
    copied(unbroken, folder)
    with Faults(folder if name in BESIDE else folder / OUTPUT_FOLDER) as calls:
        assert written(folder, name)[0] == 0
    return files(folder, name), calls.count


@pytest.fixture(autouse=True)
def inline(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.executors.ProcessEngine", Inline)


def needed(name: str) -> None:
    if name.startswith("usd") or name == "chunks":
        pytest.importorskip("pxr")


@pytest.mark.parametrize("name", sampled(WRITERS, SAMPLE))
def test_a_fault_at_some_call_leaves_the_old_file_or_the_new_one(unbroken: Path, tmp_path: Path, name: str) -> None:
    needed(name)
    chance = random.Random(name)
    expected_files, count = expected(unbroken, tmp_path / "whole", name)
    assert expected_files and count
    assert broken(unbroken, tmp_path / "p", name, chance.randrange(count), chance.choice(FAULTS), expected_files)


@pytest.mark.slow
@pytest.mark.parametrize("name", WRITERS)
def test_a_fault_at_every_call_leaves_the_old_file_or_the_new_one(unbroken: Path, tmp_path: Path, name: str) -> None:
    needed(name)
    expected_files, count = expected(unbroken, tmp_path / "whole", name)
    for at in range(count):
        broken(unbroken, tmp_path / "p", name, at, FAULTS[at % len(FAULTS)], expected_files)
        shutil.rmtree(tmp_path / "p")


def lost(unbroken: Path, folder: Path, name: str, disk: Disk, at: int, style: str, expected_files: dict[str, bytes]) -> None:
    """After a power loss a file that has its name is whole, and the same command again writes all files."""
    shutil.copytree(unbroken, folder)
    disk.loss(at, style, folder / OUTPUT_FOLDER)
    context = (name, at, style)
    if at == len(disk.calls) and name == "edit":  # the command had ended
        assert files(folder, name) == expected_files, context
    manifest = folder / OUTPUT_FOLDER / "edited" / "manifest.json"
    if name != "edit" or manifest.exists():  # an edited cache that is not complete has no manifest
        for path, data in files(folder, name).items():
            if "/runs/" not in path and not os.path.basename(path).startswith("."):
                assert same(name, path, data, expected_files[path]), (path, *context)
    code, words = written(folder, name)
    assert code == 0, (*context, words)
    final_files = {path: data for path, data in files(folder, name).items() if not os.path.basename(path).startswith(".")}
    assert final_files.keys() == expected_files.keys(), context
    for path, data in final_files.items():
        assert same(name, path, data, expected_files[path]), (path, *context)


@pytest.mark.parametrize("name", sampled(("csv", "edit", "sweep"), ("edit",)))
def test_a_power_loss_at_some_calls_leaves_whole_files(unbroken: Path, tmp_path: Path, name: str) -> None:
    chance, folder = random.Random(name), copied(unbroken, tmp_path / "whole")
    with Disk(folder / OUTPUT_FOLDER) as disk:
        assert written(folder, name)[0] == 0
    expected_files = files(folder, name)
    for number, style in enumerate(STYLES):
        lost(unbroken, tmp_path / f"{number}", name, disk, chance.randrange(len(disk.calls) + 1), style, expected_files)
    lost(unbroken, tmp_path / "end", name, disk, len(disk.calls), "nothing", expected_files)


def limited(size: int, work: Callable[[], int]) -> int:
    """The exit code of work in a process in which no file may grow beyond a size, so that C libraries see a full disk."""
    import resource

    child = os.fork()
    if not child:
        code = 99
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
            code = work()
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


@pytest.mark.skipif(os.name == "nt", reason="there is no such limit")
@pytest.mark.parametrize("name", sampled(("usdc", "usda", "chunks"), ()))
def test_usd_on_a_full_disk_is_no_bug_and_leaves_the_old_file(unbroken: Path, tmp_path: Path, name: str) -> None:
    pytest.importorskip("pxr")
    folder = copied(unbroken, tmp_path / "p")
    assert written(folder, name)[0] == 0
    old_files = files(folder, name)
    size = max(map(len, old_files.values()))

    def export() -> int:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for number in (1, 2):
            os.dup2(nowhere, number)
        os.chdir(folder)
        stream = open(os.devnull, "w")  # noqa: SIM115
        with patch("sys.argv", ["antdsl", *WRITERS[name]]), patch("sys.stdout", stream), patch("sys.stderr", stream):
            return _run_without_warnings()

    for limit in (1, size // 2, size - 10):
        assert limited(limit, export) == 3
        assert files(folder, name) == old_files


@pytest.mark.skipif(os.name == "nt", reason="there is no such limit")
def test_a_film_on_a_full_disk_is_not_written(tmp_path: Path) -> None:
    """The encoder is another program, which says nothing of it."""
    pytest.importorskip("imageio_ffmpeg")
    noise = np.random.default_rng(1).integers(0, 255, (20, 48, 64, 3)).astype(np.uint8)
    assert write_film(noise, tmp_path / "film.mp4", 24).ok
    size = (tmp_path / "film.mp4").stat().st_size
    (tmp_path / "film.mp4").write_bytes(b"old")

    def encode() -> int:
        errors = write_film(noise, tmp_path / "film.mp4", 24).errors
        return 3 if [each.code for each in errors] == ["cannot-write"] else 98

    for limit in (100, size // 2, size - 10):
        assert limited(limit, encode) == 3
        assert [path.name for path in tmp_path.iterdir()] == ["film.mp4"]
        assert (tmp_path / "film.mp4").read_bytes() == b"old"


def test_a_finished_run_of_a_sweep_that_was_damaged_is_run_again(unbroken: Path, tmp_path: Path) -> None:
    folder = copied(unbroken, tmp_path / "p")
    assert written(folder, "sweep")[0] == 0
    run_store = FinishedRunStore(folder / OUTPUT_FOLDER / "sweep")
    (path, *_) = sorted(run_store.runs.glob("*.json"))
    data, document = path.read_bytes(), json.loads(path.read_bytes())
    job: Any = SimpleNamespace(key=document["key"])
    assert run_store.read_measures(job) == document["measures"]
    results = []
    for at in range(0, len(data), 3):
        path.write_bytes(data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :])
        results.append(run_store.read_measures(job))
        path.write_bytes(data[:at])
        results.append(run_store.read_measures(job))
    assert all(each in (None, document["measures"]) for each in results) and results.count(None) > 0.9 * len(results)


@pytest.mark.slow
def test_kills_leave_nothing_damaged() -> None:
    lines: list[str] = []
    assert kill(25, 7, lines.append) == 0, lines
    assert lines[-1].endswith("consistent")
