"""What a run shows while it sets up: stages on a terminal, plain lines now and then elsewhere, nothing with `--quiet`."""

from __future__ import annotations

import io
import sys
from threading import Thread

import numpy as np
import pytest

from antdsl.cli.printing import progress
from antdsl.cli.printing.progress import show_set_up
from antdsl.numerics import stages, stored_tables


class Terminal(io.StringIO):
    encoding = "utf-8"

    def isatty(self) -> bool:
        return True


def stage_twice(clock: list[float] | None = None) -> None:
    for words in ("ground", "feet"):
        stages.begin_stage(words)
        if clock is not None:
            clock[0] += 4.0


def test_a_terminal_displays_and_clears_each_stage(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with show_set_up(is_quiet=False):
        stage_twice()
    text = terminal.getvalue()
    assert "set up: feet" in text and text.endswith("\x1b[2K"), "the line is cleared"


def test_a_pipe_gets_a_line_after_five_seconds(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    clock = [100.0]
    monkeypatch.setattr(progress.time, "perf_counter", lambda: clock[0])
    with show_set_up(is_quiet=False):
        stage_twice(clock)
        assert capsys.readouterr().out == ""
        stage_twice(clock)
    assert capsys.readouterr().out == "set up: ground\n"


def test_quiet_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    with show_set_up(is_quiet=True):
        stage_twice()
    assert terminal.getvalue() == ""


def test_only_large_tables_that_are_computed_are_stages(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(stored_tables.TABLE_STORE.variable, "")
    stored_tables.reset_store()
    stage_names: list[str] = []
    with stages.report_stages_to(stage_names.append):
        for size in (20, 124_000):
            stored_tables.get_or_compute("cuts", size, (np.arange(3),), lambda: {"found": np.arange(3)})
        other = Thread(target=stages.begin_stage, args=("of another thread",))
        other.start()
        other.join()
    stages.begin_stage("afterwards")
    stored_tables.reset_store()
    assert stage_names == ["cuts of 124,000 faces"]
