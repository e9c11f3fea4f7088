"""Commands finish their work whatever state the terminal streams are in: closed, full, broken, slow."""

from __future__ import annotations

import errno
import fcntl
import io
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import commands
import pytest
from children import child_environment

from antdsl.cli import COMMANDS
from antdsl.cli.printing.messages import TerminalWriter, print_note, treat_output_as_notes

STREAMS, STATES = ("stdout", "stderr"), ("closed", "full", "broken", "slow")
PORT = "PORT"
MCP = (
    b'{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"protocolVersion":"2025-06-18","capabilities":{},'
    b'"clientInfo":{"name":"test","version":"1"}}}\n'
)
LSP = b"".join(
    b"Content-Length: %d\r\n\r\n%s" % (len(text), text)
    for text in (
        b'{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"capabilities":{},"processId":null,"rootUri":null}}',
        b'{"jsonrpc":"2.0","method":"initialized","params":{}}',
        b'{"jsonrpc":"2.0","id":2,"method":"shutdown"}',
        b'{"jsonrpc":"2.0","method":"exit"}',
    )
)


@dataclass(frozen=True)
class Use:
    """How a command is used here. `product`: a file that it writes. `is_result`: its result goes to standard output."""

    words: str
    product: str = ""
    is_result: bool = False
    code: int = 0
    stdin: bytes = b""


USES = {
    "new": Use("new fresh", "fresh/README.md"),
    "examples": Use("examples minimal fresh", "fresh/walker.ant"),
    "check": Use("check scene.yaml --format json", is_result=True),
    "fmt": Use("fmt -", is_result=True, stdin=b"ant 1\nspecies  moth { state rest { } }\n"),
    "run": Use("run scene.yaml --frames 1..3 --out ran --profile", "ran/frames/frame.0003.npz"),
    "preview": Use(f"preview scene.yaml --no-open --port {PORT}"),
    "test": Use("test scene.yaml --json tested.json --no-keep", "tested.json"),
    "sweep": Use("sweep scene.yaml --frames 1..2 --seeds 2 --out swept --no-plots", "swept/table.csv"),
    "fit": Use("fit scene.yaml --vary walker.pace=1mm/s..2mm/s --to none", code=1),
    "render": Use("render cache --width 64 --height 64 --out drawn", "drawn"),
    "edit": Use("edit cache --smooth orient:3 --out edited", "edited/frames/frame.0003.npz"),
    "export": Use("export cache --to points.csv", "points.csv"),
    "jobs": Use("jobs scene.yaml --to job.yaml", "job.yaml"),
    "info": Use("info cache --verify", is_result=True),
    "body": Use("body ant --json", is_result=True),
    "explain": Use("explain cache --agent 0 --frame 2", is_result=True),
    "graph": Use("graph walker.ant --out graph.svg", "graph.svg"),
    "plan": Use("plan walker.ant", is_result=True),
    "bench": Use("bench --list", is_result=True),
    "docs": Use("docs --to site", "site/docs/index.html", is_result=True),
    "doctor": Use("doctor", is_result=True),
    "lsp": Use("lsp", is_result=True, stdin=LSP),
    "mcp": Use("mcp --root .", is_result=True, stdin=MCP),
}
SAMPLE = (("run", "stdout", "closed"), ("run", "stderr", "full"), ("check", "stdout", "full"), ("graph", "stdout", "slow"))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project of 20 agents."""
    folder = tmp_path_factory.mktemp("streams") / "project"
    assert commands.run("new", str(folder), cwd=folder.parent).returncode == 0
    scene = folder / "scene.yaml"
    scene.write_text(scene.read_text().replace("count: 200", "count: 20"))
    program = folder / "walker.ant"
    text = program.read_text().replace("for 5 s", "for 0.1 s")
    program.write_text(text.replace("  always: motion.circling < 10 %\n", ""))  # which is known after 2 s
    return folder


@pytest.fixture(scope="module")
def project_with_cache(project: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with a cache of three frames."""
    folder = tmp_path_factory.mktemp("streams") / "project"
    shutil.copytree(project, folder)
    assert commands.run("run", "scene.yaml", "--frames", "1..3", "--out", "cache", cwd=folder).returncode == 0
    return folder


