"""Converts a parsed file to the items of its layout: statements with their blocks, and comments with their positions.

Tokens and lines come from the parser. The tree is used only to find which brackets follow a function, and which minus signs have
no left operand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any

from antdsl.diagnostics.model import Report
from antdsl.source import Source, Span
from antdsl.syntax import nodes as n
from antdsl.syntax.blocks import BraceGroup, SourceLine, cut_lines
from antdsl.syntax.brackets import pair_brackets
from antdsl.syntax.formatting.bracket_reader import BracketGroup, BracketReader, LayoutNode, TokenLeaf
from antdsl.syntax.scan import TokenScan, scan_tokens
from antdsl.syntax.words import BODY_RULE_BY_LINE


@dataclass(slots=True)
class CommentItem:
    """A comment on a separate line."""

    text: str
    has_blank_before: bool


@dataclass(slots=True)
class LayoutBlock:
    """The content between two braces. `is_one_line`: whether all statements were on one line in the source. `opening_comment`:
    the comment after `{`."""

    items: list[LayoutItem]
    is_one_line: bool
    opening_comment: str | None = None


@dataclass(slots=True)
class LayoutStatement:
    """A statement: its words and brackets, with a `LayoutBlock` for each pair of braces. `rule`: the grammar rule for the lines
    in these braces. `comment`: the comment after the statement."""

    rule: str
    parts: list[LayoutNode | LayoutBlock]
    has_blank_before: bool
    comment: str | None = None

    @property
    def first_words(self) -> list[str]:
        """Return the words of the statement before its first bracket or block."""
        found: list[str] = []
        for part in self.parts:
            if not isinstance(part, TokenLeaf):
                break
            found.append(part.text)
        return found


LayoutItem = LayoutStatement | CommentItem


def needs_own_lines(part: LayoutNode | LayoutBlock) -> bool:
    """Return whether a part of a statement cannot share a line with the other parts."""
    return part.is_forced_open if isinstance(part, BracketGroup) else isinstance(part, LayoutBlock) and not part.is_one_line


def read_items(file: n.File) -> list[LayoutItem]:
    """Return the items of a file that was parsed without an error."""
    scanned = scan_tokens(file.source, Report())
    tokens = pair_brackets(scanned)
    assert tokens is not None, "a file with too many brackets open was not parsed without an error"
    return _ItemReader(scanned, *_find_call_ends_and_minus_signs(file)).read_lines(
        cut_lines(scanned, tokens), "top", 0, len(file.source.text)
    )


def _find_call_ends_and_minus_signs(file: n.File) -> tuple[frozenset[int], frozenset[int]]:
    """Return the offsets at which the names of called functions end, and the offsets of unary minus signs."""
    calls: set[int] = set()
    minus: set[int] = set()
    stack: list[Any] = [file.items]
    while stack:
        part = stack.pop()
        if isinstance(part, tuple):
            stack.extend(part)
        elif is_dataclass(part) and not isinstance(part, (Span, Source, type)):
            if isinstance(part, n.Call):
                calls.add(part.function.span.end)
            elif isinstance(part, n.Unary) and part.op == "-":
                minus.add(part.op_span.start)
            elif (name := _find_called_name(part)) is not None:
                calls.add(name.span.end)
            stack.extend(getattr(part, each.name) for each in fields(part))
    return frozenset(calls), frozenset(minus)


def _find_called_name(part: object) -> n.Name | None:
    """Return the name of the function or verb of a node if arguments in brackets may follow this name. Otherwise return None."""
    if isinstance(part, n.VerbLine):
        return part.name if part.amount is None else None
    return part.event if isinstance(part, n.On) else part.name if isinstance(part, n.Behaviour) else None


@dataclass(slots=True)
class _ItemReader:
    """Reader of the lines and comments of a text, both in text order.

    - `function_ends`: the end offsets of the names of called functions.
    - `unary_minus_offsets`: the offsets of minus signs with one operand.
    - `used_comment_count`: the number of comments that already have a position."""

    scan: TokenScan
    function_ends: frozenset[int]
    unary_minus_offsets: frozenset[int]
    used_comment_count: int = field(default=0)  # number of comments already placed

    def pop_comment_before(self, offset: int) -> n.Comment | None:
        """Return the next unused comment if it begins before an offset, and mark it as used. Otherwise return None."""
        comments = self.scan.comments
        if self.used_comment_count < len(comments) and comments[self.used_comment_count].span.start < offset:
            self.used_comment_count += 1
            return comments[self.used_comment_count - 1]
        return None

    def count_line_ends(self, start: int, end: int) -> int:
        return self.scan.source.text.count("\n", start, end)

    def read_lines(self, lines: Sequence[SourceLine], rule: str, start: int, end: int) -> list[LayoutItem]:
        """Return the statements and comments between the offsets `start` and `end`. `rule`: the grammar rule of the lines."""
        item_list: list[LayoutItem] = []
        last = start  # end of the previous item
        for line in lines:
            last = self.add_comments(item_list, last, line.start)
            item_list.append(self.make_statement(line, rule, self.has_blank_line(item_list, last, line.start)))
            last = line.end
        self.add_comments(item_list, last, end)
        return item_list

    def has_blank_line(self, item_list: list[LayoutItem], last: int, start: int) -> bool:
        """Return whether there is a blank line between the end `last` of the previous item and the offset `start`."""
        return bool(item_list) and self.count_line_ends(last, start) > 1

    def add_comments(self, item_list: list[LayoutItem], last: int, end: int) -> int:
        """Add the comments before the offset `end`. A comment on the line of the last statement is added to that statement.
        Other comments become separate lines.

        Return the end offset of the last comment."""
        while (comment := self.pop_comment_before(end)) is not None:
            text = comment.text.rstrip()
            previous_item = item_list[-1] if item_list else None
            if (
                isinstance(previous_item, LayoutStatement)
                and previous_item.comment is None
                and not self.count_line_ends(last, comment.span.start)
            ):
                previous_item.comment = text
            else:
                item_list.append(CommentItem(text, self.has_blank_line(item_list, last, comment.span.start)))
            last = comment.span.end
        return last

    def make_statement(self, line: SourceLine, rule: str, blank_before: bool) -> LayoutStatement:
        reader = BracketReader(self.scan, self.function_ends, self.unary_minus_offsets, self.pop_comment_before)
        parts: list[LayoutNode | LayoutBlock] = []
        groups = iter(line.groups)
        index = 0
        while index < len(line.tokens):
            token = line.tokens[index]
            if token.kind == "open" and self.scan.clean_characters[token.start] == "{":
                first = parts[0].text if isinstance(parts[0], TokenLeaf) else ""
                parts.append(self.make_block(next(groups), rule, first))
                index += 2  # skip the closing brace; the tokens between belong to the group
                reader.skip_comments_before(line.tokens[index - 1])
            else:
                node, index = reader.read_node(line.tokens, index)
                parts.append(node)
        return LayoutStatement(rule, parts, blank_before)

    def make_block(self, group: BraceGroup, rule: str, first_word: str) -> LayoutBlock:
        inner = (
            "weight" if group.is_choice else BODY_RULE_BY_LINE.get((rule, first_word)) or BODY_RULE_BY_LINE.get((rule, "*")) or ""
        )
        start, end = group.opening.end, group.closing_brace.start
        head = None
        comments = self.scan.comments
        limit = group.lines[0].start if group.lines else end
        if self.used_comment_count < len(comments) and not self.count_line_ends(
            start, comments[self.used_comment_count].span.start
        ):
            comment = self.pop_comment_before(limit)
            if comment is not None:
                head, start = comment.text.rstrip(), comment.span.end
        item_list = self.read_lines(group.lines, inner, start, end)
        return LayoutBlock(item_list, self.is_one_line(group, item_list, head), head)

    def is_one_line(self, group: BraceGroup, item_list: list[LayoutItem], opening_comment: str | None) -> bool:
        """Return whether a block may be on one line. It may if it has no line ends or comments in the source, and no part that
        needs a separate line."""
        if not item_list and opening_comment is None:
            return True
        for item in item_list:
            if isinstance(item, CommentItem) or item.comment is not None:
                return False
            if any(needs_own_lines(part) for part in item.parts):
                return False
        if opening_comment is not None:
            return False
        ends = [group.opening.end, *(line.end for line in group.lines)]
        starts = [*(line.start for line in group.lines), group.closing_brace.start]
        return not any(self.count_line_ends(end, start) for end, start in zip(ends, starts, strict=True))
