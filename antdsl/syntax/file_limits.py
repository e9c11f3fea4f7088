"""Limits on the size of a file. Counts the elements of a file before it is parsed and checked. Also measures the depth of a tree
without recursion, so that later code can walk the tree recursively."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from antdsl import limits
from antdsl.source import Source, Span
from antdsl.syntax.blocks import SourceLine
from antdsl.syntax.brackets import get_token_text
from antdsl.syntax.scan import ScannedToken, TokenScan

FileElementCounts = tuple[int, int, int]
ZERO_FILE_SIZES: FileElementCounts = (0, 0, 0)


def count_sizes(scan: TokenScan, lines: list[SourceLine]) -> FileElementCounts:
    """Return the numbers of words, statements and species in a text, in this order."""
    return len(scan.tokens), sum(1 for _ in _iterate_lines(lines)), len(_find_species_words(scan, lines))


def add_sizes(first: FileElementCounts, second: FileElementCounts) -> FileElementCounts:
    """Return the sum of two file sizes."""
    return first[0] + second[0], first[1] + second[1], first[2] + second[2]


def is_within_limits(sizes: FileElementCounts) -> bool:
    """Return whether the numbers of words, statements and species are within the limits of one file."""
    words, statements, species = sizes
    return words <= limits.MAX_FILE_TOKENS and statements <= limits.MAX_FILE_STATEMENTS and species <= limits.MAX_FILE_SPECIES


def report_too_many(scan: TokenScan, lines: list[SourceLine]) -> bool:
    """Return whether a text has more words, statements or species than allowed. If so, report an error.

    Call this before parsing and checking, because they take longer."""
    species = _find_species_words(scan, lines)
    statements = [line.tokens[0] for line in _iterate_lines(lines)]
    counts = ((species, limits.MAX_FILE_SPECIES, "species"), (statements, limits.MAX_FILE_STATEMENTS, "statements"))
    for entries, limit, noun in (*counts, (scan.tokens, limits.MAX_FILE_TOKENS, "words, numbers and signs")):
        if len(entries) > limit:
            words = f"{len(entries):,} {noun} in one file are too many: at most {limit:,} are allowed"
            help = "move some of these to another file, and write `use NAME`"
            scan.report_error("too-many", words, entries[limit].start, entries[limit].end, help)
            return True
    return False


def _find_species_words(scan: TokenScan, lines: list[SourceLine]) -> list[ScannedToken]:
    """Return the first word of each species."""
    return [line.tokens[0] for line in lines if get_token_text(scan, line.tokens[0]) == "species"]


def _iterate_lines(lines: list[SourceLine]) -> Iterator[SourceLine]:
    """Yield lines in the order of the text, including all lines inside their braces."""
    for line in lines:
        yield line
        for group in line.groups:
            yield from _iterate_lines(group.lines)


def find_too_deep_nodes(node: Any) -> Iterator[Span]:
    """Yield the spans of the nodes that are nested more deeply than allowed."""
    stack: list[tuple[Any, int]] = [(node, 0)]
    while stack:
        part, depth = stack.pop()
        if isinstance(part, tuple):
            stack.extend((each, depth) for each in part)
        elif is_dataclass(part) and not isinstance(part, (Span, Source, type)):
            if depth > limits.MAX_EXPRESSION_DEPTH:
                yield getattr(part, "span")  # noqa: B009 - every node has one
                return
            stack.extend((getattr(part, each.name), depth + 1) for each in fields(part))