def test_every_command_has_an_entry() -> None:
    assert list(USES) == [command.name for command in COMMANDS]


@pytest.mark.parametrize(("name", "stream", "state"), SAMPLE)
def test_work_is_done_and_the_exit_code_is_right(project: Path, tmp_path: Path, name: str, stream: str, state: str) -> None:
    demand_work(project, tmp_path, name, stream, state)


@pytest.mark.slow
@pytest.mark.parametrize("state", STATES)
@pytest.mark.parametrize("stream", STREAMS)
@pytest.mark.parametrize("name", USES)
def test_work_of_each_command_is_done(project_with_cache: Path, tmp_path: Path, name: str, stream: str, state: str) -> None:
    demand_work(project_with_cache, tmp_path, name, stream, state)


def demand_work(project: Path, tmp_path: Path, name: str, stream: str, state: str) -> None:
    use = USES[name]
    folder = tmp_path / "project"
    shutil.copytree(project, folder)
    words = [word.replace(PORT, str(free_port())) for word in use.words.split()]
    process, drain = start(words, folder, use, stream, state)
    if name == "preview":
        end_preview(process, int(words[-1]))
    if state == "slow" and not use.is_result and use.product:
        wait_for(lambda: (folder / use.product).exists(), process)
    other = drain()
    code = process.wait(timeout=300)
    expected = 3 if use.is_result and (stream, state) == ("stdout", "full") else use.code
    assert code == expected, other
    assert not use.product or (folder / use.product).exists()
    assert "Traceback" not in other and "Exception ignored" not in other, other
    assert "bug in antdsl" not in other
    if expected == 3:
        assert "error: cannot write to standard output: no space left on device" in other


def start(words: list[str], folder: Path, use: Use, stream: str, state: str) -> tuple[subprocess.Popen[bytes], Callable[[], str]]:
    """A command with one stream in a state, and what to call to read its other stream to the end."""
    number = 1 + STREAMS.index(stream)
    log = folder / "other.log"
    ends: list[int] = []
    if state == "full":
        target = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, target = os.pipe()
        ends.append(reader)
        if state == "broken":
            os.close(ends.pop())
        elif state == "slow":
            fill(target)
    with log.open("wb") as other, (folder / "stdin").open("wb") as stdin_file:
        stdin_file.write(use.stdin)
        stdin_file.flush()
        with (folder / "stdin").open("rb") as stdin:
            outputs = (target, other) if number == 1 else (other, target)
            command = [sys.executable, "-m", "antdsl", *words]
            if state == "closed":
                command = ["sh", "-c", f'exec "$@" {number}>&-', "sh", *command]
            process = subprocess.Popen(
                command,
                cwd=folder,
                stdin=stdin,
                stdout=outputs[0],
                stderr=outputs[1],
                env=child_environment(NO_COLOR="1"),
                preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # a background job may ignore Ctrl-C
            )
    os.close(target)
    if state == "closed":
        os.close(ends.pop())

    def drain() -> str:
        if ends:
            reader = threading.Thread(target=read_slowly, args=(ends[0],))
            reader.start()
            process.wait(timeout=300)
            reader.join(300)
        else:
            process.wait(timeout=300)
        return log.read_text(encoding="utf-8", errors="replace")

    return process, drain


def fill(target: int) -> None:
    """Fill a pipe, so that the next write to it blocks."""
    os.set_blocking(target, False)
    with pytest.raises(BlockingIOError):
        while True:
            os.write(target, b"." * 512)
    os.set_blocking(target, True)


def read_slowly(reader: int) -> None:
    while os.read(reader, 512):
        time.sleep(0)
    os.close(reader)


def end_preview(process: subprocess.Popen[bytes], port: int) -> None:
    """Press Ctrl-C once the server answers."""

    def has_answer() -> bool:
        try:
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=60) as answer:
                return bool(answer.read())
        except OSError as problem:
            return isinstance(problem, urllib.error.HTTPError)

    wait_for(has_answer, process)
    process.send_signal(signal.SIGINT)


