"""Text cells that no spreadsheet program takes for a formula; numbers stay."""

from __future__ import annotations

import csv
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from antdsl.outputs.csv_text import escape_cell, format_csv

FORMULAS = (
    "=1+1",
    "+cmd|' /C calc'!A0",
    "-2+3",
    "@SUM(1)",
    "\t=1",
    "\r=1",
    "\n=1",
    "  =1",
    "＝1",
    "－a",
    "-5 mm",
    "- 5",
    "=",
    "'=1",
)
OTHERS = ("", "walker", "a=1", "5 mm", "1-2", "pace=+1", " ", "é", "a,b", 'a"b', "a\nb")
NUMBERS = ("-5", "+5", "-1.5e-09", "-.5", "-0", "-inf", "nan", "+1E5")


@pytest.mark.parametrize("text", FORMULAS)
def test_formulas_are_text(text: str) -> None:
    assert escape_cell(text) == "'" + text


@pytest.mark.parametrize("value", [*OTHERS, *NUMBERS, -5, -1.5, None, True])
def test_other_cells_stay(value: object) -> None:
    assert escape_cell(value) == value


@given(st.lists(st.lists(st.text(st.characters(codec="utf-8", exclude_characters="\0")), min_size=2, max_size=3), max_size=4))
def test_texts_are_restored(rows: list[list[str]]) -> None:
    read = list(csv.reader(io.StringIO(format_csv(rows), newline="")))
    assert [[cell.removeprefix("'") for cell in row] for row in read] == rows
    assert not any(cell.lstrip(" ").startswith(("=", "@", "\t")) for row in read for cell in row)
