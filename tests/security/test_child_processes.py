"""Search paths of this process and of children never name the working directory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from antdsl import child_processes

TRAP = "open('TRAPPED', 'a').write(__name__ + '\\n')\nraise ImportError(__name__)\n"
SHOW = """
import os, sys
from antdsl.child_processes import isolate_search_paths
isolate_search_paths()
isolate_search_paths()
import json
print(json.dumps([sys.path, dict(os.environ)]))
"""


def isolated(cwd: Path, *flags: str, **variables: str) -> tuple[list[str], dict[str, str]]:
    """The search path and the environment of a new Python that has isolated itself."""
    env = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "PYTHONSAFEPATH")}
    process = subprocess.run([sys.executable, *flags, "-c", SHOW], cwd=cwd, env=env | variables, capture_output=True, check=True)
    path, environment = json.loads(process.stdout)
    return path, environment


def test_relative_entries_go_and_absolute_ones_stay(tmp_path: Path) -> None:
    for name in ("studio", "relative"):
        (tmp_path / name).mkdir()
    studio = str(tmp_path / "studio")
    path, env = isolated(tmp_path, PYTHONPATH=f":{studio}:relative::.", PATH=f".:/bin:{os.environ['PATH']}:", LD_LIBRARY_PATH=":")
    assert studio in path and str(tmp_path) not in path and str(tmp_path / "relative") not in path and "" not in path
    assert env["PYTHONPATH"] == studio and env["PYTHONSAFEPATH"] == "1" and "LD_LIBRARY_PATH" not in env
    assert all(os.path.isabs(entry) for entry in env["PATH"].split(":"))


def test_a_folder_that_is_named_in_full_stays_though_it_is_the_working_directory(tmp_path: Path) -> None:
    path, env = isolated(tmp_path, PYTHONPATH=f"{tmp_path}:.")
    assert str(tmp_path) in path and env["PYTHONPATH"] == str(tmp_path)


def test_an_installation_that_is_no_longer_found_comes_last(monkeypatch: pytest.MonkeyPatch) -> None:
    """A checkout that was started with `python -m antdsl` in it: its other modules must hide none of the standard library."""
    own = child_processes.INSTALLATION_FOLDER
    monkeypatch.setattr(sys, "path", ["", "relative", *(entry for entry in sys.path if entry != own)])
    monkeypatch.setattr(os, "environ", dict(os.environ))
    child_processes.isolate_search_paths()
    assert sys.path[-1] == own and sys.path.count(own) == 1 and "" not in sys.path and "relative" not in sys.path


def test_a_module_of_ours_starts_without_the_working_directory(tmp_path: Path) -> None:
    for name in ("json", "antdsl", "typing", "runpy", "__future__"):
        (tmp_path / f"{name}.py").write_text(TRAP, encoding="utf-8")
    command = child_processes.build_module_command("antdsl.bench", "{}")
    process = subprocess.run(
        command, cwd=tmp_path, env=child_processes.build_module_environment(), capture_output=True, text=True
    )
    assert "ValidationError" in process.stderr  # the job is none
    assert not (tmp_path / "TRAPPED").exists()


@pytest.mark.parametrize("flags", [(), ("-E",), ("-I",), ("-P",)])
def test_children_of_the_command_have_a_safe_path(flags: tuple[str, ...], tmp_path: Path) -> None:
    """By the environment, or by flags where Python ignores the environment."""
    code = (
        "import sys, antdsl.cli as cli\n"
        "cli._run_without_warnings = lambda: print(__import__('subprocess').run([sys.executable, "
        "*__import__('subprocess')._args_from_interpreter_flags(), '-c', 'import sys; print(sys.flags.safe_path, sys.path[0])'],"
        " capture_output=True, text=True).stdout) or 0\n"
        "cli.main()"
    )
    program = tmp_path / "started.py"
    program.write_text(code, encoding="utf-8")
    process = subprocess.run([sys.executable, *flags, str(program)], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert process.stdout.startswith("True ") and str(tmp_path) not in process.stdout


def test_the_package_imports_nothing_before_the_path_is_safe() -> None:
    """With `-m` the working directory is searched first until `__main__` has removed it."""
    code = "import sys; before = set(sys.modules); import antdsl; print(*sorted(set(sys.modules) - before))"
    process = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.split() == ["antdsl"]