def wait_for(condition: Callable[[], bool], process: subprocess.Popen[bytes]) -> None:
    until = time.monotonic() + 300
    while not condition():
        assert process.poll() is None or condition(), "the command ended without its product"
        assert time.monotonic() < until, "the command waits for its reader before its work is done"
        time.sleep(0.05)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Failing(io.RawIOBase):
    """A raw stream with writes that fail, each with the next of some error numbers; None writes 3 bytes."""

    def __init__(self, *errors: int | None) -> None:
        self.errors = list(errors)
        self.written = b""

    def write(self, data: object) -> int | None:
        error = self.errors.pop(0) if self.errors else None
        if error == errno.EAGAIN:
            return None
        if error is not None:
            raise OSError(error, os.strerror(error))
        self.written += bytes(data)[:3]  # type: ignore[call-overload]
        return min(3, len(data))  # type: ignore[arg-type]

    def fileno(self) -> int:
        return os.open(os.devnull, os.O_WRONLY)


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EDQUOT, errno.EFBIG])
def test_lost_results_change_the_exit_code_and_lost_notes_do_not(error: int) -> None:
    terminal = TerminalWriter(Failing(None, error))
    assert terminal.write(b"result\n") == 7
    assert terminal.loss_reason is not None and terminal.loss_reason.errno == error
    terminal = TerminalWriter(Failing(error))
    terminal.is_note = True
    assert terminal.write(b"note\n") == 5 and terminal.loss_reason is None


@pytest.mark.parametrize("error", [errno.EPIPE, errno.EBADF, errno.EIO])
def test_closed_streams_get_no_more_writes(error: int) -> None:
    raw = Failing(None, error)
    terminal = TerminalWriter(raw)
    terminal.write(b"result\n")
    terminal.write(b"more\n")
    assert raw.written == b"res" and terminal.loss_reason is None


def test_nonblocking_streams_get_all_output() -> None:
    raw = Failing(errno.EAGAIN, None, errno.EAGAIN, errno.EAGAIN)
    TerminalWriter(raw).write(b"result\n")
    assert raw.written == b"result\n"


def test_notes_do_not_wait_for_a_slow_reader(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, target = os.pipe()
    fcntl.fcntl(target, fcntl.F_SETPIPE_SZ, 4096)
    fill(target)
    with open(target, "wb", buffering=0) as raw:
        terminal = TerminalWriter(raw)
        stream = io.TextIOWrapper(io.BufferedWriter(terminal), "ascii", "backslashreplace")
        monkeypatch.setattr(sys, "stdout", stream)
        for number in range(200):
            print_note(f"frame {number} of 200, é and \udcff")
        with treat_output_as_notes():
            stream.write("the end\n")
        assert len(terminal.backlog) > 5000
        received = bytearray(os.read(reader, 4096))
        thread = threading.Thread(target=terminal.flush_backlog)
        thread.start()
        while not received.endswith(b"the end\n"):
            received += os.read(reader, 512)
        thread.join()
    os.close(reader)
    lines = received.lstrip(b".").decode().splitlines()
    assert lines == [rf"frame {number} of 200, \xe9 and \udcff" for number in range(200)] + ["the end"]


def test_standard_input_that_does_not_block_is_waited_for(tmp_path: Path) -> None:
    read_end, write_end = os.pipe()
    os.set_blocking(read_end, False)
    words = [sys.executable, "-P", "-m", "antdsl", "fmt", "-"]
    process = subprocess.Popen(words, cwd=tmp_path, env=child_environment(), stdin=read_end, stdout=subprocess.PIPE)
    os.close(read_end)
    with os.fdopen(write_end, "wb") as sending:
        time.sleep(0.2)  # whether it reads before or after what comes now changes nothing
        sending.write(b"ant 1\nspecies  moth { state rest { } }\n")
    assert process.communicate()[0].startswith(b"ant 1\n") and process.returncode == 0


def test_a_working_directory_that_was_removed_is_named(tmp_path: Path) -> None:
    code = "import os, sys; os.mkdir('gone'); os.chdir('gone'); os.rmdir('../gone'); os.execv(sys.executable, sys.argv[1:])"
    words = [sys.executable, "-P", "-c", code, sys.executable, "-m", "antdsl", "check", str(tmp_path / "absent.ant")]
    result = subprocess.run(words, cwd=tmp_path, env=child_environment(), capture_output=True, text=True)
    assert result.returncode == 3 and "Traceback" not in result.stderr, result.stderr
    assert "working directory was removed" in result.stderr or "absent.ant" in result.stdout
