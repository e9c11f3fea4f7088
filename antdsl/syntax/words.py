"""The words of the language: those that may begin a line in each context, and the units. For both, there is a list of common
mistakes."""

from __future__ import annotations

import re

from antdsl.syntax.editions import FIRST_LINE, NEWEST_EDITION
from antdsl.syntax.verbs import VERB_BY_WORD

UNIT_NAMES = ("mm", "cm", "m", "s", "min", "deg", "rad", "turn", "mg", "g", "kg", "N", "uN", "u", "step")

# Regular expressions of a number, of one unit, of a compound unit, and of a quantity (groups 1 and 2: digits, unit).
NUMBER_REGEX = r"[0-9]+(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+(?![0-9A-Za-z_]))?"
UNIT_REGEX = rf"(?:{'|'.join(UNIT_NAMES)})(?:\^[0-9]+)?(?![A-Za-z_0-9])"
UNITS_REGEX = rf"(?:%|{UNIT_REGEX}|/{UNIT_REGEX})(?:[/*]{UNIT_REGEX})*"
QUANTITY_PATTERN = re.compile(rf"({NUMBER_REGEX})[ \t]*({UNITS_REGEX})?")

# Units of other tools and everyday names of units, with the unit of this language.
_UNIT_SLIPS = (
    ("ms", "write thousandths of a second as `0.001 s`"),
    ("h", "write an hour as `60 min`"),
    ("km", "write a kilometre as `1000 m`"),
    ("sec secs second seconds", "write `s`"),
    ("minute minutes", "write `min`"),
    ("metr metre meter metres meters", "write `m`"),
    ("millimetre millimeter millimetres millimeters", "write `mm`"),
    ("degree degrees", "write `deg`"),
    ("radian radians", "write `rad`"),
    ("turns", "write `turn`"),
    ("steps tick ticks", "write `step`"),
    ("frame", "write a rate per second, such as `/s`, which does not depend on the frame rate; `/step` is for porting"),
    ("frames", "write a time in `s`, which does not depend on the frame rate; `step` is for porting"),
    ("gram grams", "write `g`"),
    ("percent", "write `%`"),
    ("newton", "write `N`"),
    ("pct", "write `%`"),
    ("px", "write a length such as `mm`"),
    ("unit units", "write `u`"),
)
UNIT_SLIP_HELP = {word: advice for words, advice in _UNIT_SLIPS for word in words.split()}

# First words of lines by grammar rule. Other lines begin with a value or with a name that the author chose.
_ACTION_WORDS = tuple(VERB_BY_WORD)
_CHANGE_WORDS = ("when", "interrupt")
_CLAIM_WORDS = ("always", "never", "eventually", "finally", "sooner", "until")
LINE_WORDS_BY_RULE: dict[str, tuple[str, ...]] = {
    "header": ("ant",),
    "top": ("use", "world", "field", "species", "behaviour", "spec", "measure"),
    "world_item": (),
    "declaration": (),
    "setting": (),
    "member": ("param", "let", "latch", "fuzzy", "start", "on", "layers", "machine", "state", "from"),
    "machine_member": ("state", "start", "from", "let", "latch"),
    "statement": ("steer", "face", "let", "enter", "exit", *_CHANGE_WORDS, *_ACTION_WORDS),
    "action": _ACTION_WORDS,
    "layer": ("face",),
    "rule": (),
    "weight": (),
    "behaviour_line": ("keep", "let"),
    "spec_line": ("for", "seeds", "pass", "set", "against", *_CLAIM_WORDS, "within", "goal", "when", "each"),
}

# First words from other languages, with the intended word.
FOREIGN_FIRST_WORDS: dict[str, str] = {
    "agent": "species",
    "class": "species",
    "const": "param",
    "def": "behaviour",
    "every": "each",
    "fn": "behaviour",
    "function": "behaviour",
    "if": "when",
    "import": "use",
    "include": "use",
    "parameter": "param",
    "transition": "when",
    "var": "let",
}

