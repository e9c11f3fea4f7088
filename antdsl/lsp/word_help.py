"""The meanings of the language's words, for editors and for `antdsl check --explain WORD`."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from typing import Any

from antdsl.loading import find_library
from antdsl.lsp import sample_lines
from antdsl.lsp import word_descriptions as tables
from antdsl.program.expectations import GEOMETRY_MEASURES, MOTION_MEASURES
from antdsl.program.kinds import Dimension
from antdsl.program.names.bindings import NameKey
from antdsl.program.names.collect import BUILTIN_EVENTS
from antdsl.program.tables import vocabulary
from antdsl.program.tables.colours import COLOUR_BY_NAME
from antdsl.program.tables.editions import DEFAULT_BY_SETTING, SWITCH_HELP
from antdsl.program.tables.rows import BuiltinRow
from antdsl.program.tables.things import KIND_BY_WORD, ThingKindRow
from antdsl.program.tables.units import choose_default_unit, describe_dimension, find_unit_measure
from antdsl.resources import list_library_names
from antdsl.syntax import nodes
from antdsl.syntax.editions import EDITIONS
from antdsl.syntax.words import EXAMPLE_LINES

WordHelpRule = Callable[[NameKey], str | None]
# The words at the start of species members; attributes have none.
MEMBER_WORDS: Mapping[type, str] = {nodes.ParamDecl: "param", nodes.Let: "let", nodes.Latch: "latch", nodes.Fuzzy: "fuzzy"}


def collapse_whitespace(text: str) -> str:
    """Return a text with each run of whitespace replaced by one space."""
    return " ".join(text.split())


def find_help_text(node: Any) -> str:
    """Return the help text of a declaration; "" if it has none."""
    help = getattr(node, "help", None)
    return help.text if help is not None else ""


def format_markdown(form: str, *lines: str, notation: str = "ant") -> str:
    """Return Markdown that consists of a code block and explanations, one paragraph each. `form`: the code. `notation`: its
    language."""
    return "\n\n".join([f"```{notation}\n{form}\n```", *(line for line in lines if line)])


def format_signature(node: nodes.Behaviour) -> str:
    """Return the signature of a behaviour, such as `seek(target: place) -> push`."""
    parts = []
    for argument in node.arguments:
        default = f" = {collapse_whitespace(argument.default.span.text)}" if argument.default is not None else ""
        parts.append(f"{argument.name.text}: {collapse_whitespace(argument.type.span.text)}{default}")
    return f"{node.name.text}({', '.join(parts)}) -> {collapse_whitespace(node.returns.span.text)}"


def _describe_event(key: NameKey) -> str | None:
    """Return the help for an event, built in or declared."""
    text_by_event = {"spawn": "the event at an agent's birth", "collision": "the agent's body begins to touch another one"}
    return format_markdown(
        f"on {key[1]}", text_by_event.get(key[1], "an event: agents notice it once, in the step after it was emitted")
    )


def _describe_element(key: NameKey) -> str | None:
    """Return the help for the variable of a set query."""
    return format_markdown(key[-1], "the current element of the set")


def _describe_builtin_attribute(key: NameKey) -> str | None:
    """Return the help for an attribute that every animal has; None for another word."""
    name = key[1]
    if name in SWITCH_HELP:
        return format_markdown(f"{name} true", f"{SWITCH_HELP[name]}; {_describe_defaults(name)}", "setting of a species")
    row = vocabulary.BUILTIN_ATTRIBUTE_BY_NAME.get(name)
    if row is None:
        return None
    default = [_describe_defaults(name)] if name in DEFAULT_BY_SETTING else [f"default {row.default}"] if row.default else []
    details = (
        default + (["may be set"] if row.is_settable else []) + ([f"from `ant {row.edition}` on"] if row.edition > 1 else [])
    )
    form = f"{name} {row.default}" if row.default else f"let mine = {name}"
    return format_markdown(f"{key[1]}: {row.type}\n{form}", "; ".join([row.help, *details]), "an attribute of every animal")


def _describe_defaults(name: str) -> str:
    """Return a description of a setting's default in edition 1, and in each later edition that changed it."""
    row = DEFAULT_BY_SETTING[name]
    texts = [row.get_default(edition) or "none" for edition in EDITIONS]
    changed_defaults = [f"in `ant {edition}`: {text}" for edition, text in zip(EDITIONS, texts, strict=True) if text != texts[0]]
    return ", ".join([f"default {texts[0]}", *changed_defaults])


