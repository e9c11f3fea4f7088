"""`antdsl examples` and `antdsl new --template`: what they list, write and refuse."""

from __future__ import annotations

import tomllib
from pathlib import Path

import commands
import pytest

from antdsl.cli.commands.new import DEFAULT_TEMPLATE, EXAMPLE_BY_TEMPLATE, TEMPLATE_FILES

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = sorted(path.name for path in (ROOT / "examples").iterdir() if path.is_dir())
LESSONS = [f"learn/{path.name}" for path in sorted((ROOT / "examples" / "learn").iterdir()) if path.is_dir()]
NAMES = sorted([name for name in FOLDERS if name != "learn"] + LESSONS)


def test_all_examples_are_listed_with_a_description_and_shipped(tmp_path: Path) -> None:
    lines = commands.run("examples", cwd=tmp_path).stdout.splitlines()
    assert [line.split()[0] for line in lines[:-1]] == NAMES and all(len(line.split()) > 5 for line in lines[:-1])
    wheel = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert {f"examples/{name}" for name in FOLDERS} <= wheel["force-include"].keys()


def test_an_example_is_copied_without_results_of_runs(tmp_path: Path) -> None:
    result = commands.run("examples", "minimal", "mine", cwd=tmp_path)
    assert result.returncode == 0 and "antdsl run mine/scene.yaml" in result.stdout
    for path in (tmp_path / "mine").iterdir():
        assert path.read_bytes() == (ROOT / "examples" / "minimal" / path.name).read_bytes()
    assert {"walker.ant", "scene.yaml", "ground.ply"} <= {path.name for path in (tmp_path / "mine").iterdir()}
    again = commands.run("examples", "minimal", "mine", cwd=tmp_path)
    assert again.returncode == 3 and "already exists and is not empty" in again.stderr


@pytest.mark.parametrize(("words", "advice"), [(("examples", "aren"), "did you mean `arena`?"),
                                               (("examples", "x" * 400), "`antdsl examples` lists all"),
                                               (("new", "here", "--template", "wr"), "did you mean `war`?"),
                                               (("new", "here", "--template", "cats"), "write one of `minimal`, ")])  # fmt: skip
def test_unknown_names_are_refused(tmp_path: Path, words: tuple[str, ...], advice: str) -> None:
    result = commands.run(*words, cwd=tmp_path)
    assert result.returncode == 2 and advice in result.stderr and not list(tmp_path.iterdir())


@pytest.mark.parametrize("template", EXAMPLE_BY_TEMPLATE)
def test_a_project_from_a_template_passes_its_checks(tmp_path: Path, template: str) -> None:
    assert commands.run("new", "mine", "--template", template, cwd=tmp_path).returncode == 0
    folder = tmp_path / "mine"
    assert all((folder / name).is_file() for name in (*TEMPLATE_FILES, "scene.yaml") if name != "walker.ant")
    text = (folder / "README.md").read_text(encoding="utf-8")
    assert text.startswith(f"# {template.capitalize()}\n") and "PROGRAM" not in text
    for words in (("fmt", "--check", "."), ("check", "--strict", ".")):
        assert commands.run(*words, cwd=folder).returncode == 0
    assert list(folder.glob("*.ant")) and template != DEFAULT_TEMPLATE
