"""What may be written at a place of a program: states after `->`, units after a number, arguments inside brackets."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from antdsl.lsp.context import Context, context_at
from antdsl.lsp.describe import FORM_HELP, KINDS, SETTINGS, builtin_form, signature
from antdsl.lsp.index import Place
from antdsl.lsp.names import Names, declaration
from antdsl.lsp.owners import owner_of
from antdsl.lsp.workspace import Document, Workspace
from antdsl.program.colours import COLOURS
from antdsl.program.expected import MOTION
from antdsl.program.states import STATE_WORDS
from antdsl.program.vocabulary import (
    BUILTINS,
    GIVEN,
    HIT_GIVEN,
    ITEM_GIVEN,
    REDUCERS,
    RUN_NAMES,
    SENSED_NAMES,
    TYPE_WORDS,
)
from antdsl.source import Source, Span
from antdsl.syntax import nodes
from antdsl.syntax.words import FORMS, LINE_WORDS, UNIT_NAMES


@dataclass(frozen=True, slots=True)
class Item:
    """One proposal. `kind`: keyword, state, unit, function, argument, variable, property, thing, type, colour, file; `insert`
    may hold snippet places such as `${1:name}` when `snippet`."""

    label: str
    kind: str
    detail: str = ""
    help: str = ""
    insert: str = ""
    snippet: bool = False


def complete(workspace: Workspace, document: Document, offset: int) -> list[Item]:
    """The proposals at an offset of a program, each label once."""
    context = context_at(document.text.text, offset)
    if context.quiet:
        return []
    names = document.names
    found: dict[str, Item] = {}
    for item in _items(_Request(workspace, document, names, context)):
        found.setdefault(item.label, item)
    return list(found.values())


@dataclass(frozen=True, slots=True)
class _Request:
    workspace: Workspace
    document: Document
    names: Names
    context: Context

    @property
    def before(self) -> str:
        """The statement before the word that is being written."""
        return self.context.line.removesuffix(self.context.word)

    @property
    def species(self) -> str | None:
        return self.context.around("top", "species") or self.context.around("spec_line", "each")

    @property
    def machine(self) -> str:
        return self.context.around("member", "machine") or "main"


def _items(request: _Request) -> Iterator[Item]:
    before, rule = request.before, request.context.rule
    number = re.search(r"(?<![A-Za-z_0-9.])[0-9][0-9.]*[ \t]*([a-zA-Z%/*^0-9]*)$", request.context.line)
    if number is not None and not before.endswith(".."):
        if re.search(r"\b(take|give)[ \t]+[^ \t]+[ \t]+$", before):
            yield from _amounts(request)
        yield from _units(number.group(1))
        return
    for pattern, give in _AFTER:
        if re.search(pattern, before):
            yield from give(request)
            return
    if before.endswith(".") and not before.endswith(".."):
        yield from _members(request)
        return
    if not before.strip() and request.context.called is None:
        yield from _line_start(request, rule)
        return
    if rule in ("world_item",) or (rule == "top" and not before.startswith("behaviour")):
        return
    if request.context.called is not None:
        yield from _argument_names(request)
    yield from _values(request)


# --- at the beginning of a line --------------------------------------------------------------------------------------


def _line_start(request: _Request, rule: str) -> Iterator[Item]:
    if rule == "top" and not request.document.text.text[: _start(request)].strip():
        yield _word("ant")
    for word in LINE_WORDS.get(rule, ()):
        yield _word(word)
    if rule == "world_item":
        for word, help in KINDS.items():
            yield Item(word, "keyword", "kind of thing", help)
    elif rule == "setting":
        for word, help in SETTINGS.items():
            yield Item(word, "property", "setting of a field", help)
    elif rule == "member":
        for word, row in GIVEN.items():
            if row.settable:
                yield Item(word, "property", row.type, row.help + (f"; default {row.default}" if row.default else ""))
    elif rule in ("statement", "action"):
        yield from _own(request, assignable=True)
    elif rule == "weight":
        yield from _states(request)
    elif rule == "layer":
        yield Item("state", "keyword", "what the current state steers")
        yield from _behaviours(request)
    elif rule in ("behaviour_line", "rule"):
        yield from _values(request)


def _start(request: _Request) -> int:
    return len(request.document.text.text) - len(request.document.text.text.lstrip())


_SNIPPETS = {
    "species": "species ${1:name} {\n\t$0\n}", "world": "world {\n\tsurface ${1:ground}\n}",
    "field": "field ${1:trail} on ${2:ground} { cell ${3:4 mm}; half_life ${4:8 s} }",
    "behaviour": 'behaviour ${1:name}(${2:target}: ${3:place}) -> ${4:push} {\n\t"$5"\n\t$0\n}',
    "state": 'state ${1:name} "${2:label}" ${3:amber} {\n\tsteer $0\n}', "layers": "layers {\n\t${0:state}\n}",
    "spec": 'spec "${1:what it shows}" on "${2:scene.yaml}" {\n\tfor ${3:20 s}\n\talways: $0\n}',
    "param": "param ${1:name} = ${2:1} in ${3:0} .. ${4:10}", "when": "when ${1:condition} -> ${2:state}",
}  # fmt: skip


def _word(word: str) -> Item:
    return Item(word, "keyword", FORMS.get(word, "").partition("` or")[0], FORM_HELP.get(word, ""), _SNIPPETS.get(word, ""),
                word in _SNIPPETS)  # fmt: skip


# --- after certain words ---------------------------------------------------------------------------------------------


def _units(begun: str) -> Iterator[Item]:
    from antdsl.program.units import dimension_words, measure

    head = begun[: max(begun.rfind("/"), begun.rfind("*")) + 1]
    units = (*UNIT_NAMES, "%", "mm/s", "deg/s", "/s", "%/s", "/step") if not head else UNIT_NAMES
    for unit in units:
        known = measure(head + unit)
        if known is not None:
            yield Item(unit, "unit", dimension_words(known.dim))


def _targets(request: _Request) -> Iterator[Item]:
    if re.match(r"behaviour\b", request.before):
        yield from _types(request)
    elif request.context.rule == "rule":
        yield from _values(request)
    else:
        yield from _states(request)
        yield Item("previous", "keyword", "the state it was in before")
        yield Item("choose", "keyword", "one of several, by weight", "", "choose { ${1:state}: ${2:1} }", True)


def _states(request: _Request, every: bool = False) -> Iterator[Item]:
    table = request.names.species.get(request.species or "")
    tables = [table] if table is not None else list(request.names.species.values())
    for each in tables:
        own = request.machine if request.machine in each.machines and not every and table is not None else None
        for machine, states in each.machines.items():
            if own is None or machine == own:
                for name, state in states.items():
                    yield Item(name, "state", f"state of {each.name}", state.label.text if state.label is not None else "")


def _compared(request: _Request) -> Iterator[Item]:
    return _states(request, every=True)


def _things(*kinds: str) -> Callable[[_Request], Iterator[Item]]:
    def give(request: _Request) -> Iterator[Item]:
        for name, item in request.names.things.items():
            if not kinds or item.kind.text in kinds:
                yield Item(name, "thing", item.kind.text, item.help.text if item.help is not None else "")

    return give


def _fields(request: _Request) -> Iterator[Item]:
    for name, node in request.names.fields.items():
        yield Item(name, "thing", "field", node.help.text if node.help is not None else "")


def _on(request: _Request) -> Iterator[Item]:
    yield Item("spawn", "keyword", "once, at birth")
    yield Item("collision", "keyword", "two agents touch", "", "collision(${1:other})", True)
    yield from _events(request)


def _events(request: _Request) -> Iterator[Item]:
    for name in request.names.events:
        yield Item(name, "thing", "event")


def _species(request: _Request) -> Iterator[Item]:
    for name in request.names.species:
        yield Item(name, "thing", "species")


def _types(request: _Request) -> Iterator[Item]:
    for word in TYPE_WORDS:
        yield Item(word, "type", "type")


def _colours(request: _Request) -> Iterator[Item]:
    for colour in COLOURS:
        yield Item(colour, "colour", "colour")
    yield Item("for at least", "keyword", "the shortest time in this state")


def _use(request: _Request) -> Iterator[Item]:
    from antdsl.resources import library_names

    for name in library_names():
        yield Item(name, "file", "library of behaviours")


def _amounts(request: _Request) -> Iterator[Item]:
    """What is taken or given: attributes of the animal's own."""
    return _own(request, assignable=True)


