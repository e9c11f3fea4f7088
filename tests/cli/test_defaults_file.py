"""The user's own defaults of options."""

from __future__ import annotations

from pathlib import Path

import commands
import pytest

ROOT = Path(__file__).resolve().parents[2]
PROGRAM = (ROOT / "examples" / "minimal" / "walker.ant").read_text(encoding="utf-8")


@pytest.fixture
def defaults(tmp_path: Path) -> Path:
    (tmp_path / "program.ant").write_text(PROGRAM, encoding="utf-8")
    return tmp_path / "defaults.toml"


def test_an_option_of_the_file_holds_until_the_command_line_replaces_it(defaults: Path) -> None:
    defaults.write_text('[check]\nformat = "json"\n', encoding="utf-8")
    env = {"ANTDSL_DEFAULTS": str(defaults)}
    assert commands.run("check", "program.ant", cwd=defaults.parent, env=env).stdout.startswith("{")
    result = commands.run("check", "program.ant", "--format", "concise", cwd=defaults.parent, env=env)
    assert result.returncode == 0 and not result.stdout.startswith("{")
    assert not commands.run("check", "program.ant", cwd=defaults.parent, env={"ANTDSL_DEFAULTS": ""}).stdout.startswith("{")


def test_flags_and_lists_of_the_file_are_used(defaults: Path) -> None:
    defaults.write_text('[run]\nquiet = true\nprofile = false\nset = ["nobody.pace=1"]\n', encoding="utf-8")
    env = {"ANTDSL_DEFAULTS": str(defaults)}
    scene = ROOT / "examples" / "minimal" / "scene.yaml"
    result = commands.run("run", str(scene), "--frames", "1..1", "--out", "out", cwd=defaults.parent, env=env)
    assert result.returncode == 1 and "nobody" in result.stderr and not result.stdout


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("[rum]\nthreads = 1\n", 1, ("`rum` is not a command", "did you mean `run`?")),
        ("run = 1\n", 1, ("`run` is not a command", "[run]")),
        ("[run]\n\nthread = 1\n", 3, ("no option `--thread`", "did you mean `threads`?")),
        ("[run]\nquiet = 1\n", 2, ("`quiet` needs `true` or `false`",)),
        ("[run]\nthreads = true\n", 2, ("`threads` needs a text or a number",)),
        ("[run]\nthreads = [1]\n", 2, ("`threads` needs a text or a number",)),
        ('[run]\nset = "a=1"\n', 2, ("`set` needs a list",)),
        ("[check]\nstrict = true\n[run]\nstrict = true\n", 4, ("no option `--strict`",)),
        ("[run]\nhelp = true\n", 2, ("no option `--help`",)),
        ("run.threads = {}\n", 1, ("`threads` needs",)),
    ],
)
def test_a_wrong_name_or_value_is_named_with_its_line(defaults: Path, text: str, line: int, words: tuple[str, ...]) -> None:
    defaults.write_text(text, encoding="utf-8")
    result = commands.run("check", "program.ant", cwd=defaults.parent, env={"ANTDSL_DEFAULTS": str(defaults)})
    assert result.returncode == 2 and f"{defaults}:{line}: " in result.stderr, result.stderr
    assert all(word in result.stderr for word in words), result.stderr


def test_a_value_that_the_option_rejects_is_reported_with_the_file(defaults: Path) -> None:
    defaults.write_text('[check]\nformat = "jso"\n', encoding="utf-8")
    result = commands.run("check", "program.ant", cwd=defaults.parent, env={"ANTDSL_DEFAULTS": str(defaults)})
    assert result.returncode == 2 and "--format" in result.stderr and f"note: some options come from {defaults}" in result.stderr


@pytest.mark.parametrize("data", [b"x", b"\xff", b"[run]\nthreads=" + b"1" * 70_000])
def test_a_file_that_is_not_toml_ends_the_command(defaults: Path, data: bytes) -> None:
    defaults.write_bytes(data)
    result = commands.run("check", "program.ant", cwd=defaults.parent, env={"ANTDSL_DEFAULTS": str(defaults)})
    assert result.returncode == 2 and f"`{defaults}` cannot be read" in result.stderr


def test_a_project_cannot_set_defaults(defaults: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The home folder comes from the password database: neither the folder nor its variables are read."""
    from antdsl import user_folders
    from antdsl.cli.defaults_file import find_defaults_path

    project, home = defaults.parent, defaults.parent / "home"
    home.mkdir()
    monkeypatch.setattr(user_folders, "home_folder", lambda: home)
    for variable in ("HOME", "XDG_CONFIG_HOME", "APPDATA"):
        monkeypatch.setenv(variable, str(project))
    monkeypatch.delenv("ANTDSL_DEFAULTS", raising=False)
    for folder in (project, project / ".config" / "antdsl", project / "antdsl"):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "defaults.toml").write_text('[check]\nformat = "json"\n', encoding="utf-8")
    assert find_defaults_path() is None
    own = user_folders.config_folder() / "antdsl" / "defaults.toml"
    own.parent.mkdir(parents=True)
    own.write_text("", encoding="utf-8")
    assert find_defaults_path() == own
