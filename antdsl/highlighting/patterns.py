"""The elements of `.ant` text, as regular expressions that Python and Oniguruma read alike: the first match at a place wins.

A word may be a keyword in one place and a name in another. The grammar decides by what may stand at a place; here the
neighbouring text decides."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from antdsl.program.tables.colours import COLOURS
from antdsl.program.tables.vocabulary import BUILTIN_ATTRIBUTES, BUILTINS, REDUCERS, RUN_NAMES, SENSED_NAMES, TYPE_WORDS
from antdsl.syntax.words import FIELD_SETTINGS, FORMS, LINE_WORDS, NUMBER, UNITS, WORLD_KINDS


@dataclass(frozen=True, slots=True)
class Pattern:
    """A regular expression, and the class of each of its groups. Without groups, the class applies to the complete match."""

    regex: str
    classes: tuple[str, ...]


# Each class with its scope in TextMate's way of naming, and its token type in Pygments' way.
CLASSES: dict[str, tuple[str, str]] = {
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

DECLARING = ("species", "behaviour", "field", "machine", "state", "param", "let", "latch", "fuzzy", "keep", "start")
# Words inside a line. Some are also names; where an argument is named or called, the sign after them decides.
INNER = (
    "when", "interrupt", "within", "as", "on", "any", "except", "for", "each", "held", "after", "take", "from", "all", "to",
    "until", "then", "relax", "over", "strongest", "if", "else", "at", "least",
)  # fmt: skip
OPERATORS = ("or", "and", "not", "no", "is", "none", "of", "chance", "clip", "in")
CLAIMS = tuple(word for word, form in FORMS.items() if form.startswith(f"{word}:"))  # a colon follows these

_NAME = "[a-z][a-z_0-9]*"
_END = "(?![A-Za-z_0-9])"
_CALLED = r"(?=\()"
_LABELLED = r"(?=[ \t]*:)"
_NOT_A_VALUE = r"(?![ \t]*(?:[:.,)=*/^<>!]|[-+]=|\[))"  # what follows a name in the middle of a value, or a label
_INSIDE = r"(?:^[ \t]+|(?<=[{;])[ \t]*)"  # in a world stands the species that another file brings
_BEGIN = r"(?:^|(?<=[{;]))[ \t]*"


def _any_word_of(words: Iterable[str]) -> str:
    return f"({'|'.join(sorted(set(words)))}){_END}"


_FIRST = {word for words in LINE_WORDS.values() for word in words} | {"exit", "enter"}
_PLAIN_FIRST = _FIRST - set(DECLARING) - set(CLAIMS)
_FUNCTIONS = set(BUILTINS) | set(REDUCERS)
_PROPERTIES = (set(BUILTIN_ATTRIBUTES) | set(RUN_NAMES) | set(SENSED_NAMES) | {"self", "it", "up", "state"}) - set(INNER)

PATTERNS: tuple[Pattern, ...] = (
    Pattern(r"#.*$", ("comment",)),
    Pattern(r'"[^"\n]*"?', ("string",)),
    Pattern(rf"({NUMBER})([ \t]*{UNITS})?", ("number", "unit")),
    # the first word of a line
    Pattern(rf"{_any_word_of(CLAIMS)}{_LABELLED}", ("keyword",)),
    Pattern(rf"{_INSIDE}(species)(?=[ \t]+{_NAME})", ("kind",)),
    Pattern(rf"{_BEGIN}{_any_word_of(DECLARING)}[ \t]+(?!when{_END})({_NAME})", ("declaration", "declared")),
    Pattern(rf"{_BEGIN}{_any_word_of(WORLD_KINDS)}(?=[ \t]+{_NAME})", ("kind",)),
    Pattern(rf"{_BEGIN}{_any_word_of(_PLAIN_FIRST)}{_NOT_A_VALUE}", ("keyword",)),
    Pattern(rf"{_BEGIN}{_any_word_of(FIELD_SETTINGS)}(?=[ \t]+[a-z0-9(])", ("given",)),
    # what an arrow leads to
    Pattern(r"(->)[ \t]*(previous|choose)" + _END, ("operator", "keyword")),
    Pattern(rf"(->)[ \t]*({_NAME})", ("operator", "target")),
    # other words
    Pattern(rf"{_NAME}{_LABELLED}", ("label",)),
    Pattern(rf"{_any_word_of(_FUNCTIONS)}{_CALLED}", ("builtin",)),
    Pattern(rf"{_NAME}{_CALLED}", ("function",)),
    Pattern(rf"(?<!\.){_any_word_of(OPERATORS)}", ("word operator",)),
    Pattern(rf"(?<!\.){_any_word_of(INNER)}(?![ \t]*[,)=.\[])", ("keyword",)),
    Pattern(rf"(?<!\.){_any_word_of(COLOURS)}(?=[ \t]*(?:\{{|for{_END}))", ("constant",)),
    Pattern(rf"(?<=[:>] ){_any_word_of(TYPE_WORDS)}", ("kind",)),
    Pattern(_any_word_of(_PROPERTIES), ("given",)),
    Pattern(_NAME, ("name",)),
    Pattern(r"->|\.\.|[-+<>=!]=|[-+*/^<>=.,:;]", ("operator",)),
    Pattern(r"[(){}\[\]]", ("bracket",)),
)
