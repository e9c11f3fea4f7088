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


def test_large_folders_are_not_searched_at_every_question(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.lsp import workspace
    from antdsl.pipeline import find_files

    searched: list[int] = []
    clock = [100.0]

    def slow(paths: object) -> object:
        searched.append(1)
        clock[0] += 2
        return find_files(paths)  # type: ignore[arg-type]

    monkeypatch.setattr(workspace, "find_files", slow)
    monkeypatch.setattr(workspace, "monotonic", lambda: clock[0])
    files = workspace.Workspace([tmp_path])
    first = tmp_path / "one.ant"
    first.write_text("ant 1\n", encoding="utf-8")
    assert files.files() == [first.resolve()] == files.files() and len(searched) == 1
    second = tmp_path / "two.ant"
    second.write_text("ant 1\n", encoding="utf-8")
    assert len(files.files()) == 1, "a search that took 2 s holds for 40 s"
    clock[0] += 50
    assert len(files.files()) == 2
    first.unlink()
    files.search_again()
    assert files.files() == [second.resolve()]
