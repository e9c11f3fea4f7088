"""Faults of the disk at every call: a run ends in words and exit code 3, and goes on to the same frames."""

from __future__ import annotations

import errno
import os
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import pytest
from failing_memory import MEMORY
from fault_shim import FAULTS, STYLES, Disk, Fault, Faults
from fault_shots import LAST, assert_same, project, ran
from sampling import sampled

from antdsl.outputs.cache.cache_reader import make_frame_path, open_cache
from antdsl.outputs.cache.lock import LOCK_FILE_NAME, FolderLock, FolderLocked
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import open_scene
from antdsl.runtime import Options


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = project(tmp_path_factory.mktemp("faults") / "p")
    assert ran(folder).returncode == 0
    return folder


def calls_of_a_run(folder: Path, *words: str) -> list[str]:
    with Faults(folder / "out") as calls:
        assert ran(folder, *words).returncode == 0
    return calls.seen


def broken(folder: Path, at: int, fault: Fault, unbroken: Path, *words: str) -> bool:
    """A run with a fault ends in words, and goes on; whether there was a call with that number."""
    with Faults(folder / "out", at, fault) as calls:
        process = ran(folder, *words)
    if calls.hit is None:
        assert process.returncode == 0
    elif process.returncode:
        assert process.returncode == 3, (calls.hit, process.stderr)
        assert process.stderr.startswith("error: ") and str(folder / "out") in process.stderr, (calls.hit, process.stderr)
        hint = process.stderr.splitlines()[1]
        assert hint.endswith("`--out`") or hint.endswith("antdsl run scene.yaml --resume"), (calls.hit, process.stderr)
    process = ran(folder, "--resume")
    assert process.returncode == 0, (calls.hit, process.stderr)
    assert_same(folder, unbroken)
    return calls.hit is not None


def test_a_fault_at_some_calls_ends_in_words_and_the_run_goes_on(unbroken: Path, tmp_path: Path) -> None:
    count, chance = len(calls_of_a_run(project(tmp_path / "counted"))), random.Random(20)
    for number in range(3):
        assert broken(project(tmp_path / f"{number}"), chance.randrange(count), chance.choice(FAULTS), unbroken)


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS, ids=str)
def test_a_fault_at_every_call_ends_in_words_and_the_run_goes_on(unbroken: Path, tmp_path: Path, fault: Fault) -> None:
    at = 0
    while broken(project(tmp_path / "p"), at, fault, unbroken):
        shutil.rmtree(tmp_path / "p")
        at += 1
    assert at > 50


def test_a_power_loss_at_some_calls_leaves_what_goes_on(unbroken: Path, tmp_path: Path) -> None:
    disk, chance = recorded(tmp_path / "recorded"), random.Random(20)
    for number in range(3):
        lost(disk, chance.randrange(len(disk.calls) + 1), chance.choice(STYLES), tmp_path / f"{number}", unbroken)


@pytest.mark.slow
@pytest.mark.parametrize("style", STYLES)
def test_a_power_loss_at_every_call_leaves_what_goes_on(unbroken: Path, tmp_path: Path, style: str) -> None:
    disk = recorded(tmp_path / "recorded")
    for at in range(len(disk.calls) + 1):
        lost(disk, at, style, tmp_path / "p", unbroken)
        shutil.rmtree(tmp_path / "p")


def recorded(folder: Path) -> Disk:
    project(folder)
    with Disk(folder / "out") as disk:
        assert ran(folder).returncode == 0
    return disk


def lost(disk: Disk, at: int, style: str, folder: Path, unbroken: Path) -> None:
    project(folder)
    disk.loss(at, style, folder / "out")
    process = ran(folder, "--resume")
    assert process.returncode == 0, (at, style, process.stderr)
    assert_same(folder, unbroken)
    if at == len(disk.calls):
        assert "again" not in process.stderr, (style, process.stderr)  # what a run that ended has written is on the disk


