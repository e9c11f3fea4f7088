"""Explains an unexpected token in one message, in words that an artist understands."""

from __future__ import annotations

import re
from dataclasses import dataclass

from antdsl.diagnostics.model import Diagnostic, Fix, find_fix
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.source import Span
from antdsl.syntax.mistakes.number_slips import find_comma_number, find_unit_help, make_comma_diagnostic
from antdsl.syntax.words import (
    CONTINUATION_TEXTS,
    EXAMPLE_LINE_BY_RULE,
    EXAMPLE_LINES,
    FIELD_SETTING_WORDS,
    FOREIGN_FIRST_WORDS,
    LINE_CONTEXT_BY_WORD,
    LINE_WORDS_BY_RULE,
    UNIT_NAMES,
    UNIT_SLIP_HELP,
    WORLD_KIND_WORDS,
)


@dataclass(frozen=True, slots=True)
class UnexpectedToken:
    """The token at which the parser could not continue to read a line. `rule`: the grammar rule that reads the line.
    - `previous_text`: the text of the previous token. `token_text`: the text of the token; "" at the end of the line.
    - `expected_terminals`: the names of the terminals that were possible in place of the token."""

    rule: str
    first_word: str
    previous_text: str
    previous_kind: str
    token_text: str
    token_kind: str
    span: Span
    first_span: Span
    expected_terminals: frozenset[str]
    following_text: str = ""  # the text after `token_text`
    earlier_text: str = ""  # the text before `previous_text`


# Terminals that a line needs after a complete value, the most informative first.
_REQUIRED_TERMINALS = (
    ("ARROW", "`->`"), ("_THEN", "`then`"), ("_ELSE", "`else`"), ("UNTIL", "`until`"), ("_OVER", "`over`"),
    ("FROM", "`from`"), ("RPAR", "`)`"), ("RSQB", "`]`"), ("_DOTS", "`..`"), ("LBRACE", "`{`"), ("EQUAL", "`=`"), ("ON", "`on`"),
    ("_COLON", "`:`"), ("_STRONGEST", "`strongest`"), ("_TO", "`to`"), ("_IN", "`in`"), ("WHEN", "`when`"), ("ANY", "`any`"),
    ("AT", "`at`"), ("_LEAST", "`least`"), ("EACH", "`each`"), ("AS", "`as`"), ("_COMMA", "`,`"),
)  # fmt: skip
# Words that join the parts of a line. Another word there may be a misspelling of one of these.
_JOINING_WORDS = frozenset(
    ("any", "at", "each", "else", "except", "from", "held", "least", "over", "strongest", "take", "then", "until", "when")
)
_VALUE_TERMINALS = frozenset({"NUMBER", "QUANTITY", "NAME", "LPAR"})
_SIGNS_AFTER_TARGET = {"=", "+=", "-=", "[", "."}
# Words before a condition in brackets, where no argument name is possible.
_QUERY_START_PATTERN = re.compile(r"\b(?:share|count|any|every)\(\s*[a-z_][a-z_0-9.]*\s*\Z|[(,]\s*(?:state|previous|next)\s*\Z")
_ASSIGNMENT_OPERATORS = ("=", "+=", "-=")
# Terminals after which a value begins.
_WORDS_BEFORE_VALUES = ("when", "and", "or", "not", "no", "steer", "face", "then", "else", "if", "until")
_VALUE_STARTING_WORDS = frozenset((*_WORDS_BEFORE_VALUES, *"=<>+-*/", *_ASSIGNMENT_OPERATORS, "<=", ">=", "=="))
_COMPARISON_SIGNS = {"==", "!=", "<", ">", "<=", ">=", "is"}


