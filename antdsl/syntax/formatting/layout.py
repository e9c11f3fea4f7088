"""Formats a program in the standard layout. Comments are preserved, and the output is parsed again before it is returned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Any

from antdsl import limits
from antdsl.diagnostics.model import Report
from antdsl.source import Source, Span
from antdsl.syntax import nodes as n
from antdsl.syntax.formatting.items import read_items
from antdsl.syntax.formatting.lines import format_items
from antdsl.syntax.parser import parse


class LayoutError(RuntimeError):
    """Error for a layout that has changed the meaning of a text or lost a comment. Its cause is always a bug in this package."""


def format(source: Source) -> tuple[str | None, Report]:
    """Return the text in the standard layout, and the report of parsing.

    The text is None if the source has errors, because unreadable text must not be moved. It is also None if it would exceed the
    limits of a file. Formatting the result again does not change it. Raises LayoutError if the result would have another
    meaning."""
    file, report = parse(source)
    if not report.ok:
        return None, report
    text = format_items(read_items(file))
    if text == source.text:
        return text, report
    if report_too_long(source, text, report):
        return None, report
    reparsed, findings = parse(Source(source.path, text))
    if not findings.ok or find_first_difference(file, reparsed):
        raise LayoutError(f"{source.path}: {find_first_difference(file, reparsed) or findings.diagnostics[0].message}")
    return text, report


def report_too_long(source: Source, text: str, report: Report) -> bool:
    """Return whether a formatted text exceeds the limits of a file. If so, report an error.

    Formatting can make a text longer, because it joins lines and adds blanks."""
    line = max(text.split("\n"), key=len).strip()
    if len(line) > limits.MAX_LINE_CHARACTERS:
        message = f"line that begins with `{line[:40]}` would have more than {limits.MAX_LINE_CHARACTERS} characters"
        report.error(
            "line-too-long",
            message,
            Span(source, 0, 0),
            "shorten the text of this line, or give parts of the line a name with `let`",
        )
    if len(text.encode("utf-8", "surrogatepass")) > limits.MAX_PROGRAM_BYTES:
        message = f"after formatting, the file would be larger than {limits.MAX_PROGRAM_BYTES // limits.KIB} KiB"
        report.error("file-too-large", message, Span(source, 0, 0), "split the file, and bring in the parts with `use`")
    return not report.ok


def find_first_difference(first: n.File, second: n.File) -> str | None:
    """Return a short description of the first difference between two files, or None. Locations are ignored. Comments must be
    equal."""
    first_comments, second_comments = ([comment.text.rstrip() for comment in file.comments] for file in (first, second))
    if first_comments != second_comments:
        return next(
            (f"comment `{a}` became `{b}`" for a, b in zip(first_comments, second_comments, strict=False) if a != b),
            "a comment was lost",
        )
    left, right = iterate_tree_texts(first), iterate_tree_texts(second)
    for a, b in zip(left, right, strict=False):
        if a != b:
            return f"`{a}` became `{b}`"
    rest = next(left, None) or next(right, None)
    return None if rest is None else f"`{rest}` was lost or added"


def iterate_tree_texts(node: Any) -> Iterator[str]:
    """Yield the texts of a tree in a flat sequence: the kind of each node, and the content of its leaves. Locations and comments
    are omitted."""
    stack = [node]
    while stack:
        part = stack.pop()
        if isinstance(part, tuple):
            yield f"{len(part)} things"
            stack.extend(reversed(part))
        elif is_dataclass(part) and not isinstance(part, type):
            yield type(part).__name__
            inner = [getattr(part, each.name) for each in fields(part) if each.name not in ("comments", "recovered", "broken")]
            stack.extend(reversed([each for each in inner if not isinstance(each, (Span, Source))]))
        else:
            yield repr(part)
