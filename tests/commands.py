"""Commands of antdsl as a shell runs them, in this process: what they print and their exit code. Starting one costs nothing here;
what only a separate process can show (signals, closed pipes, encodings, start-up) is tested with `subprocess`."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, chdir, contextmanager
from pathlib import Path
from subprocess import CompletedProcess
from unittest.mock import patch

from antdsl.cli import _run_without_warnings


def run(*words: str, cwd: Path, env: Mapping[str, str] | None = None) -> CompletedProcess[str]:
    """`antdsl words…` in a folder, with more variables of the environment, and without colours."""
    with tempfile.TemporaryDirectory() as place, ExitStack() as stack:
        files = [Path(place) / name for name in ("out", "err")]
        stack.enter_context(chdir(cwd))
        stack.enter_context(patch.dict(os.environ, {"NO_COLOR": "1", **(env or {})}))
        stack.enter_context(patch.object(sys, "argv", ["antdsl", *words]))
        for number, file in zip((1, 2), files, strict=True):
            stack.enter_context(_redirect(number, file))
        code = _run_without_warnings()
        stack.close()
        return CompletedProcess(["antdsl", *words], code, *(file.read_text(encoding="utf-8") for file in files))


@contextmanager
def _redirect(number: int, file: Path) -> Iterator[None]:
    """Lead what is written to standard output or error into a file, whether Python or a library or a child writes it."""
    stream = "stdout" if number == 1 else "stderr"
    original = os.dup(number)
    try:
        with file.open("w", encoding="utf-8") as output, patch.object(sys, stream, output):
            os.dup2(output.fileno(), number)
            yield
    finally:
        os.dup2(original, number)
        os.close(original)