def make_diagnostic(unexpected: UnexpectedToken) -> Diagnostic:
    """Return the error about a line that cannot be read. It explains the first kind of mistake that matches."""
    for kind in (
        _explain_quoted_library, _explain_inner_after, _explain_misspelling, _explain_misplaced, _explain_comma,
        _explain_no_line, _explain_label, _explain_unit, _explain_equals, _explain_double_comparison,
        _explain_second_line, _explain_unfinished,
    ):  # fmt: skip
        diagnostic = kind(unexpected)
        if diagnostic is not None:
            return diagnostic
    message = f"found {_quote_text(unexpected.token_text)}"
    if unexpected.previous_text:
        message += f" after {_quote_text(unexpected.previous_text)}"
    help, fix = _format_form(unexpected), None
    slip = _find_misspelt_word(unexpected)
    if slip is not None:
        help, fix = f"did you mean `{slip}`?", Fix(unexpected.span, slip)
    elif _has_missing_colon(unexpected):
        fix = _make_fix_before_token(unexpected, ": ")
        help = f"to name an argument, write `{unexpected.previous_text}: {unexpected.token_text}`"
    elif (
        unexpected.token_kind == "word"
        and unexpected.following_text == ":"
        and {"RPAR", "_COMMA"} <= unexpected.expected_terminals
    ):
        help, fix = f"write a comma before `{unexpected.token_text}:`", _make_fix_after_previous(unexpected, ",")
    elif _has_missing_arrow(unexpected):
        help, fix = f"write `-> {unexpected.token_text}`", _make_fix_before_token(unexpected, "-> ")
    elif has_missing_brackets(unexpected):
        help = f"write `{unexpected.previous_text}({unexpected.token_text})`"
        place = Span(unexpected.span.source, _make_fix_after_previous(unexpected, "").span.start, unexpected.span.end)
        fix = Fix(place, f"({unexpected.token_text})")
    return Diagnostic(
        "unexpected-text", f"{message}, expected {_describe_expected(unexpected)}", unexpected.span, help=help, fix=fix
    )


def _explain_inner_after(unexpected: UnexpectedToken) -> Diagnostic | None:
    """Return the error about `after` inside a condition, as in `when meal and after 1 s`. Return None for any other mistake."""
    if unexpected.previous_text != "after" or unexpected.earlier_text not in ("and", "or") or unexpected.token_kind != "number":
        return None
    source = unexpected.span.source
    start = source.text.rindex("after", 0, unexpected.span.start)
    span, text = Span(source, start, start + len("after")), "time_in_state >="
    message = f"`after {unexpected.token_text}` cannot be joined with a condition"
    help = f"write `{text} {unexpected.token_text}` instead"
    return Diagnostic("unexpected-text", message, span, help=help, fix=Fix(span, text))


def _explain_quoted_library(unexpected: UnexpectedToken) -> Diagnostic | None:
    """Return the error about a library in quotes, as in `use "steering"`. Return None for any other mistake."""
    name = unexpected.previous_text.strip('"')
    if unexpected.first_word != "use" or "AS" not in unexpected.expected_terminals or not name.isidentifier():
        return None
    start = unexpected.span.source.text.rindex(unexpected.previous_text, 0, unexpected.span.start)
    span = Span(unexpected.span.source, start, start + len(unexpected.previous_text))
    return Diagnostic(
        "unexpected-text",
        f"`{unexpected.previous_text}` in quotes is not a file",
        span,
        help=f"write `{name}`",
        fix=Fix(span, name),
    )


def _find_misspelt_word(unexpected: UnexpectedToken) -> str | None:
    """Return the allowed word that was probably meant by the unexpected token. Return None if no allowed word is similar."""
    if unexpected.token_kind != "word" or len(unexpected.token_text) < 3 or "NAME" in unexpected.expected_terminals:
        return None
    words = [
        terminal.lstrip("_").lower()
        for terminal in unexpected.expected_terminals
        if terminal.lstrip("_").lower() in _JOINING_WORDS
    ]
    return find_nearest_name(unexpected.token_text, words)


def _has_missing_arrow(unexpected: UnexpectedToken) -> bool:
    return "ARROW" in unexpected.expected_terminals and unexpected.token_kind == "word" and unexpected.following_text in ("", "{")


def has_missing_brackets(unexpected: UnexpectedToken) -> bool:
    """Return whether brackets are missing, as in `touching nest`: two names in a row, the first of which may be a function."""
    names = unexpected.previous_kind == unexpected.token_kind == "word" and unexpected.following_text not in ("(", ".", "[", ":")
    return (
        names
        and unexpected.earlier_text in _VALUE_STARTING_WORDS
        and {unexpected.previous_text, unexpected.token_text}.isdisjoint(_list_keywords() | _JOINING_WORDS)
    )


