"""The meanings of names at a position in the text.

`Declarations` has the declarations of all files. `NameScope` has the names that are visible at one position."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.kinds import BAD_TYPE
from antdsl.program.memo import CheckResultCache
from antdsl.program.model import Binding, ChangeRate, Dimension, Expr, ThingRef, TypeKind, ValueType, WorldThing
from antdsl.program.names.bindings import NameUse
from antdsl.program.tables.editions import STANDING_SIZE_SETTING
from antdsl.program.tables.vocabulary import (
    HIT_ATTRIBUTE_TYPES,
    ITEM_ATTRIBUTE_TYPES,
    TYPE_BY_WORD,
    BuiltinAttribute,
    get_builtin_attributes,
)
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.editions import NEWEST_EDITION

TypingRules = Mapping[type, Callable[["NameScope", object, "ValueType | None"], Expr]]


@dataclass(slots=True)
class MachineNames:
    """The states of a machine, with the index of each state by name. `key`: `species.machine`, as in the type of a state."""

    name: str
    key: str
    states: dict[str, int]


@dataclass(slots=True)
class SpeciesNames:
    """The declared names of a species. The types in `attributes` and `params` are added as these are checked."""

    name: str
    node: nodes.Species | None
    attributes: dict[str, ValueType] = field(default_factory=dict)
    pair_value_species: dict[str, str] = field(default_factory=dict)  # pair values, with the species of the other agents
    params: dict[str, ValueType] = field(default_factory=dict)
    bindings: dict[str, Binding] = field(default_factory=dict)  # checked lets and latches
    untyped_names: set[str] = field(default_factory=set)  # declared names without a known type yet
    machines: dict[str, MachineNames] = field(default_factory=dict)
    edition: int = NEWEST_EDITION  # of the file that declares it

    @property
    def builtins(self) -> Mapping[str, BuiltinAttribute]:
        """Return the built-in attributes that agents of the species have, by name."""
        rows = get_builtin_attributes(self.edition)
        return rows if self.has_standing_bodies else {name: row for name, row in rows.items() if not row.is_for_standing}

    @property
    def has_standing_bodies(self) -> bool:
        """Return whether the bodies of the species stand upright. They do if the species sets their height."""
        members = () if self.node is None else self.node.members
        return any(isinstance(each, nodes.AnimalProperty) and each.name.text == STANDING_SIZE_SETTING for each in members)


@dataclass(slots=True)
class BehaviourInfo:
    """A behaviour with everything that a call of it needs.

    - `calls`: the behaviours that it calls.
    - `operation_count`, `depth`: the number of its operations, and how deeply they are nested, with all calls expanded.
    - `check_state`: the progress of its check: new, sized, circular, ok or broken."""

    node: nodes.Behaviour
    file: FileNames
    calls: list[BehaviourInfo] = field(default_factory=list)
    operation_count: int = 0
    depth: int = 0
    has_memory: bool = False
    has_draws: bool = False
    check_state: str = "new"  # new, sized, circular, ok, broken


@dataclass(slots=True)
class FileNames:
    """The behaviours that one file can call: its own, those of its libraries, and those of its modules, which are stored by
    alias."""

    node: nodes.File
    own_behaviours: dict[str, BehaviourInfo] = field(default_factory=dict)
    library_behaviours: dict[str, BehaviourInfo] = field(default_factory=dict)
    aliases: dict[str, FileNames] = field(default_factory=dict)
    libraries: list[str] = field(default_factory=list)
    is_missing: bool = False  # the file could not be read
    missing_uses: set[str] = field(default_factory=set)  # libraries for which a missing `use` is reported

    def find_behaviour(self, name: str) -> BehaviourInfo | None:
        """Return the behaviour that this file calls by `name`, or None."""
        return self.own_behaviours.get(name) or self.library_behaviours.get(name)


@dataclass(slots=True)
class Declarations:
    """All declarations in the files of one program, all uses of the declared names, and the findings so far."""

    rules: TypingRules
    report: Report
    strict: bool = False
    find_library: Callable[[str], str | None] = lambda name: None  # the library that contains a behaviour
    find_library_behaviour: Callable[[str, str], BehaviourInfo | None] = lambda library, name: (
        None
    )  # a behaviour, by library and name
    things: dict[str, WorldThing] = field(default_factory=dict)
    fields: dict[str, nodes.FieldDecl] = field(default_factory=dict)
    species: dict[str, SpeciesNames] = field(default_factory=dict)
    measures: dict[str, nodes.Measure] = field(default_factory=dict)
    measure_values: dict[str, Expr] = field(default_factory=dict)  # the checked values of measures without errors
    events: dict[str, Span] = field(default_factory=dict)
    name_uses: list[NameUse] = field(default_factory=list)  # resolved names, in the order of checking
    used_names: set[tuple[str, str]] = field(default_factory=set)
    written_attributes: set[str] = field(default_factory=set)  # attributes, as `species.name`
    unclear_things: set[str] = field(default_factory=set)  # reported things of unknown kind
    unknown_names: dict[tuple[str, ...], list[Span]] = field(
        default_factory=dict
    )  # all uses of each missing name, by kind and place
    expanded_count: int = 0  # operations in all expanded behaviours
    memo: CheckResultCache | None = None  # results of an earlier check
    outside_number: int = 0  # number of the declarations that parts can see of other parts


def is_known_missing(scope: NameScope, kind: str, name: nodes.Name, owner: str = "") -> bool:
    """Return whether a missing name has already been reported. If not, record it as reported; the caller must then report it.

    Every call also records the span of the name.

    - `kind`: the kind of name, such as `attribute`. Names of different kinds are independent.
    - `owner`: the species to which the name always belongs; "" for the species at this position."""
    around = (scope.file.node.source.path, scope.species.name if scope.species else "", scope.behaviour or "")
    where = (kind, *((owner,) if owner else around), name.text)
    if where in scope.declarations.unknown_names:
        scope.declarations.unknown_names[where].append(name.span)
        return True
    scope.declarations.unknown_names[where] = [name.span]
    return False


class StableKeys:
    """Generator of keys for memories and draws. A key does not change when lines move. It consists of a path, a word, and how
    many times the word has occurred before."""

    __slots__ = ("counts", "path")

    def __init__(self, path: str) -> None:
        self.path = path
        self.counts: dict[str, int] = {}

    def make_key(self, word: str, separator: str = ".") -> str:
        """Return the next key for a word: first `PATH.word#1`, then `PATH.word#2`."""
        count = self.counts[word] = self.counts.get(word, 0) + 1
        return f"{self.path}{separator}{word}#{count}"


@dataclass(frozen=True, slots=True)
class NameScope:
    """The names that are visible at one position in the text. `with_changes(…)` returns a copy for another position."""

    declarations: Declarations
    file: FileNames
    keys: StableKeys
    report: Report
    species: SpeciesNames | None = None
    machine: MachineNames | None = None
    local_names: Mapping[str, Binding | Expr] = field(default_factory=dict)
    element: Binding | None = None  # in `with:`, names refer to its attributes first
    set_elements: tuple[Binding, ...] = ()  # elements of the enclosing sets
    behaviour: str | None = None  # the behaviour around this place; inside, names of the species are not visible
    is_generic: bool = False  # whether a behaviour is checked alone, with argument types that may be open
    no_keep_reason: str | None = None  # reason for which no `keep` is allowed here, for messages
    no_let_reason: str | None = None  # reason for which no `let` can be read here, for messages
    allows_degrees: bool = False  # in a rule of `fuzzy`: a bool next to a degree counts as 1 or 0
    is_evaluated_once: bool = False  # the line runs once, not in each step: amounts instead of rates

    @property
    def builtins(self) -> Mapping[str, BuiltinAttribute]:
        """Return the built-in attributes of agents at this position, by name."""
        return get_builtin_attributes(self.edition) if self.species is None else self.species.builtins

    @property
    def edition(self) -> int:
        """Return the edition of the language at this position."""
        return self.file.node.edition_number if self.species is None else self.species.edition

    def with_changes(self, **changes: Any) -> NameScope:
        return replace(self, **changes)

    def type_expression(self, node: nodes.Expr, expected_type: ValueType | None = None) -> Expr:
        """Return the typed expression of a node. `expected_type`: the expected type, which determines the meaning of `none` and
        of bare names. The result may have another type."""
        return self.declarations.rules[type(node)](self, node, expected_type)

    def report_error(self, code: str, message: str, span: Span, help: str | None = None, **details: object) -> Expr:
        """Report an error about an expression, and return a placeholder for the expression."""
        self.report.error(code, message, span, help, **details)
        return make_bad_expression(span)

    def record_name_use(self, span: Span, *key: str) -> None:
        """Record the declaration to which the name at a span refers. `key`: the declaration's key.

        Names in an expanded behaviour are not recorded, because the text of the behaviour is at another position."""
        if self.behaviour is None or self.is_generic:
            self.declarations.name_uses.append(NameUse(span, key))

    def record_local_name_use(self, span: Span, declaration: Span) -> None:
        """Record the use of a name that is declared in the surrounding text, at the span `declaration`."""
        if self.behaviour is None or self.is_generic:
            self.declarations.name_uses.append(NameUse(span, declaration))

    def record_thing_use(self, name: nodes.Name) -> None:
        """Record the use of a name. At this position, it can only name a species or a thing of the world."""
        kinds = (("species", self.declarations.species), ("thing", self.declarations.things))
        for kind in (kind for kind, known in kinds if name.text in known):
            self.record_name_use(name.span, kind, name.text)
            return

    def record_own_name_use(self, span: Span, name: str, owner: SpeciesNames | None = None) -> None:
        """Record the use of a name. At this position, it can only name a member of a species. `owner`: the species; None for the
        species at this position."""
        owner = owner or self.species
        if owner is not None and (
            name in owner.attributes or name in owner.params or name in owner.bindings or name in owner.untyped_names
        ):
            self.record_name_use(span, "own", owner.name, name)

    def record_value_use(self, span: Span, owner: ValueType, name: str) -> None:
        """Record the use of a value of an item, agent or hit. `owner`: the type of this item, agent or hit."""
        if owner.kind is TypeKind.AGENT:
            self.record_name_use(
                span,
                *(
                    ("given", name)
                    if name in find_builtins_of_agent(self.declarations, owner)
                    else ("own", owner.referent or "", name)
                ),
            )
        elif owner.kind is TypeKind.HIT or owner.referent == "hit":
            self.record_name_use(span, "hit-given", name)
        else:
            thing = self.declarations.things.get(owner.referent or "")
            own = thing is not None and any(each.name == name for each in thing.attributes)
            self.record_name_use(span, *(("attribute", owner.referent or "", name) if own else ("item-given", name)))

    def record_possible_use(self, name: nodes.Name, owner: ValueType) -> None:
        """Record the use of a declared name that cannot be read here, such as a param of a single agent."""
        one = ValueType(TypeKind.ITEM, referent=owner.referent)
        if owner.kind in (TypeKind.AGENT, TypeKind.SPECIES) and owner.referent in self.declarations.species:
            self.record_own_name_use(name.span, name.text, self.declarations.species[owner.referent])
        elif owner.kind is TypeKind.ITEMS and name.text in find_attributes(self.declarations, one):
            self.record_value_use(name.span, one, name.text)

    def mark_used(self, kind: str, name: str) -> None:
        """Record that a declared name is used."""
        self.declarations.used_names.add((kind, name))


def make_bad_expression(span: Span) -> Expr:
    """Return a placeholder for an expression with an error that has already been reported."""
    return ThingRef(BAD_TYPE, ChangeRate.CONST, span, "?")


def find_highest_rate(parts: Iterable[Expr | None]) -> ChangeRate:
    """Return the highest rate of the given expressions, or CONST if there are none."""
    return max((part.rate for part in parts if part is not None), default=ChangeRate.CONST)


def parse_type_words(words: str, owner_name: str | None = None) -> ValueType | None:
    """Return the type that `words` in a table stand for: a word of `TYPE_BY_WORD`, or a quotient such as `angle / time`. Return
    None if there is no such type."""
    if "/" in words:
        top, below = (TYPE_BY_WORD.get(part.strip()) for part in words.split("/"))
        if not isinstance(top, Dimension) or not isinstance(below, Dimension):
            return None
        return ValueType(TypeKind.NUMBER, Dimension(*(a - b for a, b in zip(top, below, strict=True))))
    known = TYPE_BY_WORD.get(words)
    if known is None:
        return None
    if isinstance(known, Dimension):
        return ValueType(TypeKind.NUMBER, known)
    vectors = {"push": Dimension(), "position": Dimension(length=1), "velocity": Dimension(length=1, time=-1)}
    if known in vectors:
        return ValueType(TypeKind.VECTOR, vectors[known])
    return BAD_TYPE if known == "vector" else ValueType(TypeKind(known), Dimension(), owner_name)


def find_attributes(declarations: Declarations, type: ValueType) -> dict[str, ValueType]:
    """Return the types of the values that an item, agent or hit of the type `type` has, by name.

    If the species of an agent is unknown, only built-in values are returned."""
    if type.kind is TypeKind.HIT or (type.kind is TypeKind.ITEM and type.referent == "hit"):
        return _parse_types(HIT_ATTRIBUTE_TYPES)
    if type.kind is TypeKind.ITEM:
        thing = declarations.things.get(type.referent or "")
        own = {a.name: a.type for a in thing.attributes} if thing else {}
        return _parse_types(ITEM_ATTRIBUTE_TYPES) | own
    if type.kind is TypeKind.AGENT:
        names = declarations.species.get(type.referent or "")
        builtin_types = _parse_types({name: row.type for name, row in find_builtins_of_agent(declarations, type).items()})
        return builtin_types | (names.attributes if names else {})
    return {}


def find_builtins_of_agent(declarations: Declarations, type: ValueType) -> Mapping[str, BuiltinAttribute]:
    """Return the built-in attributes that agents of the type `type` have, by name.

    If the species is unknown, these are the attributes of edition 1, which every agent has."""
    names = declarations.species.get(type.referent or "")
    return get_builtin_attributes(1) if names is None else names.builtins


def _parse_types(table: Mapping[str, str]) -> dict[str, ValueType]:
    return {name: word_type for name, words in table.items() if (word_type := parse_type_words(words))}


def suggest_name(word: str, candidates: Iterable[str], default_help: str | None = None) -> str:
    """Return help text for the unknown name `word`: a similar candidate, else `default_help`, else a list of candidates."""
    known = list(candidates)
    suggestion = find_nearest_name(word, known)
    if suggestion:
        return f"did you mean `{suggestion}`?"
    return default_help or (f"there is {list_names(known)}" if known else "declare it, or leave this out")


def list_names(names: Iterable[str], max_count: int = 12) -> str:
    """Return text that lists at most `max_count` names for a help line, such as `a`, `b`, `c` …."""
    names = sorted(names)
    return ", ".join(f"`{name}`" for name in names[:max_count]) + (", …" if len(names) > max_count else "")


def report_duplicate(report: Report, kind_words: str, name: nodes.Name, first: Span) -> None:
    """Report that a name is declared again, with the location of its first declaration. `kind_words`: words for the kind of
    name."""
    message = f"{kind_words} `{name.text}` is declared twice"
    advice = "give one of them another name, or delete it"
    report.error("duplicate-name", message, name.span, advice, labels=(Label(first, "first here"),))
