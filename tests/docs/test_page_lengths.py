"""No page of the documentation is so long that a reader cannot find a topic in it."""

from __future__ import annotations

import re
from pathlib import Path

from page_groups import LANGUAGE_PAGES, ROOT

WORD_LIMIT = 2500  # in the text of a page, without code and tables, which readers look up and do not read
LANGUAGE_LINE_LIMIT = 660  # of the reference of the language, all pages together, without blank lines
LONG_PAGES = {"CHANGELOG.md": "a list of all changes, in which readers look up one version"}
FOLDERS = ("docs", "grammar", "examples")


def count_words(text: str) -> int:
    """The words of a page outside code blocks and tables."""
    text = re.sub(r"^(`{3,}).*?^\1\s*$", "", text, flags=re.DOTALL | re.MULTILINE)
    return sum(len(line.split()) for line in text.splitlines() if not line.lstrip().startswith("|"))


def list_pages() -> list[Path]:
    """All pages, also those of the examples."""
    nested = [page for folder in FOLDERS for page in (ROOT / folder).rglob("*.md") if "node_modules" not in page.parts]
    return sorted([*ROOT.glob("*.md"), *nested])


def test_no_page_is_too_long() -> None:
    words = {page.relative_to(ROOT).as_posix(): count_words(page.read_text(encoding="utf-8")) for page in list_pages()}
    assert len(words) > 250
    too_long = {name: count for name, count in words.items() if count > WORD_LIMIT}
    assert sorted(too_long) == sorted(LONG_PAGES), "split it by topic, or give the reason in LONG_PAGES"


def test_words_are_counted_outside_code_and_tables() -> None:
    assert count_words("# One two\n\n```ant\nant 1\n```\n\n| a | b |\n|---|---|\n\n- three `four`\n") == 6


def test_the_reference_of_the_language_is_short() -> None:
    lines = [line for page in LANGUAGE_PAGES for line in page.read_text(encoding="utf-8").splitlines()]
    assert sum(bool(line.strip()) for line in lines) <= LANGUAGE_LINE_LIMIT
