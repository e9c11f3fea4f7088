"""The reader of a process: it is started once, replaced when it dies, hangs or talks nonsense, and leaves nothing behind."""

from __future__ import annotations

import io
import os
import signal
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from antdsl import limits
from antdsl.reader import client, private_folder
from antdsl.reader.client import FileReader, ReaderFailureError
from antdsl.reader.image_request import ImageError, read_image_file
from antdsl.reader.private_folder import PrivateFolder, remove_stale_folders

HELLO = """import sys, json, struct, time, os
def send(document, arrays=(), body=b""):
    text = json.dumps({"document": document, "arrays": list(arrays)}).encode()
    os.write(1, struct.pack("<4sQ", b"ant1", len(text)) + text + body)
send({"active": {"rlimits": 1, "landlock": 1, "seccomp": 1}})
os.read(0, 1 << 20)
"""


def png(samples: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(samples).save(file, "PNG")
    return file.getvalue()


GREY = np.arange(12, dtype=np.uint16).reshape(3, 4) * 5000


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Iterator[FileReader]:
    new_reader = FileReader()
    monkeypatch.setattr(client, "_file_reader", new_reader)
    yield new_reader
    new_reader.end_reader_process()


def samples() -> np.ndarray | None:
    return read_image_file(png(GREY), "PNG", ("I;16",), 100).samples


def test_the_reader_restarts_after_it_died(reader: FileReader) -> None:
    assert np.array_equal(samples(), GREY)  # type: ignore[arg-type]
    assert reader._reader_process is not None
    first = reader._reader_process.process
    samples()
    assert reader._reader_process.process is first
    first.send_signal(signal.SIGKILL)
    first.wait()
    assert np.array_equal(samples(), GREY)  # type: ignore[arg-type]
    second, folder = reader._reader_process.process, reader._folder
    assert second is not first and folder is not None
    reader.end_reader_process()
    assert second.poll() is not None and not folder.path.exists()


def test_invalid_and_large_images_are_rejected(reader: FileReader) -> None:
    with pytest.raises(ImageError, match="cannot be read as PNG"):
        read_image_file(b"\x89PNG\r\n\x1a\n" + bytes(90), "PNG", ("RGB",), 100)
    for modes, pixels in ((("RGB",), 100), (("I;16",), 11)):
        image = read_image_file(png(GREY), "PNG", modes, pixels)
        assert image.samples is None and (image.rows, image.columns, image.mode) == (3, 4, "I;16")


@pytest.mark.parametrize(
    ("does", "words"),
    [
        ("sys.exit(3)", "the library for its format crashes"),
        ("os.abort()", "the library for its format crashes"),
        ("os.write(1, b'what?' * 100)", "invalid answer"),
        ("send({'answer': 3})", "invalid answer"),
        ("send({'refusal': {'code': 'no-such-code', 'message': 'x', 'help': None, 'key': '', 'about': ''}})", "invalid answer"),
        ("send({'answer': {}}, [['samples', '<f8', [1 << 39]]])", "invalid answer"),
        ("send({'answer': {'mode': 'I;16', 'rows': 3, 'columns': 4, 'pages': 1, 'texts': {}}})", "invalid answer"),
        ("send({'answer': {'mode': 'I;16', 'rows': -3, 'columns': -4, 'pages': 1, 'texts': {}}})", "invalid answer"),
        ("send({'failure': 'memory'})", "too much memory"),
        ("time.sleep(600)", "takes too long"),
    ],
)
def test_any_misbehaviour_of_the_reader_is_an_error(
    does: str, words: str, reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program = tmp_path / "child.py"
    program.write_text(f"{HELLO}{does}\n")
    monkeypatch.setattr(client, "_CHILD_PROGRAM", program)
    if "sleep" in does:
        monkeypatch.setattr(limits, "READER_BASE_WALL_SECONDS", 1)
        monkeypatch.setattr(limits, "READER_BASE_CPU_SECONDS", 0)
    with pytest.raises(ImageError, match=words):
        samples()
    monkeypatch.undo()
    monkeypatch.setattr(client, "_file_reader", FileReader())
    assert np.array_equal(samples(), GREY), "the next one answers"  # type: ignore[arg-type]
    client._file_reader.end_reader_process()


def test_failed_requests_are_not_repeated(reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "child.py"
    program.write_text(f"{HELLO}os.abort()\n")
    monkeypatch.setattr(client, "_CHILD_PROGRAM", program)
    with pytest.raises(ReaderFailureError):
        client.send_request("image", {}, request_digest="a")
    monkeypatch.setattr(reader, "_start_process", lambda: pytest.fail("started again"))
    with pytest.raises(ReaderFailureError, match="crashes"):
        client.send_request("image", {}, request_digest="a")


def test_threads_take_turns(reader: FileReader) -> None:
    matches: list[bool] = []
    threads = [threading.Thread(target=lambda: matches.append(np.array_equal(samples(), GREY))) for _ in range(6)]  # type: ignore[arg-type]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert matches == [True] * 6


@pytest.mark.skipif(not hasattr(os, "fork"), reason="a system without fork")
def test_forked_processes_have_separate_readers(reader: FileReader) -> None:
    samples()
    assert reader._reader_process is not None and reader._folder is not None
    process, folder = reader._reader_process.process, reader._folder.path
    forked = os.fork()
    if not forked:
        code = 1
        try:
            is_new = client._file_reader is not reader
            code = 0 if is_new and np.array_equal(samples(), GREY) and client._file_reader._folder.path != folder else 2  # type: ignore[union-attr,arg-type]
            client._file_reader.end_reader_process()
        finally:
            os._exit(code)
    assert os.waitstatus_to_exitcode(os.waitpid(forked, 0)[1]) == 0
    assert folder.exists() and process.poll() is None
    assert np.array_equal(samples(), GREY) and reader._reader_process.process is process  # type: ignore[arg-type]


def test_folders_of_killed_processes_are_removed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    living = PrivateFolder()
    assert living.path.parent.stat().st_mode & 0o777 == 0o700
    (living.create_folder() / "a.usda").write_text("x")
    dead, other = tmp_path / f"{private_folder._FOLDER_PREFIX}dead", tmp_path / "other"
    target = tmp_path / "target"
    for folder in (dead, other, target):
        (folder / "files").mkdir(parents=True)
        (folder / "lock").write_bytes(b"")
    (tmp_path / f"{private_folder._FOLDER_PREFIX}link").symlink_to(target)
    remove_stale_folders()
    assert not dead.exists() and other.exists() and target.exists() and (living.path / "1" / "a.usda").exists()
    living.remove()
    assert not living.path.parent.exists()


def test_a_check_by_many_processes_leaves_no_folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from cases.hostile.rows import PROJECT

    from antdsl.checking import check_files
    from antdsl.pipeline import RunChoices

    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    monkeypatch.setattr(client, "_file_reader", FileReader())
    scenes = []
    for number in range(12):
        folder = tmp_path / str(number)
        folder.mkdir()
        for name, data in PROJECT.items():
            (folder / name).write_bytes(data if isinstance(data, bytes) else data())
        (folder / "h.png").write_bytes(png(np.full((4, 4), number, np.uint16)))
        text = (folder / "scene.yaml").read_text()
        height = "{height: h.png, extent: [1, 1], scale: 1}"
        assert "{mesh: ground.ply}" in text
        (folder / "scene.yaml").write_text(text.replace("{mesh: ground.ply}", height))
        scenes.append(folder / "scene.yaml")
    result = check_files(scenes, RunChoices(), cores=2)
    assert len(result.reports) == 12 and not any(report.errors for report in result.reports.values())
    client._file_reader.end_reader_process()
    assert not list((tmp_path / "temporary").glob(f"{private_folder._FOLDER_PREFIX}*"))
