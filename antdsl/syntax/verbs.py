"""The verbs: words that begin a line in which an agent requests something of the world. This table is the source of the grammar,
of the list of words that may begin a line, and of the samples in messages.

The meaning of such a line is defined in the row of the same word in `antdsl.program.tables.effects`. After a change here, run
`python -m antdsl.syntax.grammar`, which regenerates the verbs in the grammar and the parse tables."""

from __future__ import annotations

from dataclasses import dataclass

# Grammar text after a verb. "own": the grammar has a separate rule for the verb.
SHAPE_PATTERNS: dict[str, str] = {
    "alone": "",
    "name": "NAME",
    "open": "NAME [LPAR [_arguments] RPAR] [_TO expr] -> ask_open",
    "called": "NAME [LPAR [_arguments] RPAR]",
    "arguments": "NAME LPAR [_arguments] RPAR",
    "amount": "NAME expr -> ask_amount",
    "set": "NAME EQUAL expr -> ask_amount",
    "when": "NAME [WHEN expr] -> ask_when",
    "own": "",
}


@dataclass(frozen=True, slots=True)
class Verb:
    """A verb of the language. `shape`: a key of `SHAPE_PATTERNS`. `example_line`: an example line for help texts.
    `following_text`: words that say what follows the verb in a line."""

    word: str
    shape: str
    example_line: str
    following_text: str = ""


# In the order of messages and editors.
_VERB_ROWS = (
    Verb("deposit", "amount", "deposit trail 2 /s", "the name of a field"),
    Verb("carve", "arguments", "carve hill(radius: 2 mm)", "the name of a solid"),
    Verb("give", "own", "give all load to nest", "an amount, such as `all load`"),
    Verb("emit", "open", "emit alarm(within: 50 mm)", "the name of an event"),
    Verb("spawn", "name", "spawn worker", "the name of a species"),
    Verb("die", "alone", "die"),
    Verb("play", "called", "play walk", "the name of a clip"),
    Verb("wear", "when", "wear load when load > 0", "the name of a layer"),
    Verb("channel", "set", "channel jaw = load", "the name of a channel"),
    Verb("look", "arguments", "look head(at: meal)", "the name of a transform group"),
)
VERB_BY_WORD: dict[str, Verb] = {row.word: row for row in _VERB_ROWS}