def _has_missing_colon(unexpected: UnexpectedToken) -> bool:
    arguments = {"RPAR", "_COMMA"} <= unexpected.expected_terminals and unexpected.rule != "top"
    is_single_argument = arguments and unexpected.earlier_text in ("(", ",") and unexpected.following_text in (",", ")")
    return is_single_argument and unexpected.previous_kind == "word" and unexpected.token_kind in ("number", "word")


def make_plain_diagnostic(unexpected: UnexpectedToken) -> Diagnostic:
    """Return the error about a line that cannot be read, without advice. It is used in files with very many mistakes."""
    if not unexpected.token_text:
        return Diagnostic("unfinished-line", f"line ends after {_quote_text(unexpected.previous_text)}", unexpected.span)
    return Diagnostic(
        "unexpected-text", f"found {_quote_text(unexpected.token_text)}, but the line cannot continue with it", unexpected.span
    )


def suggest_first_word(unexpected: UnexpectedToken) -> str | None:
    """Return the correct spelling of a line's first word. None if it is not misspelt, or the line has another valid meaning."""
    words = LINE_WORDS_BY_RULE[unexpected.rule]
    other = FOREIGN_FIRST_WORDS.get(unexpected.first_word)
    if other in words and unexpected.token_text not in _ASSIGNMENT_OPERATORS:
        return other
    declares = unexpected.earlier_text == unexpected.first_word and unexpected.token_text == "="  # `parm smell = …`
    if (
        unexpected.first_word in words
        or not unexpected.first_word.isidentifier()
        or (unexpected.token_text in (*_ASSIGNMENT_OPERATORS, "(") and not declares)
    ):
        return None
    return find_nearest_name(unexpected.first_word, words)


def _explain_misspelling(unexpected: UnexpectedToken) -> Diagnostic | None:
    suggestion = suggest_first_word(unexpected)
    if suggestion is None:
        return None
    message = f"`{unexpected.first_word}` does not begin a line here"
    return Diagnostic(
        "unknown-line",
        message,
        unexpected.first_span,
        help=f"did you mean `{suggestion}`?",
        fix=Fix(unexpected.first_span, suggestion),
    )


def _explain_misplaced(unexpected: UnexpectedToken) -> Diagnostic | None:
    if unexpected.first_word in LINE_WORDS_BY_RULE[unexpected.rule] or unexpected.first_word not in LINE_CONTEXT_BY_WORD:
        return None
    return make_misplaced_diagnostic(unexpected.first_word, unexpected.first_span)


def make_misplaced_diagnostic(word: str, span: Span) -> Diagnostic:
    """Return the error about a line that begins with a word that is only allowed elsewhere."""
    return Diagnostic("misplaced-line", f"`{word}` is not allowed here", span, help=f"it belongs {LINE_CONTEXT_BY_WORD[word]}")


def _explain_no_line(unexpected: UnexpectedToken) -> Diagnostic | None:
    words = LINE_WORDS_BY_RULE[unexpected.rule]
    if unexpected.previous_text or not words or unexpected.token_text in words or unexpected.rule == "behaviour_line":
        return None
    begins = f"a line here begins with one of {' '.join(words)}"
    help = begins if unexpected.rule in ("top", "spec_line") else f"{begins}, or with a name"
    return Diagnostic(
        "unknown-line", f"{_quote_text(unexpected.token_text)} does not begin a line here", unexpected.span, help=help
    )


def _explain_label(unexpected: UnexpectedToken) -> Diagnostic | None:
    """Return the error about a missing comma before an argument name, as in `f(a b: 1)`. Return None for any other mistake."""
    names = (
        unexpected.previous_kind == "word"
        and unexpected.token_text == ":"
        and unexpected.earlier_text not in ("(", ",", "{", "", "let", "param", "keep", "latch")
    )
    if not names or unexpected.rule in ("spec_line", "weight", "top"):
        return None
    line_text = unexpected.span.source.text[unexpected.first_span.start : unexpected.span.start]
    if line_text.count("(") <= line_text.count(")"):
        return None
    message = f"found `{unexpected.previous_text}:` after {_quote_text(unexpected.earlier_text)}, expected `,` or `)`"
    return Diagnostic("unexpected-text", message, unexpected.span, help=f"write a comma before `{unexpected.previous_text}:`")


