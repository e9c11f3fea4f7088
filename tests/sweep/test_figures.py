"""Figures are drawn with matplotlib's own defaults: no settings file of a project is opened, and no program started."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment

pytest.importorskip("matplotlib")

_DRAW = """
import json, os, sys
from pathlib import Path
from antdsl.sweeps.figures import open_figure

opened, started = [], []

def note(event, arguments):
    if event == "open" and isinstance(arguments[0], str):
        opened.append(os.path.realpath(arguments[0]))
    if event in ("subprocess.Popen", "os.posix_spawn", "os.exec", "os.system"):
        started.append(repr(arguments[0]))

sys.addaudithook(note)
before = dict(os.environ), os.getcwd()
for name in ("one.png", "two.png"):
    with open_figure(2.0, 1.0, Path(sys.argv[1]) / name) as drawn:
        drawn.subplots(1, 1).set_title("$x$")
assert (dict(os.environ), os.getcwd()) == before
print(json.dumps([opened, started]))
"""


def test_no_settings_of_a_project_are_read_and_no_program_is_started(tmp_path: Path) -> None:
    """In the working directory, and where variables lead to one below it."""
    project, out = tmp_path / "project", tmp_path / "out"
    out.mkdir()
    for folder in (project, project / ".config" / "matplotlib", project / ".matplotlib", project / "settings"):
        folder.mkdir(parents=True)
        (folder / "matplotlibrc").write_text("text.usetex: True\nsavefig.dpi: 7\n")
        (folder / "stylelib").mkdir()
        (folder / "stylelib" / "classic.mplstyle").write_text("text.usetex: True\n")
    for program in ("latex", "fc-list"):
        (project / program).write_text("#!/bin/sh\nexit 3\n")
        (project / program).chmod(0o755)
    env = child_environment() | {
        "HOME": str(project),
        "XDG_CONFIG_HOME": str(project / ".config"),
        "XDG_CACHE_HOME": str(project / "cache"),
        "MATPLOTLIBRC": "settings",
        "MPLCONFIGDIR": "settings",
        "MPLBACKEND": "module://nothing",
    }
    env["PATH"] = os.pathsep.join([str(project), env.get("PATH", "")])
    process = subprocess.run(
        [sys.executable, "-P", "-c", _DRAW, str(out)], cwd=project, env=env, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr
    opened, started = json.loads(process.stdout)
    assert opened and not [each for each in opened if Path(each).is_relative_to(project.resolve())]
    assert started == []
    assert (out / "one.png").read_bytes() == (out / "two.png").read_bytes() != b""
    assert not (project / "cache").exists()


def test_settings_of_a_host_change_nothing_and_stay(tmp_path: Path) -> None:
    from antdsl.sweeps.figures import open_figure

    def draw(name: str) -> bytes:
        with open_figure(2.0, 1.0, tmp_path / name) as drawn:
            drawn.subplots(1, 1).plot([1, 2], [3, 1])
        return (tmp_path / name).read_bytes()

    plain = draw("plain.png")
    import matplotlib

    with matplotlib.rc_context({"lines.linewidth": 9.0, "text.usetex": True, "axes.facecolor": "red"}):
        assert draw("host.png") == plain
        assert matplotlib.rcParams["text.usetex"] and matplotlib.rcParams["lines.linewidth"] == 9.0


def test_where_nothing_can_be_written_is_an_error_and_draws_nothing(tmp_path: Path) -> None:
    from antdsl.sweeps.figures import open_figure

    with pytest.raises(OSError), open_figure(2.0, 1.0, tmp_path / "missing" / "plot.png"):
        pass
    assert not list(tmp_path.iterdir())
