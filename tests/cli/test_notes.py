"""What a backend tells, such as that there is no machine code, comes to the terminal from every command that steps, once."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

import commands
import pytest
from executed import InThisProcess

from antdsl.preview.observing.observers import BackendMessageObserver
from antdsl.runtime.backends.native import compile_queue
from antdsl.runtime.backends.native import native_backend as native_backend

WHY = "llvmlite is not there: install it"
NOTE = f"NumPy runs instead of machine code, more slowly but with the same result: {WHY}\n"


@pytest.fixture
def walkers(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which there is a project, for a process in which no machine code can be made."""

    def beside(*what: Any) -> Future[Any]:
        coming: Future[Any] = Future()
        coming.set_exception(compile_queue.CodeUnavailable(WHY))
        return coming

    monkeypatch.setattr(native_backend, "start_code_build", beside)
    monkeypatch.setattr(native_backend, "find_compiled_code", lambda plan, facts: None)
    monkeypatch.setattr(
        native_backend, "find_stored_blocks", lambda plan, blocks, facts: None
    )  # an earlier test may have stored the code
    monkeypatch.setattr(native_backend, "_MIN_AGENTS_FOR_CODE", 0)
    assert commands.run("new", "walkers", cwd=tmp_path).returncode == 0
    return tmp_path


def test_run_prints_notes(walkers: Path) -> None:
    for words in ((), ("--quiet",)):
        result = commands.run("run", "walkers/scene.yaml", "--frames", "1..4", "--force", *words, cwd=walkers)
        assert result.returncode == 0 and result.stderr.count(NOTE) == 1
    result = commands.run("run", "walkers/scene.yaml", "--frames", "1..4", "--force", "--backend", "numpy", cwd=walkers)
    assert "NumPy runs" not in result.stderr


def test_specs_print_notes_once(walkers: Path) -> None:
    result = commands.run("test", "walkers", "--seeds", "2", "--quiet", "--no-keep", cwd=walkers)
    assert result.returncode == 0 and result.stderr.count(NOTE) == 1


def test_sweeps_print_notes_once(walkers: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.executors.ProcessEngine", InThisProcess)
    words = ("sweep", "walkers/scene.yaml", "--frames", "1..4", "--seeds", "2", "--no-plots")
    for extra_words in ((), ("--quiet", "--again")):
        result = commands.run(*words, *extra_words, cwd=walkers)
        assert result.returncode == 0 and result.stderr.count(NOTE) == 1, result.stderr


def test_the_preview_prints_notes_once_immediately(walkers: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("websockets")
    from antdsl.preview import PreviewSession

    session, report = PreviewSession.open(walkers / "walkers" / "scene.yaml")
    assert session is not None, report
    notes, said = BackendMessageObserver(), []
    for _ in range(4):
        session.step()
        notes.after_step(session)
        said.append(capsys.readouterr().err)
    assert said == ["", NOTE, "", ""]