def _explain_comma(unexpected: UnexpectedToken) -> Diagnostic | None:
    """Return the error about a decimal comma, as in `(0,15)` where one argument is needed. Return None for any other mistake."""
    token_span, source = unexpected.span, unexpected.span.source
    comma = token_span.start if unexpected.token_text == "," else token_span.start - 1 if unexpected.previous_text == "," else -1
    span = find_comma_number(source, comma) if comma > 0 else None
    return None if span is None else make_comma_diagnostic(span)


def _explain_unit(unexpected: UnexpectedToken) -> Diagnostic | None:
    number = unexpected.previous_kind == "number" and unexpected.previous_text[-1:].isdigit()
    if (
        not number
        or unexpected.token_kind != "word"
        or unexpected.token_text in _list_keywords()
        or unexpected.following_text == ":"
    ):
        return None
    if unexpected.following_text in _SIGNS_AFTER_TARGET and "$END" in unexpected.expected_terminals:
        return _explain_line_end(unexpected)
    if (
        _has_missing_arrow(unexpected)
        and unexpected.token_text not in UNIT_SLIP_HELP
        and find_nearest_name(unexpected.token_text, UNIT_NAMES) is None
    ):
        return None
    message, help = f"`{unexpected.token_text}` is not a unit", find_unit_help(unexpected.token_text)
    return Diagnostic("unknown-unit", message, unexpected.span, help=help, fix=find_fix(message, unexpected.span, help))


def _list_keywords() -> frozenset[str]:
    line_words = frozenset(word for words in LINE_WORDS_BY_RULE.values() for word in words)
    return line_words | {*CONTINUATION_TEXTS, "relax", "strongest"}


def _explain_equals(unexpected: UnexpectedToken) -> Diagnostic | None:
    if has_doubled_sign(unexpected):
        message, help = f"found `==` after {_quote_text(unexpected.previous_text)}", "to give a value, write `=`"
        return Diagnostic("unexpected-text", message, unexpected.span, help=help, fix=Fix(unexpected.span, "="))
    if unexpected.token_text != "=" or "SAME" not in unexpected.expected_terminals:
        return None
    is_named_argument = (
        unexpected.previous_kind == "word" and unexpected.earlier_text in ("(", ",") and "RPAR" in unexpected.expected_terminals
    )
    if is_named_argument and not _QUERY_START_PATTERN.search(unexpected.span.source.text, 0, unexpected.span.start):
        name = unexpected.previous_text
        message, help = f"found `=` after the argument's name `{name}`", f"write `{name}: …`"
        return Diagnostic("unexpected-text", message, unexpected.span, help=help, fix=Fix(unexpected.span, ":"))
    message, fix = "found `=` in a condition", Fix(unexpected.span, "==")
    return Diagnostic("unexpected-text", message, unexpected.span, help="to compare, write `==`", fix=fix)


def has_doubled_sign(unexpected: UnexpectedToken) -> bool:
    """Return whether `==` stands for `=`, as in `let x == 1`."""
    names = unexpected.previous_kind == "word" and unexpected.earlier_text in ("let", "param", "latch", "keep")
    return unexpected.token_text == "==" and (names or unexpected.previous_text == unexpected.first_word)


def _explain_double_comparison(unexpected: UnexpectedToken) -> Diagnostic | None:
    expected = unexpected.expected_terminals
    if unexpected.token_text not in _COMPARISON_SIGNS or "SAME" in expected or not {"AND", "OR"} & expected:
        return None
    message = f"found a second comparison `{unexpected.token_text}`"
    return Diagnostic("unexpected-text", message, unexpected.span, help="join two comparisons with `and`")


def _explain_second_line(unexpected: UnexpectedToken) -> Diagnostic | None:
    return _explain_line_end(unexpected) if is_line_start(unexpected) else None


def _explain_line_end(unexpected: UnexpectedToken) -> Diagnostic:
    message = f"`{unexpected.token_text}` is in the middle of a line"
    fix = _make_fix_before_token(unexpected, "; ")
    return Diagnostic(
        "missing-line-end", message, unexpected.span, help="begin a new line with it, or write `;` before it", fix=fix
    )


