"""Commands under strace: which files they open, which programs they start, which sockets they bind."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

CHANGES = [
    "rename",
    "renameat",
    "renameat2",
    "mkdir",
    "mkdirat",
    "rmdir",
    "unlink",
    "unlinkat",
    "symlink",
    "symlinkat",
    "link",
    "linkat",
    "truncate",
]
CALLS = ",".join(["execve,execveat,open,openat,openat2,creat,bind,listen,connect", *CHANGES])
_STARTED = re.compile(r"^(\d+)\s+(\w+)\((.*)$")
_RESUMED = re.compile(r"^(\d+)\s+<\.\.\. (\w+) resumed>(.*)$")
_UNFINISHED = " <unfinished ...>"
_PATH = re.compile(r'(?:(?:AT_FDCWD|\d+)<([^>]*)>, )?"([^"]*)"')
_RESULT = re.compile(r"\) += (-?\d+)(?:<([^>]*)>)?")
_ESCAPE = re.compile(rb"\\x([0-9a-f]{2})")


@dataclass(frozen=True, slots=True)
class Opened:
    """A file that was opened, or in vain: the name as an absolute path, and the file that it led to. `writes`: not only for
    reading."""

    name: str
    file: str | None
    writes: bool
    folder: bool


@dataclass(slots=True)
class Trace:
    """What a command did, and how it ended."""

    code: int
    output: str
    opened: list[Opened] = field(default_factory=list)
    changed: list[str] = field(default_factory=list)  # paths that were made, moved or removed
    programs: list[str] = field(default_factory=list)
    sockets: list[str] = field(default_factory=list)


def traced(
    command: Sequence[str],
    cwd: Path,
    env: Mapping[str, str],
    log: Path,
    *,
    stdin: bytes = b"",
    until: str = "",
    limit: float = 900,
) -> Trace:
    """Run a command to its end under strace; or, with `until`, to the line that has these words, and end it by SIGINT then.
    RuntimeError where nothing can be traced here: no test may pass for that."""
    strace = shutil.which("strace")
    if strace is None:
        raise RuntimeError("strace is missing: `python3 -m antdsl.bootstrap test` installs it; on Debian: apt-get install strace")
    tracer = [
        strace,
        "-f",
        "--seccomp-bpf",
        "-y",
        "-xx",
        "-s",
        "4096",
        "-e",
        f"trace={CALLS}",
        "-e",
        "signal=none",
        "-o",
        str(log),
    ]
    printed = log.with_suffix(".printed")
    with printed.open("wb") as output:
        process = subprocess.Popen(
            [*tracer, *command], cwd=cwd, env=dict(env), stdin=subprocess.PIPE, stdout=output, stderr=subprocess.STDOUT,
            process_group=0,
        )  # fmt: skip
        assert process.stdin is not None
        try:
            process.stdin.write(stdin)
            process.stdin.close()
        except BrokenPipeError:
            pass
        if until:
            _wait_for(until, printed, process, limit)
            _interrupt(log)
        try:
            code = process.wait(limit)
        finally:
            if process.poll() is None:
                process.kill()
    text = printed.read_text(encoding="utf-8", errors="replace")
    trace = read_trace(log.read_text(encoding="utf-8", errors="replace"), Trace(code, text), cwd)
    if not trace.programs:
        raise RuntimeError(f"strace could not trace here, so nothing is known of what the command did:\n{text}")
    return trace


def _wait_for(words: str, printed: Path, process: subprocess.Popen[bytes], limit: float) -> None:
    end = time.monotonic() + limit
    while process.poll() is None and words not in printed.read_text(encoding="utf-8", errors="replace"):
        if time.monotonic() > end:
            process.kill()
            raise TimeoutError(printed.read_text(encoding="utf-8", errors="replace"))
        time.sleep(0.05)


def _interrupt(log: Path) -> None:
    """Send SIGINT to the first process that was traced: strace itself passes none on."""
    first = log.read_text(encoding="utf-8", errors="replace").split(maxsplit=1)[0]
    os.kill(int(first), signal.SIGINT)


def read_trace(text: str, trace: Trace, cwd: Path) -> Trace:
    """Fill a trace from what strace wrote of a command that was started in `cwd`."""
    waiting: dict[str, str] = {}
    for line in text.splitlines():
        if (resumed := _RESUMED.match(line)) and (first_part := waiting.pop(resumed[1] + resumed[2], None)) is not None:
            line = first_part + resumed[3]
        if not (call := _STARTED.match(line)):
            continue
        if line.endswith(_UNFINISHED):
            waiting[call[1] + call[2]] = line.removesuffix(_UNFINISHED)
            continue
        _add(trace, call[2], call[3], cwd)
    for line in waiting.values():  # a call during which the process ended
        if call := _STARTED.match(line):
            _add(trace, call[2], call[3], cwd)
    return trace


def _add(trace: Trace, name: str, rest: str, cwd: Path) -> None:
    if name in ("bind", "listen", "connect"):
        trace.sockets.append(f"{name} {_decoded(rest)}")
        return
    paths = [str(Path(_decoded(folder) or cwd) / _decoded(name)) for folder, name in _PATH.findall(rest)]
    result = _RESULT.search(rest)
    has_succeeded = result is not None and int(result[1]) >= 0
    if name in ("execve", "execveat"):
        trace.programs.append(_decoded(_PATH.findall(rest)[0][1]))
    elif name in CHANGES and has_succeeded:
        trace.changed += paths[-1:] if name.startswith("symlink") else paths
    elif name not in CHANGES:
        file = _decoded(result[2]) if has_succeeded and result is not None and result[2] else None
        flags = rest.rsplit('"', 1)[-1]
        writes = name == "creat" or any(flag in flags for flag in ("O_WRONLY", "O_RDWR", "O_CREAT", "O_TRUNC"))
        trace.opened.append(Opened(paths[0], file, writes, "O_DIRECTORY" in flags or "O_PATH" in flags))


def _decoded(text: str) -> str:
    """The bytes that strace wrote as hexadecimal numbers, so that nothing in a name is mistaken for its own marks."""
    data = text.encode("utf-8", "surrogateescape")
    return _ESCAPE.sub(lambda match: bytes([int(match[1], 16)]), data).decode("utf-8", "replace")
