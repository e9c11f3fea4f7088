"""Rows of CSV (RFC 4180). Text is written so that spreadsheet programs do not read it as a formula."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Sequence
from types import SimpleNamespace

_FORMULA_START_CHARACTERS = frozenset(
    "=+-@\t\r\n＝＋－＠"
)  # some programs read a cell that begins with one of these as a formula
_NUMBER_PATTERN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?|[+-]?(?:inf|nan)")


def escape_cell(value: object) -> object:
    """Return a value as cell content. Text that begins like a formula or with an apostrophe gets an apostrophe in front.

    To restore the text, remove one leading apostrophe. Numbers are unchanged, including numbers written as text."""
    if not isinstance(value, str) or _NUMBER_PATTERN.fullmatch(value):
        return value
    return f"'{value}" if value.startswith("'") or value.lstrip(" ")[:1] in _FORMULA_START_CHARACTERS else value


def format_csv(rows: Iterable[Sequence[object]]) -> str:
    """Return rows as lines that end with a line feed. Cells that contain commas, quotes or line ends are quoted."""
    lines: list[str] = []
    # `csv` ends a line in CR LF, and so quotes cells that contain either character
    writer = csv.writer(SimpleNamespace(write=lines.append))
    writer.writerows([escape_cell(value) for value in row] for row in rows)
    return "".join(f"{line[:-2]}\n" for line in lines)
