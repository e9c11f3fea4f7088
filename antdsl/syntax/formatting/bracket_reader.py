"""Converts tokens to words, which record the blank before them, and to brackets, which have slots between their commas.

A comment inside brackets is placed after a slot, or on separate lines before the slot. A comment in the middle of a slot is
moved to the lines before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from antdsl.syntax import nodes as n
from antdsl.syntax.scan import ScannedToken, TokenScan
from antdsl.syntax.words import QUANTITY_PATTERN

# Precedence of operators, lowest first, for breaking a long value. `..` separates the ends of a range.
_PRECEDENCE_LEVELS = (("..",), ("then", "else"), ("or",), ("and",), ("<", ">", "<=", ">=", "==", "!="), ("+", "-"), ("*", "/"))


@dataclass(slots=True)
class TokenLeaf:
    """A token with its text in the source and whether a blank precedes it. `is_infix`: whether it is a sign between two
    values."""

    text: str
    has_blank_before: bool
    kind: str = "word"
    is_infix: bool = False

    @property
    def flat_text(self) -> str:
        return f" {self.text}" if self.has_blank_before else self.text


@dataclass(slots=True)
class BracketSlot:
    """The content of a bracket between two commas. It includes the second comma.

    - `leading_comments`: the comments on the lines before the content. `trailing_comment`: the comment after the content.
    - `inner_comments`: for each comment in the middle, the index of the next node, the comment, and whether the previous token
      is on the same line.
    - `operands`: the content, split at its operators; empty unless there are comments between the operands.
    - `is_indented`: whether the content is indented one level more, as for the body after `n in SET:`."""

    nodes: list[LayoutNode] = field(default_factory=list)
    leading_comments: list[n.Comment] = field(default_factory=list)
    trailing_comment: n.Comment | None = None
    inner_comments: list[tuple[int, n.Comment, bool]] = field(default_factory=list)
    operands: list[BracketSlot] = field(default_factory=list)  # the slot cut at its operators, if these have comments
    is_indented: bool = False  # indented once more: the body after `n in SET:`

    @property
    def flat_text(self) -> str:
        return "".join(node.flat_text for node in self.nodes).lstrip(" ")

    @property
    def is_broken(self) -> bool:
        """Return whether a comment in the slot forces it onto separate lines."""
        inner = any(isinstance(node, BracketGroup) and node.is_forced_open for node in self.nodes)
        return inner or bool(self.leading_comments or self.trailing_comment or self.operands)


@dataclass(slots=True)
class BracketGroup:
    """A pair of parentheses or square brackets with its content. `end_comments`: the comments before the closing bracket.

    `is_forced_open`: whether a comment forces the content onto separate lines."""

    opening: TokenLeaf
    slots: list[BracketSlot]
    closing_leaf: TokenLeaf
    end_comments: list[n.Comment] = field(default_factory=list)
    is_forced_open: bool = False
    flat_text: str = ""


LayoutNode = TokenLeaf | BracketGroup


class BracketReader:
    """Reader of the words and brackets of one statement.

    `pop_comment_before`: returns the next comment if it is before an offset, and marks it as used."""

    def __init__(
        self,
        scan: TokenScan,
        function_ends: frozenset[int],
        unary_minus_offsets: frozenset[int],
        pop_comment_before: Callable[[int], n.Comment | None],
    ) -> None:
        self.scan, self.function_ends, self.unary_minus_offsets, self.take_comment_before = (
            scan,
            function_ends,
            unary_minus_offsets,
            pop_comment_before,
        )
        self.last: ScannedToken | None = None

    def skip_comments_before(self, token: ScannedToken) -> None:
        """Mark the comments before `token`, the last token of a block, as already placed."""
        self.last = token

    def read_node(self, tokens: Sequence[ScannedToken], index: int) -> tuple[LayoutNode, int]:
        """Return the node that begins with the token at `index`, and the index of the token after the node."""
        token = tokens[index]
        leaf = self.read_leaf(token)
        if token.kind != "open":
            return leaf, index + 1
        return self.read_bracket(leaf, tokens, index + 1)

    def read_bracket(self, opening: TokenLeaf, tokens: Sequence[ScannedToken], index: int) -> tuple[BracketGroup, int]:
        slots = [BracketSlot()]
        while True:
            token, slot = tokens[index], slots[-1]
            left: list[n.Comment] = []  # comments without a slot yet
            while (comment := self.take_comment_before(token.start)) is not None:
                self.place_comment(comment, slots, token, left)
            if token.kind == "close":
                close = self.read_leaf(token)
                break
            sign = self.scan.clean_characters[token.start]
            node, index = self.read_node(tokens, index)
            slot.nodes.append(node)
            if sign == "," or (sign == ":" and len(slots) == 1 and _is_comprehension(slot)):
                slots.append(BracketSlot(leading_comments=left, is_indented=sign == ":"))
        found = BracketGroup(opening, [_place_inner_comments(slot) for slot in slots if slot.nodes], close, left)
        return _set_flat_text(found), index + 1

    def place_comment(
        self, comment: n.Comment, slots: list[BracketSlot], token: ScannedToken, remaining_comments: list[n.Comment]
    ) -> None:
        """Assign a comment before `token` to one of the slots that have been read. If the comment comes after the last slot, add
        it to `remaining_comments`."""
        slot = slots[-1]
        assert self.last is not None
        is_on_same_line = "\n" not in self.scan.source.text[self.last.end : comment.span.start] and not remaining_comments
        if not slot.nodes:
            previous_slot = slots[-2] if len(slots) > 1 else None
            if (
                is_on_same_line
                and previous_slot is not None
                and previous_slot.trailing_comment is None
                and not slot.leading_comments
            ):
                previous_slot.trailing_comment = comment
            elif token.kind == "close":
                remaining_comments.append(comment)
            else:
                slot.leading_comments.append(comment)
        elif token.kind == "close" or self.scan.clean_characters[token.start] == ",":
            if is_on_same_line and slot.trailing_comment is None:
                slot.trailing_comment = comment
            else:
                remaining_comments.append(comment)
        else:
            slot.inner_comments.append((len(slot.nodes), comment, is_on_same_line))

    def read_leaf(self, token: ScannedToken) -> TokenLeaf:
        text = "".join(self.scan.clean_characters[token.start : token.end])
        blank = self.needs_blank(token, text)
        joins = token.kind in ("word", "sign") and token.start not in self.unary_minus_offsets
        self.last = token
        if token.kind == "number":
            parts = QUANTITY_PATTERN.match(text)
            assert parts is not None
            text = " ".join(part for part in parts.groups() if part)
        return TokenLeaf(text, blank, token.kind, joins)

    def needs_blank(self, token: ScannedToken, text: str) -> bool:
        """Return whether a blank is needed before a token."""
        if self.last is None:
            return False
        previous_text = "".join(self.scan.clean_characters[self.last.start : self.last.end])
        if previous_text in ("(", "[", ".") or text in (")", "]", ",", ":", ".", "["):
            return False
        if self.last.start in self.unary_minus_offsets:
            return False
        return not (text == "(" and (self.last.end in self.function_ends or previous_text in (")", "]")))


def _is_comprehension(slot: BracketSlot) -> bool:
    """Return whether a slot is the beginning of a comprehension: `n in SET:`, with the colon as its last node."""
    second = slot.nodes[1] if len(slot.nodes) > 3 else None
    return isinstance(second, TokenLeaf) and second.text == "in"


def split_operands(slot: BracketSlot) -> list[BracketSlot]:
    """Return the content of a slot, split before its operators of lowest precedence. Without operators, there is one part."""
    for level in _PRECEDENCE_LEVELS:
        cuts = [
            k for k, node in enumerate(slot.nodes) if k and isinstance(node, TokenLeaf) and node.is_infix and node.text in level
        ]
        if cuts:
            ends = [*cuts, len(slot.nodes)]
            return [BracketSlot(slot.nodes[start:end]) for start, end in zip([0, *cuts], ends, strict=True)]
    return [slot]


def _place_inner_comments(slot: BracketSlot) -> BracketSlot:
    """Return the slot with its inner comments moved before it or between its operands."""
    if not slot.inner_comments:
        return slot
    cut = split_operands(slot)
    if len(cut) == 1:
        slot.leading_comments += [*(comment for _, comment, _ in slot.inner_comments), *_collect_comments(slot.nodes)]
        slot.leading_comments.sort(key=lambda comment: comment.span.start)
        slot.inner_comments = []
        return slot
    starts = [0]
    for operand in cut:
        starts.append(starts[-1] + len(operand.nodes))
    for place, comment, is_on_same_line in slot.inner_comments:
        number = next(k for k in range(len(cut)) if place < starts[k + 1])
        operand = cut[number]
        if (
            place == starts[number]
            and is_on_same_line
            and number
            and cut[number - 1].trailing_comment is None
            and not operand.leading_comments
        ):
            cut[number - 1].trailing_comment = comment
        elif place == starts[number]:
            operand.leading_comments.append(comment)
        else:
            operand.inner_comments.append((place - starts[number], comment, is_on_same_line))
    slot.inner_comments = []
    cut = [_place_inner_comments(operand) for operand in cut]
    if any(operand.leading_comments for operand in cut[1:]) or any(
        operand.trailing_comment or operand.operands for operand in cut
    ):
        slot.operands = cut
    else:
        slot.leading_comments += cut[0].leading_comments
    return slot


def _collect_comments(nodes: Sequence[LayoutNode]) -> list[n.Comment]:
    """Return the comments inside brackets, and remove them from the nodes."""
    comments: list[n.Comment] = []
    for node in nodes:
        if isinstance(node, BracketGroup) and node.is_forced_open:
            for slot in node.slots:
                comments += [*_collect_slot_comments(slot), *_collect_comments(slot.nodes)]
            comments += node.end_comments
            node.end_comments = []
            _set_flat_text(node)
    return comments


def _collect_slot_comments(slot: BracketSlot) -> list[n.Comment]:
    """Return the comments around a slot and between its operands, and remove them from the slot."""
    comments = [*slot.leading_comments, *([slot.trailing_comment] if slot.trailing_comment else [])]
    for operand in slot.operands:
        comments += _collect_slot_comments(operand)
    slot.leading_comments, slot.trailing_comment, slot.operands = [], None, []
    return comments


def _set_flat_text(bracket: BracketGroup) -> BracketGroup:
    """Return the bracket after storing in it its text on one line, and whether it must be broken into several lines. So both are
    computed only once."""
    bracket.is_forced_open = bool(bracket.end_comments) or any(slot.is_broken for slot in bracket.slots)
    bracket.flat_text = (
        bracket.opening.flat_text + " ".join(slot.flat_text for slot in bracket.slots) + bracket.closing_leaf.flat_text
    )
    return bracket
