"""Finds lines that continue the line above although no bracket is open, such as `and near -> approach` below `when meal`. They
are reported, and both lines are read as one."""

from __future__ import annotations

from dataclasses import replace

from antdsl.diagnostics.model import Fix
from antdsl.source import Span
from antdsl.syntax.scan import ScannedToken, TokenScan
from antdsl.syntax.words import LINE_WORDS_BY_RULE

# No separate line begins with these. A line of a behaviour or of `layers` may begin with `-` or `(`.
_CONTINUING_SIGNS = ("+", "*", "/", "^", "<", ">", "<=", ">=", "==", "!=", ",", ".")
_CONTINUING_WORDS = frozenset(
    (
        "and",
        "or",
        "then",
        "else",
        "held",
        "take",
        "is",
        "in",
        "over",
        "relax",
        "strongest",
        "except",
        "->",
        "..",
        *_CONTINUING_SIGNS,
    )
)
# Signs and words after which a statement is incomplete.
_INCOMPLETE_ENDINGS = frozenset(("and", "or", "then", "else", "-", "..", *_CONTINUING_SIGNS))
_LINE_WORDS = frozenset(word for words in LINE_WORDS_BY_RULE.values() for word in words)


def join_continued_lines(scan: TokenScan) -> list[ScannedToken]:
    """Return the tokens of a text without the line ends inside continued statements. Report each such statement."""
    tokens, open, indent = list(scan.tokens), 0, 0
    joints: list[int] = []  # indices of line ends inside one statement
    left_out: set[int] = set()
    for index, token in enumerate(tokens):
        text = _get_token_text(scan, token)
        indent = token.indent if token.indent >= 0 and not (joints and joints[-1] == index - 1) else indent
        open = open + 1 if text in ("(", "[") else max(0, open - 1) if text in (")", "]") else 0 if text in ("{", "}") else open
        if token.kind != "end" or open:
            continue
        if _is_continuation(scan, tokens, index, indent):
            joints.append(index)
            left_out.add(index)
            scan.replace_by_blanks(token.start, token.end)
            tokens[index + 1] = replace(tokens[index + 1], indent=-1)
        elif joints:
            _report_continuations(scan, tokens, joints)
            joints = []
    if joints:
        _report_continuations(scan, tokens, joints)
    return [token for index, token in enumerate(tokens) if index not in left_out] if left_out else scan.tokens


def _get_token_text(scan: TokenScan, token: ScannedToken) -> str:
    return "".join(scan.clean_characters[token.start : token.end])


def _is_continuation(scan: TokenScan, tokens: list[ScannedToken], index: int, indent: int) -> bool:
    """Return whether the line after a line end continues the line before the line end. `index`: the index of the token of the
    line end. `indent`: the indent of the line before."""
    if index + 1 >= len(tokens) or index == 0 or scan.source.text[tokens[index].start] != "\n":
        return False
    previous_token, following = tokens[index - 1], tokens[index + 1]
    if previous_token.kind == "end" or _get_token_text(scan, previous_token) in ("{", "}") or following.kind == "end":
        return False
    word = _get_token_text(scan, following)
    if word in _CONTINUING_WORDS:
        second_word = _get_token_text(scan, tokens[index + 2]) if index + 2 < len(tokens) else ""
        return not word.isalpha() or second_word not in ("=", ":")
    return (
        _get_token_text(scan, previous_token) in _INCOMPLETE_ENDINGS
        and following.indent > indent
        and word not in _LINE_WORDS
        and word not in "{}"
    )


def _report_continuations(scan: TokenScan, tokens: list[ScannedToken], line_end_indices: list[int]) -> None:
    text, following = scan.source.text, tokens[line_end_indices[0] + 1]
    word = text[following.start : following.end]
    start, end = tokens[line_end_indices[0] - 1].end, tokens[line_end_indices[-1] + 1].start
    joined_text, copied_end = "", start
    for joint in line_end_indices:
        joined_text += text[copied_end : tokens[joint - 1].end] + " "
        copied_end = tokens[joint + 1].start
    comment = any(start <= each.span.start < end for each in scan.comments)
    reason = f"`{word}` cannot begin a line" if word in _CONTINUING_WORDS else "the previous line is incomplete"
    span = Span(scan.source, following.start, following.end)
    help = "write everything on one line, or put a part with several lines in round brackets"
    fix = None if comment else Fix(Span(scan.source, start, end), joined_text)
    scan.report.error("continued-line", f"this line continues the line above: {reason}", span, help, fix=fix)
    scan.fault_offsets.append(following.start)
