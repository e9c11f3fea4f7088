"""Tokens → words with the blank before each, and brackets with the slots between their commas.

A comment inside brackets stands behind a slot or on separate lines before it; one from the middle of a slot moves before it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from antdsl.syntax import nodes as n
from antdsl.syntax.scan import ScannedToken, TokenScan
from antdsl.syntax.words import QUANTITY_PATTERN

# Precedence of operators, lowest first, for breaking a long value. `..` separates the ends of a range.
_BINDING_LEVELS = (("..",), ("then", "else"), ("or",), ("and",), ("<", ">", "<=", ">=", "==", "!="), ("+", "-"), ("*", "/"))


@dataclass(slots=True)
class TokenLeaf:
    """One token as in the source, and whether a blank precedes it. `joins`: true for a sign between two values."""

    text: str
    blank: bool
    kind: str = "word"
    joins: bool = False

    @property
    def flat(self) -> str:
        return f" {self.text}" if self.blank else self.text


@dataclass(slots=True)
class BracketSlot:
    """The content between two commas, with the comma. `lead`: comments on lines before it. `trail`: the comment after it.
    `inner`: comments in its middle, each with the index of the next node."""

    nodes: list[LayoutNode] = field(default_factory=list)
    lead: list[n.Comment] = field(default_factory=list)
    trail: n.Comment | None = None
    inner: list[tuple[int, n.Comment, bool]] = field(default_factory=list)
    operands: list[BracketSlot] = field(default_factory=list)  # the slot cut at its operators, if these have comments
    deeper: bool = False  # indented once more: the body after `n in SET:`

    @property
    def flat(self) -> str:
        return "".join(node.flat for node in self.nodes).lstrip(" ")

    @property
    def is_broken(self) -> bool:
        """Return whether a comment in the slot forces it onto separate lines."""
        inner = any(isinstance(node, BracketGroup) and node.forced for node in self.nodes)
        return inner or bool(self.lead or self.trail or self.operands)


@dataclass(slots=True)
class BracketGroup:
    """`( … )` or `[ … ]`. `tail`: comments before its end."""

    open: TokenLeaf
    slots: list[BracketSlot]
    close: TokenLeaf
    tail: list[n.Comment] = field(default_factory=list)
    forced: bool = False
    flat: str = ""


LayoutNode = TokenLeaf | BracketGroup


class BracketReader:
    """Reads the nodes of one statement. `comments` returns the next comment before an offset."""

    def __init__(
        self, scan: TokenScan, calls: frozenset[int], minus: frozenset[int], comments: Callable[[int], n.Comment | None]
    ) -> None:
        self.scan, self.calls, self.minus, self.comments = scan, calls, minus, comments
        self.last: ScannedToken | None = None

    def resume(self, token: ScannedToken) -> None:
        """Continue after a block that ended with this token."""
        self.last = token

    def read_node(self, tokens: Sequence[ScannedToken], index: int) -> tuple[LayoutNode, int]:
        """Return the node that begins with a token, and the index of the next one."""
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
            while (comment := self.comments(token.start)) is not None:
                self.place(comment, slots, token, left)
            if token.kind == "close":
                close = self.read_leaf(token)
                break
            sign = self.scan.clean[token.start]
            node, index = self.read_node(tokens, index)
            slot.nodes.append(node)
            if sign == "," or (sign == ":" and len(slots) == 1 and _is_comprehension(slot)):
                slots.append(BracketSlot(lead=left, deeper=sign == ":"))
        found = BracketGroup(opening, [_place_inner_comments(slot) for slot in slots if slot.nodes], close, left)
        return _measure_bracket(found), index + 1

    def place(self, comment: n.Comment, slots: list[BracketSlot], token: ScannedToken, left: list[n.Comment]) -> None:
        """Assign a comment before `token` to the slots so far, or to `left` if it comes after the last of them."""
        slot = slots[-1]
        assert self.last is not None
        beside = "\n" not in self.scan.source.text[self.last.end : comment.span.start] and not left
        if not slot.nodes:
            previous_slot = slots[-2] if len(slots) > 1 else None
            if beside and previous_slot is not None and previous_slot.trail is None and not slot.lead:
                previous_slot.trail = comment
            elif token.kind == "close":
                left.append(comment)
            else:
                slot.lead.append(comment)
        elif token.kind == "close" or self.scan.clean[token.start] == ",":
            if beside and slot.trail is None:
                slot.trail = comment
            else:
                left.append(comment)
        else:
            slot.inner.append((len(slot.nodes), comment, beside))

    def read_leaf(self, token: ScannedToken) -> TokenLeaf:
        text = "".join(self.scan.clean[token.start : token.end])
        blank = self.needs_blank(token, text)
        joins = token.kind in ("word", "sign") and token.start not in self.minus
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
        previous_text = "".join(self.scan.clean[self.last.start : self.last.end])
        if previous_text in ("(", "[", ".") or text in (")", "]", ",", ":", ".", "["):
            return False
        if self.last.start in self.minus:
            return False
        return not (text == "(" and (self.last.end in self.calls or previous_text in (")", "]")))


def _is_comprehension(slot: BracketSlot) -> bool:
    """Return whether the nodes are `n in SET:`, with the colon as the last node."""
    second = slot.nodes[1] if len(slot.nodes) > 3 else None
    return isinstance(second, TokenLeaf) and second.text == "in"


def split_operands(slot: BracketSlot) -> list[BracketSlot]:
    """Split the slot before its operators of lowest precedence; return it alone if there are none."""
    for level in _BINDING_LEVELS:
        cuts = [k for k, node in enumerate(slot.nodes) if k and isinstance(node, TokenLeaf) and node.joins and node.text in level]
        if cuts:
            ends = [*cuts, len(slot.nodes)]
            return [BracketSlot(slot.nodes[start:end]) for start, end in zip([0, *cuts], ends, strict=True)]
    return [slot]


def _place_inner_comments(slot: BracketSlot) -> BracketSlot:
    """Return the slot with its inner comments moved before it or between its operands."""
    if not slot.inner:
        return slot
    cut = split_operands(slot)
    if len(cut) == 1:
        slot.lead += [*(comment for _, comment, _ in slot.inner), *_take_comments(slot.nodes)]
        slot.lead.sort(key=lambda comment: comment.span.start)
        slot.inner = []
        return slot
    starts = [0]
    for operand in cut:
        starts.append(starts[-1] + len(operand.nodes))
    for place, comment, beside in slot.inner:
        number = next(k for k in range(len(cut)) if place < starts[k + 1])
        operand = cut[number]
        if place == starts[number] and beside and number and cut[number - 1].trail is None and not operand.lead:
            cut[number - 1].trail = comment
        elif place == starts[number]:
            operand.lead.append(comment)
        else:
            operand.inner.append((place - starts[number], comment, beside))
    slot.inner = []
    cut = [_place_inner_comments(operand) for operand in cut]
    if any(operand.lead for operand in cut[1:]) or any(operand.trail or operand.operands for operand in cut):
        slot.operands = cut
    else:
        slot.lead += cut[0].lead
    return slot


def _take_comments(nodes: Sequence[LayoutNode]) -> list[n.Comment]:
    """Remove and return the comments inside brackets."""
    comments: list[n.Comment] = []
    for node in nodes:
        if isinstance(node, BracketGroup) and node.forced:
            for slot in node.slots:
                comments += [*_take_slot_comments(slot), *_take_comments(slot.nodes)]
            comments += node.tail
            node.tail = []
            _measure_bracket(node)
    return comments


def _take_slot_comments(slot: BracketSlot) -> list[n.Comment]:
    """Remove and return the comments around a slot and between its operands."""
    comments = [*slot.lead, *([slot.trail] if slot.trail else [])]
    for operand in slot.operands:
        comments += _take_slot_comments(operand)
    slot.lead, slot.trail, slot.operands = [], None, []
    return comments


def _measure_bracket(bracket: BracketGroup) -> BracketGroup:
    """Record a bracket's flat text and whether it must be broken, so that no later call descends into it again."""
    bracket.forced = bool(bracket.tail) or any(slot.is_broken for slot in bracket.slots)
    bracket.flat = bracket.open.flat + " ".join(slot.flat for slot in bracket.slots) + bracket.close.flat
    return bracket
