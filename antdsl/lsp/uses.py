"""Which name in an expression stands for what, looked up as the checker looks it up."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from antdsl.lsp.names import Key, Names
from antdsl.lsp.owners import Owner, owner_of, set_of
from antdsl.program.expectations import MOTION
from antdsl.program.tables.vocabulary import BUILTINS, GIVEN, HIT_GIVEN, ITEM_GIVEN, REDUCERS, RUN_NAMES, SENSED_NAMES
from antdsl.program.types.aggregates import WHOLES
from antdsl.program.types.states import STATE_WORDS
from antdsl.source import Span
from antdsl.syntax import nodes

_WORDS = frozenset({*RUN_NAMES, *SENSED_NAMES, *STATE_WORDS, "self", "true", "false", "it", "at_start", "motion"})


@dataclass(frozen=True, slots=True)
class Occurrence:
    """A name in the text. Where one word stands for two things at once, as in `take 1 load from meal`, there are two."""

    span: Span
    key: Key
    declares: bool = False


@dataclass(frozen=True, slots=True)
class Place:
    """What can be seen at a place: `locals` by name, with whose attributes they have; `element` inside `with:`."""

    species: str | None = None
    machine: str | None = None
    behaviour: str | None = None
    locals: Mapping[str, tuple[Key, Owner]] = field(default_factory=dict)
    element: Owner = None
    spec: bool = False


class Uses:
    """One walk over expressions. `found` grows as it goes."""

    def __init__(self, names: Names) -> None:
        self.names = names
        self.path = str(names.path)
        self.found: list[Occurrence] = []

    def say(self, span: Span, key: Key, declares: bool = False) -> None:
        length = len(span.text.split(":")[0].rstrip()) if key[0] in ("inner", "builtin-argument") else span.end - span.start
        self.found.append(Occurrence(Span(span.source, span.start, span.start + length), key, declares))

    def expression(self, node: Any, place: Place) -> None:
        rule = _EXPRESSIONS.get(type(node))
        if rule is not None:
            rule(self, node, place)

    def state_name(self, name: nodes.Name, species: str | None, machine: str | None) -> None:
        table = self.names.species.get(species or "")
        found = table.machine_of(name.text, machine) if table is not None else None
        self.say(name.span, ("state", species, found or machine, name.text))

    def quantity(self, node: nodes.Quantity, place: Place) -> None:
        self.say(node.unit_span, ("unit", node.unit))

    def name(self, node: nodes.NameRef, place: Place) -> None:
        self.say(node.name.span, self.key_of(node.name.text, place))

    def key_of(self, name: str, place: Place) -> Key:
        """What a bare name stands for: local names, then those of the element of `with:`, then words, the species' own, and the
        world's, as the checker looks them up."""
        found = place.locals.get(name)
        if found is not None:
            return found[0]
        member = self.member_key(place.element, name) if place.element is not None else None
        if member is not None:
            return member
        table = self.names.species.get(place.species or "")
        if name in ("self", "true", "false"):
            return ("word", name)
        if table is not None and place.behaviour is None:
            if name in table.own:
                return ("own", table.name, name)
            if name in table.machines:
                return ("machine", table.name, name)
        if name in GIVEN:
            return ("given", name)
        return ("word", name) if name in _WORDS else self.world_key(name)

    def world_key(self, name: str) -> Key:
        names = self.names
        if name in names.fields:
            return ("field", name)
        if name in names.species:
            return ("species", name)
        if name in names.things:
            return ("thing", name)
        return ("event", name) if name in names.events else ("?", name)

    def member_key(self, owner: Owner, name: str) -> Key | None:
        """What `owner.name` is; None when nothing of that name is known there."""
        if owner is None:
            return None
        kind, whose = owner
        if kind in ("item", "things"):
            thing = self.names.things.get(whose)
            if thing is not None and any(each.name.text == name for each in thing.attributes):
                return ("attribute", whose, name)
            return ("item-given", name) if name in ITEM_GIVEN else None
        if kind in ("agent", "species"):
            table = self.names.species.get(whose)
            if table is not None and name in table.own:
                return ("own", whose, name)
            return ("given", name) if name in GIVEN else ("word", name) if name in STATE_WORDS else None
        return ("hit-given", name) if name in HIT_GIVEN else None

    def member_of(self, node: nodes.Member, place: Place) -> None:
        owner = node.owner
        if isinstance(owner, nodes.NameRef):
            name = owner.name.text
            if place.spec and name == "motion" and node.name.text in MOTION:
                self.say(owner.name.span, ("word", "motion"))
                self.say(node.name.span, ("motion", node.name.text))
                return
            if name in self.names.modules and name not in place.locals:
                self.say(owner.name.span, ("alias", self.path, name))
                self.say(node.name.span, ("behaviour", str(self.names.modules[name]), node.name.text))
                return
        self.expression(owner, place)
        if isinstance(owner, nodes.NameRef) and self.key_of(owner.name.text, place)[0] == "machine":
            self.say(node.name.span, ("word", node.name.text))
            return
        found = self.member_key(owner_of(self.names, place, owner), node.name.text)
        self.say(node.name.span, found or ("?member", node.name.text))

    def index(self, node: nodes.Index, place: Place) -> None:
        self.expression(node.owner, place)
        self.expression(node.index, place)

    def binary(self, node: nodes.Binary, place: Place) -> None:
        if node.op in ("==", "!="):
            for asked, state in ((node.left, node.right), (node.right, node.left)):
                where = self.asked(asked, place)
                if where is not None and isinstance(state, nodes.NameRef) and state.name.text not in STATE_WORDS:
                    first, second = (asked, state) if asked is node.left else (state, asked)
                    for part in (first, second):
                        if part is state:
                            self.state_name(state.name, *where)
                        else:
                            self.expression(part, place)
                    return
        self.expression(node.left, place)
        self.expression(node.right, place)

    def asked(self, node: nodes.Expr, place: Place) -> tuple[str | None, str | None] | None:
        """Of `state`, `mood.state` and `n.state`: whose state it is, and of which machine."""
        if isinstance(node, nodes.NameRef) and node.name.text in STATE_WORDS and node.name.text not in place.locals:
            if place.element is not None and place.element[0] == "agent":
                return place.element[1], None
            return place.species, place.machine
        if isinstance(node, nodes.Member) and node.name.text in STATE_WORDS:
            if isinstance(node.owner, nodes.NameRef):
                key = self.key_of(node.owner.name.text, place)
                if key[0] == "machine":
                    return key[1], key[2]
            owner = owner_of(self.names, place, node.owner)
            return (owner[1], None) if owner is not None and owner[0] in ("agent", "species") else None
        return None

    def unary(self, node: nodes.Unary, place: Place) -> None:
        self.expression(node.operand, place)

    def is_none(self, node: nodes.IsNone, place: Place) -> None:
        self.expression(node.operand, place)

    def if_else(self, node: nodes.IfElse, place: Place) -> None:
        for part in (node.condition, node.then, node.otherwise):
            self.expression(part, place)

    def range(self, node: nodes.RangeExpr, place: Place) -> None:
        self.expression(node.low, place)
        self.expression(node.high, place)

    def none_of(self, node: nodes.NoneOf, place: Place) -> None:
        if node.of is not None:
            self.say(node.of.span, self.world_key(node.of.text))

    def call(self, node: nodes.Call, place: Place) -> None:
        function = node.function
        called = function.name.text if isinstance(function, (nodes.NameRef, nodes.Member)) else ""
        if isinstance(function, nodes.NameRef):
            self.say(function.name.span, self.called(called, place))
        else:
            self.expression(function, place)
        self.arguments(called, node.arguments, place, function)

    def called(self, name: str, place: Place) -> Key:
        if name in BUILTINS or name in REDUCERS or (place.spec and name in WHOLES) or name == "at_start":
            return ("builtin", name)
        if name in self.names.behaviours:
            return ("behaviour", self.path, name)
        for path in self.names.libraries.values():
            return ("behaviour", str(path), name)
        return ("?behaviour", name)

    def arguments(self, called: str, arguments: tuple[Any, ...], place: Place, function: Any = None) -> None:
        whose = None
        if isinstance(function, nodes.NameRef):
            whose = self.called(called, place)
        elif isinstance(function, nodes.Member) and isinstance(function.owner, nodes.NameRef):
            module = self.names.modules.get(function.owner.name.text)
            whose = ("behaviour", str(module), called) if module is not None else None
        for argument in arguments:
            if isinstance(argument, nodes.Comprehension):
                self.comprehension(argument, place)
                continue
            inner = place
            if argument.name is not None:
                label = argument.name.text
                behaviour = whose is not None and whose[0] == "behaviour"
                self.say(
                    argument.name.span,
                    ("inner", *whose[1:], label) if behaviour and whose else ("builtin-argument", called, label),
                )
                if label == "with" and not behaviour and arguments and isinstance(arguments[0], nodes.Argument):
                    inner = replace(place, element=set_of(self.names, place, arguments[0].value))
            self.expression(argument.value, inner)

    def comprehension(self, node: nodes.Comprehension, place: Place) -> None:
        key = ("element", node.variable)
        self.say(node.variable.span, key, True)
        self.expression(node.over, place)
        local = {**place.locals, node.variable.text: (key, set_of(self.names, place, node.over))}
        self.expression(node.body, replace(place, locals=local))


_EXPRESSIONS: dict[type, Callable[[Uses, Any, Place], None]] = {
    nodes.Quantity: Uses.quantity, nodes.NameRef: Uses.name, nodes.Member: Uses.member_of, nodes.Index: Uses.index,
    nodes.Call: Uses.call, nodes.Unary: Uses.unary, nodes.Binary: Uses.binary, nodes.IsNone: Uses.is_none,
    nodes.IfElse: Uses.if_else, nodes.RangeExpr: Uses.range, nodes.NoneOf: Uses.none_of,
}  # fmt: skip
