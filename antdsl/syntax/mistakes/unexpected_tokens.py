"""What the parser found and what it could have taken → one complaint in an artist's words."""

from __future__ import annotations

import re
from dataclasses import dataclass

from antdsl.diagnostics.model import Diagnostic, Fix, replacement
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.source import Span
from antdsl.syntax.mistakes.number_slips import comma_in_number, number_with_comma, unit_help
from antdsl.syntax.words import (
    AFTER,
    BELONGS,
    FIELD_SETTINGS,
    FORMS,
    LINE_WORDS,
    OTHER_WORDS,
    RULE_FORMS,
    UNIT_NAMES,
    UNIT_SLIPS,
    WORLD_KINDS,
)


@dataclass(frozen=True, slots=True)
class Surprise:
    """Where a line could not be read on. `before` and `found` are the texts on both sides (`found` empty at the line's end),
    `wanted` the names of the terminals that could have stood there, `rule` the rule of the grammar that reads the line."""

    rule: str
    first: str
    before: str
    before_kind: str
    found: str
    found_kind: str
    span: Span
    first_span: Span
    wanted: frozenset[str]
    next: str = ""  # the text after `found`
    earlier: str = ""  # the text before `before`


# Of the terminals that can follow a finished value, the ones that a line needs, most telling first.
_NEEDED = (
    ("ARROW", "`->`"),
    ("_THEN", "`then`"),
    ("_ELSE", "`else`"),
    ("UNTIL", "`until`"),
    ("_OVER", "`over`"),
    ("FROM", "`from`"),
    ("RPAR", "`)`"),
    ("RSQB", "`]`"),
    ("_DOTS", "`..`"),
    ("LBRACE", "`{`"),
    ("EQUAL", "`=`"),
    ("_COLON", "`:`"),
    ("_STRONGEST", "`strongest`"),
    ("_TO", "`to`"),
    ("_IN", "`in`"),
    ("WHEN", "`when`"),
    ("ANY", "`any`"),
    ("_AT", "`at`"),
    ("_LEAST", "`least`"),
    ("EACH", "`each`"),
    ("AS", "`as`"),
    ("ON", "`on`"),
    ("_COMMA", "`,`"),
)
# Words inside a line that join its parts: what else is found there may be a slip of one of these.
_JOINING = frozenset(
    ("any", "at", "each", "else", "except", "from", "held", "least", "over", "strongest", "take", "then", "until", "when")
)
_VALUE = frozenset({"NUMBER", "QUANTITY", "NAME", "LPAR"})
_ASSIGNING = {"=", "+=", "-=", "[", "."}
# The beginning of a question to all: its brackets hold a condition and no argument's name.
_ASKING = re.compile(r"\b(?:share|count|any|every)\(\s*[a-z_][a-z_0-9.]*\s*\Z|[(,]\s*(?:state|previous|next)\s*\Z")
_WRITING = ("=", "+=", "-=")
# After these a value begins.
_BEGINS_VALUE = frozenset(
    ("when", "and", "or", "not", "no", "steer", "then", "else", "if", "until", *"=<>+-*/", *_WRITING, "<=", ">=", "==")
)
_COMPARISONS = {"==", "!=", "<", ">", "<=", ">=", "is"}


def complain(surprise: Surprise) -> Diagnostic:
    """The complaint about a line that cannot be read; the first kind of mistake that fits."""
    for kind in (
        _quoted_library, _after_inside, _misspelt, _misplaced, _comma, _no_line, _label, _unit, _equals, _compared_twice,
        _second_line, _unfinished,
    ):  # fmt: skip
        found = kind(surprise)
        if found is not None:
            return found
    message = (
        f"found {_shown(surprise.found)} after {_shown(surprise.before)}"
        if surprise.before
        else f"found {_shown(surprise.found)}"
    )
    help, fix = _form(surprise), None
    slip = _slip(surprise)
    if slip is not None:
        help, fix = f"did you mean `{slip}`?", Fix(surprise.span, slip)
    elif _forgets_colon(surprise):
        help, fix = f"to name an argument, write `{surprise.before}: {surprise.found}`", _before(surprise, ": ")
    elif surprise.found_kind == "word" and surprise.next == ":" and {"RPAR", "_COMMA"} <= surprise.wanted:
        help, fix = f"write a comma before `{surprise.found}:`", _behind(surprise, ",")
    elif _forgets_arrow(surprise):
        help, fix = f"write `-> {surprise.found}`", _before(surprise, "-> ")
    elif forgets_brackets(surprise):
        help = f"write `{surprise.before}({surprise.found})`"
        fix = Fix(Span(surprise.span.source, _behind(surprise, "").span.start, surprise.span.end), f"({surprise.found})")
    return Diagnostic("unexpected-text", f"{message}, expected {_wanted(surprise)}", surprise.span, help=help, fix=fix)


