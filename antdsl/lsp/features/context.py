"""The context of a position in a program: enclosing blocks, open call, and current word. It depends only on the text before the
position."""

from __future__ import annotations

import re
from dataclasses import dataclass

from antdsl.syntax.words import BODY_RULE_BY_LINE

_PIECE_PATTERN = re.compile(r'"[^"\n]*"?|#[^\n]*|[{}()\[\]\n;]')
_HEAD_WORD_PATTERN = re.compile(r"[a-z_][a-z_0-9]*")
_CALLED_NAME_PATTERN = re.compile(r"([a-z_][a-z_0-9]*(?:\.[a-z_][a-z_0-9]*)?)\s*$")


@dataclass(frozen=True, slots=True)
class ContextBlock:
    """A block that is still open at the position: the grammar rule for its lines, and the line that opened it."""

    rule: str
    opening_line: str


@dataclass(frozen=True, slots=True)
class CursorContext:
    """The context of a position, derived from the text before it.

    - `blocks`: the open blocks, outermost first.
    - `line`: the statement up to the position, without closed brackets and their content.
    - `word_prefix`: the unfinished word at the end of the line; "" if there is none.
    - `called_function`: the function of which the bracket is still open, if there is one. `arguments`: the text after this
      bracket."""

    blocks: tuple[ContextBlock, ...]
    line: str
    word_prefix: str
    called_function: str | None
    arguments: str
    is_in_text_or_comment: bool  # whether the cursor is in a text or a comment

    @property
    def rule(self) -> str:
        """Return the grammar rule of the innermost block."""
        return self.blocks[-1].rule if self.blocks else "top"

    def find_enclosing_name(self, rule: str, word: str) -> str | None:
        """Return the name of an enclosing block of a kind; None if there is none. For example, ("top", "species") gives
        `forager`. `rule`: the rule of the lines around the block. `word`: the first word of the block."""
        outer_rule = "top"
        for block in self.blocks:
            words = _HEAD_WORD_PATTERN.findall(block.opening_line)
            if outer_rule == rule and words[:1] == [word]:
                return words[1] if len(words) > 1 else ""
            outer_rule = block.rule
        return None


def is_line_start(text: str, start: int) -> bool:
    """Return whether the word at `start` is the first word of its statement. In a line of a state, `interrupt` may precede it."""
    return find_context(text, start).line.strip() in ("", "interrupt")


def find_context(text: str, offset: int) -> CursorContext:
    """Return the context of an offset. Any text is accepted, even if it is not a valid program."""
    blocks: list[ContextBlock] = []
    brackets: list[int] = []  # offsets of open round and square brackets in this statement
    begin, quiet = 0, False
    for piece in _PIECE_PATTERN.finditer(text, 0, offset):
        sign = piece.group()
        if sign[0] in '"#':
            quiet = piece.end() == offset and (sign[0] == "#" or len(sign) == 1 or sign[-1] != '"')
        elif sign == "{":
            head = text[begin : piece.start()].strip()
            rule, words = blocks[-1].rule if blocks else "top", _HEAD_WORD_PATTERN.findall(head)
            first = words[0] if words else ""
            inner = (
                BODY_RULE_BY_LINE.get((rule, first))
                or BODY_RULE_BY_LINE.get((rule, "*"))
                or ("weight" if words[-1:] == ["choose"] else "")
            )
            blocks.append(ContextBlock("weight" if words[-1:] == ["choose"] else inner, head))
            begin, brackets = piece.end(), []
        elif sign == "}":
            if blocks:
                blocks.pop()
            begin, brackets = piece.end(), []
        elif sign in "([":
            brackets.append(piece.start())
        elif sign in ")]":
            if brackets:
                brackets.pop()
        elif not brackets:
            begin = piece.end()
    line = text[begin:offset].lstrip()
    word = re.search(r"[A-Za-z_0-9]*$", line)
    called_function, arguments = None, ""
    if brackets and text[brackets[-1]] == "(":
        match = _CALLED_NAME_PATTERN.search(text, begin, brackets[-1])
        called_function = match.group(1) if match is not None else ""
        arguments = text[brackets[-1] + 1 : offset]
    return CursorContext(tuple(blocks), line, word.group() if word else "", called_function, arguments, quiet)
