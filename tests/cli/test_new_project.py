"""What `antdsl new` writes passes its own CI: the workflow's commands, the hooks' and the README's are run in it."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import commands
import pytest
import yaml
from children import child_environment
from packaging.requirements import Requirement

from antdsl import __version__
from antdsl.cli import COMMANDS
from antdsl.cli.commands.new import TEMPLATE_FILES, read_template_file
from antdsl.packages import DISTRIBUTION_BY_MODULE, LIGHT_PACKAGES

ROOT = Path(__file__).resolve().parents[2]
FILE = {name: read_template_file(name) for name in TEMPLATE_FILES}
WORKFLOW: dict[Any, Any] = yaml.safe_load(FILE[".github/workflows/antdsl.yml"])
HOOKS: list[dict[str, Any]] = yaml.safe_load(FILE[".pre-commit-config.yaml"])["repos"][0]["hooks"]
STEPS: list[dict[str, Any]] = [step for job in WORKFLOW["jobs"].values() for step in job["steps"]]
LINES = [line for step in STEPS for line in step.get("run", "").splitlines()]
OURS = [line for line in LINES if line.startswith("antdsl ")]


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment in which `antdsl` is a command of this checkout."""
    folder = tmp_path_factory.mktemp("bin")
    script = folder / "antdsl"
    script.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m antdsl "$@"\n', encoding="utf-8")
    script.chmod(0o755)
    return child_environment(NO_COLOR="1", PATH=f"{folder}{os.pathsep}{os.environ['PATH']}")


