"""The documentation site: Sphinx builds it without a warning, so every page is in its table of contents and every link leads
somewhere; `antdsl docs` builds, stores and finds it."""

from __future__ import annotations

import re
import shutil
from html import unescape
from io import StringIO
from pathlib import Path

import commands
import pytest

from antdsl.cli.commands.manual import docs

sphinx = pytest.importorskip("sphinx.application")
ROOT = Path(__file__).resolve().parents[2]
GROUPS = ["Learn", "How-to", "Reference", "Explanation", "Gallery", "Project"]
BROKEN_LINK = re.compile(r'class="[^"]*(?:problematic|system-message)')


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    warnings = StringIO()
    sphinx.Sphinx(ROOT, ROOT / "docs", folder / "site", folder / "trees", "html", status=None, warning=warnings).build()
    assert warnings.getvalue() == ""
    return folder / "site"


def test_every_page_is_built_and_its_links_lead_somewhere(site: Path) -> None:
    pages = [*(ROOT / "docs").rglob("*.md"), *ROOT.glob("examples/*/README.md"), ROOT / "grammar" / "README.md"]
    for page in pages:
        assert (site / page.relative_to(ROOT)).with_suffix(".html").is_file(), page
    ids = {file: set(re.findall(r'id="([^"]*)"', file.read_text(encoding="utf-8"))) for file in site.rglob("*.html")}
    for file in ids:
        text = file.read_text(encoding="utf-8")
        assert not BROKEN_LINK.search(text), file
        for link in re.findall(r'<(?:a|img)\b[^>]*\b(?:href|src)="([^"]*)"', text):
            path, _, anchor = unescape(link).partition("#")
            if "://" in path or path.startswith("mailto:"):
                continue
            target = (file.parent / path).resolve() if path else file
            assert target.is_file(), f"{file.relative_to(site)}: {link}"
            assert not anchor or target.suffix != ".html" or anchor in ids[target], f"{file.relative_to(site)}: {link}"


def test_the_first_page_groups_all_pages_in_reading_order(site: Path) -> None:
    first = (site / docs.FIRST_PAGE).read_text(encoding="utf-8")
    assert re.findall(r'class="caption-text">([^<]*)<', first.split("</aside>")[0]) == GROUPS
    assert "Search.setIndex" in (site / "searchindex.js").read_text(encoding="utf-8")
    assert "theme-toggle" in first


def test_a_page_has_one_title() -> None:
    """A second one would be another entry in the sidebar, for the same page."""
    for page in (*(ROOT / "docs").rglob("*.md"), ROOT / "grammar" / "README.md"):
        text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)
        assert len(re.findall(r"^# ", text, re.MULTILINE)) == 1, page


@pytest.fixture
def pages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Installed pages: the settings and two pages. The user's folders are below the test's."""
    (tmp_path / "data" / "docs").mkdir(parents=True)
    shutil.copy(ROOT / "docs" / "conf.py", tmp_path / "data" / "docs")
    (tmp_path / "data" / "docs" / "index.md").write_text("# antdsl\n\n## Learn\n\n[One](one.md)\n")
    (tmp_path / "data" / "docs" / "one.md").write_text("# One\n\n[not installed](../antdsl/limits.py)\n")
    monkeypatch.setattr(docs, "documentation_folder", lambda: tmp_path / "data")
    monkeypatch.setattr(docs, "cache_folder", lambda: tmp_path / "cache")
    return tmp_path / "data" / "docs"


def test_the_command_builds_once_and_again_after_a_change(pages: Path, tmp_path: Path) -> None:
    first = commands.run("docs", "--no-open", cwd=tmp_path)
    path = Path(first.stdout.splitlines()[-1])
    assert first.returncode == 0 and "building" in first.stdout and path.is_file() and (path.parent / "one.html").is_file()
    again = commands.run("docs", "--no-open", cwd=tmp_path)
    assert again.stdout.splitlines() == [str(path)]
    (pages / "one.md").write_text("# Other\n")
    other = Path(commands.run("docs", "--no-open", cwd=tmp_path).stdout.splitlines()[-1])
    assert "Other" in (other.parent / "one.html").read_text() and not path.exists()


def test_the_command_opens_the_page(pages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr("webbrowser.open", opened.append)
    path = commands.run("docs", cwd=tmp_path).stdout.splitlines()[-1]
    assert opened == [Path(path).as_uri()]


def test_a_folder_must_be_empty_and_packages_installed(pages: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert commands.run("docs", "--to", "site", cwd=tmp_path).stdout.splitlines()[-1] == "site/docs/index.html"
    again = commands.run("docs", "--to", "site", cwd=tmp_path)
    assert again.returncode == 3 and "already exists and is not empty" in again.stderr
    monkeypatch.setattr(docs, "_PACKAGES", ("sphinx", "no_such_package"))
    result = commands.run("docs", "--to", "other", cwd=tmp_path)
    assert result.returncode == 1 and 'pip install "antdsl[docs]"' in result.stderr and not (tmp_path / "other").exists()