def format_builtin(name: str, row: BuiltinRow) -> str:
    """Return the signature of a built-in, such as `clamp(x: number A, to: range A) -> number A`."""
    parts = []
    for arg in row.args:
        default = f" = {arg.default}" if arg.default is not None else ""
        parts.append(f"{arg.name}{'…' if arg.is_variadic else ''}: {arg.type}{default}{'?' if arg.is_optional else ''}")
    return f"{name}({', '.join(parts)}) -> {row.result}"


def _describe_builtin(key: NameKey) -> str | None:
    """Return the help for a word that can be called: a function, a reducer or an aggregate."""
    texts = [rule(key) for rule in (_describe_builtin_function, _describe_reducer, _describe_aggregate)]
    return "\n\n".join(each for each in texts if each) or None


def _describe_builtin_function(key: NameKey) -> str | None:
    """Return the help for a built-in function; None for another word."""
    rows = vocabulary.BUILTINS_BY_NAME.get(key[1], ())
    if not rows:
        return None
    return format_markdown(
        "\n".join([*(format_builtin(key[1], row) for row in rows), sample_lines.CALL_SAMPLES[key[1]]]), rows[0].help
    )


def _describe_reducer(key: NameKey) -> str | None:
    """Return the help for a reducer of a set, such as `sum`; None for another word."""
    help = vocabulary.REDUCER_HELP.get(key[1])
    return None if help is None else format_markdown(f"{key[1]}(n in SET: …)\n{sample_lines.SET_QUERY_SAMPLES[key[1]]}", help)


def _describe_aggregate(key: NameKey) -> str | None:
    """Return the help for an aggregate of a spec; None for another word."""
    row = tables.AGGREGATE_HELP.get(key[1])
    return None if row is None else format_markdown(f"{key[1]}(…)\n{row.sample}", row.help)


def _describe_builtin_argument(key: NameKey) -> str | None:
    """Return the help for an argument of a built-in function; None for another word."""
    for row in vocabulary.BUILTINS_BY_NAME.get(key[1], ()):
        for arg in row.args:
            if arg.name == key[2]:
                default = f"default {arg.default}" if arg.default is not None else "may be left out" if arg.is_optional else ""
                return format_markdown(f"{arg.name}: {arg.type}", default, f"argument of `{key[1]}`")
    return None


def _describe_value_word(key: NameKey) -> str | None:
    """Return the help for a word that stands for a value or a property of a state; None for another word."""
    word = key[1]
    row = tables.STATE_WORD_HELP.get(word) or tables.VALUE_HELP.get(word)
    type = vocabulary.RUN_VALUE_TYPES.get(word) or vocabulary.SENSE_TYPE_BY_NAME.get(word)
    return None if row is None else format_markdown(f"{word}: {type}\n{row.sample}" if type else row.sample, row.help)


def _describe_unit(key: NameKey) -> str | None:
    """Return the help for a unit, which may be compound, such as `mm/s`; None for an unknown unit."""
    measure = find_unit_measure(key[1])
    if measure is None:
        return None
    base = choose_default_unit(measure.dim)
    base_unit = find_unit_measure(base)
    # angles are stored in radians, but displayed relative to `deg`
    factor = measure.factor / base_unit.factor if base_unit is not None else measure.factor
    worth = f"1 {key[1]} = {factor:.6g} {base}".strip() if key[1] != base and not measure.unit_power and not measure.step else ""
    rate = f"an amount per second: `x += 3 {key[1]}` in a state" if measure.dim.time == -1 and not measure.step else ""
    of_steps = "" if not measure.step or key[1] in tables.UNIT_HELP else tables.STEP_UNIT_NOTE
    return format_markdown(
        f"3 {key[1]}", describe_dimension(measure.dim), tables.UNIT_HELP.get(key[1], ""), worth, rate, of_steps
    )


def _make_typed_word_rule(table: Any, explanation: str, form: str) -> WordHelpRule:
    """Return a rule that describes the words of `table`, which maps words to types. `explanation`: added to each description.
    `form`: a sample line with a placeholder for the word."""

    def describe_typed_word(key: NameKey) -> str | None:
        return format_markdown(f"{key[1]}: {table[key[1]]}\n{form.format(key[1])}", explanation) if key[1] in table else None

    return describe_typed_word


