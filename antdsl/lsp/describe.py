"""What an editor shows about a name: its declaration in the language's own form, type, range, default and help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from antdsl.lsp.names import Key, declaration
from antdsl.lsp.navigation import declared
from antdsl.lsp.words import FORM_HELP, INNER_HELP, KINDS, SETTINGS, STATE_WORD_HELP, WHOLE_HELP, WORD_HELP
from antdsl.lsp.workspace import Document, Workspace
from antdsl.program.expected import MOTION
from antdsl.program.kinds import Kind, Type
from antdsl.program.model import Program
from antdsl.program.units import unit_of
from antdsl.program.vocabulary import (
    BUILTINS,
    GIVEN,
    HIT_GIVEN,
    ITEM_GIVEN,
    REDUCERS,
    RUN_NAMES,
    SENSED_NAMES,
    TYPE_WORDS,
    Builtin,
)
from antdsl.program.wording import type_words
from antdsl.syntax import nodes
from antdsl.syntax.words import FORMS


def markdown(form: str, *lines: str) -> str:
    """A form in the language, then what there is to say, a paragraph each."""
    return "\n\n".join([f"```ant\n{form}\n```", *(line for line in lines if line)])


def describe(workspace: Workspace, document: Document, key: Key) -> str | None:
    """What to show for a symbol, as Markdown; None when nothing is known."""
    rule = _RULES.get(key[0])
    return rule(workspace, document, key) if rule is not None else None


def _flat(text: str) -> str:
    return " ".join(text.split())


def _help(node: Any) -> str:
    help = getattr(node, "help", None)
    return help.text if help is not None else ""


def _typed(program: Program | None, key: Key) -> Type | None:
    """The type that the checker found for a name of a species."""
    species = program.species.get(key[1]) if program is not None else None
    if species is None:
        return None
    for each in (*species.attributes, *species.lets, *species.latches):
        if each.name == key[-1]:
            return each.type
    return next((p.type for p in species.params if p.name == f"{key[1]}.{key[-1]}"), None)


def _kind_line(type: Type | None, *more: str) -> str:
    if type is None or type.kind is Kind.BAD:
        return "; ".join(more)
    unit = unit_of(type.dim) if type.kind in (Kind.NUMBER, Kind.VECTOR) else ""
    return "; ".join([type_words(type) + (f", in `{unit}`" if unit else ""), *more])


def _own(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    if found is None:
        return None
    where, node = found[0], declaration(found[1].node) or found[1].node
    typed = _typed(workspace.good(where.path), key)
    word = {nodes.ParamDecl: "param ", nodes.Let: "let ", nodes.Latch: "latch ", nodes.Fuzzy: "fuzzy "}.get(
        type(found[1].node), ""
    )
    if isinstance(node, nodes.Latch):
        form = f"latch {node.name.text} = {_flat(node.on.span.text)} until {_flat(node.until.span.text)}"
    elif isinstance(node, nodes.Fuzzy):
        form = f"fuzzy {node.name.text} {{ … }}"
    else:
        form = f"{word}{node.name.text} = {_flat(node.value.span.text)}"
    more = []
    if isinstance(node, nodes.Declaration):
        if node.range is not None:
            form += f" in {_flat(node.range.span.text)}"
            more.append(f"from {_flat(node.range.low.span.text)} to {_flat(node.range.high.span.text)}")
        more.append(f"default {_flat(node.value.span.text)}" if word else f"{_flat(node.value.span.text)} at birth")
        if node.each is not None:
            more.append(f"one value about each {node.each.species.text}")
    return markdown(
        form,
        _kind_line(typed, *more),
        _help(node),
        f"{'param' if word == 'param ' else word.strip() or 'attribute'} of `{key[1]}`",
    )


def _thing(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    node = found[1].node if found is not None else None
    if not isinstance(node, nodes.WorldItem):
        return None
    inner = "; ".join(_flat(each.span.text) for each in node.attributes)
    return markdown(
        f"{node.kind.text} {node.name.text}" + (f" {{ {inner} }}" if inner else ""), KINDS.get(node.kind.text, ""), _help(node)
    )


def _attribute(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    if found is None:
        return None
    program = workspace.good(found[0].path)
    thing = program.world.get(key[1]) if program is not None else None
    type = next((each.type for each in thing.attributes if each.name == key[2]), None) if thing is not None else None
    node = found[1].node
    value = _flat(node.value.span.text)
    return markdown(f"{key[2]} = {value}", _kind_line(type, f"default {value}"), _help(node), f"value of each of `{key[1]}`")


def _field(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    node = found[1].node if found is not None else None
    if not isinstance(node, nodes.FieldDecl):
        return None
    surfaces = ", ".join(name.text for name in node.surfaces)
    settings = "; ".join(_flat(each.span.text) for each in node.settings)
    return markdown(f"field {key[1]} on {surfaces} {{ {settings} }}", "a field; its name is its value here", _help(node))


def _species(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    if found is None:
        return None
    table = found[0].names.species.get(key[1])
    machines = table.machines if table is not None else {}
    states = "; ".join(f"{name}: {', '.join(f'`{s}`' for s in states)}" for name, states in machines.items())
    return markdown(f"species {key[1]}", _help(found[1].node), f"states of {states}" if states else "")


def _state(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    node = found[1].node if found is not None else None
    if not isinstance(node, nodes.State):
        return None
    label = f' "{node.label.text}"' if node.label is not None else ""
    colour = f" {node.colour.text}" if node.colour is not None else ""
    least = f"at least {_flat(node.at_least.span.text)}" if node.at_least is not None else ""
    ways = []
    for line in node.body:
        if isinstance(line, nodes.Change):
            ways += [line.target.name.text] if line.target.name is not None else [c.target.text for c in line.target.choices]
    leads = "leads to " + ", ".join(f"`{way}`" for way in dict.fromkeys(ways)) if ways else "nothing leads out of it"
    where = f"state of `{key[1]}`" + (f", machine `{key[2]}`" if key[2] != "main" else "")
    still = "stands still: no line of it steers" if _rests(workspace, document, key, node) else ""
    return markdown(f"state {node.name.text}{label}{colour}", least, leads, still, where)


def _rests(workspace: Workspace, document: Document, key: Key, state: nodes.State) -> bool:
    """Whether a state steers nothing where another state of its machine steers."""
    found = declared(workspace, document, ("species", key[1]))
    members = found[1].node.members if found is not None else ()
    beside = next((m.members for m in members if isinstance(m, nodes.Machine) and m.name.text == key[2]), members)
    silent = not any(isinstance(line, nodes.Steer) for line in state.body)
    return silent and any(isinstance(line, nodes.Steer) for m in beside if isinstance(m, nodes.State) for line in m.body)


def signature(node: nodes.Behaviour) -> str:
    """`seek(target: place) -> push`."""
    parts = []
    for argument in node.arguments:
        default = f" = {_flat(argument.default.span.text)}" if argument.default is not None else ""
        parts.append(f"{argument.name.text}: {_flat(argument.type.span.text)}{default}")
    return f"{node.name.text}({', '.join(parts)}) -> {_flat(node.returns.span.text)}"


def _behaviour(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    node = found[1].node if found is not None else None
    if not isinstance(node, nodes.Behaviour) or found is None:
        return None
    return markdown(f"behaviour {signature(node)}", _help(node), f"in `{found[0].path.name}`")


def _inner(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    if found is None:
        return None
    node = found[1].node
    if isinstance(node, nodes.BehaviourArgument):
        default = _flat(node.default.span.text) if node.default is not None else ""
        form = f"{node.name.text}: {_flat(node.type.span.text)}" + (f" = {default}" if default else "")
        return markdown(form, f"default {default}" if default else "must be given", f"argument of `{key[2]}`")
    return markdown(_flat(node.span.text), _help(node), f"in behaviour `{key[2]}`")


def _let(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    return markdown(_flat(found[1].node.span.text), f"in state `{key[3]}`") if found is not None else None


def _machine(workspace: Workspace, document: Document, key: Key) -> str | None:
    found = declared(workspace, document, key)
    node = found[1].node if found is not None else None
    if not isinstance(node, nodes.Machine):
        return None
    states = ", ".join(f"`{m.name.text}`" for m in node.members if isinstance(m, nodes.State))
    return markdown(f"machine {node.name.text}", _help(node), f"states {states}" if states else "")


def _event(workspace: Workspace, document: Document, key: Key) -> str | None:
    known = {"spawn": "happens once, at birth", "collision": "two agents touch"}
    return markdown(f"on {key[1]}", known.get(key[1], "an event: seen once, in the step after it was raised"))


def _element(workspace: Workspace, document: Document, key: Key) -> str | None:
    return markdown(key[1].text, "one of the set, each in turn")


def _given(workspace: Workspace, document: Document, key: Key) -> str | None:
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


def _builtin(workspace: Workspace, document: Document, key: Key) -> str | None:
    rows = BUILTINS.get(key[1], ())
    said = [markdown("\n".join(builtin_form(key[1], row) for row in rows), rows[0].help)] if rows else []
    if key[1] in REDUCERS:
        said.append(markdown(f"{key[1]}(n in SET: …)", REDUCERS[key[1]]))
    if key[1] in WHOLE_HELP:
        said.append(markdown(f"{key[1]}(…)", WHOLE_HELP[key[1]]))
    return "\n\n".join(said) or None


def _builtin_argument(workspace: Workspace, document: Document, key: Key) -> str | None:
    for row in BUILTINS.get(key[1], ()):
        for arg in row.args:
            if arg.name == key[2]:
                default = f"default {arg.default}" if arg.default is not None else "may be left out" if arg.optional else ""
                return markdown(f"{arg.name}: {arg.type}", default, f"argument of `{key[1]}`")
    return None


def _word(workspace: Workspace, document: Document, key: Key) -> str | None:
    word = key[1]
    help = STATE_WORD_HELP.get(word) or WORD_HELP.get(word)
    type = RUN_NAMES.get(word) or SENSED_NAMES.get(word)
    return markdown(f"{word}: {type}" if type else word, help) if help else None


def _unit(workspace: Workspace, document: Document, key: Key) -> str | None:
    from antdsl.program.units import dimension_words, measure

    known = measure(key[1])
    if known is None:
        return None
    base = unit_of(known.dim)
    whole = measure(base)
    factor = known.factor / whole.factor if whole is not None else known.factor  # angles are in radians behind `deg`
    worth = f"1 {key[1]} = {factor:.6g} {base}".strip() if key[1] != base and not known.u and not known.step else ""
    return markdown(key[1], dimension_words(known.dim), worth)


def _typed_word(table: Any, what: str) -> Callable[[Workspace, Document, Key], str | None]:
    def rule(workspace: Workspace, document: Document, key: Key) -> str | None:
        return markdown(f"{key[1]}: {table[key[1]]}", what) if key[1] in table else None

    return rule


def _said(table: dict[str, str], what: str) -> Callable[[Workspace, Document, Key], str | None]:
    def rule(workspace: Workspace, document: Document, key: Key) -> str | None:
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


def _type_word(workspace: Workspace, document: Document, key: Key) -> str | None:
    known = TYPE_WORDS.get(key[1])
    if known is None:
        return None
    from antdsl.program.model import Dim

    unit = unit_of(known) if isinstance(known, Dim) else ""
    return markdown(key[1], f"a type: numbers in `{unit}`" if unit else "a type")


def _steered(workspace: Workspace, document: Document, key: Key) -> str | None:
    return markdown("state", "what the states of the animal steer")


_RULES: dict[str, Callable[[Workspace, Document, Key], str | None]] = {
    "own": _own, "thing": _thing, "attribute": _attribute, "field": _field, "species": _species, "state": _state,
    "behaviour": _behaviour, "inner": _inner, "let": _let, "machine": _machine, "event": _event, "element": _element,
    "given": _given, "builtin": _builtin, "builtin-argument": _builtin_argument, "word": _word, "steered": _steered,
    "unit": _unit,
    "setting": _said(SETTINGS, "setting of a field"), "kind": _said(KINDS, "kind of thing of the world"), "type": _type_word,
    "item-given": _typed_word(ITEM_GIVEN, "every item has it"), "hit-given": _typed_word(HIT_GIVEN, "what a ray met has it"),
    "motion": _typed_word(MOTION, "how the crowd moves"),
}  # fmt: skip
