"""Every code has a page, and every page says what antdsl says: its wrong example gives its code and nothing else, in exactly
these words and at this place; nothing at all is said of its right one."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import code_pages
import pytest
from code_pages import PAGES, ROOT, Page

from antdsl.diagnostics.codes import CODES
from antdsl.resources import code_page
from antdsl.source import Source
from antdsl.syntax.formatting import format

FILES = sorted(path for path in PAGES.glob("*.md") if path.stem != "README")
# What an example cannot be run without; a package that is not there is not what these pages are about.
NEEDS = {
    **dict.fromkeys(("bad-usd", "no-such-prim", "usd-left-out"), "pxr"),
    **dict.fromkeys(("cannot-write", "no-pictures"), "imageio_ffmpeg"),
}


@pytest.fixture(scope="module")
def pages() -> dict[str, Page]:
    return {path.stem: code_pages.read(path) for path in FILES}


def test_every_code_has_a_page_and_every_page_a_code(pages: dict[str, Page]) -> None:
    assert sorted(pages) == sorted(CODES)
    for name, page in pages.items():
        assert (page.code, page.meaning) == (name, code_pages.sentence(CODES[name])), f"run `python tests/code_pages.py {name}`"


def test_a_page_says_why_in_a_few_words_and_shows_little(pages: dict[str, Page]) -> None:
    for name, page in pages.items():
        assert 40 < len(page.why) < 400 and page.why.endswith((".", "?")) and "\n" not in page.why, name
        blocks = re.findall(r"^```\w*\n(.*?)^```", (PAGES / f"{name}.md").read_text(encoding="utf-8"), flags=re.M | re.S)
        assert max(block.count("\n") for block in blocks) <= 20, name
        assert page.wrong.files != page.right.files or page.wrong.command != page.right.command, name
        assert page.wrong.said and page.right.said is None, name


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_the_examples_do_what_the_page_says(path: Path, tmp_path: Path) -> None:
    needed = NEEDS.get(path.stem)
    if needed is not None and importlib.util.find_spec(needed) is None:
        pytest.skip(f"needs {needed}")
    page = code_pages.read(path)
    wrong = code_pages.said(page.wrong, tmp_path / "wrong").rstrip()
    assert page.wrong.said is not None
    assert wrong == page.wrong.said.rstrip(), f"run `python tests/code_pages.py {path.stem}` and read what changed"
    assert code_pages.codes_in(wrong) == {path.stem}
    assert code_pages.said(page.right, tmp_path / "right") == ""
    for name, data in page.right.files.items():
        if name.endswith(".ant"):
            text = data.decode("utf-8")
            assert format(Source(name, text))[0] == text, "a right example has the one layout"


def test_the_index_has_all_codes_by_their_sections() -> None:
    text = (PAGES / "README.md").read_text(encoding="utf-8")
    assert text == code_pages.index(), "run `python tests/code_pages.py`"
    assert re.findall(r"^\| \[`([a-z0-9-]+)`\]", text, flags=re.MULTILINE) == list(CODES)


def test_the_pages_go_with_the_package() -> None:
    packed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert packed["force-include"]["docs/codes"] == "antdsl/_data/docs/codes"
    assert code_page("unknown-state") == PAGES / "unknown-state.md" and code_page("no-such-code") is None


def test_explain_shows_the_page() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "antdsl", "check", "--explain", "unknown-state"]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, encoding="utf-8")
    assert done.stdout == (PAGES / "unknown-state.md").read_text(encoding="utf-8")


def test_check_leads_to_the_page_once_and_for_people_only(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from antdsl.cli import app

    wrong = code_pages.read(PAGES / "unknown-sign.md").wrong  # two complaints of one code
    with code_pages.laid_out(wrong, tmp_path / "wrong"):
        full, concise = (
            CliRunner().invoke(app, ["check", "walker.ant", "--format", kind]).stdout for kind in ("full", "concise")
        )
    assert full.count("`antdsl check --explain unknown-sign` says more") == 1 and "--explain" not in concise


def test_a_code_without_its_page_is_explained_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from antdsl.cli import pages

    monkeypatch.setattr(pages, "code_page", lambda code: None)
    pages.show_page("trap")
    assert CODES["trap"] in capsys.readouterr().out


def test_explain_is_laid_out_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """What rich makes of a page has its words and none of Markdown's signs."""
    from antdsl.cli import pages

    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "100")
    pages.show_page("unknown-state")
    shown = capsys.readouterr().out
    assert "did you mean `stroll`?" in shown and "when after 1 s -> strol }" in shown
    assert "```" not in shown and "## " not in shown
