"""What the words of the language mean, wherever they are asked for: in an editor, and by `antdsl check --explain WORD`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from antdsl.lsp.names import Key
from antdsl.lsp.words import FORM_HELP, INNER_HELP, KINDS, SCENE_HELP, SETTINGS, STATE_WORD_HELP, WHOLE_HELP, WORD_HELP
from antdsl.program.collect import EVENTS
from antdsl.program.colours import COLOURS
from antdsl.program.expected import GEOMETRY, MOTION
from antdsl.program.units import unit_of
from antdsl.program.vocabulary import (
    BUILTINS,
    GIVEN,
    HIT_GIVEN,
    ITEM_GIVEN,
    REDUCERS,
    RESERVED,
    RUN_NAMES,
    SENSED_NAMES,
    TYPE_WORDS,
    UNITS,
    Builtin,
)
from antdsl.resources import library_file, library_names
from antdsl.syntax import nodes, parse, read
from antdsl.syntax.words import FORMS

Rule = Callable[[Key], str | None]


def flat(text: str) -> str:
    return " ".join(text.split())


def markdown(form: str, *lines: str) -> str:
    """A form in the language, then what there is to say, a paragraph each."""
    return "\n\n".join([f"```ant\n{form}\n```", *(line for line in lines if line)])


def signature(node: nodes.Behaviour) -> str:
    """`seek(target: place) -> push`."""
    parts = []
    for argument in node.arguments:
        default = f" = {flat(argument.default.span.text)}" if argument.default is not None else ""
        parts.append(f"{argument.name.text}: {flat(argument.type.span.text)}{default}")
    return f"{node.name.text}({', '.join(parts)}) -> {flat(node.returns.span.text)}"


def _event(key: Key) -> str | None:
    known = {"spawn": "happens once, at birth", "collision": "two agents touch"}
    return markdown(f"on {key[1]}", known.get(key[1], "an event: seen once, in the step after it was raised"))


def _element(key: Key) -> str | None:
    return markdown(key[1].text, "one of the set, each in turn")


def _given(key: Key) -> str | None:
    row = GIVEN.get(key[1])
    if row is None:
        return None
    more = ([f"default {row.default}"] if row.default else []) + (["may be set"] if row.settable else [])
    return markdown(f"{key[1]}: {row.type}", "; ".join([row.help, *more]), "every animal has it")


def builtin_form(name: str, row: Builtin) -> str:
    """`clamp(x: number A, to: range A) -> number A`."""
    parts = []
    for arg in row.args:
        default = f" = {arg.default}" if arg.default is not None else ""
        parts.append(f"{arg.name}{'…' if arg.variadic else ''}: {arg.type}{default}{'?' if arg.optional else ''}")
    return f"{name}({', '.join(parts)}) -> {row.result}"


def _builtin(key: Key) -> str | None:
    rows = BUILTINS.get(key[1], ())
    said = [markdown("\n".join(builtin_form(key[1], row) for row in rows), rows[0].help)] if rows else []
    if key[1] in REDUCERS:
        said.append(markdown(f"{key[1]}(n in SET: …)", REDUCERS[key[1]]))
    if key[1] in WHOLE_HELP:
        said.append(markdown(f"{key[1]}(…)", WHOLE_HELP[key[1]]))
    return "\n\n".join(said) or None


def _builtin_argument(key: Key) -> str | None:
    for row in BUILTINS.get(key[1], ()):
        for arg in row.args:
            if arg.name == key[2]:
                default = f"default {arg.default}" if arg.default is not None else "may be left out" if arg.optional else ""
                return markdown(f"{arg.name}: {arg.type}", default, f"argument of `{key[1]}`")
    return None


def _word(key: Key) -> str | None:
    word = key[1]
    help = STATE_WORD_HELP.get(word) or WORD_HELP.get(word)
    type = RUN_NAMES.get(word) or SENSED_NAMES.get(word)
    return markdown(f"{word}: {type}" if type else word, help) if help else None


def _unit(key: Key) -> str | None:
    from antdsl.program.units import dimension_words, measure

    known = measure(key[1])
    if known is None:
        return None
    base = unit_of(known.dim)
    whole = measure(base)
    factor = known.factor / whole.factor if whole is not None else known.factor  # angles are in radians behind `deg`
    worth = f"1 {key[1]} = {factor:.6g} {base}".strip() if key[1] != base and not known.u and not known.step else ""
    return markdown(key[1], dimension_words(known.dim), worth)


def _typed_word(table: Any, what: str) -> Rule:
    def rule(key: Key) -> str | None:
        return markdown(f"{key[1]}: {table[key[1]]}", what) if key[1] in table else None

    return rule


def _said(table: dict[str, str], what: str) -> Rule:
    def rule(key: Key) -> str | None:
        return markdown(key[1], table[key[1]], what) if key[1] in table else None

    return rule


def keyword(word: str, begins: bool) -> str | None:
    """A word of the language. What begins a line says something else than what stands inside one: `on spawn { … }`, `field
    trail on ground`."""
    if not begins:
        return markdown(word, INNER_HELP[word]) if word in INNER_HELP else None
    if word not in FORM_HELP:
        return None
    form = FORMS.get(word, "when touching(meal) take 1 load from meal -> carry" if word == "take" else word)
    return markdown(form.replace("` or `", "\n"), FORM_HELP[word])


def _type_word(key: Key) -> str | None:
    known = TYPE_WORDS.get(key[1])
    if known is None:
        return None
    from antdsl.program.model import Dim

    unit = unit_of(known) if isinstance(known, Dim) else ""
    return markdown(key[1], f"a type: numbers in `{unit}`" if unit else "a type")


def _steered(key: Key) -> str | None:
    return markdown("state", "what the states of the animal steer")


def _colour(key: Key) -> str | None:
    red, green, blue = COLOURS[key[1]]
    return markdown(f'state rest "At rest" {key[1]} {{ … }}', f"a colour of a state: {red}, {green}, {blue} of 255")


LANGUAGE: dict[str, Rule] = {
    "given": _given, "builtin": _builtin, "builtin-argument": _builtin_argument, "word": _word, "unit": _unit,
    "steered": _steered, "event": _event, "element": _element,
    "setting": _said(SETTINGS, "setting of a field"), "kind": _said(KINDS, "kind of thing of the world"), "type": _type_word,
    "item-given": _typed_word(ITEM_GIVEN, "every item has it"), "hit-given": _typed_word(HIT_GIVEN, "what a ray met has it"),
    "motion": _typed_word(MOTION, "how the crowd moves"),
    "geometry": _typed_word(GEOMETRY, "how an animal's body stands: asked in a spec"),
    "scene": _said(SCENE_HELP, "key of a scene"), "colour": _colour,
}  # fmt: skip
# Which of them a bare word is looked up in, and by which table.
_LOOKED_UP: dict[str, Any] = {
    "builtin": {**BUILTINS, **REDUCERS, **WHOLE_HELP}, "given": GIVEN, "word": {**STATE_WORD_HELP, **WORD_HELP}, "unit": UNITS,
    "kind": KINDS, "setting": SETTINGS, "type": TYPE_WORDS, "hit-given": HIT_GIVEN, "item-given": ITEM_GIVEN, "motion": MOTION,
    "geometry": GEOMETRY, "scene": SCENE_HELP, "colour": COLOURS,
}  # fmt: skip


def words() -> set[str]:
    """All words that `about` knows."""
    own = {word for _, node in _library() for word in (node.name.text, *(argument.name.text for argument in node.arguments))}
    arguments = {arg.name for rows in BUILTINS.values() for row in rows for arg in row.args}
    tables = {word for table in _LOOKED_UP.values() for word in table}
    return {*FORM_HELP, *INNER_HELP, *tables, *own, *arguments, *library_names(), *EVENTS, *RESERVED}


def about(word: str) -> str | None:
    """All that a word of the language, of a scene or of the library means, as Markdown; None for one that is not known."""
    found = [keyword(word, begins=True), keyword(word, begins=False)]
    found += [LANGUAGE[kind]((kind, word)) for kind, table in _LOOKED_UP.items() if word in table]
    found += [LANGUAGE["event"](("event", word))] if word in EVENTS else []
    found += [_builtin_argument(("builtin-argument", called, word)) for called in BUILTINS]
    names = []
    for library, node in _library():
        names += [node.name.text] if library == word else []
        if node.name.text == word:
            text = f"behaviour {signature(node)}"
            found.append(markdown(text, node.help.text if node.help else "", f"in the library `{library}`: `use {library}`"))
            found.append(f"It is written so:\n\n```ant\n{node.span.text}\n```")
        for argument in node.arguments:
            found += [markdown(flat(argument.span.text), f"argument of `{node.name.text}`")] if argument.name.text == word else []
    if names:
        found.append(markdown(f"use {word}", "the library: " + ", ".join(f"`{name}`" for name in names)))
    if word in RESERVED and not any(found):
        found.append("a word of the language that does not work yet")
    bare = markdown(word, "")  # a word alone shows nothing
    said = list(dict.fromkeys(each.removeprefix(f"{bare}\n\n") for each in found if each is not None))
    return f"# {word}\n\n" + "\n\n".join(said) + "\n" if said else None


def _library() -> Iterator[tuple[str, nodes.Behaviour]]:
    for name in library_names():
        path = library_file(name)
        source = read(path)[0] if path is not None else None
        for item in parse(source)[0].items if source is not None else ():
            if isinstance(item, nodes.Behaviour):
                yield name, item
