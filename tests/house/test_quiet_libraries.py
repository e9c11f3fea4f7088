"""What libraries have to say to programmers does not reach the terminal, and `doctor` knows every extra."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from children import child_environment

from antdsl.cli.commands.doctor import OPTIONAL_PACKAGES
from antdsl.cli.commands.run import choose_threads

ROOT = Path(__file__).resolve().parents[2]
FOR_DEVELOPERS = {"test", "quality"}
LOUD = "import warnings\nwarnings.warn('a library warns', DeprecationWarning, stacklevel=1)\nwarnings.warn('and again')\n"


@pytest.mark.parametrize(("flags", "heard"), [((), False), (("-W", "default"), True)])
def test_warnings_of_libraries_do_not_reach_the_terminal(tmp_path: Path, flags: tuple[str, ...], heard: bool) -> None:
    """A library that warns when it is imported: `antdsl graph` imports graphlay."""
    (tmp_path / "graphlay.py").write_text(LOUD + "raise ImportError('none')\n", encoding="utf-8")
    environment = child_environment(tmp_path)
    environment.pop("PYTHONWARNINGS", None)
    program = ROOT / "examples" / "minimal" / "walker.ant"
    result = subprocess.run(
        [sys.executable, *flags, "-m", "antdsl", "graph", str(program), "--format", "svg", "--out", "-"],
        env=environment, cwd=tmp_path, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert "missing-extra" in result.stderr  # it was imported
    assert ("and again" in result.stderr) == heard


def test_doctor_lists_every_extra() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    named_extras = {extra for words in OPTIONAL_PACKAGES.values() for extra in re.findall(r"antdsl\[(\w+)\]", words)}
    assert named_extras == set(extras) - FOR_DEVELOPERS


@pytest.mark.parametrize(
    ("cores", "requested", "taken", "message"),
    [(2, 4, 2, "may use 2 cores here"), (1, 4, 1, "may use 1 core here"), (2, 0, 2, ""), (2, 2, 2, ""), (8, 3, 3, "")],
)
def test_more_threads_than_cores_are_not_started_and_that_is_reported(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], cores: int, requested: int, taken: int, message: str
) -> None:
    """Embree's scheduler writes to the terminal if more workers are requested than there are cores."""
    monkeypatch.setattr("antdsl.cli.commands.run.count_available_cores", lambda: cores)
    assert choose_threads(requested) == taken
    said = capsys.readouterr().err
    assert message in said and bool(said) == bool(message)
    assert choose_threads(requested, quiet=True) == taken and not capsys.readouterr().err


def test_every_command_with_threads_takes_no_more_than_there_are_cores() -> None:
    """All go by `choose_threads`."""
    for path in sorted((ROOT / "antdsl" / "cli").rglob("*.py")):
        if '"--threads"' in (text := path.read_text(encoding="utf-8")):
            assert "choose_threads(threads" in text and "threads or cores" not in text, path.name
