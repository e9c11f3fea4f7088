"""The command line: help, version, completion, programs from standard input, folders that results create."""

from __future__ import annotations

import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment
from typer.testing import CliRunner

from antdsl import __version__
from antdsl.cli import COMMANDS, app
from antdsl.cli.exits import CommandError

PROGRAM = 'ant 1\nuse "./mine.ant" as mine\nspecies a { state s { steer mine.go() } }\n'


def run(*words: str, text: str | None = None) -> tuple[int, str]:
    result = CliRunner().invoke(app, list(words), input=text)
    if isinstance(result.exception, CommandError):
        return result.exception.code, f"{result.output}{result.exception.message}"
    return result.exit_code, result.output


def test_help_lists_each_command_once_and_cuts_no_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    code, text = run("--help")
    assert code == 0 and "..." not in text.replace("[ARGS]...", "") and "…" not in text
    for command in COMMANDS:
        assert text.count(f"\n  {command.name} ") == 1 and text.count(f"\n{command.heading}:\n") == 1


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.name)
def test_help_of_a_command_ends_with_an_example_of_flags_that_exist(command: object) -> None:
    name, example = command.name, command.example  # type: ignore[attr-defined]
    code, text = run(name, "--help")
    assert code == 0 and " ".join(text.split()).endswith(f"Example: {example}")
    words = shlex.split(example)
    assert words[:2] == ["antdsl", name]
    assert {word for word in words if word.startswith("--")} <= set(re.findall(r"--[a-z-]+", text.rpartition("Example:")[0]))


@pytest.mark.parametrize("flag", ["-V", "--version"])
def test_the_version_is_printed(flag: str) -> None:
    assert run(flag) == (0, f"antdsl {__version__}\n")


def test_a_shell_completes_the_names_of_commands() -> None:
    result = subprocess.run(
        [sys.executable, "-P", "-c", "from antdsl.cli import main; main()"],
        env=child_environment(_ANTDSL_COMPLETE="complete_bash", COMP_WORDS="antdsl re", COMP_CWORD="1"),
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert result.stdout.split() == ["render"], result.stderr


def test_check_without_a_path_checks_the_working_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "a.ant").write_text("ant 1\nspecies a { state s { steer heading } }\n")
    monkeypatch.chdir(tmp_path)
    assert run("check") == (0, "checked 1 file, no findings\n")


def test_check_of_a_folder_without_programs_says_so(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("no program")
    assert run("check", str(tmp_path)) == (0, f"no file was checked: there is no program and no scene in `{tmp_path}`\n")


def test_check_reads_a_program_from_standard_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "mine.ant").write_text("ant 1\nbehaviour go() -> push { heading }\n")
    monkeypatch.chdir(tmp_path)
    assert run("check", "-", text=PROGRAM) == (0, "checked 1 file, no findings\n")
    code, text = run("check", "-", "--format", "concise", text=PROGRAM.replace("go()", "gone()"))
    assert code == 1 and text.startswith("<stdin>:3:34: error[unknown-behaviour]")
    code, text = run(
        "check", "-", "--params", text=PROGRAM.replace("{ state", "{ param pace = 2 mm/s in 1 mm/s .. 3 mm/s; state")
    )
    assert "pace" in text
    assert run("check", "-", "inner", text=PROGRAM)[0] == 2
    code, text = run("check", "-", text="\x00")
    assert code == 1 and "<stdin>" in text
    assert not (tmp_path / "<stdin>.ant").exists()


def test_an_export_creates_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    code, _ = run("new", "walkers")
    code, text = run("run", "walkers/scene.yaml", "--frames", "1..2", "--out", "walk", "--quiet")
    assert code == 0, text
    assert run("export", "walk", "--to", "results/first/walk.csv")[0] == 0
    assert (tmp_path / "results" / "first" / "walk.csv").is_file()
    (tmp_path / "taken").write_text("mine")
    code, text = run("export", "walk", "--to", "taken/walk.csv")
    assert code == 3 and "is a file, but a folder is needed" in text and (tmp_path / "taken").read_text() == "mine"
