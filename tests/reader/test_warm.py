"""A preview with a USD file that becomes one that crashes the reader: it goes on, says where, and reads the next file."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest
from cases.hostile.rows import PROJECT
from cases.hostile.usd import ABORTS, GOOD, MESH, usd

pytest.importorskip("pxr")

from antdsl.preview.session import PreviewSession
from antdsl.reader import client


def test_the_preview_continues_after_the_reader_dies(tmp_path: Path) -> None:
    row = usd("", GOOD, file="set.usd")
    for name, data in {**PROJECT, **row.files}.items():
        (tmp_path / name).write_bytes(data if isinstance(data, bytes) else data())
    session, report = PreviewSession.open(tmp_path / "scene.yaml")
    assert session is not None, report.errors
    running = client._file_reader._reader_process
    assert running is not None
    session.step()
    (tmp_path / "set.usd").write_text(GOOD.replace(MESH, MESH + MESH.replace("ground", "other")))
    assert session.reload().is_successful and client._file_reader._reader_process is running, "one reader stays"
    frame = session.frame
    (tmp_path / "set.usd").write_bytes(ABORTS)
    outcome = session.reload()
    [error] = outcome.report.errors
    assert not outcome.is_successful and error.code == "bad-usd" and error.span is not None and error.span.text == "set.usd"
    session.step()
    assert session.frame == frame + 1
    (tmp_path / "set.usd").write_text(GOOD)
    assert session.reload().is_successful
    os.kill(client._file_reader._reader_process.process.pid, signal.SIGKILL)  # type: ignore[union-attr]
    assert session.reload().is_successful
