"""The reader's processor time counts for the budget of a check, and a file that took too much is not tried again."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from unittest.mock import patch

import pytest
from cases.hostile.usd import GOOD, HEAD

from antdsl import cpu_budget, limits
from antdsl.cpu_budget import CpuBudgetSpentError
from antdsl.reader import client
from antdsl.reader.client import FileReader, ReaderFailureError
from antdsl.scene import Roots
from antdsl.scene.geometry import usd
from antdsl.scene.geometry.usd.errors import import_pxr_module

SPIN = """import sys, json, struct, time, os, resource
def send(document):
    text = json.dumps({"document": document, "arrays": []}).encode()
    os.write(1, struct.pack("<4sQ", b"ant1", len(text)) + text)
def spin(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass
send({"active": {"rlimits": 1, "landlock": 1, "seccomp": 1}})
while os.read(0, 1 << 20):
    spin(0.1)
"""


@pytest.fixture
def reader(monkeypatch: pytest.MonkeyPatch) -> Iterator[FileReader]:
    new_reader = FileReader()
    monkeypatch.setattr(client, "_file_reader", new_reader)
    yield new_reader
    new_reader.end_reader_process()


def program(does: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    file = tmp_path / "child.py"
    file.write_text(f"{SPIN}    {does}\n")
    monkeypatch.setattr(client, "_CHILD_PROGRAM", file)


def test_charged_time_ends_the_budget() -> None:
    cpu_budget.charge_cpu_seconds(1e9)  # without a budget nothing happens
    with pytest.raises(CpuBudgetSpentError), cpu_budget.limit_cpu_seconds(1000):
        for _ in range(1000):
            cpu_budget.charge_cpu_seconds(0.5)
        assert 0 < cpu_budget.compute_remaining_cpu_seconds() < 500.01, "setting the timer adds nothing"
        cpu_budget.charge_cpu_seconds(501)
        raise AssertionError("the budget is spent")
    assert cpu_budget.compute_remaining_cpu_seconds() == float("inf")


# The child spins for 0.1 s, whatever it says of it; where it dies, the system tells the time.
@pytest.mark.parametrize(
    "does", ["send({'answer': {}, 'cpu': 0.0})", "os.abort()", "send({'failure': 'exception'})", "send({'what': 1})"]
)
def test_reader_time_is_charged_to_the_check(
    does: str, reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program(does, monkeypatch, tmp_path)
    with pytest.raises(CpuBudgetSpentError), cpu_budget.limit_cpu_seconds(1000):
        cpu_budget.charge_cpu_seconds(cpu_budget.compute_remaining_cpu_seconds() - 100)
        start_seconds = reader._used_cpu_seconds
        with suppress(ReaderFailureError):
            client.send_request("image", {})
        assert reader._used_cpu_seconds - start_seconds >= 0.1
        used = 100 - cpu_budget.compute_remaining_cpu_seconds()
        assert used >= 0.1
        cpu_budget.charge_cpu_seconds(cpu_budget.compute_remaining_cpu_seconds() - 0.01)
        client.send_request("image", {})


def test_a_request_gets_no_more_time_than_the_budget_has(
    reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program("send({'answer': {}})", monkeypatch, tmp_path)
    said: list[dict[str, int]] = []
    write = client.write_message
    monkeypatch.setattr(
        client, "write_message", lambda file, document, arrays: (said.append(document), write(file, document, arrays))
    )
    client.send_request("image", {}, extra_cpu_seconds=1000)
    with cpu_budget.limit_cpu_seconds(500):
        client.send_request("image", {}, extra_cpu_seconds=1000)
    seconds = [each["seconds"] for each in said]  # a thread of another test may ask too
    # The system counts a timer in ticks, one too many at first, and the request rounds up.
    assert 1000 + limits.READER_BASE_CPU_SECONDS in seconds and min(seconds) <= 501, seconds


def test_an_exhausted_budget_does_not_blame_the_file(reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program("os.kill(os.getpid(), 24)", monkeypatch, tmp_path)  # SIGXCPU
    with pytest.raises(CpuBudgetSpentError), cpu_budget.limit_cpu_seconds(4):
        client.send_request("image", {}, request_digest="a", files_digest="b")
    assert not reader._failures and not reader._heavy_failures


# A library that runs out of memory may crash: what took time before it crashed is too heavy as well.
@pytest.mark.parametrize(
    "does", ["os.kill(os.getpid(), 24)", "os.kill(os.getpid(), 9)", "send({'failure': 'memory'})", "spin(0.6), os.abort()"]
)
def test_files_over_the_limit_are_not_read_again(
    does: str, reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program(does, monkeypatch, tmp_path)
    monkeypatch.setattr(limits, "READER_BASE_CPU_SECONDS", 1)
    with pytest.raises(ReaderFailureError) as first:
        client.send_request("image", {}, request_digest="a", files_digest="x")
    with monkeypatch.context() as patch:
        patch.setattr(reader, "_start_process", lambda *_: pytest.fail("started again"))
        with pytest.raises(ReaderFailureError) as second:
            client.send_request("image", {}, request_digest="b", files_digest="x")
        assert str(second.value) == str(first.value) and second.value.help == first.value.help
    for digest, files in (("b", "y"), ("c", "")):  # other files are
        with pytest.raises(ReaderFailureError):
            client.send_request("image", {}, request_digest=digest, files_digest=files)
    client.begin_scene()
    program("send({'answer': {}})", monkeypatch, tmp_path)
    client.send_request("image", {}, request_digest="d", files_digest="x")  # another scene may ask for less of them
    with pytest.raises(ReaderFailureError):
        client.send_request("image", {}, request_digest="a", files_digest="x")


def test_a_crash_affects_one_request(reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program("os.abort()", monkeypatch, tmp_path)
    with pytest.raises(ReaderFailureError):
        client.send_request("image", {}, request_digest="a", files_digest="x")
    program("send({'answer': {}})", monkeypatch, tmp_path)
    client.send_request("image", {}, request_digest="b", files_digest="x")


def test_each_scene_has_the_full_time_limit(reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program("send({'answer': {}})", monkeypatch, tmp_path)
    monkeypatch.setattr(limits, "READER_CPU_SECONDS_PER_SCENE", 0.05)
    client.begin_scene()
    client.send_request("image", {}, request_digest="a", files_digest="x")
    with pytest.raises(ReaderFailureError, match="the files of this scene took more than"):
        client.send_request("image", {}, request_digest="b", files_digest="y")
    client.begin_scene()
    client.send_request("image", {}, request_digest="b", files_digest="y", file_bytes=limits.READER_BYTES_PER_CPU_SECOND * 1000)
    client.send_request("image", {}, request_digest="c", files_digest="y")  # large files have more of it


def test_time_of_a_dead_child_is_counted(reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program("os.abort()", monkeypatch, tmp_path)
    running = reader._start_process()
    running.requests.write(b"x")
    running.requests.flush()
    while os.waitid(os.P_PID, running.process.pid, os.WEXITED | os.WNOWAIT) is None:
        time.sleep(0.01)
    assert running.wait_for_end()[1] >= 0.1


def heavy(folder: Path, levels: int = 20) -> None:
    """A file of few lines with prims that are each composed with two of the next one."""
    pytest.importorskip("pxr")
    text = GOOD
    for number in range(levels):
        children = "".join(f'def "{name}" (\nreferences = </r{number + 1}>\n)\n{{\n}}\n' for name in "ab")
        text += f'def "r{number}"\n{{\n{children}}}\n'
    (folder / "heavy.usda").write_text(f'{text}def "r{levels}"\n{{\n}}\n')


def test_prims_of_a_heavy_file_are_rejected_immediately(
    reader: FileReader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    heavy(tmp_path)
    monkeypatch.setattr(limits, "READER_BASE_CPU_SECONDS", 0)
    closures: dict[str, usd.UsdFileClosure | usd.UsdError] = {}

    def read(prim: str) -> usd.UsdMesh:
        stage = usd.open_stage(
            Roots(tmp_path, {}), "heavy.usda", prim, up="y", frames=range(1, 2), fps=Fraction(24), closures=closures
        )
        return usd.read_usd_mesh(stage)

    assert len(read("/ground").raw_mesh.faces) == 2
    with pytest.raises(usd.UsdError, match="takes too long"):
        read("/r0")
    used = reader._used_cpu_seconds
    for number in range(1, 10):
        with pytest.raises(usd.UsdError, match=f"`/r{number}` of `heavy.usda` cannot be read: reading the file takes too long"):
            read(f"/r{number}")
    assert reader._used_cpu_seconds == used, "no more time is taken"


def test_a_file_that_cannot_be_collected_is_collected_once(
    reader: FileReader, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("pxr")
    (tmp_path / "a.usda").write_text(HEAD.replace("(\n", "(\n    subLayers = [@gone.usda@]\n", 1))
    closures: dict[str, usd.UsdFileClosure | usd.UsdError] = {}
    messages = set()
    for _ in range(3):
        with pytest.raises(usd.UsdError) as error:
            usd.open_stage(Roots(tmp_path, {}), "a.usda", "/m", up="y", frames=[1], fps=Fraction(24), closures=closures)
        messages.add((error.value.code, str(error.value), error.value.help, error.value.key))
        monkeypatch.setattr(client, "send_request", lambda *_, **__: pytest.fail("asked again"))
    assert len(messages) == 1


@pytest.mark.parametrize("does", ["os.abort()", "os.kill(os.getpid(), 9)", "send({'failure': 'memory'})"])
def test_a_small_user_limit_is_out_of_memory(
    does: str, reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program(does, monkeypatch, tmp_path)
    monkeypatch.setattr(client, "get_address_space_limit", lambda: 1 << 30)
    with pytest.raises(MemoryError):
        client.send_request("image", {}, request_digest="a", files_digest="x")
    assert not reader._failures and not reader._heavy_failures
    monkeypatch.setattr(client, "get_address_space_limit", lambda: float("inf"))
    with pytest.raises(ReaderFailureError):
        client.send_request("image", {}, request_digest="a", files_digest="x")


def test_a_reader_that_cannot_start_for_want_of_memory(
    reader: FileReader, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    (tmp_path / "child.py").write_text("")
    monkeypatch.setattr(client, "_CHILD_PROGRAM", tmp_path / "child.py")
    with pytest.raises(ReaderFailureError):
        client.find_active_layers()
    monkeypatch.setattr(client, "get_address_space_limit", lambda: 1 << 28)
    with pytest.raises(MemoryError):
        client.find_active_layers()


def test_a_library_that_cannot_be_mapped_is_out_of_memory() -> None:
    words = "libusd_usd.so: failed to map segment from shared object"
    import_pxr_module.cache_clear()
    with patch("importlib.import_module", side_effect=ImportError(words)), pytest.raises(MemoryError):
        import_pxr_module("Usd")
    with patch("importlib.import_module", side_effect=ImportError("undefined symbol")), pytest.raises(usd.UsdError):
        import_pxr_module("Usd")