def _takes_from(request: _Request) -> Iterator[Item]:
    if re.match(r"(from|machine)\b", request.before.strip()) and "take" not in request.before:
        yield Item("any", "keyword", "out of every state but …")
    else:
        yield from _values(request)


def _motion(request: _Request) -> Iterator[Item]:
    for name, type in MOTION.items():
        yield Item(name, "property", type)


_AFTER: tuple[tuple[str, Callable[[_Request], Iterator[Item]]], ...] = (
    (r"->[ \t]*$", _targets),
    (r"^start[ \t]+$", _states),
    (r"^from any except ([a-z_0-9]+, *)*$", _states),
    (r"(\b|\.)(state|previous|next)[ \t]*[!=]=[ \t]*$", _compared),
    (r"^deposit[ \t]+$", _fields),
    (r"^carve[ \t]+$", _things("solid")),
    (r"^field[ \t]+[a-z_0-9]+[ \t]+on[ \t]+([a-z_0-9]+,[ \t]*)*$", _things("surface", "solid", "obstacle")),
    (r"^on[ \t]+$", _on),
    (r"^emit[ \t]+$", _events),
    (r"^(spawn|each)[ \t]+$", _species),
    (r"^use[ \t]+$", _use),
    (r"^state[ \t]+[a-z_0-9]+[ \t]+(\"[^\"]*\"[ \t]+)$", _colours),
    (r"^(behaviour\b.*[(,][ \t]*[a-z_0-9]+|keep[ \t]+[a-z_0-9]+|[a-z_0-9]+):[ \t]*$", lambda request: _after_colon(request)),
    (r"\b(take|give)[ \t]+(all|[^ \t]+([ \t]+[a-z%/]+)?)[ \t]+$", _amounts),
    (r"\bfrom[ \t]+$", _takes_from),
    (r"\bmotion\.$", _motion),
)


