"""The shell lines of the documents and of the examples' own pages are run, shots cut down to their first frames."""

from __future__ import annotations

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path

import commands
import pytest
from children import child_environment
from sampling import sampled

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "grammar" / "README.md",
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted(ROOT.glob("examples/*/README.md")),
]
# What is added to a line so that it takes seconds; the last value of an option overrides the first.
SHORTER = {
    "run": ["--frames", "1..3", "--quiet"],
    "sweep": ["--seeds", "1", "--frames", "1..2", "--no-plots"],
    "render": ["--width", "96", "--height", "54"],
}
# The first two commands set up environments: `.ci/run` runs them. The study's specs are runs of 5,000 frames:
# `test_foraging_study.py` runs them cut down. What asks a registry or an editor cannot be run everywhere; that the
# extension packs is tested where node is. `test_preview_command.py` starts previews, which do not end by themselves.
ELSEWHERE = re.compile(
    r"python3 -m antdsl\.bootstrap (example|test|test --quick|gate)|antdsl test forager\.ant"
    r"|antdsl preview .*|pip install .*|pre-commit install .*|npm install|npm run package|code --install-extension .*"
)


def shell_lines(page: Path) -> list[str]:
    blocks = re.findall(r"^```bash\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return [line.split(" #")[0].strip() for block in blocks for line in block.splitlines() if line.split("#")[0].strip()]


LINES = {page: lines for page in PAGES if (lines := shell_lines(page))}
# Each takes 16 s of CPU. Sweeps, films and scripts of other examples are in the sample.
LONG = {ROOT / "examples" / name / "README.md" for name in ("bridge", "foraging_study")}


@pytest.mark.parametrize("page", sampled(LINES, LINES.keys() - LONG), ids=lambda page: str(page.relative_to(ROOT)))
def test_shell_lines_run(page: Path, tmp_path: Path) -> None:
    for part in ("examples", "behaviours", "grammar"):
        (tmp_path / part).symlink_to(ROOT / part, target_is_directory=True)
    folder = tmp_path
    if any(line.startswith("antdsl render out/foraging") for line in LINES[page]):
        result = run(["antdsl", "run", "examples/foraging/scene.yaml", "--out", "out/foraging"], folder)
        assert result.returncode == 0, result.stderr
    for line in LINES[page]:
        words = shlex.split(line)
        if words[0] == "cd":
            folder = copied(folder / words[1], tmp_path / "work")
            continue
        if ELSEWHERE.fullmatch(line):
            continue
        result = run(words, folder)
        if "--film" in words and importlib.util.find_spec("imageio_ffmpeg") is None:
            assert "antdsl[video]" in result.stderr
            continue
        assert "Traceback" not in result.stderr
        # a script of an example may find that two frames do not show what the whole shot shows
        assert result.returncode == 0 or words[0] == "python", f"{line}\n{result.stdout[-1000:]}{result.stderr[-2000:]}"


def copied(folder: Path, to: Path) -> Path:
    """A separate folder, so that nothing is written among the examples."""
    to.mkdir()
    for file in folder.iterdir():
        if file.is_file():
            (to / file.name).write_bytes(file.read_bytes())
    return to


def run(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    assert words[0] in ("antdsl", "python"), f"{words[0]}: a line that no test can run"
    if words[0] == "antdsl":
        return commands.run(*words[1:], *SHORTER.get(words[1], []), cwd=folder)
    command = [sys.executable, *words[1:]]
    environment = child_environment(NO_COLOR="1")
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)
