"""`antdsl`, or a script, in a separate process that is forked from one which has imported everything: signals and ports for the
price of a fork. How a process starts is tested with `subprocess`."""

from __future__ import annotations

import os
import runpy
import sys
import tempfile
from multiprocessing import get_context
from pathlib import Path

IMPORTED = ("open3d", "llvmlite.binding", "antdsl.cli.commands.preview", "antdsl.preview.live", "antdsl.preview.serving.server")
_context = get_context("forkserver")
_context.set_forkserver_preload(list(IMPORTED))


class Forked:
    """`antdsl words…`, or a script of Python with `words`, running. What it prints goes into a file, as `text` has it."""

    def __init__(self, *words: str, cwd: Path, script: Path | None = None) -> None:
        handle, name = tempfile.mkstemp(prefix="antdsl.printed.")
        os.close(handle)
        self._printed = Path(name)
        self._process = _context.Process(target=_run, args=(words, str(cwd), dict(os.environ), name, script))
        self._process.start()

    @property
    def text(self) -> str:
        return self._printed.read_text(encoding="utf-8")

    @property
    def over(self) -> bool:
        return not self._process.is_alive()

    def signal(self, number: int) -> None:
        assert self._process.pid is not None
        if not self.over:
            os.kill(self._process.pid, number)

    def ended(self, seconds: float) -> tuple[int, str]:
        """Its exit code and all that it printed, once it has ended normally. TimeoutError if it does not; it is killed then."""
        self._process.join(seconds)
        late = self._process.exitcode is None
        if late:
            self._process.kill()
            self._process.join()
        code, text = self._process.exitcode, self.text
        self._printed.unlink()
        if late or code is None:
            raise TimeoutError(text)
        return code, text


def _run(words: tuple[str, ...], cwd: str, env: dict[str, str], printed: str, script: Path | None) -> None:
    os.chdir(cwd)
    os.environ.clear()
    os.environ.update(env)  # as it is now where the test runs, not as it was when all was imported
    handle = os.open(printed, os.O_WRONLY | os.O_APPEND)
    for number in (1, 2):
        os.dup2(handle, number)
    sys.stdout.reconfigure(encoding="utf-8", line_buffering=True)
    sys.argv = ["antdsl" if script is None else str(script), *words]
    if script is not None:
        runpy.run_path(str(script), run_name="__main__")
        return
    from antdsl.cli import main  # after standard output is led away

    main()
