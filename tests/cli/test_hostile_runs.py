"""Where commands run: folders full of what is no file, pipes without a reader, narrow terminals, other languages and clocks."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from cases.hostile.rows import PROJECT, SCENE
from children import child_environment
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, read_lines
from antdsl.preview import FileWatch

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(os.name == "nt", reason="no such files there")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name, data in PROJECT.items():
        (tmp_path / name).write_bytes(data)
    return tmp_path


def antdsl(folder: Path, *words: str, **env: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "antdsl", *words]
    return subprocess.run(command, cwd=folder, env=child_environment(**env), capture_output=True, text=True, timeout=300)


@posix
def test_r4_a_folder_of_what_is_no_file_is_checked(folder: Path) -> None:
    os.mkfifo(folder / "pipe.ant")
    os.mkfifo(folder / "pipe.yaml")  # its first line would say whether it is a scene
    (folder / "endless.yaml").symlink_to("/dev/zero")
    (folder / "loop").symlink_to(folder)
    (folder / "itself.ant").symlink_to("itself.ant")
    (folder / "folder.ant").mkdir()
    (folder / ".git").mkdir()
    (folder / ".git" / "bad.ant").write_text("no program")
    many = folder / "many"
    many.mkdir()
    for number in range(2000):
        (many / f"notes{number}.yaml").write_text("notes: 1\n")
    result = antdsl(folder, "check", ".")
    output = result.stdout + result.stderr
    assert result.returncode in (1, 3) and "Traceback" not in output, output
    assert "pipe.ant` is not a regular file" in output and "itself.ant" in output
    assert "no program" not in output and "notes" not in output


def test_r2_a_storm_of_changes_is_reported_once(folder: Path) -> None:
    """As of a checkout: five hundred files at once."""
    files = [folder / f"part{number}.ant" for number in range(500)]
    for each in files:
        each.write_text("one")
    now = [0.0]
    watch = FileWatch(lambda: files, clock=lambda: now[0])
    for each in files:
        each.write_text("two, longer")
    reports = []
    for _ in range(40):
        now[0] += 0.01
        reports += [changes] if (changes := watch.find_changed_files()) else []
    assert len(reports) == 1 and set(reports[0]) == set(files)


@posix
def test_r5_a_reader_that_stops_ends_a_command_without_a_traceback(folder: Path) -> None:
    (folder / "bad.ant").write_text("ant 1\n" + "".join(f"species a{k} {{ x{k} }}\n" for k in range(400)))
    command = f"{sys.executable} -m antdsl check bad.ant | head -1; exit ${{PIPESTATUS[0]}}"
    env = child_environment()
    result = subprocess.run(["bash", "-c", command], cwd=folder, env=env, capture_output=True, text=True, timeout=300)
    assert "Traceback" not in result.stderr and result.returncode in (0, 1, 141)
    assert len(result.stdout.splitlines()) == 1


def test_r5_words_fit_a_terminal_that_knows_ascii_alone_and_is_narrow(folder: Path) -> None:
    (folder / "walker.ant").write_text(PROJECT["walker.ant"].decode().replace("wander", "wandr"))
    result = antdsl(folder, "check", "walker.ant", PYTHONIOENCODING="ascii", COLUMNS="20", NO_COLOR="1", TERM="dumb")
    assert result.returncode == 1 and "wandr" in result.stdout + result.stderr
    assert "Traceback" not in result.stderr and (result.stdout + result.stderr).isascii()


def test_r6_language_clock_and_hash_seed_change_no_bit(folder: Path) -> None:
    hashes = []
    abroad = {"PYTHONHASHSEED": "77", "LC_ALL": "tr_TR.UTF-8", "LANG": "de_DE", "TZ": "Asia/Kathmandu"}
    for number, env in enumerate(({}, abroad)):
        result = antdsl(folder, "run", "scene.yaml", "--out", f"out{number}", "--threads", str(number + 1), **env)
        assert result.returncode == 0, result.stderr
        hashes.append(read_lines(folder / f"out{number}" / HASHES_FILE_NAME))
    assert len(hashes[0]) == 6 and hashes[0] == hashes[1]


def test_r7_a_value_that_is_wrong_everywhere_is_reported_once(folder: Path) -> None:
    (folder / "scene.yaml").write_bytes(SCENE.replace(b"count: 20", b"count: 500"))
    program = PROJECT["walker.ant"].decode().replace("start stroll", "n = 0\n  start stroll")
    program = program.replace("{ steer wander(swing: 40 deg) }", "{\n    n = 1 / n\n    steer wander(swing: 40 deg)\n  }")
    (folder / "walker.ant").write_text(program)
    result = CliRunner().invoke(app, ["run", str(folder / "scene.yaml"), "--on-fault", "quarantine"])
    assert result.exit_code == 0, result.output
    assert result.output.count("500 faults") == 1 and len(result.output.splitlines()) < 20
