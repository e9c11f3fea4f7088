"""Faults of the disk at every call: a run ends in words and exit code 3, and goes on to the same frames."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest
from fault_shim import FAULTS, STYLES, Disk, Fault, Faults
from fault_shots import assert_same, project, ran


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
        done = ran(folder, *words)
    if calls.hit is None:
        assert done.returncode == 0
    elif done.returncode:
        assert done.returncode == 3, (calls.hit, done.stderr)
        assert done.stderr.startswith("error: ") and str(folder / "out") in done.stderr, (calls.hit, done.stderr)
        hint = done.stderr.splitlines()[1]
        assert hint.endswith("`--out`") or hint.endswith("antdsl run scene.yaml --resume"), (calls.hit, done.stderr)
    done = ran(folder, "--resume")
    assert done.returncode == 0, (calls.hit, done.stderr)
    assert_same(folder, unbroken)
    return calls.hit is not None


def test_a_fault_at_some_calls_ends_in_words_and_the_run_goes_on(unbroken: Path, tmp_path: Path) -> None:
    count, chance = len(calls_of_a_run(project(tmp_path / "counted"))), random.Random(20)
    for number in range(10):
        assert broken(project(tmp_path / f"{number}"), chance.randrange(count), chance.choice(FAULTS), unbroken) or True


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
    for number in range(10):
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
    done = ran(folder, "--resume")
    assert done.returncode == 0, (at, style, done.stderr)
    assert_same(folder, unbroken)
    if at == len(disk.calls):
        assert "again" not in done.stderr, (style, done.stderr)  # what a run that ended has written is on the disk