def _make_word_rule(table: Mapping[str, tables.WordHelp | ThingKindRow], explanation: str, notation: str = "ant") -> WordHelpRule:
    """Return a rule that describes the words of `table`, which maps words to help texts. `explanation`: added to each
    description."""

    def describe_word(key: NameKey) -> str | None:
        row = table.get(key[1])
        return None if row is None else format_markdown(row.sample, row.help, explanation, notation=notation)

    return describe_word


def describe_keyword(word: str, begins_line: bool) -> str | None:
    """Return the description of a keyword; None for another word.

    `begins_line`: whether the word begins a line. The meaning can depend on this: compare `on` in `on spawn { … }` and in `field
    trail on ground`."""
    if not begins_line:
        return (
            format_markdown(tables.INNER_WORD_HELP[word].sample, tables.INNER_WORD_HELP[word].help)
            if word in tables.INNER_WORD_HELP
            else None
        )
    if word not in tables.FORM_HELP:
        return None
    form = EXAMPLE_LINES.get(word, "when touching(meal) take 1 load from meal -> carry" if word == "take" else word)
    return format_markdown(form.replace("` or `", "\n"), tables.FORM_HELP[word])


def _describe_type_word(key: NameKey) -> str | None:
    """Return the help for a type; None for another word."""
    value_type = vocabulary.TYPE_BY_WORD.get(key[1])
    if value_type is None:
        return None
    unit = choose_default_unit(value_type) if isinstance(value_type, Dimension) else ""
    return format_markdown(
        f"behaviour mine(x: {key[1]}) -> push {{ … }}", f"numbers in `{unit}`" if unit else tables.TYPE_HELP[key[1]], "a type"
    )


def _describe_steered_state(key: NameKey) -> str | None:
    """Return the help for the word `state` in a list of layers."""
    return format_markdown("state", "the push that the animal's states steer")


def _describe_colour(key: NameKey) -> str | None:
    """Return the help for a colour."""
    red, green, blue = COLOUR_BY_NAME[key[1]]
    return format_markdown(f'state rest "At rest" {key[1]} {{ … }}', f"a colour for states: {red}, {green}, {blue} of 255")


HELP_RULES: dict[str, WordHelpRule] = {
    "given": _describe_builtin_attribute, "builtin": _describe_builtin, "builtin-argument": _describe_builtin_argument,
    "word": _describe_value_word, "unit": _describe_unit, "steered": _describe_steered_state,
    "event": _describe_event, "element": _describe_element,
    "setting": _make_word_rule(tables.SETTING_HELP, "setting of a field"),
    "kind": _make_word_rule(KIND_BY_WORD, "kind of thing of the world"), "type": _describe_type_word,
    "item-given": _make_typed_word_rule(vocabulary.ITEM_ATTRIBUTE_TYPES, "a value of every item", "nearest(food).{}"),
    "hit-given": _make_typed_word_rule(
        vocabulary.HIT_ATTRIBUTE_TYPES, "a value of a ray's hit", "ray(heading, reach: 20 mm, on: stones).{}"
    ),
    "motion": _make_typed_word_rule(MOTION_MEASURES, "a measure of the crowd's motion", "motion.{}"),
    "geometry": _make_typed_word_rule(GEOMETRY_MEASURES, "a measure of an animal's pose, for specs", "any({} > 0)"),
    "scene": _make_word_rule(tables.SCENE_KEY_HELP, "key of a scene", "yaml"), "colour": _describe_colour,
    "body": lambda key: format_markdown(
        key[1], "a clip, layer, channel or transform group of the animal's body"
    ),
}  # fmt: skip
# Possible meanings of a bare word: as text, the table that contains it, and the rule that recognises it.
_WORD_MEANINGS: tuple[tuple[str, Collection[str], WordHelpRule], ...] = (
    ("begins a line", tables.FORM_HELP, lambda key: describe_keyword(key[1], True)),
    ("inside a line", tables.INNER_WORD_HELP, lambda key: describe_keyword(key[1], False)),
    ("a call", vocabulary.BUILTINS_BY_NAME, _describe_builtin_function),
    ("of a set", vocabulary.REDUCER_HELP, _describe_reducer),
    ("of all agents, in a spec", tables.AGGREGATE_HELP, _describe_aggregate),
    ("an attribute of every animal", {**vocabulary.BUILTIN_ATTRIBUTE_BY_NAME, **SWITCH_HELP}, _describe_builtin_attribute),
    ("a value", {**tables.STATE_WORD_HELP, **tables.VALUE_HELP}, _describe_value_word),
    ("a unit", vocabulary.UNIT_BY_NAME, _describe_unit),
    ("kind of thing of the world", KIND_BY_WORD, HELP_RULES["kind"]),
    ("setting of a field", tables.SETTING_HELP, HELP_RULES["setting"]),
    ("a type", vocabulary.TYPE_BY_WORD, _describe_type_word),
    ("a value of a ray's hit", vocabulary.HIT_ATTRIBUTE_TYPES, HELP_RULES["hit-given"]),
    ("a value of every item", vocabulary.ITEM_ATTRIBUTE_TYPES, HELP_RULES["item-given"]),
    ("a measure of the crowd's motion", MOTION_MEASURES, HELP_RULES["motion"]),
    ("a measure of an animal's pose, for specs", GEOMETRY_MEASURES, HELP_RULES["geometry"]),
    ("key of a scene", tables.SCENE_KEY_HELP, HELP_RULES["scene"]),
    ("a colour", COLOUR_BY_NAME, _describe_colour),
    ("an event", BUILTIN_EVENTS, _describe_event),
)


