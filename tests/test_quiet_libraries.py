"""What libraries have to say to programmers does not reach the terminal, and `doctor` knows every extra."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from antdsl.cli.doctor import EXTRAS

ROOT = Path(__file__).resolve().parent.parent
FOR_DEVELOPERS = {"test", "quality"}
LOUD = "import warnings\nwarnings.warn('a library warns', DeprecationWarning, stacklevel=1)\nwarnings.warn('and again')\n"


@pytest.mark.parametrize(("flags", "heard"), [((), False), (("-W", "default"), True)])
def test_warnings_of_libraries_do_not_reach_the_terminal(tmp_path: Path, flags: tuple[str, ...], heard: bool) -> None:
    """A library that warns when it is imported: `antdsl graph` imports graphlay."""
    (tmp_path / "graphlay.py").write_text(LOUD + "raise ImportError('none')\n", encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), str(ROOT)])}
    environment.pop("PYTHONWARNINGS", None)
    program = ROOT / "examples" / "minimal" / "walker.ant"
    done = subprocess.run(
        [sys.executable, *flags, "-m", "antdsl", "graph", str(program), "--format", "svg", "--out", "-"],
        env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert "missing-extra" in done.stderr  # it was imported
    assert ("and again" in done.stderr) == heard


def test_doctor_lists_every_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    told = {found for words in EXTRAS.values() for found in re.findall(r"antdsl\[(\w+)\]", words)}
    assert told == set(extras) - FOR_DEVELOPERS