# --- two runs, locks, clocks ---------------------------------------------------------------------------------------------


def test_a_run_that_another_one_overtook_writes_nothing(unbroken: Path, tmp_path: Path) -> None:
    """Another run, of another seed, begins and ends between reading the cache and locking it."""
    folder = tmp_path / "p"
    shutil.copytree(unbroken, folder)
    shot, _ = open_scene(folder / "scene.yaml")
    assert shot is not None
    recording = begin_recording(shot, folder / "out" / "scene", Options(backend="numpy"), resume=True, force=False)
    assert recording.resumed_from == LAST
    other = open_cache(folder / "out" / "scene")
    assert ran(folder, "--seed", "2").returncode == 0
    initial_contents = {path: path.read_bytes() for path in other.folder.rglob("*.npz")}
    with pytest.raises(FolderLocked, match="another run has written"):
        list(record_frames(recording))
    assert {path: path.read_bytes() for path in other.folder.rglob("*.npz")} == initial_contents
    process = ran(folder, "--resume")
    assert process.returncode == 1 and "with seed 2, not 1" in process.stderr and "without `--resume`" in process.stderr
    assert ran(folder).returncode == 0
    assert_same(folder, unbroken)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (b"", "process ?"),
        (b"1\n", "process 1 is"),
        (b"%d somewhere-else\n" % (2**22 + 1), "of somewhere-else is"),
        (b"\xff\0\x1b[31m red\n", "process ? of red is"),
        (b"9" * 200, "process 9999"),
    ],
)
def test_a_lock_that_is_held_is_not_waited_for_unless_its_process_is_known_to_be_gone(
    tmp_path: Path, words: bytes, expected: str
) -> None:
    """Of an empty file, a process that runs, one of another host or container, and nonsense."""
    with FolderLock(tmp_path):
        (tmp_path / LOCK_FILE_NAME).write_bytes(words)
        with (
            patch("antdsl.outputs.cache.lock._MAX_WAIT_SECONDS", 0.05),
            pytest.raises(FolderLocked, match=re.escape(expected)) as error_info,
        ):
            FolderLock(tmp_path).__enter__()
        assert error_info.value.args[0].isprintable()
    with FolderLock(tmp_path):  # what a file says that no process holds counts for nothing
        assert (tmp_path / LOCK_FILE_NAME).read_text().split()[0] == str(os.getpid())


@pytest.mark.skipif(os.name == "nt", reason="Windows does not remove a file that is open")
def test_a_lock_with_another_name_is_replaced(tmp_path: Path) -> None:
    """Of a copy that is made of hard links, or of a file outside that an archive links to."""
    import fcntl

    outside = tmp_path / "outside"
    outside.write_text("precious")
    (tmp_path / "cache").mkdir()
    os.link(outside, tmp_path / "cache" / LOCK_FILE_NAME)
    with FolderLock(tmp_path / "cache") as lock:
        assert outside.read_text() == "precious" and os.stat(lock.path).st_nlink == 1
        with patch("antdsl.outputs.cache.lock._MAX_WAIT_SECONDS", 0.05), pytest.raises(FolderLocked):
            FolderLock(tmp_path / "cache").__enter__()
    os.unlink(lock.path)
    os.link(outside, lock.path)
    with outside.open("r+") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with patch("antdsl.outputs.cache.lock._MAX_WAIT_SECONDS", 0.05), pytest.raises(FolderLocked):
            FolderLock(tmp_path / "cache").__enter__()
    assert outside.read_text() == "precious"


