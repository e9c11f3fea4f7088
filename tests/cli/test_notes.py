"""What a backend tells, such as that there is no machine code, comes to the terminal from every command that steps, once."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import commands
import pytest

from antdsl.preview.observing.notes import Notes
from antdsl.runtime.backends.native import backend as native_backend
from antdsl.runtime.backends.native import ready
from antdsl.sweep import Job, Outcome
from antdsl.sweep.workers import _work

WHY = "llvmlite is not there: install it"
TOLD = f"NumPy runs instead of machine code, slower and with the same result: {WHY}\n"


@pytest.fixture
def walkers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which there is a project, for a process in which no machine code can be made."""

    def beside(*what: Any) -> Future[Any]:
        coming: Future[Any] = Future()
        coming.set_exception(ready.Unavailable(WHY))
        return coming

    monkeypatch.setattr(native_backend, "beside", beside)
    monkeypatch.setattr(native_backend, "known", lambda plan, facts: None)
    monkeypatch.setattr(native_backend.compiled, "pays", lambda agents, spent: True)
    assert commands.run("new", "walkers", cwd=tmp_path).returncode == 0
    return tmp_path


def test_a_run_tells(walkers: Path) -> None:
    for words in ((), ("--quiet",)):
        done = commands.run("run", "walkers/scene.yaml", "--frames", "1..4", "--force", *words, cwd=walkers)
        assert done.returncode == 0 and done.stderr.count(TOLD) == 1
    done = commands.run("run", "walkers/scene.yaml", "--frames", "1..4", "--force", "--backend", "numpy", cwd=walkers)
    assert "NumPy runs" not in done.stderr


def test_specs_tell_once_for_all_runs(walkers: Path) -> None:
    done = commands.run("test", "walkers", "--seeds", "2", "--quiet", "--no-keep", cwd=walkers)
    assert done.returncode == 0 and done.stderr.count(TOLD) == 1


class Ended:
    """A pipe of a process of a sweep: one job comes in, what goes out is kept."""

    def __init__(self, job: Job) -> None:
        self._jobs, self.sent = [job], list[tuple[str, Any]]()

    def recv(self) -> Job:
        if not self._jobs:
            raise EOFError
        return self._jobs.pop()

    def send(self, what: tuple[str, Any]) -> None:
        self.sent.append(what)


def test_sweeps_tell_once_for_all_runs(walkers: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def run_all(todo: Sequence[Job], processes: int, threads: int, told: Any, noted: Any) -> Iterator[Outcome]:
        for job in todo:
            pipe: Any = Ended(job)
            with monkeypatch.context() as patch:
                patch.setattr("signal.signal", lambda *_: None)
                patch.setattr("antdsl.numerics.compiled.expect_long_runs", lambda: None)
                _work(pipe, 1)
            notes = [value for word, value in pipe.sent if word == "note"]
            assert notes == [TOLD.strip()]
            noted(notes[0])
            yield Outcome(job, pipe.sent[-1][1])

    monkeypatch.setattr("antdsl.sweep.run_all", run_all)
    words = ("sweep", "walkers/scene.yaml", "--frames", "1..4", "--seeds", "2", "--no-plots")
    for more in ((), ("--quiet", "--again")):
        done = commands.run(*words, *more, cwd=walkers)
        assert done.returncode == 0 and done.stderr.count(TOLD) == 1, done.stderr


def test_the_preview_tells_once_and_as_it_comes(walkers: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("websockets")
    from antdsl.preview import Session

    session, report = Session.open(walkers / "walkers" / "scene.yaml")
    assert session is not None, report
    notes, said = Notes(), []
    for _ in range(4):
        session.step()
        notes.stepped(session)
        said.append(capsys.readouterr().err)
    assert said == ["", TOLD, "", ""]