def _after_colon(request: _Request) -> Iterator[Item]:
    """After `name:`: a type where something is declared, a condition in a spec, a weight of `choose`."""
    if request.context.rule in ("spec_line", "weight"):
        return _values(request)
    return _types(request)


# --- inside an expression --------------------------------------------------------------------------------------------


def _place(request: _Request) -> Place:
    behaviour = request.context.around("top", "behaviour")
    local: dict[str, Any] = {}
    node = request.names.behaviours.get(behaviour or "")
    if node is not None:
        for each in (*node.arguments, *node.body):
            local[each.name.text] = (("inner", "", behaviour, each.name.text), None)
    for variable, over in re.findall(r"\(\s*([a-z_][a-z_0-9]*)\s+in\s+([a-z_][a-z_0-9]*)", request.context.line):
        owner = _owner_of_text(request, Place(request.species, locals={}), over)
        if over == "neighbours":
            owner = ("agent", request.species or "")
        elif over in ("feelers", "ray"):
            owner = ("hit", "")
        elif over in ("all", "nearest"):
            inner = re.search(rf"{variable}\s+in\s+{over}\(\s*([a-z_][a-z_0-9]*)", request.context.line)
            owner = _owner_of_text(request, Place(request.species, locals={}), inner.group(1)) if inner else None
        if owner is not None:
            owner = ({"things": "item", "species": "agent"}.get(owner[0], owner[0]), owner[1])
        local[variable] = (("element", None), owner)
    return Place(request.species, request.machine, behaviour, local, None, request.context.around("top", "spec") is not None)


def _owner_of_text(request: _Request, place: Place, name: str) -> Any:
    span = Span(Source("", name), 0, len(name))
    return owner_of(request.names, place, nodes.NameRef(nodes.Name(name, span), span))


def _members(request: _Request) -> Iterator[Item]:
    before = request.before[:-1].rstrip()
    call = re.search(r"\b(?:nearest|random|first|pick)\(\s*([a-z_][a-z_0-9]*)[^()]*\)$", before)
    name = call or re.search(r"([a-z_][a-z_0-9]*)$", before)
    if name is None:
        return
    word = name.group(1)
    place = _place(request)
    table = request.names.species.get(request.species or "")
    if word in request.names.modules and word not in place.locals:
        module = request.workspace.document(request.names.modules[word])
        for behaviour in module.names.behaviours.values() if module is not None else ():
            yield _call(behaviour)
        return
    if table is not None and word in table.machines:
        for each in STATE_WORDS:
            yield Item(each, "property", f"of machine {word}")
        return
    owner = _owner_of_text(request, place, word)
    if owner is None:
        return
    kind, whose = owner
    if kind in ("item", "things"):
        thing = request.names.things.get(whose)
        for attribute in thing.attributes if thing is not None else ():
            yield Item(attribute.name.text, "property", f"value of {whose}", attribute.help.text if attribute.help else "")
        for given, type in ITEM_GIVEN.items():
            yield Item(given, "property", type)
    elif kind == "hit":
        for given, type in HIT_GIVEN.items():
            yield Item(given, "property", type)
    else:
        other = request.names.species.get(whose)
        for own, member in (other.own if other is not None else {}).items():
            node = declaration(member)
            yield Item(own, "property", f"of {whose}", node.help.text if node is not None and node.help is not None else "")
        if kind == "agent":
            for given, row in GIVEN.items():
                yield Item(given, "property", row.type, row.help)


