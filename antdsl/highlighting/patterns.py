"""The elements of `.ant` text as regular expressions, in the syntax common to Python and Oniguruma.

At each position, the first matching pattern wins. A word may be a keyword in one position and a name in another. The grammar
decides this by the tokens that are allowed there; these patterns decide it by the neighbouring text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from antdsl.program.tables.colours import COLOUR_BY_NAME
from antdsl.program.tables.editions import SWITCH_HELP
from antdsl.program.tables.vocabulary import (
    BUILTIN_ATTRIBUTE_BY_NAME,
    BUILTINS_BY_NAME,
    REDUCER_HELP,
    RUN_VALUE_TYPES,
    SENSE_TYPE_BY_NAME,
    TYPE_BY_WORD,
)
from antdsl.syntax.words import (
    EXAMPLE_LINES,
    FIELD_SETTING_WORDS,
    LINE_WORDS_BY_RULE,
    NUMBER_REGEX,
    UNITS_REGEX,
    WORLD_KIND_WORDS,
)


@dataclass(frozen=True, slots=True)
class TokenPattern:
    """A regular expression for one kind of token. `group_classes`: the class of text of each group. An expression without groups
    has one class, for the complete match."""

    regex: str
    group_classes: tuple[str, ...]


# Each class with its scope in TextMate's way of naming, and its token type in Pygments' way.
SCOPE_AND_TOKEN_BY_CLASS: dict[str, tuple[str, str]] = {
    "comment": ("comment.line.number-sign", "Comment.Single"),
    "string": ("string.quoted.double", "String.Double"),
    "number": ("constant.numeric", "Number"),
    "unit": ("keyword.other.unit", "Keyword.Type"),
    "declaration": ("storage.type", "Keyword.Declaration"),
    "keyword": ("keyword.control", "Keyword"),
    "word operator": ("keyword.operator.word", "Operator.Word"),
    "declared": ("entity.name.type", "Name.Class"),
    "target": ("entity.name.function", "Name.Label"),
    "label": ("variable.parameter", "Name.Attribute"),
    "builtin": ("support.function", "Name.Builtin"),
    "function": ("entity.name.function", "Name.Function"),
    "given": ("variable.language", "Name.Builtin.Pseudo"),
    "kind": ("support.type", "Name.Builtin"),
    "constant": ("constant.other", "Name.Constant"),
    "name": ("variable.other", "Name"),
    "operator": ("keyword.operator", "Operator"),
    "bracket": ("punctuation", "Punctuation"),
}

DECLARING_WORDS = (
    "species", "behaviour", "field", "machine", "state", "param", "let", "latch", "fuzzy", "keep", "start", "measure",
)  # fmt: skip
# Words inside a line. Some are also names; where an argument is named or called, the sign after them decides.
INNER_WORDS = (
    "when", "interrupt", "within", "as", "on", "any", "except", "for", "each", "held", "after", "take", "from", "all", "to",
    "until", "then", "relax", "over", "strongest", "if", "else", "at", "least",
)  # fmt: skip
OPERATOR_WORDS = ("or", "and", "not", "no", "is", "none", "of", "chance", "clip", "in")
SPEC_CLAIM_WORDS = tuple(word for word, form in EXAMPLE_LINES.items() if form.startswith(f"{word}:"))  # a colon follows these

_NAME_REGEX = "[a-z][a-z_0-9]*"
_WORD_END_REGEX = "(?![A-Za-z_0-9])"
_CALL_AHEAD_REGEX = r"(?=\()"
_LABEL_AHEAD_REGEX = r"(?=[ \t]*:)"
_NOT_VALUE_REGEX = r"(?![ \t]*(?:[:.,)=*/^<>!]|[-+]=|\[))"  # what follows a name in the middle of a value, or a label
_MEMBER_START_REGEX = r"(?:^[ \t]+|(?<=[{;])[ \t]*)"  # in a world stands the species that another file brings
_LINE_START_REGEX = r"(?:^|(?<=[{;]))[ \t]*"


def _make_word_regex(words: Iterable[str]) -> str:
    return f"({'|'.join(sorted(set(words)))}){_WORD_END_REGEX}"


_LINE_START_WORDS = {word for words in LINE_WORDS_BY_RULE.values() for word in words} | {"exit", "enter"}
_PLAIN_LINE_WORDS = _LINE_START_WORDS - set(DECLARING_WORDS) - set(SPEC_CLAIM_WORDS)
_FUNCTION_WORDS = set(BUILTINS_BY_NAME) | set(REDUCER_HELP)
_PROPERTY_WORDS = (
    set(BUILTIN_ATTRIBUTE_BY_NAME)
    | set(SWITCH_HELP)
    | set(RUN_VALUE_TYPES)
    | set(SENSE_TYPE_BY_NAME)
    | {"self", "it", "up", "state"}
) - set(INNER_WORDS)

TOKEN_PATTERNS: tuple[TokenPattern, ...] = (
    TokenPattern(r"#.*$", ("comment",)),
    TokenPattern(r'"[^"\n]*"?', ("string",)),
    TokenPattern(rf"({NUMBER_REGEX})([ \t]*{UNITS_REGEX})?", ("number", "unit")),
    # the first word of a line
    TokenPattern(rf"{_make_word_regex(SPEC_CLAIM_WORDS)}{_LABEL_AHEAD_REGEX}", ("keyword",)),
    TokenPattern(rf"{_MEMBER_START_REGEX}(species)(?=[ \t]+{_NAME_REGEX})", ("kind",)),
    TokenPattern(
        rf"{_LINE_START_REGEX}{_make_word_regex(DECLARING_WORDS)}[ \t]+(?!when{_WORD_END_REGEX})({_NAME_REGEX})",
        ("declaration", "declared"),
    ),
    TokenPattern(rf"{_LINE_START_REGEX}{_make_word_regex(WORLD_KIND_WORDS)}(?=[ \t]+{_NAME_REGEX})", ("kind",)),
    TokenPattern(rf"{_LINE_START_REGEX}{_make_word_regex(_PLAIN_LINE_WORDS)}{_NOT_VALUE_REGEX}", ("keyword",)),
    TokenPattern(rf"{_LINE_START_REGEX}{_make_word_regex(FIELD_SETTING_WORDS)}(?=[ \t]+[a-z0-9(])", ("given",)),
    # what an arrow leads to
    TokenPattern(r"(->)[ \t]*(previous|choose)" + _WORD_END_REGEX, ("operator", "keyword")),
    TokenPattern(rf"(->)[ \t]*({_NAME_REGEX})", ("operator", "target")),
    # other words
    TokenPattern(rf"{_NAME_REGEX}{_LABEL_AHEAD_REGEX}", ("label",)),
    TokenPattern(rf"{_make_word_regex(_FUNCTION_WORDS)}{_CALL_AHEAD_REGEX}", ("builtin",)),
    TokenPattern(rf"{_NAME_REGEX}{_CALL_AHEAD_REGEX}", ("function",)),
    TokenPattern(rf"(?<!\.){_make_word_regex(OPERATOR_WORDS)}", ("word operator",)),
    TokenPattern(rf"(?<!\.){_make_word_regex(INNER_WORDS)}(?![ \t]*[,)=.\[])", ("keyword",)),
    TokenPattern(rf"(?<!\.){_make_word_regex(COLOUR_BY_NAME)}(?=[ \t]*(?:\{{|for{_WORD_END_REGEX}))", ("constant",)),
    TokenPattern(rf"(?<=[:>] ){_make_word_regex(TYPE_BY_WORD)}", ("kind",)),
    TokenPattern(_make_word_regex(_PROPERTY_WORDS), ("given",)),
    TokenPattern(_NAME_REGEX, ("name",)),
    TokenPattern(r"->|\.\.|[-+<>=!]=|[-+*/^<>=.,:;]", ("operator",)),
    TokenPattern(r"[(){}\[\]]", ("bracket",)),
)
