"""Commands that need an extra name it before they begin."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.blender.rendering import PYTHON_VARIABLE, build_command


@pytest.mark.parametrize(
    ("words", "module", "extra"),
    [(("lsp",), "pygls", "lsp"), (("mcp", "--root", "."), "mcp", "mcp"), (("preview", "scene.yaml"), "websockets", "preview")],
)
def test_a_missing_extra_is_named(
    words: tuple[str, ...], module: str, extra: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    searched = []
    monkeypatch.setattr("antdsl.packages.find_spec", searched.append)  # returns None: not installed
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 1 and searched == [module]
    assert f'pip install "antdsl[{extra}]"' in result.stderr and "missing-extra" in result.stderr


def test_missing_blender_is_named_before_the_cache_is_opened(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(PYTHON_VARIABLE, raising=False)
    searched = []
    monkeypatch.setattr("antdsl.packages.find_spec", searched.append)
    result = CliRunner().invoke(app, ["render", str(tmp_path / "no_cache"), "--blender"])
    assert result.exit_code == 1 and searched == ["pxr", "bpy"]
    assert 'pip install "antdsl[blender]"' in result.stderr and PYTHON_VARIABLE in result.stderr


def test_a_python_with_blender_may_be_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PYTHON_VARIABLE, "/opt/blender/bin/python")
    python, safe, script = build_command()
    assert python == "/opt/blender/bin/python" and safe == "-P" and Path(script).is_file()
    monkeypatch.delenv(PYTHON_VARIABLE)
    assert build_command()[0] == sys.executable


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("--samples", "8"), "--samples"),
        (("--blender", "--cut", "z > 0"), "--cut"),
        (("--blender", "--show", "trail,ids"), "--show"),
        (("--blender", "--marks", "5"), "--marks"),
    ],
)
def test_options_that_only_one_of_the_two_has_are_refused(words: tuple[str, ...], option: str) -> None:
    result = CliRunner().invoke(app, ["render", "no_cache", *words])
    assert result.exit_code == 2 and option in result.stderr