def _argument_names(request: _Request) -> Iterator[Item]:
    context = request.context
    if not re.search(r"(^|[,(])\s*[a-z_0-9]*$", "(" + context.given):
        return
    given = set(re.findall(r"([a-z_][a-z_0-9]*)\s*:", context.given))
    called = context.called or ""
    behaviour = _find_behaviour(request, called)
    if behaviour is not None:
        for argument in behaviour.arguments:
            if argument.name.text not in given:
                default = f" = {argument.default.span.text}" if argument.default is not None else ""
                yield _argument(argument.name.text, argument.type.span.text + default)
        return
    for row in BUILTINS.get(called, ()):
        for arg in row.args:
            if arg.name not in given:
                yield _argument(arg.name, arg.type + (f" = {arg.default}" if arg.default is not None else ""))
    for name, detail in _LINE_ARGUMENTS.get(called if called in _LINE_ARGUMENTS else context.line.split(" ")[0], ()):
        if name not in given and context.line.startswith(("carve", "emit")):
            yield _argument(name, detail)


_LINE_ARGUMENTS = {
    "carve": (("radius", "length"), ("toward", "push"), ("into", "attribute, a volume")), "emit": (("within", "length"),),
}  # fmt: skip


def _argument(name: str, detail: str) -> Item:
    return Item(f"{name}:", "argument", detail, "", f"{name}: ")


def _find_behaviour(request: _Request, called: str) -> nodes.Behaviour | None:
    alias, dot, name = called.partition(".")
    if dot:
        module = request.workspace.document(request.names.modules[alias]) if alias in request.names.modules else None
        return module.names.behaviours.get(name) if module is not None else None
    return dict(_known_behaviours(request)).get(called)


def _known_behaviours(request: _Request) -> Iterator[tuple[str, nodes.Behaviour]]:
    for path in request.names.libraries.values():
        library = request.workspace.document(path.resolve())
        if library is not None:
            yield from library.names.behaviours.items()
    yield from request.names.behaviours.items()


def _behaviours(request: _Request) -> Iterator[Item]:
    for behaviour in dict(_known_behaviours(request)).values():
        yield _call(behaviour)
    for alias in request.names.modules:
        yield Item(alias, "file", "another file")


def _call(node: nodes.Behaviour) -> Item:
    """A behaviour with a place for each argument that must be given."""
    wanted = [argument for argument in node.arguments if argument.default is None]
    places = ", ".join(f"${{{number}:{argument.name.text}}}" for number, argument in enumerate(wanted, 1))
    optional = "$0" if not wanted and node.arguments else ""
    insert = f"{node.name.text}({places or optional})" + ("" if optional else "$0")
    return Item(node.name.text, "function", signature(node), node.help.text if node.help is not None else "", insert, True)


def _own(request: _Request, assignable: bool = False) -> Iterator[Item]:
    table = request.names.species.get(request.species or "")
    for name, member in (table.own if table is not None else {}).items():
        if assignable and not isinstance(member, nodes.Declaration):
            continue
        node = declaration(member)
        kind = {nodes.ParamDecl: "param", nodes.Let: "let", nodes.Latch: "latch", nodes.Fuzzy: "fuzzy"}.get(type(member), "attribute")
        value = f" = {' '.join(node.value.span.text.split())}" if isinstance(node, nodes.Declaration) else ""
        yield Item(name, "variable", f"{kind}{value}", node.help.text if node.help is not None else "")


def _values(request: _Request) -> Iterator[Item]:
    """Everything that can be a value, or begin one."""
    place = _place(request)
    for name, (key, _) in place.locals.items():
        yield Item(name, "variable", "argument" if key[0] == "inner" else "element")
    if place.behaviour is None:
        yield from _own(request)
        for word in (*STATE_WORDS, *(request.names.species[request.species].machines if request.species in request.names.species else ())):
            if word != "main":
                yield Item(word, "variable", "of its states")
    yield from _behaviours(request)
    yield from _things()(request)
    yield from _fields(request)
    yield from _species(request)
    for name, row in GIVEN.items():
        yield Item(name, "variable", row.type, row.help)
    for name, type in (*RUN_NAMES.items(), *SENSED_NAMES.items()):
        yield Item(name, "variable", type)
    for name, rows in BUILTINS.items():
        yield Item(name, "function", builtin_form(name, rows[0]), rows[0].help, f"{name}($0)", True)
    for name, help in REDUCERS.items():
        yield Item(name, "function", f"{name}(n in SET: …)", help, f"{name}(${{1:n}} in ${{2:neighbours(20 mm)}}: $0)", True)
    for word in ("and", "or", "not", "no", "if", "then", "else", "is none", "none of", "held", "take", "after", "chance", "when", "self"):
        yield Item(word, "keyword")
    if place.spec:
        for word in ("total", "share", "at_start", "motion"):
            yield Item(word, "keyword", "of the whole crowd")
