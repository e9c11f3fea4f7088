"""Has USD files opened by another process first, which they may bring down."""

from __future__ import annotations

import atexit
import json
import os
import subprocess
import sys
from functools import cache
from pathlib import Path
from threading import Lock

_PROGRAM = Path(__file__).with_name("trial.py")
CPU = 15  # seconds that it may take for one question, and some more for large files
_lock = Lock()


class _Other:
    """The other process; a new one where the last has ended, and one for each process that was forked from this one."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[bytes] | None = None
        self.of = 0

    def ask(self, question: list[str]) -> str:
        process = self.running()
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(json.dumps(question).encode() + b"\n")
            process.stdin.flush()
            answer = process.stdout.readline()
        except BrokenPipeError:
            answer = b""
        if answer:
            return str(json.loads(answer))
        code = process.wait()
        self.end()
        return _why(code)

    def running(self) -> subprocess.Popen[bytes]:
        if self.process is None or self.of != os.getpid():
            command = [sys.executable, "-I", str(_PROGRAM), json.dumps(sys.path), str(CPU)]
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
            self.of = os.getpid()
            atexit.register(self.end)
        return self.process

    def end(self) -> None:
        if self.process is not None and self.of == os.getpid():
            for pipe in (self.process.stdin, self.process.stdout):
                assert pipe is not None
                pipe.close()
            self.process.kill()
            self.process.wait()
        self.process = None


_other = _Other()


@cache
def what_is_wrong(digest: str, *question: str) -> str:
    """Why a file is not to be opened here, empty where nothing is wrong. `digest`: of all bytes that are meant, for which the
    answer is known from then on."""
    del digest
    with _lock:
        try:
            return _other.ask(list(question))
        except OSError:  # no process may be made here
            return ""


def _why(code: int) -> str:
    import signal

    if code == -getattr(signal, "SIGXCPU", 0):
        return "it takes too long to be read"
    return "it brings down USD's own code, as files do that are damaged or nested without end"