# Words after which `NAME …` follows in `world`, listed if the word is missing.
WORLD_KIND_WORDS = ("surface", "obstacle", "solid", "items", "curve", "flow", "map", "camera", "lamp", "species")
FIELD_SETTING_WORDS = ("cell", "half_life", "evaporate", "keeps", "diffuse", "stencil", "combine", "deposits", "limit")
FIELD_VALUE_WORDS = ("number", "push")  # what the cells of a field hold, the default first
FIXED_FIELD_SETTINGS = ("cell", "stencil", "combine", "deposits")  # a changed value makes it another field
WORD_SETTING_VALUES = {"combine": ("add", "max"), "deposits": ("last", "first")}  # words as values, the default first

# The context of lines with these first words, for messages about misplaced lines.
LINE_CONTEXT_BY_WORD: dict[str, str] = {
    **{word: "at the top of the file" for word in LINE_WORDS_BY_RULE["top"]},
    **{word: "in a species" for word in LINE_WORDS_BY_RULE["member"]},
    **{word: "in a state" for word in ("steer", "enter", "exit", *_CHANGE_WORDS)},
    "face": "in a state, or in `layers`",
    **{word: "in a state, or in the braces of a transition" for word in _ACTION_WORDS},
    **{word: "in a state" for word in ("play", "wear", "channel", "look")},
    "let": "in a species, a state or a behaviour",
    "keep": "in a behaviour",
    **{word: "in a spec" for word in LINE_WORDS_BY_RULE["spec_line"] if word != "when"},
}

# The grammar rule of the lines in braces, by the rule of the line before and its first word (`*`: any).
BODY_RULE_BY_LINE: dict[tuple[str, str], str] = {
    ("top", "world"): "world_item",
    ("top", "field"): "setting",
    ("top", "species"): "member",
    ("top", "behaviour"): "behaviour_line",
    ("top", "spec"): "spec_line",
    ("world_item", "*"): "declaration",
    ("member", "state"): "statement",
    ("member", "machine"): "machine_member",
    ("member", "layers"): "layer",
    ("member", "on"): "action",
    ("member", "fuzzy"): "rule",
    ("member", "from"): "action",
    ("machine_member", "state"): "statement",
    ("machine_member", "from"): "action",
    ("statement", "enter"): "action",
    ("statement", "exit"): "action",
    ("statement", "when"): "action",
    ("statement", "interrupt"): "action",
    ("spec_line", "each"): "spec_line",
    ("spec_line", "against"): "spec_line",
}
_OPTIONAL_BRACE_WORDS = {"*", "when", "interrupt", "from", "against"}
BLOCK_WORDS = frozenset(word for _, word in BODY_RULE_BY_LINE) - _OPTIONAL_BRACE_WORDS  # their braces cannot be left out

