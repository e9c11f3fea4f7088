"""Counts what a file holds, before the costly work of parsing and checking it."""

from __future__ import annotations

from collections.abc import Iterator

from antdsl import limits
from antdsl.syntax.blocks import Line
from antdsl.syntax.brackets import text_of
from antdsl.syntax.scan import Scan


def has_too_many(scanned: Scan, lines: list[Line]) -> bool:
    """Whether a text has more words, statements or species than are allowed, counted before the costly work. Reports it."""
    species = [line.tokens[0] for line in lines if text_of(scanned, line.tokens[0]) == "species"]
    statements = [line.tokens[0] for line in _statements(lines)]
    counts = ((species, limits.SPECIES, "species"), (statements, limits.STATEMENTS, "statements"))
    for found, most, what in (*counts, (scanned.tokens, limits.TOKENS, "words, numbers and signs")):
        if len(found) > most:
            words = f"{len(found):,} {what} in one file, at most {most:,} are allowed"
            help = "move a part of them into a file of its own, and write `use NAME`"
            scanned.error("too-many", words, found[most].start, found[most].end, help)
            return True
    return False


def _statements(lines: list[Line]) -> Iterator[Line]:
    """Lines and all that are within their braces, in the order of the text."""
    for line in lines:
        yield line
        for group in line.groups:
            yield from _statements(group.lines)
