"""The table of `docs/cache.md` with the arrays of a frame, made from the rows of `antdsl/program/tables/columns.py`.

`python tests/column_tables.py` writes it into the page; `tests/docs/test_docs_tables.py` compares."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from antdsl.program.tables.columns import FRAME_COLUMNS, Column

PAGE = Path(__file__).resolve().parents[1] / "docs" / "cache.md"
HEAD = "| array | type, shape | meaning |\n|---|---|---|\n"
_LETTERS = {"frame": "", "species": "n", "one": "k", "pair": "p", "event": "e", "item": "m", "part": "c"}


def shape(column: Column) -> str:
    """The shape of a column in a frame, as in the page."""
    sizes = [_LETTERS[column.row_kind], *map(str, column.shape)]
    return f"({', '.join(size for size in sizes if size)})"


def lines() -> Iterator[str]:
    """The rows of the table."""
    for column in FRAME_COLUMNS:
        condition = "if `output` requests it: " if column.save_mode == "request" else ""
        yield f"| `{column.frame_name}` | {column.frame_type}, {shape(column)} | {condition}{column.help} |\n"


def page(text: str) -> str:
    """The page with the current table."""
    start, _, table = text.partition(HEAD)
    return start + HEAD + "".join(lines()) + table[table.index("\n\n") + 1 :]


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
