"""Files that are watched: told of once they have come to rest, however they are saved."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Event

import pytest

from antdsl.preview import Watch


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


def told(watch: Watch, clock: Clock, seconds: float) -> list[Path]:
    """What is told of while time passes in hundredths of a second."""
    found: list[Path] = []
    for _ in range(round(seconds * 100)):
        clock.now += 0.01
        found += watch.look()
    return found


def test_nothing_is_told_of_files_that_stay_or_are_saved_as_they_were(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    assert told(watch, clock, 1) == []
    file.write_text("one")
    os.utime(file, ns=(5, 5))
    assert told(watch, clock, 1) == []


def test_a_save_is_told_once(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    file.write_text("two, longer")
    assert told(watch, clock, 1) == [file]
    assert told(watch, clock, 3) == []


def test_a_file_that_is_still_being_written_is_waited_for(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    for k in range(20):
        file.write_text("two" * (k + 1))
        assert told(watch, clock, 0.02) == []
    assert told(watch, clock, 0.1) == [file]


def test_an_editor_that_empties_or_deletes_before_it_writes_is_told_once(file: Path) -> None:
    for begin in (lambda: file.write_text(""), file.unlink):
        clock = Clock()
        watch = Watch(lambda: [file], clock=clock)
        begin()
        assert told(watch, clock, 0.2) == []
        file.write_text("new")
        assert told(watch, clock, 1) == [file]
        file.write_text("one")


def test_an_editor_that_renames_another_file_over_it_is_heard(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    other = file.with_suffix(".swp")
    other.write_text("two")
    os.utime(other, ns=(os.stat(file).st_atime_ns, os.stat(file).st_mtime_ns))
    os.replace(other, file)
    assert told(watch, clock, 1) == [file]


def test_a_change_that_no_date_tells_of_is_found_within_a_second_or_so(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    date = os.stat(file)
    file.write_text("two")  # as long as before
    os.utime(file, ns=(date.st_atime_ns, date.st_mtime_ns))
    assert told(watch, clock, 1.5) == [file]


def test_a_file_that_stays_away_is_told_of_and_told_again_when_it_is_back(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    file.unlink()
    assert told(watch, clock, 1) == [file]
    file.write_text("one")
    assert told(watch, clock, 1) == [file]


def test_files_that_an_edit_brings_in_are_watched_from_then_on(file: Path) -> None:
    clock, paths = Clock(), [file]
    watch = Watch(lambda: paths, clock=clock)
    other = file.with_name("mine.ant")
    other.write_text("a")
    paths.append(other)
    assert told(watch, clock, 0.5) == []
    other.write_text("bb")
    assert told(watch, clock, 0.5) == [other]
    paths.remove(other)
    other.write_text("ccc")
    assert told(watch, clock, 0.5) == []


def test_waiting_for_changes_ends_when_somebody_says_so(file: Path) -> None:
    stop = Event()
    watch = Watch(lambda: [file])
    file.write_text("other")
    for changed in watch.changes(stop, every=0.005):
        assert changed == (file,)
        stop.set()
    assert stop.is_set()


def test_a_file_that_begins_to_change_stirs_once_before_it_is_told(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    assert watch.look() == () and not watch.stirs()
    file.write_text("two")
    assert watch.look() == () and watch.stirs() and not watch.stirs()
    file.write_text("two, and more")
    assert watch.look() == () and watch.stirs(), "it goes on"
    clock.now += 0.05
    assert watch.look() == (file,) and not watch.stirs()
    file.write_text("")
    assert watch.look() == () and not watch.stirs(), "half of a save"


def test_what_somebody_has_read_in_the_middle_of_a_change_is_told_though_it_is_taken_back(file: Path) -> None:
    clock = Clock()
    watch = Watch(lambda: [file], clock=clock)
    watch.doubt()
    assert told(watch, clock, 1.2) == [], "nobody was changing it"
    file.write_text("two")
    watch.doubt()
    file.write_text("one")
    assert told(watch, clock, 0.1) == [file]
    file.write_text("two")
    watch.look()
    file.write_text("one")
    assert told(watch, clock, 2.0) == [], "nobody has read it meanwhile"
