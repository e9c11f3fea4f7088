"""Parts of the language server by themselves: places, names, and what it needs to start."""

from __future__ import annotations

from pathlib import Path

import pytest


def test_the_extra_is_named_when_it_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    import antdsl.lsp

    monkeypatch.setattr(antdsl.lsp, "find_spec", lambda name: None)
    report = antdsl.lsp.ready()
    assert [(d.code, "[lsp]" in d.message) for d in report.diagnostics] == [("missing-extra", True)]


def test_starting_imports_nothing_heavy() -> None:
    import subprocess
    import sys

    code = "import sys, antdsl.lsp.server; print([m for m in ('open3d', 'scipy', 'numba', 'trimesh') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_paths_and_uris_lead_to_each_other(tmp_path: Path) -> None:
    from antdsl.lsp.text import path_of, uri_of

    path = (tmp_path / "a b%20c#ü🐜.ant").resolve()
    assert path_of(uri_of(path)) == path
    assert path_of("untitled:Untitled-1") is None
