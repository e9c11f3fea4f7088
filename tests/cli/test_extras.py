"""Commands that need an extra name it before they begin."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from antdsl.cli import app


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
