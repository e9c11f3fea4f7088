"""Aligns consecutive lines of one kind in columns: at `->`, `=`, values, help texts and comments.

An alignment mark is the word, sign or position at which a line is split into cells."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

from antdsl.syntax.formatting.bracket_reader import LayoutNode, TokenLeaf
from antdsl.syntax.formatting.items import LayoutBlock, LayoutStatement

MAX_ALIGNED_CHARACTERS = 64  # longer text before a mark does not affect the alignment of neighbouring lines
_MIN_COMMENT_BLANKS = 2  # minimum blanks before a comment


@dataclass(slots=True)
class LayoutRow:
    """A statement or a comment before alignment.

    - `kind`: consecutive rows of the same kind are aligned with each other.
    - `cells`: the texts of the first line between its marks. `following_lines`: the other lines.
    - `is_separate`: whether the row is not aligned with its neighbours."""

    kind: str
    cells: list[str]
    following_lines: list[str]
    comment: str | None
    has_blank_before: bool
    is_separate: bool


def split_cells(statement: LayoutStatement) -> tuple[str, list[Sequence[LayoutNode | LayoutBlock]]]:
    """Return the kind of a one-line statement, and its cells. The last cell is the help text.

    The cells of consecutive statements of the same kind are aligned with each other. A statement without alignment marks has one
    cell."""
    parts, words = statement.parts, statement.first_words
    kind, mark = _find_alignment(statement.rule, words)
    if mark is None:
        return "plain", [parts]
    place = mark(parts)
    if place is None:
        return "plain", [parts]
    last = parts[-1]
    end = len(parts) - 1 if isinstance(last, TokenLeaf) and last.kind == "text" and place < len(parts) - 1 else len(parts)
    block = place + 1 if kind == "world_item" else end
    return kind, [parts[:place], parts[place:block], parts[block:end], parts[end:]]


AlignmentPointFinder = Callable[[Sequence[LayoutNode | LayoutBlock]], int | None]


def _find_sign(sign: str) -> AlignmentPointFinder:
    """Return a function that finds the index of the sign `sign` outside all brackets."""

    def find_sign_index(parts: Sequence[LayoutNode | LayoutBlock]) -> int | None:
        return next((k for k, part in enumerate(parts) if k and isinstance(part, TokenLeaf) and part.text == sign), None)

    return find_sign_index


def _find_second_part(parts: Sequence[LayoutNode | LayoutBlock]) -> int | None:
    return 1 if len(parts) > 1 else None


def _find_alignment(rule: str, words: Sequence[str]) -> tuple[str, AlignmentPointFinder | None]:
    """Return the kind of a line, and a function that finds its alignment mark. Both depend on the line's rule and its first
    words. The function is None for a line without a mark."""
    first = words[0] if words else ""
    if rule in ("world_item", "setting"):
        return rule, _find_second_part
    if rule == "rule":
        return rule, _find_sign("->")
    if rule in ("declaration", "weight"):
        return rule, _find_sign("=")
    if rule in ("member", "machine_member", "statement", "behaviour_line"):
        if first in ("when", "interrupt", "from"):
            return "change", _find_sign("->")
        if first in ("param", "let", "latch", "keep"):
            return "let" if first == "latch" else first, _find_sign("=")
    if rule == "member" and "{" not in words:
        return _find_member_alignment(words)
    return "plain", None


def _find_member_alignment(words: Sequence[str]) -> tuple[str, AlignmentPointFinder | None]:
    """Return the kind and the mark finder of a line in a species that begins with a name. Such a line sets an attribute or a
    built-in property. `words`: the first words of the line."""
    if words[0] in ("start", "on", "layers", "machine", "state", "fuzzy") and words[1:2] not in (["="], [":"]):
        return "plain", None
    return ("declaration", _find_sign("=")) if words[1:2] in (["="], [":"]) else ("given", _find_second_part)


def align_rows(rows: Sequence[LayoutRow], indent: int) -> list[str]:
    """Return the lines of a block. A blank line or a comment line ends a group of aligned lines."""
    lines: list[str] = []
    for run in _iterate_row_runs(rows):
        if run[0].has_blank_before:
            lines.append("")
        texts = [text for _, group in groupby(run, key=lambda row: row.kind) for text in _align_row_run(list(group))]
        column = _compute_next_column([text for row, text in zip(run, texts, strict=True) if row.comment], _MIN_COMMENT_BLANKS)
        for row, text in zip(run, texts, strict=True):
            first = (
                text if row.comment is None or row.following_lines else _pad_text(text, column, row.comment, _MIN_COMMENT_BLANKS)
            )
            lines += [" " * indent + first, *row.following_lines]
            if row.following_lines and row.comment is not None:
                lines[-1] += " " * _MIN_COMMENT_BLANKS + row.comment
    return lines


def _iterate_row_runs(rows: Sequence[LayoutRow]) -> Iterator[list[LayoutRow]]:
    """Yield groups of consecutive rows that may be aligned with each other. A comment line is a separate group, and so is a
    statement of several lines."""
    run: list[LayoutRow] = []
    for row in rows:
        if run and (row.has_blank_before or row.is_separate or run[-1].is_separate):
            yield run
            run = []
        run.append(row)
    if run:
        yield run


def _align_row_run(rows: Sequence[LayoutRow]) -> list[str]:
    """Return the texts of rows of one kind, with aligned cells."""
    texts = [row.cells[0] for row in rows]
    for k in range(1, max(len(row.cells) for row in rows)):
        has_cell = [len(row.cells) > k and row.cells[k] != "" for row in rows]
        column = _compute_next_column([text for text, is_aligned in zip(texts, has_cell, strict=True) if is_aligned], 1)
        texts = [
            _pad_text(t, column, r.cells[k], 1) if is_aligned else t
            for t, r, is_aligned in zip(texts, rows, has_cell, strict=True)
        ]
    return texts


def _compute_next_column(texts: Sequence[str], gap: int) -> int:
    """Return the column after the longest text and a gap of `gap` blanks. Texts longer than `MAX_ALIGNED_CHARACTERS` are
    ignored."""
    return max((len(text) + gap for text in texts if len(text) <= MAX_ALIGNED_CHARACTERS), default=0)


def _pad_text(text: str, column: int, following_text: str, gap: int) -> str:
    return (
        (text + " " * gap).ljust(column) + following_text
        if len(text) <= MAX_ALIGNED_CHARACTERS
        else text + " " * gap + following_text
    )