def run(line: str, folder: Path, shell: dict[str, str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["bash", "-c", line], cwd=folder, env=shell, capture_output=True, text=True, timeout=400)


def run_here(line: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """The same in this process; a shell's `> file` is all that a line may have of a shell."""
    line, redirection, file = line.partition(" > ")
    result = commands.run(*shlex.split(line)[1:], cwd=folder)
    if redirection:
        (folder / file.strip()).write_text(result.stdout, encoding="utf-8")
    return result


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory, shell: dict[str, str]) -> Path:
    folder = tmp_path_factory.mktemp("new")
    result = run("antdsl new walkers", folder, shell)
    assert result.returncode == 0, result.stderr
    return folder / "walkers"


def test_a_new_project_has_exactly_the_listed_files(project: Path) -> None:
    file_names = {str(path.relative_to(project)) for path in project.rglob("*") if path.is_file()}
    assert {*FILE, "ground.ply"} == file_names - {"antdsl.sarif", "antdsl-junit.xml", "walker.svg"} - {
        f for f in file_names if "out/" in f
    }


def test_the_workflow_passes_in_the_new_project(project: Path, shell: dict[str, str]) -> None:
    """Every line of the workflow that is ours, as it stands there."""
    assert [line.split()[1] for line in OURS] == ["fmt", "check", "check", "test"]
    for line in OURS:
        result = run(line, project, shell)
        assert result.returncode == 0, (line, result.stdout, result.stderr)
    assert json.loads((project / "antdsl.sarif").read_text(encoding="utf-8"))["version"] == "2.1.0"
    junit = ElementTree.parse(project / "antdsl-junit.xml").getroot()
    assert int(junit.get("tests", "0")) >= 1 and junit.get("failures") == "0"


def test_the_workflow_fails_on_errors(project: Path, tmp_path: Path) -> None:
    """A mistake and a spec that does not hold each fail the step that looks for them, and SARIF is written all the same."""
    for name, old, new, failing in (
        ("typo", "-> rest", "-> resst", {"check", "test"}),
        ("spec", "< 50 %", "< 0 %", {"test"}),
        ("layout", "  state rest", "  state    rest", {"fmt"}),
    ):
        folder = tmp_path / name
        folder.mkdir()
        for file in ("walker.ant", "scene.yaml", "ground.ply"):
            (folder / file).write_bytes((project / file).read_bytes())
        text = (folder / "walker.ant").read_text(encoding="utf-8")
        assert old in text
        (folder / "walker.ant").write_text(text.replace(old, new), encoding="utf-8")
        codes = {line: run_here(line, folder).returncode for line in OURS}
        assert set(codes.values()) == {0, 1}, codes
        assert {line.split()[1] for line, code in codes.items() if code == 1} == failing, codes
        findings = json.loads((folder / "antdsl.sarif").read_text(encoding="utf-8"))["runs"][0]["results"]
        assert bool(findings) == ("check" in failing)


def test_a_step_after_a_failed_one_runs_and_files_are_those_that_are_written() -> None:
    """GitHub passes over the steps after one that failed, unless they say otherwise."""
    for job in WORKFLOW["jobs"].values():
        first = next(n for n, step in enumerate(job["steps"]) if step.get("run", "").startswith("antdsl"))
        assert all(step.get("if") == "always()" for step in job["steps"][first + 1 :])
    written = " ".join(OURS)
    for step in STEPS:
        for key in ("sarif_file", "path"):
            assert step.get("with", {}).get(key, "") in written
    assert WORKFLOW["permissions"]["security-events"] == "write" and WORKFLOW["permissions"]["contents"] == "read"
    assert WORKFLOW[True] == ["push", "pull_request"]  # YAML 1.1 reads the key `on` as true; GitHub does not
    assert WORKFLOW["env"].keys() == {"ANTDSL"} and 'pip install "$ANTDSL"' in LINES
    # no package index has antdsl: what is installed is the wheel that `pip wheel` makes of this version
    assert WORKFLOW["env"]["ANTDSL"] == f"wheels/antdsl-{__version__}-py3-none-any.whl"
    assert "pip wheel --no-deps --wheel-dir wheels" in FILE["README.md"] and "/wheels" not in FILE[".gitignore"]
    for line in LINES:
        assert line in OURS or re.match(r"(pip install|sudo apt-get update)", line), line


def make_light_command(target: str) -> str:
    """The line of the light installation, with the bounds of `pyproject.toml`."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    bounds = [*project["dependencies"], *project["optional-dependencies"]["lsp"]]
    requirements = [f'"{text}"' for name in LIGHT_PACKAGES for text in bounds if Requirement(text).name == name]
    assert len(requirements) == len(LIGHT_PACKAGES)
    return f"pip install {' '.join(requirements)} && pip install --no-deps {target}"


def test_the_light_installation_is_the_same_everywhere() -> None:
    assert make_light_command('"$ANTDSL"') in LINES
    assert make_light_command(f"wheels/antdsl-{__version__}-py3-none-any.whl") in (ROOT / "docs" / "install.md").read_text(
        "utf-8"
    )
    action_steps = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))["runs"]["steps"]
    action_lines = [step["run"] for step in action_steps if "run" in step]
    assert make_light_command('"$GITHUB_ACTION_PATH"') in action_lines
    assert [line.split()[1] for line in action_lines if line.startswith("antdsl ")] == ["fmt", "check", "test"]


def test_the_light_installation_checks_formats_and_names_missing_packages(project: Path, tmp_path: Path) -> None:
    """Every required package that the light installation lacks cannot be imported."""
    absent = [module for module, distribution in DISTRIBUTION_BY_MODULE.items() if distribution not in LIGHT_PACKAGES]
    assert {"open3d", "scipy", "PIL", "llvmlite"} <= set(absent)
    script = f"import sys; sys.modules.update(dict.fromkeys({absent})); from antdsl.cli import main; main()"

    def run_light(*arguments: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-P", "-c", script, *arguments]
        return subprocess.run(command, cwd=project, env=child_environment(), capture_output=True, text=True, timeout=100)

    for words in (["check", ".", "--strict"], ["fmt", "--check", "."], ["new", str(tmp_path / "other")], ["examples"]):
        result = run_light(*words)
        assert result.returncode == 0, (words, result.stderr)
    for words in (["run", "scene.yaml"], ["test", "."], ["render", "out/scene"], ["info", "out/scene"]):
        result = run_light(*words)
        assert result.returncode == 3, (words, result.stderr)
        assert re.fullmatch(
            r"error: this command needs the package \S+, which is not installed\n.*`pip install antdsl`\n", result.stderr
        )


def test_the_hooks_of_this_repository_are_those_of_new_projects() -> None:
    own = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text("utf-8"))
    assert own == [hook | {"language": "python"} for hook in HOOKS]


@pytest.mark.slow
def test_the_hooks_pass_and_check_the_right_files(project: Path, shell: dict[str, str]) -> None:
    for hook in HOOKS:
        files = [] if hook.get("pass_filenames", True) is False else [f for f in FILE if re.search(hook["files"], f)]
        result = run(" ".join([hook["entry"], *files]), project, shell)
        assert result.returncode == 0, (hook["id"], result.stdout, result.stderr)
        assert re.search(hook["files"], "walker.ant") and not re.search(hook["files"], "README.md")
    assert [hook["id"] for hook in HOOKS] == ["antdsl-fmt", "antdsl-check", "antdsl-test"]
    assert (project / "walker.ant").read_text(encoding="utf-8") == FILE["walker.ant"]


def test_the_readme_of_the_project_works(project: Path) -> None:
    first = re.findall(r"```sh\n(.*?)```", FILE["README.md"], re.DOTALL)[0]
    for line in first.splitlines():
        assert line.split()[1] in [command.name for command in COMMANDS]
        if "render" not in line:  # pictures take their time; tests of their own draw them
            frames_option = " --frames 1..4" if " run " in line else ""
            result = run_here(line + frames_option, project)
            assert result.returncode == 0, (line, result.stdout, result.stderr)
    assert (project / "out" / "scene").is_dir()  # what `antdsl render` has to draw
    assert not [line for line in FILE[".gitignore"].splitlines() if not line.startswith("/")]


@pytest.mark.parametrize(("kind", "name"), [("workflow", ".github/workflows/antdsl.yml"), ("hooks", ".pre-commit-config.yaml")])
def test_the_page_shows_the_files_as_they_are_written(kind: str, name: str) -> None:
    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    assert re.findall(rf"```yaml {kind}\n(.*?)```", page, re.DOTALL) == [FILE[name]]


def test_the_page_has_every_exit_code() -> None:
    from antdsl.cli.exits import ExitCode

    page = (ROOT / "docs" / "ci.md").read_text(encoding="utf-8")
    assert [int(code) for code in re.findall(r"^\| (\d+) \|", page, re.M)] == [code.value for code in ExitCode]
