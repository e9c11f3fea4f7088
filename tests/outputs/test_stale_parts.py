"""Files that a killed process left are removed by the next one, and nothing else is."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment

from antdsl import atomic_write


def killed(folder: Path) -> Path:
    """A file that a process began to write before it was killed."""
    create = "from antdsl.atomic_write import create_sibling_file; create_sibling_file(pathlib.Path(sys.argv[1]))"
    code = f"import os, sys, pathlib; {create}; os._exit(9)"
    subprocess.run([sys.executable, "-c", code, str(folder / "points.csv")], env=child_environment(), check=False)
    (left,) = folder.glob(".points.csv.*.part")
    return left


@pytest.mark.skipif(os.name == "nt", reason="not on Windows")
def test_only_files_of_ended_processes_of_this_machine_are_removed(tmp_path: Path) -> None:
    left = killed(tmp_path)
    name = left.name.split(".")
    machine, process, chance = name[3].split("-")
    others = [
        f".points.csv.{machine}-{os.getppid():x}-{chance}.part",  # of a process that runs
        f".points.csv.{int(machine, 16) ^ 1:08x}-{process}-{chance}.part",  # of another machine
        f"points.csv.{machine}-{process}-{chance}.part",
        f".points.csv.{chance}.part",
        ".points.csv.part",
    ]
    for other in others:
        (tmp_path / other).write_text("another's")
    (tmp_path / f".link.{machine}-{process}-{chance}.part").symlink_to(tmp_path / others[0])
    (tmp_path / f".folder.{machine}-{process}-{chance}.part").mkdir()
    os.utime(left, (2**33, 2**33))  # the clock was set back since
    with atomic_write.atomic_path(tmp_path / "points.csv") as part:
        part.write_text("x")
    assert not left.exists() and (tmp_path / "points.csv").read_text() == "x"
    assert all((tmp_path / other).exists() for other in others)
    assert len(list(tmp_path.iterdir())) == len(others) + 3


def test_a_file_that_this_process_writes_stays(tmp_path: Path) -> None:
    mine = atomic_write.create_sibling_file(tmp_path / "one.csv")
    atomic_write._cleaned_folders.clear()
    atomic_write.create_sibling_file(tmp_path / "two.csv")
    assert mine.exists()