def _after_inside(surprise: Surprise) -> Diagnostic | None:
    """`when meal and after 1 s`: only the whole condition may be `after`."""
    if surprise.before != "after" or surprise.earlier not in ("and", "or") or surprise.found_kind != "number":
        return None
    source = surprise.span.source
    start = source.text.rindex("after", 0, surprise.span.start)
    span, text = Span(source, start, start + len("after")), "time_in_state >="
    message = f"`after {surprise.found}` cannot be joined with a condition"
    help = f"write `{text} {surprise.found}` for it"
    return Diagnostic("unexpected-text", message, span, help=help, fix=Fix(span, text))


def _quoted_library(surprise: Surprise) -> Diagnostic | None:
    """`use "steering"`: a library has no quotes, a file has an ending and a name."""
    name = surprise.before.strip('"')
    if surprise.first != "use" or "AS" not in surprise.wanted or not name.isidentifier():
        return None
    start = surprise.span.source.text.rindex(surprise.before, 0, surprise.span.start)
    span = Span(surprise.span.source, start, start + len(surprise.before))
    return Diagnostic(
        "unexpected-text", f"`{surprise.before}` in quotes is no file", span, help=f"write `{name}`", fix=Fix(span, name)
    )


def _slip(surprise: Surprise) -> str | None:
    """The word of the language that can stand here and that what was found is a slip of."""
    if surprise.found_kind != "word" or len(surprise.found) < 3 or "NAME" in surprise.wanted:
        return None
    words = [terminal.lstrip("_").lower() for terminal in surprise.wanted if terminal.lstrip("_").lower() in _JOINING]
    return nearest_name(surprise.found, words)


def _forgets_arrow(surprise: Surprise) -> bool:
    return "ARROW" in surprise.wanted and surprise.found_kind == "word" and surprise.next in ("", "{")


def forgets_brackets(surprise: Surprise) -> bool:
    """`touching nest`: a name behind one that begins a value, and so could be called with it."""
    names = surprise.before_kind == surprise.found_kind == "word" and surprise.next not in ("(", ".", "[", ":")
    return names and surprise.earlier in _BEGINS_VALUE and {surprise.before, surprise.found}.isdisjoint(_keywords() | _JOINING)


def _forgets_colon(surprise: Surprise) -> bool:
    between = {"RPAR", "_COMMA"} <= surprise.wanted and surprise.rule != "top" and surprise.earlier in ("(", ",")
    return (
        between and surprise.before_kind == "word" and surprise.found_kind in ("number", "word") and surprise.next in (",", ")")
    )


def plain_complaint(surprise: Surprise) -> Diagnostic:
    """The same without a thought about what was meant: for a file with a great many mistakes."""
    if not surprise.found:
        return Diagnostic("unfinished-line", f"line ends after {_shown(surprise.before)}", surprise.span)
    return Diagnostic("unexpected-text", f"found {_shown(surprise.found)} where the line cannot go on with it", surprise.span)


def better_first_word(surprise: Surprise) -> str | None:
    """The word that the first word of a line is a slip of, when the line fits no other reading."""
    words = LINE_WORDS[surprise.rule]
    other = OTHER_WORDS.get(surprise.first)
    if other in words and surprise.found not in _WRITING:
        return other
    declares = surprise.earlier == surprise.first and surprise.found == "="  # `parm smell = …`
    if surprise.first in words or not surprise.first.isidentifier() or (surprise.found in (*_WRITING, "(") and not declares):
        return None
    return nearest_name(surprise.first, words)


def _misspelt(surprise: Surprise) -> Diagnostic | None:
    better = better_first_word(surprise)
    if better is None:
        return None
    message = f"`{surprise.first}` does not begin a line here"
    return Diagnostic(
        "unknown-line", message, surprise.first_span, help=f"did you mean `{better}`?", fix=Fix(surprise.first_span, better)
    )


