"""What the reader's process cannot do once it is confined, tried in a process that confines itself in the same way."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from children import child_environment

from antdsl.reader import client, confinement

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Landlock and seccomp are parts of Linux")
BY_LANDLOCK = ("read outside", "read through a link", "list outside", "read the password file")
ALLOWED = ("read inside", "a thread")


@pytest.fixture(scope="module")
def outcomes(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    folder, outside = tmp_path_factory.mktemp("inside"), tmp_path_factory.mktemp("outside") / "secret"
    (folder / "inside").write_text("x")
    outside.write_text("secret")
    (folder / "link").symlink_to(outside)
    previous_handler = signal.signal(signal.SIGUSR1, signal.SIG_IGN)
    try:
        with socket.create_server(("127.0.0.1", 0)) as server:
            program = Path(__file__).with_name("confined.py")
            command = [sys.executable, str(program), str(folder), str(outside), str(server.getsockname()[1])]
            process = subprocess.run(command, capture_output=True, text=True, env=child_environment(), check=True)
    finally:
        signal.signal(signal.SIGUSR1, previous_handler)
    assert (folder / "inside").read_text() == "x" and sorted(os.listdir(folder)) == ["inside", "link"]
    results: dict[str, Any] = json.loads(process.stdout)
    return results


def test_the_sandbox_blocks_files_processes_and_networks(outcomes: dict[str, Any]) -> None:
    active = outcomes["active"]
    assert active["rlimits"]
    if not active["seccomp"]:
        pytest.skip(f"this system has no seccomp filter: {active}")
    successes = {name for name, outcome in outcomes.items() if outcome == "done"}
    assert successes - set(BY_LANDLOCK) == set(ALLOWED)


def test_only_the_private_folder_and_the_installation_are_readable(outcomes: dict[str, Any]) -> None:
    active = outcomes["active"]
    if not active["landlock"]:
        pytest.skip(f"this system has no Landlock: {active}")
    assert {outcomes[name] for name in BY_LANDLOCK} == {"refused: PermissionError"}


def test_the_reader_itself_is_confined() -> None:
    active = client.find_active_layers()
    running = client._file_reader._reader_process
    assert running is not None
    status = Path(f"/proc/{running.process.pid}/status").read_text()
    limits = Path(f"/proc/{running.process.pid}/limits").read_text()
    assert bool(active["seccomp"]) == ("Seccomp:\t2" in status) and "NoNewPrivs:\t1" in status
    assert [line.split()[-3:-1] for line in limits.splitlines() if line.startswith("Max file size")] == [["0", "0"]]
    environment = Path(f"/proc/{running.process.pid}/environ").read_bytes().split(b"\0")
    names = {each.partition(b"=")[0].decode() for each in environment if each}
    assert names <= {*confinement._PASSED_VARIABLES, *confinement._SET_VARIABLES} | {
        name for name in names if name.startswith("NPY_")
    }


def test_modules_come_from_the_installation(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", ".", "relative", str(tmp_path), *sys.path])
    assert not {"", ".", "relative", str(tmp_path)} & set(confinement.list_module_folders())
    assert str(tmp_path) not in confinement.list_readable_folders()
