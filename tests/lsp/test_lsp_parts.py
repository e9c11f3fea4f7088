"""Parts of the language server by themselves: places, names, and what it needs to start."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from antdsl.lsp.features.navigation import rename_symbol
from antdsl.lsp.workspace import Workspace


def test_starting_imports_no_heavy_package() -> None:
    import subprocess
    import sys

    code = "import sys, antdsl.lsp.server; print([m for m in ('open3d', 'scipy', 'llvmlite', 'trimesh') if m in sys.modules])"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_unit_help_shows_the_right_factor(tmp_path: Path) -> None:
    from antdsl.lsp.features.symbol_help import describe_symbol

    workspace = Workspace()
    document = workspace.put_document(tmp_path / "a.ant", "ant 1\n")
    for unit, worth in (("turn", "1 turn = 360 deg"), ("rad", "1 rad = 57.2958 deg"), ("min", "1 min = 60 s"), ("cm", "= 10 mm")):
        assert worth in (describe_symbol(workspace, document, ("unit", unit)) or ""), unit


PROGRAM = """ant 1
use steering
world { surface ground; items nest { load = 0 } }
behaviour hold(rate: number) -> push { heading * rate }
species bug {
  param pace = 0.5 in 0 .. 1
  state s { steer seek(nearest(nest)) }
  layers { hold(pace); separate(radius: size); state }
}
"""
BASE = """antdsl: 1
units: mm
world:
  ground: {mesh: ground.ply}
  nest: {home: {at: [0, 0, 0], on: ground}}
crowd:
  - {species: bug, from: bug.ant, count: 5, place: {on: ground, around: home, radius: 9 mm}}
"""
CHILD = """antdsl: 1
extends: base.yaml
crowd:
  - {species: bug, from: bug.ant, count: 9, place: {on: ground, around: home, radius: 9 mm}}
layers: {bug: [separate, "hold(pace)", state]}
"""


@pytest.mark.parametrize(
    "opened, name",
    [
        *(("bug.ant", name) for name in ("ground", "nest", "pace", "hold", "bug")),
        *(("base.yaml", name) for name in ("ground", "nest", "home", "bug")),
        *(("child.yaml", name) for name in ("ground", "home", "hold", "pace", "bug")),
    ],
)
def test_a_rename_reaches_scenes_that_extend_each_other(tmp_path: Path, opened: str, name: str) -> None:
    workspace = Workspace([tmp_path])
    for file, text in (("bug.ant", PROGRAM), ("base.yaml", BASE), ("child.yaml", CHILD), ("ground.ply", "")):
        (tmp_path / file).write_text(text, encoding="utf-8")
    document = workspace.find_document(tmp_path / opened)
    assert document is not None
    offset = document.text.text.index(name)
    texts: dict[Path, str] = {}
    for each in sorted(
        rename_symbol(workspace, document, offset, "other"),
        key=lambda occurrence: -occurrence.document.find_start(occurrence.span),
    ):
        path, text = each.document.path, texts.get(each.document.path, each.document.text.text)
        texts[path] = text[: each.document.find_start(each.span)] + "other" + text[each.document.find_end(each.span) :]
    for path, text in texts.items():
        workspace.put_document(path, text)  # open in the editor, and not saved
        assert not re.search(rf"\b{name}\b(?!\.)", text), text
    for file in ("bug.ant", "base.yaml", "child.yaml"):
        assert [d.message for d in workspace.find_diagnostics(tmp_path / file) if d.severity == "error"] == []


def test_an_exit_without_a_shutdown_sets_the_exit_code() -> None:
    pytest.importorskip("pygls", reason="the language server needs the extra [lsp]")

    def ended(*methods: str) -> int:
        texts = []
        for number, method in enumerate(("initialize", *methods)):
            parameters = {"params": {"processId": None, "rootUri": None, "capabilities": {}}} if not number else {}
            said = json.dumps({"jsonrpc": "2.0", "method": method, **parameters, **({} if method == "exit" else {"id": number})})
            texts.append(f"Content-Length: {len(said)}\r\n\r\n{said}")
        command = [sys.executable, "-m", "antdsl", "lsp"]
        return subprocess.run(command, input="".join(texts).encode(), capture_output=True, timeout=60).returncode

    assert (ended("shutdown", "exit"), ended("exit")) == (0, 1)


def test_paths_and_uris_lead_to_each_other(tmp_path: Path) -> None:
    from antdsl.lsp.text import path_to_uri, uri_to_path

    path = (tmp_path / "a b%20c#ü🐜.ant").resolve()
    assert uri_to_path(path_to_uri(path)) == path
    assert uri_to_path("untitled:Untitled-1") is None


def test_large_folders_are_not_searched_for_each_request(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.files import find_files
    from antdsl.lsp import workspace

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
    assert files.list_files() == [first.resolve()] == files.list_files() and len(searched) == 1
    second = tmp_path / "two.ant"
    second.write_text("ant 1\n", encoding="utf-8")
    assert len(files.list_files()) == 1, "a search that took 2 s holds for 40 s"
    clock[0] += 50
    assert len(files.list_files()) == 2
    first.unlink()
    files.invalidate_file_list()
    assert files.list_files() == [second.resolve()]


def test_names_in_all_spec_lines_are_resolved(tmp_path: Path) -> None:
    lines = """when state == s for 1 s: pace > 0
never: state == s held 1 s * pace
when any(n in neighbours(size): n.pace > 0) eventually: true"""
    text = f'{PROGRAM}spec "a" on "base.yaml" {{\nagainst "child.yaml"\neach bug {{\n{lines}\n}}\n}}\n'
    document = Workspace().put_document(tmp_path / "bug.ant", text)
    keys = [each.key for each in document.occurrences if document.find_start(each.span) > len(PROGRAM)]
    assert keys.count(("state", "bug", "main", "s")) == 2 and keys.count(("own", "bug", "pace")) == 3
    assert [key[1] for key in keys if key[0] == "file"] == [str(tmp_path / "base.yaml"), str(tmp_path / "child.yaml")]