# An example line of each kind, for messages.
EXAMPLE_LINES: dict[str, str] = {
    "ant": FIRST_LINE,
    "use": 'use steering` or `use "./mine.ant" as mine',
    "world": "world { surface ground }",
    "field": "field trail on ground { cell 4 mm; half_life 8 s }",
    "species": "species forager { … }",
    "behaviour": "behaviour seek(target: place) -> push { … }",
    "spec": 'spec "what it shows" on "scene.yaml" { … }',
    "measure": "measure stored = total(nest.load)",
    "param": "param smell = 40 mm in 0 mm .. 200 mm",
    "let": "let meal = nearest(food)",
    "latch": "latch hungry = energy < 0.4 until energy > 0.6",
    "fuzzy": "fuzzy danger { near and fast -> 0.8 }",
    "start": "start search",
    "on": "on collision(other) { calm -= 0.3 }",
    "layers": "layers { avoid(stones); state }",
    "machine": "machine moving { … }",
    "state": 'state search "Looking for food" amber { … }',
    "from": "from any except dead when hurt -> flee",
    "steer": "steer seek(meal)",
    "face": "face direction(meal)",
    "enter": "enter { calm = 1 }",
    "exit": "exit { calm = 1 }",
    "when": "when meal -> approach",
    "interrupt": "interrupt when hurt -> flee",
    **{row.word: row.example_line for row in VERB_BY_WORD.values()},
    "keep": "keep bearing = 0 deg then bearing + 1 deg",
    "for": "for 20 s",
    "seeds": "seeds 1 .. 5",
    "pass": "pass 80 %",
    "set": "set forager.smell = 50 mm",
    "against": "against { set forager.reward = 0 /s }",
    "always": "always: share(state == carry) < 0.9",
    "never": "never: share(state == carry) > 0.9",
    "eventually": "eventually: share(state == carry) > 0.1",
    "finally": "finally: total(food.load) == 0",
    "sooner": "sooner: total(food.load) == 0",
    "until": "until: total(food.load) == 0",
    "within": "within 20 s: total(nest.load) > 0",
    "goal": "goal 5 %: total(nest.load) == 400",
    "each": "each forager { never: speed > 40 mm/s }",
}

# The same for lines that begin with a name, by grammar rule.
EXAMPLE_LINE_BY_RULE: dict[str, str] = {
    "header": FIRST_LINE,
    "world_item": 'surface ground "What ants walk on"',
    "declaration": "load = 0",
    "setting": "cell 4 mm",
    "member": "calm = 1` or `max_speed 30 mm/s",
    "statement": "calm -= 10 %/s",
    "action": "calm = 1",
    "layer": "avoid(stones) when state == carry",
    "rule": "near and fast -> 0.8",
    "weight": "search: 2",
    "behaviour_line": "direction(target)",
}

# Descriptions of what follows a word or sign.
CONTINUATION_TEXTS: dict[str, str] = {
    "when": "a condition",
    "and": "a condition",
    "or": "a condition",
    "not": "a condition",
    "no": "a sense, such as `meal`",
    "if": "a condition",
    "then": "a value",
    "else": "a value",
    "steer": "a push, such as `seek(meal)`",
    "face": "a direction, such as `direction(meal)`",
    "held": "a time, such as `0.5 s`",
    "after": "a time, such as `0.5 s`",
    "over": "a time, such as `4 s`",
    "within": "a time, such as `20 s`",
    "goal": "a tolerance, such as `5 %`",
    "least": "a time, such as `1 s`",
    "take": "an amount, such as `1 load`",
    "from": "where from",
    "to": "where to",
    "in": "a range, such as `0 mm .. 200 mm`",
    "chance": "a rate, such as `20 %/s`",
    "clip": "`done`, or `at` and the name of a mark",
    "until": "a condition",
    "state": "the name of the state",
    "start": "the name of a state",
    "species": "a name",
    "field": "the name of the field",
    "machine": "the name of the machine",
    "behaviour": "the name of the behaviour",
    "param": "the name of the parameter",
    "let": "a name",
    "latch": "a name",
    "fuzzy": "a name",
    "keep": "a name",
    "use": "the name of a library, or the path of a file in quotes",
    "as": "a name",
    "spec": "a name in quotes",
    "measure": "a name",
    **{row.word: row.following_text for row in VERB_BY_WORD.values() if row.following_text},
    "choose": "`{`",
    "each": "the name of a species",
    "of": "a name",
    "is": "`none` or `not none`",
    "(": "a value or `)`",
    "..": "the upper end of the range",
    "ant": f"the edition, `{NEWEST_EDITION}`",
    "{": "a line or `}`",
}

# All words with a meaning in some line.
LANGUAGE_WORDS = frozenset(
    {*(word for words in LINE_WORDS_BY_RULE.values() for word in words), *(word for word in CONTINUATION_TEXTS if word.isalpha())}
    | {"relax", "strongest", "any", "except", "none", "all"}
)
