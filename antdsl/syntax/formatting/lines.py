"""Converts the items of a text to lines. A line that is too long is broken inside its brackets. A block stays on one line if the
author wrote it on one line and it fits."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.syntax.formatting.brackets import BracketGroup, BracketSlot, LayoutNode, TokenLeaf, split_operands
from antdsl.syntax.formatting.columns import LayoutRow, align_rows, split_cells
from antdsl.syntax.formatting.items import LayoutBlock, LayoutItem, LayoutStatement, RemarkItem, needs_own_lines

MAX_LINE_CHARACTERS = 120  # characters of a line that can be broken
INDENT_BLANKS = 2  # indent of a block

LayoutPart = LayoutNode | LayoutBlock


def text_of_items(items: Sequence[LayoutItem]) -> str:
    """Return the text of a file from its items."""
    return "".join(f"{line}\n" for line in _block_lines(items, 0))


def _block_lines(items: Sequence[LayoutItem], indent: int) -> list[str]:
    """Return the lines of the items of a block, indented by `indent` blanks."""
    rows = [_make_row(item, indent) for item in items]
    return align_rows(rows, indent)


def _make_row(item: LayoutItem, indent: int) -> LayoutRow:
    if isinstance(item, RemarkItem):
        return LayoutRow("remark", [item.text], [], None, item.blank_before, True)
    lines = _statement_lines(item.parts, indent)
    if len(lines) > 1:
        return LayoutRow("long", lines[:1], lines[1:], item.comment, item.blank_before, True)
    kind, parts = split_cells(item)
    return LayoutRow(kind, [_flat_text(part).strip(" ") for part in parts], [], item.comment, item.blank_before, False)


def _flat_text(parts: Sequence[LayoutPart]) -> str:
    """Return parts as text on one line."""
    return "".join(_flat_block(part) if isinstance(part, LayoutBlock) else part.flat for part in parts)


def _flat_block(block: LayoutBlock) -> str:
    if not block.items:
        return " {}"
    return " { " + "; ".join(_flat_text(item.parts) for item in block.items if isinstance(item, LayoutStatement)) + " }"


def _statement_lines(parts: Sequence[LayoutPart], indent: int) -> list[str]:
    """Return the lines of a statement; the first has no indent."""
    blocks = [k for k, part in enumerate(parts) if isinstance(part, LayoutBlock)]
    opened = [k for k in blocks if needs_own_lines(parts[k])]
    for start, end in zip([-1, *opened], [*opened, len(parts)], strict=True):
        inner = [k for k in blocks if start < k < end]
        if inner and indent + len(_piece_text(parts, start, min(end, inner[-1] + 1))) > MAX_LINE_CHARACTERS:
            opened += inner
    opened.sort()
    lines = [""]
    for start, end in zip([-1, *opened], [*opened, len(parts)], strict=True):
        block = parts[end] if end < len(parts) else None
        piece = _sequence_lines(parts[start + 1 : end], indent, len(lines[-1]) or indent, len(" {") if block else 0)
        lines[-1] += piece[0]
        lines += piece[1:]
        if isinstance(block, LayoutBlock):
            lines[-1] += " {" + (f"  {block.head}" if block.head else "")
            lines += _block_lines(block.items, indent + INDENT_BLANKS)
            lines.append(" " * indent + "}")
    return lines


def _piece_text(parts: Sequence[LayoutPart], start: int, end: int) -> str:
    """Return the line between two broken blocks, with the braces before and after it."""
    text = _flat_text(parts[start + 1 : end])
    return ("}" if start >= 0 else "") + text + (" {" if end < len(parts) and isinstance(parts[end], LayoutBlock) else "")


def _sequence_lines(parts: Sequence[LayoutPart], indent: int, column: int, suffix: int = 0) -> list[str]:
    """Lay out successive parts from a column on. A bracket is broken if it does not fit together with what follows up to the next
    bracket. `suffix` characters follow the last part."""
    lines = [""]
    for k, part in enumerate(parts):
        if isinstance(part, BracketGroup) and (part.forced or column + _required_width(parts, k, suffix) > MAX_LINE_CHARACTERS):
            inside = _bracket_lines(part, indent)
            lines[-1] += inside[0]
            lines += inside[1:]
            column = len(lines[-1])
        else:
            text = _flat_text([part])
            lines[-1] += text
            column += len(text)
    return lines


def _required_width(parts: Sequence[LayoutPart], start: int, suffix: int) -> int:
    """Return the number of characters that must fit on the line if a bracket is not broken. A help text at its end does not
    count."""
    count = len(_flat_text([parts[start]]))
    for part in parts[start + 1 :]:
        if isinstance(part, BracketGroup):
            return count + len(part.open.flat)
        if not (part is parts[-1] and isinstance(part, TokenLeaf) and part.kind == "text"):
            count += len(_flat_text([part]))
    return count + suffix


def _bracket_lines(bracket: BracketGroup, indent: int) -> list[str]:
    """Return a bracket with each slot on separate lines."""
    if not bracket.slots and not bracket.tail:
        return [bracket.flat]
    lines = [bracket.open.flat]
    for slot in bracket.slots:
        lines += _slot_lines(
            slot,
            indent + INDENT_BLANKS * (2 if slot.deeper else 1),
            INDENT_BLANKS if len(bracket.slots) > 1 and not slot.deeper else 0,
        )
    lines += [" " * (indent + INDENT_BLANKS) + comment.text.rstrip() for comment in bracket.tail]
    lines.append(" " * indent + bracket.close.flat)
    return lines


def _slot_lines(slot: BracketSlot, indent: int, deeper: int) -> list[str]:
    """Return the lines of a slot; its operands after the first are indented by `deeper`."""
    lines = [" " * indent + comment.text.rstrip() for comment in slot.lead]
    parts = slot.operands or split_operands(slot)
    flat = slot.flat
    if (
        not slot.operands
        and not any(isinstance(node, BracketGroup) and node.forced for node in slot.nodes)
        and indent + len(flat) <= MAX_LINE_CHARACTERS
    ):
        lines.append(" " * indent + flat)
    elif len(parts) > 1:
        for number, operand in enumerate(parts):
            lines += _slot_lines(operand, indent + (deeper if number else 0), INDENT_BLANKS)
    else:
        inside = _sequence_lines(slot.nodes, indent, indent)
        lines += [" " * indent + inside[0].lstrip(" "), *inside[1:]]
    if slot.trail is not None:
        lines[-1] += f"  {slot.trail.text.rstrip()}"
    return lines
