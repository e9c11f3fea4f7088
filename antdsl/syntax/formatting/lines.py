"""Converts the items of a text to lines. A line that is too long is broken inside its brackets. A block stays on one line if it
is on one line in the source and fits."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.syntax.formatting.bracket_reader import BracketGroup, BracketSlot, LayoutNode, TokenLeaf, split_operands
from antdsl.syntax.formatting.columns import LayoutRow, align_rows, split_cells
from antdsl.syntax.formatting.items import CommentItem, LayoutBlock, LayoutItem, LayoutStatement, needs_own_lines

MAX_LINE_CHARACTERS = 120  # characters of a line that can be broken
INDENT_BLANKS = 2  # indent of a block

LayoutPart = LayoutNode | LayoutBlock


def format_items(items: Sequence[LayoutItem]) -> str:
    """Return the text of the file that consists of `items`."""
    return "".join(f"{line}\n" for line in _format_block(items, 0))


def _format_block(items: Sequence[LayoutItem], indent: int) -> list[str]:
    """Return the lines of the items of a block, indented by `indent` blanks."""
    rows = [_make_row(item, indent) for item in items]
    return align_rows(rows, indent)


def _make_row(item: LayoutItem, indent: int) -> LayoutRow:
    if isinstance(item, CommentItem):
        return LayoutRow("remark", [item.text], [], None, item.has_blank_before, True)
    lines = _format_statement(item.parts, indent)
    if len(lines) > 1:
        return LayoutRow("long", lines[:1], lines[1:], item.comment, item.has_blank_before, True)
    kind, parts = split_cells(item)
    return LayoutRow(kind, [_format_flat(part).strip(" ") for part in parts], [], item.comment, item.has_blank_before, False)


def _format_flat(parts: Sequence[LayoutPart]) -> str:
    """Return parts as text on a single line."""
    return "".join(_format_flat_block(part) if isinstance(part, LayoutBlock) else part.flat_text for part in parts)


def _format_flat_block(block: LayoutBlock) -> str:
    if not block.items:
        return " {}"
    return " { " + "; ".join(_format_flat(item.parts) for item in block.items if isinstance(item, LayoutStatement)) + " }"


def _format_statement(parts: Sequence[LayoutPart], indent: int) -> list[str]:
    """Return the lines of a statement. The first line has no indent."""
    blocks = [k for k, part in enumerate(parts) if isinstance(part, LayoutBlock)]
    opened = [k for k in blocks if needs_own_lines(parts[k])]
    for start, end in zip([-1, *opened], [*opened, len(parts)], strict=True):
        inner = [k for k in blocks if start < k < end]
        if inner and indent + len(_format_piece(parts, start, min(end, inner[-1] + 1))) > MAX_LINE_CHARACTERS:
            opened += inner
    opened.sort()
    lines = [""]
    for start, end in zip([-1, *opened], [*opened, len(parts)], strict=True):
        block = parts[end] if end < len(parts) else None
        piece = _format_sequence(parts[start + 1 : end], indent, len(lines[-1]) or indent, len(" {") if block else 0)
        lines[-1] += piece[0]
        lines += piece[1:]
        if isinstance(block, LayoutBlock):
            lines[-1] += " {" + (f"  {block.opening_comment}" if block.opening_comment else "")
            lines += _format_block(block.items, indent + INDENT_BLANKS)
            lines.append(" " * indent + "}")
    return lines


def _format_piece(parts: Sequence[LayoutPart], start: int, end: int) -> str:
    """Return the line between two broken blocks. It includes the closing brace of the first block and the opening brace of the
    second one."""
    text = _format_flat(parts[start + 1 : end])
    return ("}" if start >= 0 else "") + text + (" {" if end < len(parts) and isinstance(parts[end], LayoutBlock) else "")


def _format_sequence(parts: Sequence[LayoutPart], indent: int, column: int, suffix: int = 0) -> list[str]:
    """Return the lines of successive parts. A bracket is broken into several lines if it does not fit on the line, together with
    the text up to the next bracket.

    `column`: the column of the first part. `suffix`: the number of characters after the last part."""
    lines = [""]
    for k, part in enumerate(parts):
        if isinstance(part, BracketGroup) and (
            part.is_forced_open or column + _compute_required_width(parts, k, suffix) > MAX_LINE_CHARACTERS
        ):
            inside = _format_bracket(part, indent)
            lines[-1] += inside[0]
            lines += inside[1:]
            column = len(lines[-1])
        else:
            text = _format_flat([part])
            lines[-1] += text
            column += len(text)
    return lines


def _compute_required_width(parts: Sequence[LayoutPart], start: int, suffix: int) -> int:
    """Return how many characters the line needs if the bracket at `start` is not broken. They end before the next bracket. A
    help text at the end does not count."""
    count = len(_format_flat([parts[start]]))
    for part in parts[start + 1 :]:
        if isinstance(part, BracketGroup):
            return count + len(part.opening.flat_text)
        if not (part is parts[-1] and isinstance(part, TokenLeaf) and part.kind == "text"):
            count += len(_format_flat([part]))
    return count + suffix


def _format_bracket(bracket: BracketGroup, indent: int) -> list[str]:
    """Return the lines of a bracket, with each slot on separate lines."""
    if not bracket.slots and not bracket.end_comments:
        return [bracket.flat_text]
    lines = [bracket.opening.flat_text]
    for slot in bracket.slots:
        lines += _format_slot(
            slot,
            indent + INDENT_BLANKS * (2 if slot.is_indented else 1),
            INDENT_BLANKS if len(bracket.slots) > 1 and not slot.is_indented else 0,
        )
    lines += [" " * (indent + INDENT_BLANKS) + comment.text.rstrip() for comment in bracket.end_comments]
    lines.append(" " * indent + bracket.closing_leaf.flat_text)
    return lines


def _format_slot(slot: BracketSlot, indent: int, operand_indent: int) -> list[str]:
    """Return the lines of a slot. All operands except the first are indented by `operand_indent`."""
    lines = [" " * indent + comment.text.rstrip() for comment in slot.leading_comments]
    parts = slot.operands or split_operands(slot)
    flat = slot.flat_text
    if (
        not slot.operands
        and not any(isinstance(node, BracketGroup) and node.is_forced_open for node in slot.nodes)
        and indent + len(flat) <= MAX_LINE_CHARACTERS
    ):
        lines.append(" " * indent + flat)
    elif len(parts) > 1:
        for number, operand in enumerate(parts):
            lines += _format_slot(operand, indent + (operand_indent if number else 0), INDENT_BLANKS)
    else:
        inside = _format_sequence(slot.nodes, indent, indent)
        lines += [" " * indent + inside[0].lstrip(" "), *inside[1:]]
    if slot.trailing_comment is not None:
        lines[-1] += f"  {slot.trailing_comment.text.rstrip()}"
    return lines