def _misplaced(surprise: Surprise) -> Diagnostic | None:
    if surprise.first in LINE_WORDS[surprise.rule] or surprise.first not in BELONGS:
        return None
    return misplaced(surprise.first, surprise.first_span)


def misplaced(word: str, span: Span) -> Diagnostic:
    """A line that begins with a word which belongs elsewhere."""
    return Diagnostic("misplaced-line", f"`{word}` does not stand here", span, help=f"it belongs {BELONGS[word]}")


def _no_line(surprise: Surprise) -> Diagnostic | None:
    words = LINE_WORDS[surprise.rule]
    if surprise.before or not words or surprise.found in words or surprise.rule == "behaviour_line":
        return None
    begins = f"a line here begins with one of {' '.join(words)}"
    help = begins if surprise.rule in ("top", "spec_line") else f"{begins}, or with a name"
    return Diagnostic("unknown-line", f"{_shown(surprise.found)} does not begin a line here", surprise.span, help=help)


def _label(surprise: Surprise) -> Diagnostic | None:
    """`f(a b: 1)`, where the word before the colon was taken for something else."""
    names = (
        surprise.before_kind == "word"
        and surprise.found == ":"
        and surprise.earlier not in ("(", ",", "{", "", "let", "param", "keep", "latch")
    )
    if not names or surprise.rule in ("spec_line", "weight", "top"):
        return None
    begun = surprise.span.source.text[surprise.first_span.start : surprise.span.start]
    if begun.count("(") <= begun.count(")"):
        return None
    message = f"found `{surprise.before}:` after {_shown(surprise.earlier)}, expected `,` or `)`"
    return Diagnostic("unexpected-text", message, surprise.span, help=f"write a comma before `{surprise.before}:`")


def _comma(surprise: Surprise) -> Diagnostic | None:
    """`(0,15)`, as numbers are written in many countries, where it cannot be two arguments."""
    found, source = surprise.span, surprise.span.source
    comma = found.start if surprise.found == "," else found.start - 1 if surprise.before == "," else -1
    span = number_with_comma(source, comma) if comma > 0 else None
    return None if span is None else comma_in_number(span)


def _unit(surprise: Surprise) -> Diagnostic | None:
    number = surprise.before_kind == "number" and surprise.before[-1:].isdigit()
    if not number or surprise.found_kind != "word" or surprise.found in _keywords() or surprise.next == ":":
        return None
    if surprise.next in _ASSIGNING and "$END" in surprise.wanted:
        return _line_end(surprise)
    if _forgets_arrow(surprise) and surprise.found not in UNIT_SLIPS and nearest_name(surprise.found, UNIT_NAMES) is None:
        return None
    message, help = f"`{surprise.found}` is not a unit", unit_help(surprise.found)
    return Diagnostic("unknown-unit", message, surprise.span, help=help, fix=replacement(message, surprise.span, help))


def _keywords() -> frozenset[str]:
    return frozenset(word for words in LINE_WORDS.values() for word in words) | set(AFTER) | {"relax", "strongest"}


def _equals(surprise: Surprise) -> Diagnostic | None:
    if gives_with_two(surprise):
        message, help = f"found `==` after {_shown(surprise.before)}", "to give a value, write `=`"
        return Diagnostic("unexpected-text", message, surprise.span, help=help, fix=Fix(surprise.span, "="))
    if surprise.found != "=" or "SAME" not in surprise.wanted:
        return None
    named = surprise.before_kind == "word" and surprise.earlier in ("(", ",") and "RPAR" in surprise.wanted
    if named and not _ASKING.search(surprise.span.source.text, 0, surprise.span.start):
        message, help = f"found `=` after the argument's name `{surprise.before}`", f"write `{surprise.before}: …`"
        return Diagnostic("unexpected-text", message, surprise.span, help=help, fix=Fix(surprise.span, ":"))
    return Diagnostic(
        "unexpected-text", "found `=` in a condition", surprise.span, help="to compare, write `==`", fix=Fix(surprise.span, "==")
    )


def gives_with_two(surprise: Surprise) -> bool:
    """`let x == 1`: the first sign was taken for the one that is meant."""
    names = surprise.before_kind == "word" and surprise.earlier in ("let", "param", "latch", "keep")
    return surprise.found == "==" and (names or surprise.before == surprise.first)


