"""Single mistakes in the foraging file, one at a time: one error each, at its place, and what its suggestion does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from antdsl.diagnostics import Report
from antdsl.loading import find_library
from antdsl.program import check
from antdsl.source import Source
from antdsl.syntax import parse
from antdsl.syntax.scan import scan_tokens

ROOT = Path(__file__).resolve().parents[2]
ROWS: list[dict[str, Any]] = yaml.safe_load((ROOT / "tests/cases/mistakes/foraging.yaml").read_text(encoding="utf-8"))
FORAGER = (ROOT / "examples/foraging/forager.ant").read_text(encoding="utf-8")
MARK = "‸"


def diagnose(text: str) -> Report:
    file, report = parse(Source("forager.ant", text))
    report.extend(check(file, find_library)[1])
    return report


def place_of(text: str, within: str) -> int:
    """Where the mark stands when `text`, with any blanks between its words, is found in `within`."""
    prefix, _, suffix = text.partition(MARK)
    pattern = r"\s+".join(re.escape(word) for word in prefix.split())
    gap = r"\s*" if prefix[-1:].isspace() or suffix[:1].isspace() else ""
    rest = r"\s+".join(re.escape(word) for word in suffix.split())
    match = re.search(f"({pattern}{gap}){rest}", within)
    assert match, text
    return match.end(1)


def test_the_foraging_file_is_clean_and_the_table_is_long() -> None:
    assert diagnose(FORAGER).diagnostics == []
    assert len(ROWS) >= 60 and sum(row.get("left") == [] for row in ROWS) >= 60


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['code']}: {row['new'].replace(MARK, '')}"[:60])
def test_one_mistake_is_one_error_at_its_place(row: dict[str, Any]) -> None:
    pattern = r"\s+".join(re.escape(word) for word in row["old"].split())
    match = re.search(pattern, FORAGER)
    assert match, row["old"]
    new = row["new"].replace(MARK, "")
    text = FORAGER[: match.start()] + new + FORAGER[match.end() :]
    report = diagnose(text)
    assert [error.code for error in report.errors] == [row["code"]], [error.message for error in report.errors]
    (error,) = report.errors
    assert error.span is not None and error.help
    expected_start = place_of(row["at"], text) if "at" in row else match.start() + row["new"].index(MARK)
    line, column = error.span.source.find_line_column(error.span.start)
    assert (line, column) == error.span.source.find_line_column(expected_start), error.message
    assert (error.fix is not None) == ("left" in row), error.help
    if error.fix is not None:
        mended = text[: error.fix.span.start] + error.fix.text + text[error.fix.span.end :]
        assert sorted({each.code for each in diagnose(mended).diagnostics}) == row["left"], mended


def without_a_token(path: Path, every: int) -> Iterator[tuple[int, int]]:
    """For each of every so many tokens of a file, where it stands and how many errors the file has without it. None of them is
    about a value that was complained about already."""
    text = path.read_text(encoding="utf-8")
    tokens = [token for token in scan_tokens(Source(path.name, text), Report()).tokens if token.end > token.start]
    for token in tokens[::every]:
        report = diagnose(text[: token.start] + text[token.end :])
        assert not [each.message for each in report.diagnostics if "is a bad" in each.message], (path, token.start)
        yield token.start, len(report.errors)


def mean_errors(every: int) -> float:
    counts = [errors for path in sorted((ROOT / "examples").rglob("*.ant")) for _, errors in without_a_token(path, every)]
    assert len(counts) * every > 3000
    return sum(counts) / len(counts)


def test_a_lost_token_costs_little_more_than_one_error() -> None:
    assert mean_errors(every=153) <= 1.3


@pytest.mark.slow
def test_any_lost_token_costs_little_more_than_one_error() -> None:
    assert mean_errors(every=1) <= 1.3
