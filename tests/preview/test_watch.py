"""Files that are watched: reported once they do not change any more, however they are saved."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from threading import Event

import pytest

from antdsl.preview import FileWatch
from antdsl.safe_read import open_regular_file


def sparse(path: Path) -> None:
    """A file of 20 GB that takes no room on the disk."""
    with open(path, "wb") as file:
        file.truncate(20 * 10**9)


KINDS: dict[str, Callable[[Path], None]] = {
    "pipe": lambda path: os.mkfifo(path),
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "sparse": sparse,
    "folder": lambda path: path.mkdir(),
}
if os.name == "nt":
    KINDS = {"folder": KINDS["folder"]}


def taken_away(path: Path) -> None:
    path.rmdir() if path.is_dir() else path.unlink()


class Clock:
    """Time that passes when a test says so."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "life.ant"
    path.write_text("one")
    return path


def collect_changes(watch: FileWatch, clock: Clock, seconds: float) -> list[Path]:
    """What is reported while time passes in hundredths of a second."""
    changes: list[Path] = []
    for _ in range(round(seconds * 100)):
        clock.now += 0.01
        changes += watch.find_changed_files()
    return changes


def test_unchanged_files_are_not_reported(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    assert collect_changes(watch, clock, 1) == []
    file.write_text("one")
    os.utime(file, ns=(5, 5))
    assert collect_changes(watch, clock, 1) == []


def test_a_save_is_reported_once(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    file.write_text("two, longer")
    assert collect_changes(watch, clock, 1) == [file]
    assert collect_changes(watch, clock, 3) == []


def test_a_file_that_is_still_being_written_is_waited_for(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    for k in range(20):
        file.write_text("two" * (k + 1))
        assert collect_changes(watch, clock, 0.02) == []
    assert collect_changes(watch, clock, 0.1) == [file]


def test_an_editor_that_empties_or_deletes_before_writing_is_reported_once(file: Path) -> None:
    for begin in (lambda: file.write_text(""), file.unlink):
        clock = Clock()
        watch = FileWatch(lambda: [file], clock=clock)
        begin()
        assert collect_changes(watch, clock, 0.2) == []
        file.write_text("new")
        assert collect_changes(watch, clock, 1) == [file]
        file.write_text("one")


def test_an_editor_that_renames_another_file_over_it_is_heard(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    other = file.with_suffix(".swp")
    other.write_text("two")
    os.utime(other, ns=(os.stat(file).st_atime_ns, os.stat(file).st_mtime_ns))
    os.replace(other, file)
    assert collect_changes(watch, clock, 1) == [file]


def test_a_change_that_no_date_tells_of_is_found_within_a_second_or_so(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    date = os.stat(file)
    file.write_text("two")  # as long as before
    os.utime(file, ns=(date.st_atime_ns, date.st_mtime_ns))
    assert collect_changes(watch, clock, 1.5) == [file]


def test_a_missing_file_is_reported_and_again_on_its_return(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    file.unlink()
    assert collect_changes(watch, clock, 1) == [file]
    file.write_text("one")
    assert collect_changes(watch, clock, 1) == [file]


def test_files_that_an_edit_brings_in_are_watched_from_then_on(file: Path) -> None:
    clock, paths = Clock(), [file]
    watch = FileWatch(lambda: paths, clock=clock)
    other = file.with_name("mine.ant")
    other.write_text("a")
    paths.append(other)
    assert collect_changes(watch, clock, 0.5) == []
    other.write_text("bb")
    assert collect_changes(watch, clock, 0.5) == [other]
    paths.remove(other)
    other.write_text("ccc")
    assert collect_changes(watch, clock, 0.5) == []


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_file_is_not_read_and_a_file_in_its_place_is(file: Path, kind: str) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    file.unlink()
    KINDS[kind](file)
    assert collect_changes(watch, clock, 2) == [file]
    assert collect_changes(watch, clock, 2) == [], "it is as it was"
    taken_away(file)
    file.write_text("two")
    assert collect_changes(watch, clock, 1) == [file]


@pytest.mark.parametrize("kind", KINDS)
def test_it_begins_beside_what_is_no_file(file: Path, kind: str) -> None:
    file.unlink()
    KINDS[kind](file)
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    assert collect_changes(watch, clock, 2) == []
    taken_away(file)
    file.write_text("one")
    assert collect_changes(watch, clock, 1) == [file]


def test_a_pipe_is_not_even_opened(file: Path) -> None:
    """A writer would take the opening for a reader, and the closing for a broken pipe."""
    file.unlink()
    os.mkfifo(file)
    FileWatch(lambda: [file]).find_changed_files()
    with pytest.raises(OSError, match="No such device or address"):  # no reader
        os.open(file, os.O_WRONLY | os.O_NONBLOCK)


def test_how_much_is_read_without_a_sign_of_change_is_bounded(tmp_path: Path) -> None:
    """A thousand frames of a mesh that moves, each read again every second, would leave no time for the ants."""
    read: list[Path] = []

    def opened(path: Path) -> int:
        read.append(path)
        return open_regular_file(path)

    files = [tmp_path / f"walls.{number:04d}.ply" for number in range(200)]
    for each in files:
        each.write_bytes(bytes(100_000))
    clock = Clock()
    watch = FileWatch(lambda: files, open_file=opened, clock=clock)
    read.clear()
    for _ in range(100):
        clock.now += 0.05
        initial_count = len(read)
        watch.find_changed_files()
        assert len(read) - initial_count <= 11, "a mebibyte and a part"
    assert set(read) == set(files), "each has its turn"


def test_waiting_for_changes_ends_at_the_stop_event(file: Path) -> None:
    stop = Event()
    watch = FileWatch(lambda: [file])
    file.write_text("other")
    for changed in watch.wait_for_changes(stop, interval=0.005):
        assert changed == (file,)
        stop.set()
    assert stop.is_set()


def test_a_changing_file_stirs_once_before_it_is_reported(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    assert watch.find_changed_files() == () and not watch.is_any_file_being_written()
    file.write_text("two")
    assert watch.find_changed_files() == () and watch.is_any_file_being_written() and not watch.is_any_file_being_written()
    file.write_text("two, and more")
    assert watch.find_changed_files() == () and watch.is_any_file_being_written(), "it goes on"
    clock.now += 0.05
    assert watch.find_changed_files() == (file,) and not watch.is_any_file_being_written()
    file.write_text("")
    assert watch.find_changed_files() == () and not watch.is_any_file_being_written(), "half of a save"


def test_a_change_that_was_read_is_reported_though_it_is_undone(file: Path) -> None:
    clock = Clock()
    watch = FileWatch(lambda: [file], clock=clock)
    watch.recheck_unstable_files()
    assert collect_changes(watch, clock, 1.2) == [], "nobody was changing it"
    file.write_text("two")
    watch.recheck_unstable_files()
    file.write_text("one")
    assert collect_changes(watch, clock, 0.1) == [file]
    file.write_text("two")
    watch.find_changed_files()
    file.write_text("one")
    assert collect_changes(watch, clock, 2.0) == [], "nobody has read it meanwhile"