def list_known_words() -> set[str]:
    """Return all words that `explain_word` knows, except compound units."""
    own_words = {
        word
        for _, node in _list_library_behaviours()
        for word in (node.name.text, *(argument.name.text for argument in node.arguments))
    }
    arguments = {arg.name for rows in vocabulary.BUILTINS_BY_NAME.values() for row in rows for arg in row.args}
    words_with_meaning = {word for _, table, _ in _WORD_MEANINGS for word in table}
    return {*words_with_meaning, *own_words, *arguments, *list_library_names(), *vocabulary.RESERVED_WORDS}


def explain_word(word: str) -> str | None:
    """Return all meanings of a word as Markdown; None for an unknown word.

    The word may be a compound unit, with or without a number before it."""
    meanings = [(title, rule(("", word))) for title, table, rule in _WORD_MEANINGS if word in table]
    unit = word.lstrip("0123456789. ")
    if not meanings and (unit_text := _describe_unit(("unit", unit))):
        meanings, word = [("a unit", unit_text)], unit
    meanings += [("argument of a call", "\n\n".join(_describe_argument_uses(word)))]
    for brings, node in _list_library_behaviours():
        if node.name.text == word:
            text = format_markdown(f"behaviour {format_signature(node)}", find_help_text(node), f"`use {brings}`")
            meanings.append(
                (f"a behaviour of the library `{brings}`", f"{text}\n\nIts definition:\n\n```ant\n{node.span.text}\n```")
            )
    if word in list_library_names():
        names = ", ".join(f"`{node.name.text}`" for brings, node in _list_library_behaviours() if brings == word)
        meanings.append(("a library", format_markdown(f"use {word}", f"the library: {names}")))
    texts = [(title, text) for title, text in meanings if text]
    if not texts and word in vocabulary.RESERVED_WORDS:
        texts = [("", "a word of the language that does not work yet")]
    if not texts:
        return None
    if len(texts) == 1:
        return f"# {word}\n\n{texts[0][1]}\n"
    parts = (f"## {title}\n\n{text.removesuffix(f'{_PARAGRAPH_BREAK}{title}')}" for title, text in texts)
    return f"# {word}\n\n" + "\n\n".join(parts) + "\n"


_PARAGRAPH_BREAK = "\n\n"


def _describe_argument_uses(word: str) -> Iterator[str]:
    """Yield the help for each built-in call that has an argument of this name."""
    for function_name, rows in vocabulary.BUILTINS_BY_NAME.items():
        for row in rows:
            if any(arg.name == word for arg in row.args):
                yield format_markdown(
                    f"{format_builtin(function_name, row)}\n{sample_lines.CALL_SAMPLES[function_name]}",
                    f"argument of `{function_name}`",
                )
    if word in tables.PLAY_HELP:
        yield format_markdown(f"play CLIP({word}: …)\n{tables.PLAY_HELP[word]}", "argument of `play`")
    for _, node in _list_library_behaviours():
        if any(argument.name.text == word for argument in node.arguments):
            yield format_markdown(format_signature(node), f"argument of `{node.name.text}`")


def _list_library_behaviours() -> Iterator[tuple[str, nodes.Behaviour]]:
    """Yield the behaviours of all libraries, each with the name of its library."""
    for name in list_library_names():
        file = find_library(name)
        if file is not None:
            yield from ((name, item) for item in file.items if isinstance(item, nodes.Behaviour))