@pytest.mark.parametrize(
    "make", [lambda path: path.symlink_to("elsewhere"), lambda path: os.mkfifo(path), os.mkdir], ids=["link", "fifo", "folder"]
)
def test_a_lock_that_is_no_file_is_named(tmp_path: Path, make: Callable[[Path], None]) -> None:
    folder = project(tmp_path / "p")
    (folder / "out" / "scene").mkdir()
    make(folder / "out" / "scene" / LOCK_FILE_NAME)
    for words in ((), ("--force",)):
        process = ran(folder, *words)
        assert process.returncode == 3 and "scene/lock` is a" in process.stderr and "move it away" in process.stderr, (
            process.stderr
        )


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.EIO])
def test_a_disk_without_locks_is_no_other_run(unbroken: Path, tmp_path: Path, number: int) -> None:
    folder = project(tmp_path / "p")
    with patch("fcntl.flock", side_effect=OSError(number, os.strerror(number))):
        process = ran(folder)
    assert process.returncode == 3 and "process" not in process.stderr and "scene/lock`" in process.stderr, process.stderr
    assert "--resume" in process.stderr
    assert ran(folder).returncode == 0
    assert_same(folder, unbroken)


@pytest.mark.parametrize("seconds", sampled([-(10**9), 0, 10**9], [10**9]))
def test_a_clock_that_is_set_back_or_ahead_changes_nothing(unbroken: Path, tmp_path: Path, seconds: int) -> None:
    """Files from the future, or from before all others: what counts is what is in them."""
    folder = tmp_path / "p"
    shutil.copytree(unbroken, folder)
    for number, path in enumerate(sorted(folder.rglob("*"))):
        os.utime(path, (1.7e9 + (-1) ** number * seconds,) * 2)
    flip(make_frame_path(folder / "out" / "scene", 4))
    process = ran(folder, "--resume")
    assert process.returncode == 0 and "frames 4 to 5 are computed again" in process.stderr, process.stderr
    assert_same(folder, unbroken)


def flip(path: Path, at: float = 0.5) -> None:
    data = bytearray(path.read_bytes())
    data[int(at * (len(data) - 1))] ^= 4
    path.write_bytes(data)


def test_an_unwritable_folder_is_reported_before_anything_is_created(tmp_path: Path) -> None:
    """As root writes everywhere, the calls are made to fail as those of a disk that is mounted to be read."""
    folder = project(tmp_path / "p")
    with Faults(folder / "out", 0, Fault(errno.EROFS, lasting=True)):
        process = ran(folder)
    assert process.returncode == 3 and "read-only" in process.stderr and "`--out`" in process.stderr, process.stderr
    assert not list((folder / "out").iterdir())


# --- memory --------------------------------------------------------------------------------------------------------------


def without_memory(folder: Path, at: int, lasting: bool, unbroken: Path) -> None:
    """A run in which an array cannot be allocated ends in words, and goes on."""
    with MEMORY.intercept():
        MEMORY.at, MEMORY.lasting = at, lasting
        process = ran(folder)
    assert process.returncode in (0, 3), (at, process.stderr)  # 0: what was begun beside the run was not needed
    if process.returncode:
        assert "out of memory" in process.stderr, (at, process.stderr)
        assert "antdsl run scene.yaml" in process.stderr or "run the same command again" in process.stderr, (at, process.stderr)
    assert ran(folder, "--resume").returncode == 0
    assert_same(folder, unbroken)


def allocations(folder: Path) -> int:
    with MEMORY.intercept():
        assert ran(folder).returncode == 0
    return MEMORY.count


def test_a_lack_of_memory_at_some_arrays_ends_in_words_and_the_run_goes_on(unbroken: Path, tmp_path: Path) -> None:
    count, chance = allocations(project(tmp_path / "counted")), random.Random(20)
    for number in range(2):
        without_memory(project(tmp_path / f"{number}"), chance.randrange(count), number % 2 == 0, unbroken)


@pytest.mark.slow
@pytest.mark.parametrize("begin", range(0, 97, 8))
def test_a_lack_of_memory_at_many_arrays_ends_in_words_and_the_run_goes_on(unbroken: Path, tmp_path: Path, begin: int) -> None:
    count = allocations(project(tmp_path / "counted"))
    for at in range(begin, count, 997):
        without_memory(project(tmp_path / f"{at}"), at, at % 2 == 0, unbroken)
