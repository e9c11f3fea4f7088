"""A search in the pages of the documentation."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from math import log
from typing import NamedTuple

from antdsl.resources import documentation_folder

_HEADING_WEIGHT = 6.0  # how much more a word counts in a heading than in the text
_COUNT_LIMIT = 4  # further occurrences of a word in a section add nothing
_EXCERPT_CHARACTERS = 1500


class Section(NamedTuple):
    """A part of a page, below one heading. `counts`: how often each word occurs in its text."""

    page: str
    heading: str
    text: str
    counts: Counter[str]


def list_pages() -> tuple[str, ...]:
    """Return the names of all pages, such as `docs/directing` and `grammar/README`."""
    root = documentation_folder()
    files = (*root.glob("docs/**/*.md"), *root.glob("grammar/*.md"), *root.glob("CHANGELOG.md"))
    return tuple(sorted(path.relative_to(root).with_suffix("").as_posix() for path in files))


def read_page(name: str) -> str | None:
    """Return the Markdown text of a page, or None if it does not exist. `name`: a name from `list_pages`, or its last part."""
    names = list_pages()
    name = name.removesuffix(".md")
    found = name if name in names else next((each for each in names if each.rpartition("/")[2] == name), None)
    return None if found is None else _read_listed_page(found)


def _read_listed_page(name: str) -> str:
    return (documentation_folder() / f"{name}.md").read_text(encoding="utf-8")


def search_pages(query: str, count: int = 5) -> list[Section]:
    """Return at most `count` sections that match a query, the best match first. Sections that contain none of its words are
    omitted. Rare words have more weight (inverse document frequency, Spärck Jones 1972), and so have words in headings."""
    words = set(_split_words(query))
    sections = _list_sections()
    frequency = {word: sum(word in section.counts for section in sections) for word in words}
    weights = {word: log(1 + len(sections) / number) for word, number in frequency.items() if number}

    def score(section: Section) -> float:
        heading = set(_split_words(f"{section.page} {section.heading}"))
        return sum(
            weight * (min(section.counts[word], _COUNT_LIMIT) / _COUNT_LIMIT + _HEADING_WEIGHT * (word in heading))
            for word, weight in weights.items()
        )

    rated = [(score(section), number) for number, section in enumerate(sections)]
    best = sorted((-rating, number) for rating, number in rated if rating > 0)
    return [sections[number] for _, number in best[:count]]


def format_sections(sections: list[Section]) -> str:
    """Return sections as Markdown, each with the name of its page and cut after a few paragraphs."""
    parts = []
    for section in sections:
        excerpt = section.text if len(section.text) <= _EXCERPT_CHARACTERS else f"{section.text[:_EXCERPT_CHARACTERS]} […]"
        parts.append(f"## {section.heading} (page `{section.page}`)\n\n{excerpt}")
    return "\n\n".join(parts)


@cache
def _list_sections() -> tuple[Section, ...]:
    """Return the sections of all pages."""
    sections = []
    for page in list_pages():
        for part in re.split(r"^(?=#{1,3} )", _read_listed_page(page), flags=re.MULTILINE):
            heading, _, body = part.partition("\n")
            if body.strip():
                sections.append(Section(page, heading.strip("# "), body.strip(), Counter(_split_words(part))))
    return tuple(sections)


def _split_words(text: str) -> list[str]:
    """Return the words of a text in lower case, without plural endings."""
    return [word.removesuffix("s") for word in re.findall(r"[a-z0-9_]{2,}", text.lower())]