def _compared_twice(surprise: Surprise) -> Diagnostic | None:
    if surprise.found not in _COMPARISONS or "SAME" in surprise.wanted or not {"AND", "OR"} & surprise.wanted:
        return None
    return Diagnostic(
        "unexpected-text", f"found a second comparison `{surprise.found}`", surprise.span, help="join two comparisons with `and`"
    )


def _second_line(surprise: Surprise) -> Diagnostic | None:
    return _line_end(surprise) if begins_line(surprise) else None


def _line_end(surprise: Surprise) -> Diagnostic:
    message = f"`{surprise.found}` in the middle of a line"
    fix = _before(surprise, "; ")
    return Diagnostic(
        "missing-line-end", message, surprise.span, help="begin a new line with it, or write `;` before it", fix=fix
    )


def _before(surprise: Surprise, text: str) -> Fix:
    """Text put in between what was read and the surprise."""
    return Fix(Span(surprise.span.source, surprise.span.start, surprise.span.start), text)


def _behind(surprise: Surprise, text: str) -> Fix:
    """Text put right behind what was read, before the blanks."""
    source, start = surprise.span.source, surprise.span.start
    end = len(source.text[:start].rstrip())
    return Fix(Span(source, end, end), text)


def begins_line(surprise: Surprise) -> bool:
    """Whether the surprise is a word that begins a line, after something that could have been the end of one."""
    words = LINE_WORDS[surprise.rule]
    assigns = bool(words) and surprise.found_kind == "word" and surprise.next in _ASSIGNING
    return (surprise.found in words or assigns) and "$END" in surprise.wanted


def _unfinished(surprise: Surprise) -> Diagnostic | None:
    if surprise.found:
        return None
    message = f"line ends after {_shown(surprise.before)}, expected {_wanted(surprise)}"
    return Diagnostic("unfinished-line", message, surprise.span, help=_form(surprise))


def _wanted(surprise: Surprise) -> str:
    wanted = surprise.wanted
    if surprise.before == "->":
        return {"top": "the type of the result, such as `push`", "rule": "a value from 0 to 1"}.get(
            surprise.rule, "the name of a state"
        )
    if wanted >= _VALUE:
        return AFTER.get(surprise.before, "a value")
    if {"RPAR", "_COMMA"} <= wanted:
        return "`,` or `)`"
    begins = wanted & {"NAME", "STRING", "NUMBER", "NONE"} and "PLUS" not in wanted
    if begins and surprise.before in AFTER and surprise.before not in ("{", "("):
        return AFTER[surprise.before]
    if surprise.rule == "world_item" and "NAME" in wanted:
        return f"a name after one of {' '.join(WORLD_KINDS)}" if not surprise.before else "a name"
    if surprise.rule == "setting" and not surprise.before:
        return f"one of {' '.join(FIELD_SETTINGS)}"
    if wanted == {"$END"}:
        return "the end of the line"
    for terminal, words in _NEEDED:
        if terminal in wanted and not ("$END" in wanted and terminal in ("EQUAL", "_COMMA", "_TO", "_IN", "WHEN", "ON")):
            return words
    if "NAME" in wanted:
        return "a name"
    if "STRING" in wanted and "$END" not in wanted:
        return "text in quotes"
    return "the end of the line" if "$END" in wanted else "something else"


def _form(surprise: Surprise) -> str:
    if {"RPAR", "_COMMA"} <= surprise.wanted and surprise.rule != "top":
        return "arguments are written like `seek(meal)` or `wander(swing: 40 deg)`"
    if surprise.wanted == {"FROM"}:
        return "write it like `take 1 load from meal`"
    if (
        surprise.rule == "statement"
        and surprise.found == "("
        and surprise.before == surprise.first not in LINE_WORDS["statement"]
    ):
        return f"write `steer {surprise.first}(…)` to move that way"
    form = FORMS.get(surprise.first) if surprise.first in LINE_WORDS[surprise.rule] else RULE_FORMS.get(surprise.rule)
    if form is None:
        return f"a line here begins with one of {' '.join(LINE_WORDS[surprise.rule])}"
    return f"write it like `{form}`"


def _shown(text: str) -> str:
    if not text:
        return "the end of the line"
    return f"`{text}`" if len(text) <= 40 else f"`{text[:37]}...`"
