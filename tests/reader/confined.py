"""A program that confines itself as the reader does, then tries what it must not be able to do: `confined.py FOLDER FILE PORT`.

It prints a JSON object: what confines it, and for each attempt `refused` or what happened."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from antdsl.reader import confinement, sandbox


def main() -> None:
    folder, outside, port, parent = sys.argv[1], sys.argv[2], int(sys.argv[3]), os.getppid()
    null_descriptor = os.open(os.devnull, os.O_WRONLY)
    active = sandbox.confine_process([*confinement.list_readable_folders(), folder])
    attempts: dict[str, Callable[[], object]] = {
        "read inside": lambda: Path(os.path.join(folder, "inside")).read_bytes(),
        "read outside": lambda: Path(outside).read_bytes(),
        "read through a link": lambda: Path(os.path.join(folder, "link")).read_bytes(),
        "list outside": lambda: os.listdir(os.path.dirname(outside)),
        "read the password file": lambda: Path("/etc/passwd").read_bytes(),
        "write inside": lambda: Path(folder, "new").write_bytes(b"x"),
        "append inside": lambda: os.open(os.path.join(folder, "inside"), os.O_WRONLY | os.O_APPEND),
        "write an open file": lambda: os.open(outside, os.O_RDWR),
        "remove": lambda: os.unlink(os.path.join(folder, "inside")),
        "rename": lambda: os.rename(os.path.join(folder, "inside"), os.path.join(folder, "other")),
        "make a folder": lambda: os.mkdir(os.path.join(folder, "folder")),
        "link": lambda: os.symlink(outside, os.path.join(folder, "second")),
        "change a mode": lambda: os.chmod(os.path.join(folder, "inside"), 0o777),
        "connect": lambda: socket.create_connection(("127.0.0.1", port), 1),
        "bind": lambda: socket.socket().bind(("127.0.0.1", 0)),
        "unix socket": lambda: socket.socketpair(),
        "start a program": lambda: subprocess.run([sys.executable, "-V"], check=False),
        "exec": lambda: os.execv(sys.executable, [sys.executable, "-V"]),
        "fork": lambda: os.fork() or os._exit(0),
        "signal the parent": lambda: os.kill(parent, signal.SIGUSR1),
        "trace": lambda: _call(ctypes.CDLL(None, use_errno=True).ptrace, 16, parent, 0, 0),
        "make memory a file": lambda: os.memfd_create("x") if hasattr(os, "memfd_create") else _missing(),
        "lift the limits": lambda: _lift(),
        "a thread": lambda: _thread(),
    }
    print(json.dumps({"active": active, **{name: _outcome(attempt) for name, attempt in attempts.items()}}))
    os.close(null_descriptor)


def _outcome(attempt: Callable[[], object]) -> str:
    try:
        attempt()
    except (OSError, ValueError) as problem:
        return f"refused: {type(problem).__name__}"
    return "done"


def _call(function: Callable[..., int], *arguments: int) -> None:
    if function(*arguments) < 0:
        raise OSError(ctypes.get_errno(), "refused")


def _missing() -> None:
    raise OSError("not on this system")


def _lift() -> None:
    import resource

    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))
    if os.getuid() == 0:
        raise OSError("root may raise a limit; seccomp still refuses to open a file to write")


def _thread() -> None:
    import threading

    thread = threading.Thread(target=lambda: None)
    thread.start()
    thread.join()


if __name__ == "__main__":
    main()