def _make_fix_before_token(unexpected: UnexpectedToken, text: str) -> Fix:
    """Return a fix that inserts `text` directly before the unexpected token."""
    return Fix(Span(unexpected.span.source, unexpected.span.start, unexpected.span.start), text)


def _make_fix_after_previous(unexpected: UnexpectedToken, text: str) -> Fix:
    """Return a fix that inserts `text` directly after the previous token, before the blanks that follow it."""
    source, start = unexpected.span.source, unexpected.span.start
    end = len(source.text[:start].rstrip())
    return Fix(Span(source, end, end), text)


def is_line_start(unexpected: UnexpectedToken) -> bool:
    """Return whether a line end is missing before the unexpected token: the token is a word that may begin a line, and the
    previous token may end one."""
    words = LINE_WORDS_BY_RULE[unexpected.rule]
    assigns = bool(words) and unexpected.token_kind == "word" and unexpected.following_text in _SIGNS_AFTER_TARGET
    return (unexpected.token_text in words or assigns) and "$END" in unexpected.expected_terminals


def _explain_unfinished(unexpected: UnexpectedToken) -> Diagnostic | None:
    if unexpected.token_text:
        return None
    message = f"line ends after {_quote_text(unexpected.previous_text)}, expected {_describe_expected(unexpected)}"
    return Diagnostic("unfinished-line", message, unexpected.span, help=_format_form(unexpected))


def _describe_expected(unexpected: UnexpectedToken) -> str:
    expected_terminals = unexpected.expected_terminals
    if unexpected.previous_text == "->":
        return {"top": "the type of the result, such as `push`", "rule": "a value from 0 to 1"}.get(
            unexpected.rule, "the name of a state"
        )
    if expected_terminals >= _VALUE_TERMINALS:
        return CONTINUATION_TEXTS.get(unexpected.previous_text, "a value")
    if {"RPAR", "_COMMA"} <= expected_terminals:
        return "`,` or `)`"
    begins = expected_terminals & {"NAME", "STRING", "NUMBER", "NONE"} and "PLUS" not in expected_terminals
    if begins and unexpected.previous_text in CONTINUATION_TEXTS and unexpected.previous_text not in ("{", "("):
        return CONTINUATION_TEXTS[unexpected.previous_text]
    if unexpected.rule == "world_item" and "NAME" in expected_terminals:
        return f"a name after one of {' '.join(WORLD_KIND_WORDS)}" if not unexpected.previous_text else "a name"
    if unexpected.rule == "setting" and not unexpected.previous_text:
        return f"one of {' '.join(FIELD_SETTING_WORDS)}"
    if expected_terminals == {"$END"}:
        return "the end of the line"
    for terminal, words in _REQUIRED_TERMINALS:
        if terminal in expected_terminals and not (
            "$END" in expected_terminals and terminal in ("EQUAL", "_COMMA", "_TO", "_IN", "WHEN", "ON")
        ):
            return words
    if "NAME" in expected_terminals:
        return "a name"
    if "STRING" in expected_terminals and "$END" not in expected_terminals:
        return "text in quotes"
    return "the end of the line" if "$END" in expected_terminals else "something else"


def _format_form(unexpected: UnexpectedToken) -> str:
    if {"RPAR", "_COMMA"} <= unexpected.expected_terminals and unexpected.rule != "top":
        return "arguments are written like `seek(meal)` or `wander(swing: 40 deg)`"
    if unexpected.expected_terminals == {"FROM"}:
        return "write the line like `take 1 load from meal`"
    if (
        unexpected.rule == "statement"
        and unexpected.token_text == "("
        and unexpected.previous_text == unexpected.first_word not in LINE_WORDS_BY_RULE["statement"]
    ):
        return f"write `steer {unexpected.first_word}(…)` to move that way"
    form = (
        EXAMPLE_LINES.get(unexpected.first_word)
        if unexpected.first_word in LINE_WORDS_BY_RULE[unexpected.rule]
        else EXAMPLE_LINE_BY_RULE.get(unexpected.rule)
    )
    if form is None:
        return f"a line here begins with one of {' '.join(LINE_WORDS_BY_RULE[unexpected.rule])}"
    return f"write the line like `{form}`"


def _quote_text(text: str) -> str:
    if not text:
        return "the end of the line"
    return f"`{text}`" if len(text) <= 40 else f"`{text[:37]}...`"
