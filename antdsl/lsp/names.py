"""The names that a file declares, and the meaning of every use of a name. Meanings come from the checker's bindings and the
syntax tree."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from antdsl.program.expectations import MOTION_MEASURES
from antdsl.program.names.bindings import NameBindings, NameKey
from antdsl.program.names.file_declarations import Declaration, list_declarations
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.vocabulary import (
    BUILTIN_ATTRIBUTE_BY_NAME,
    BUILTINS_BY_NAME,
    REDUCER_HELP,
    RUN_VALUE_TYPES,
    SENSE_TYPE_BY_NAME,
)
from antdsl.program.traverse import iterate_nodes
from antdsl.program.types.aggregates import AGGREGATE_WORDS
from antdsl.program.types.states import STATE_WORDS
from antdsl.resources import find_library_file
from antdsl.safe_read import resolve_path
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.words import WORD_SETTING_VALUES

_LANGUAGE_WORDS = frozenset(
    {*RUN_VALUE_TYPES, *SENSE_TYPE_BY_NAME, *STATE_WORDS, "self", "true", "false", "it", "at_start", "motion"}
)
_CALLED_WORDS = frozenset({*BUILTINS_BY_NAME, *REDUCER_HELP, *AGGREGATE_WORDS, "at_start", "time_of"})


@dataclass(frozen=True, slots=True)
class NameOccurrence:
    """A name in the text and its meaning. A word with two meanings, as in `take 1 load from meal`, has two occurrences."""

    span: Span
    key: NameKey
    is_declaration: bool = False


@dataclass(slots=True)
class SpeciesTable:
    """The names that a species declares.

    - `node`: the declaration; None for a species of another file, of which only the attributes in `world` are known.
    - `own_members`: the declarations of its params, attributes, lets, latches and fuzzy values, by name.
    - `machines`: for each machine name, the machine's states by name."""

    name: str
    node: nodes.Species | None
    own_members: dict[str, Any] = field(default_factory=dict)  # declarations of params, attributes, lets, latches, fuzzies
    machines: dict[str, dict[str, nodes.State]] = field(default_factory=dict)


@dataclass(slots=True)
class ProgramNames:
    """The declarations of one file, by key and by kind. `libraries`: the files that its `use` lines name."""

    path: Path
    file: nodes.File
    things: dict[str, nodes.WorldItem] = field(default_factory=dict)
    fields: dict[str, nodes.FieldDecl] = field(default_factory=dict)
    species: dict[str, SpeciesTable] = field(default_factory=dict)
    behaviours: dict[str, nodes.Behaviour] = field(default_factory=dict)
    libraries: dict[str, Path] = field(default_factory=dict)
    modules: dict[str, Path] = field(default_factory=dict)
    events: dict[str, nodes.Name] = field(default_factory=dict)
    declaration_by_key: dict[NameKey, Declaration] = field(default_factory=dict)
    key_by_declaration_span: dict[Span, NameKey] = field(default_factory=dict)  # spans of declarations, including repeated ones


def collect_names(path: Path, file: nodes.File) -> ProgramNames:
    """Return the declarations of a file. If a name is declared twice, the first declaration counts, as in the checker."""
    names = ProgramNames(path, file)
    for each in list_declarations(file):
        names.declaration_by_key.setdefault(each.key, each)
        kind, *_, last = each.key
        if kind != "event":  # emitting an event does not declare it
            names.key_by_declaration_span[each.name.span] = each.key
        if kind == "thing":
            names.things.setdefault(last, each.node)
        elif kind == "field":
            names.fields.setdefault(last, each.node)
        elif kind == "behaviour":
            names.behaviours.setdefault(last, each.node)
        elif kind == "event":
            names.events.setdefault(last, each.node)
        elif kind == "alias" and each.node.path is not None:
            names.modules[last] = resolve_path(path.parent.joinpath(each.node.path.text))
        elif kind == "species":
            names.species.setdefault(last, SpeciesTable(last, each.node if isinstance(each.node, nodes.Species) else None))
        elif kind == "own":
            names.species[each.key[1]].own_members.setdefault(last, each.node)
        elif kind == "machine":
            names.species[each.key[1]].machines.setdefault(last, {})
        elif kind == "state":
            names.species[each.key[1]].machines.setdefault(each.key[2], {}).setdefault(last, each.node)
    library_names = [item.library.text for item in file.items if isinstance(item, nodes.Use) and item.library is not None]
    names.libraries = {name: library_path for name in library_names if (library_path := find_library_file(name)) is not None}
    return names


# --- every name ------------------------------------------------------------------------------------------------------


def find_occurrences(names: ProgramNames, bindings: NameBindings) -> list[NameOccurrence]:
    """Return every occurrence of a name in a file. A name is declared in the file, bound by the checker, or a word of the
    language at this position. If the checker did not resolve or reach a name, its kind begins with `?`."""
    bound: dict[Span, dict[NameKey, None]] = {}
    for span, declared in bindings.uses:
        key = (
            names.key_by_declaration_span.get(declared) or _make_element_key(names, declared)
            if isinstance(declared, Span)
            else declared
        )
        bound.setdefault(span, {})[key] = None
    index = _OccurrenceIndexer(names, bound)
    for item in names.file.items:
        index.index_item(item)
    return index.occurrences


def _make_element_key(names: ProgramNames, declaration: Span) -> NameKey:
    """Return the key of a symbol that is visible only in one expression or handler. The key contains the position of the
    declaration, because the name alone is not unique."""
    return ("element", str(names.file.file_span(declaration).start), declaration.text)


@dataclass(slots=True)
class _OccurrenceIndexer:
    """Collects all names of one file.

    - `bound_keys`: for the span of each name, the keys of the declarations that the checker has bound to it.
    - `meaning_by_span`: for each other word, the key of its meaning and whether it is a declaration; None if it is not a name.
    - `occurrences`: the result."""

    names: ProgramNames
    bound_keys: dict[Span, dict[NameKey, None]]
    meaning_by_span: dict[Span, tuple[NameKey, bool] | None] = field(default_factory=dict)
    occurrences: list[NameOccurrence] = field(default_factory=list)

    def index_item(self, item: nodes.TopItem) -> None:
        """Add all names in a top-level item."""
        for part, _ in iterate_nodes(item):
            if isinstance(part, nodes.Name):
                self.add_name(part, item)
            elif type(part) in _KINDS_BY_NODE_TYPE:
                for field_name, kind in _KINDS_BY_NODE_TYPE[type(part)]:
                    self.mark_by_position(getattr(part, field_name), kind)
            if type(part) in _MARKERS_BY_NODE_TYPE:
                _MARKERS_BY_NODE_TYPE[type(part)](self, part)

    def add_name(self, name: nodes.Name, item: nodes.TopItem) -> None:
        """Add a name with its meaning, from its declaration, its bindings, or its position in the tree."""
        span = Span(name.span.source, name.span.start, name.span.start + len(name.text))  # without the colon of an argument
        declared = self.names.key_by_declaration_span.get(name.span)
        if declared is not None:
            self.occurrences.append(NameOccurrence(span, declared, True))
        elif name.span in self.bound_keys:
            self.occurrences += [NameOccurrence(span, key) for key in self.bound_keys[name.span]]
        elif (meaning := self.meaning_by_span.get(name.span)) is not None:
            self.occurrences.append(NameOccurrence(span, self.resolve_nearby(meaning[0], item), meaning[1]))

    def resolve_nearby(self, key: NameKey, item: nodes.TopItem) -> NameKey:
        """Return the key of a name that the checker did not resolve. If the enclosing behaviour or species declares the name,
        this is the key of the declaration; otherwise it is `key`."""
        if key[0] in ("?", "?state") and isinstance(item, (nodes.Behaviour, nodes.Species)):
            scope = ("inner", str(self.names.path), item.name.text) if isinstance(item, nodes.Behaviour) else (item.name.text,)
            for each in self.names.declaration_by_key:
                inner = each[0] in ("own", "machine", "state") and each[1:2] == scope
                if each[-1] == key[-1] and (inner or each[:-1] == scope):
                    return each
        return key

    def mark_by_position(self, names: nodes.Name | tuple[nodes.Name, ...] | None, kind: str) -> None:
        """Record names that have the meaning `kind` because of their positions in the tree. Known meanings are not changed."""
        for name in names if isinstance(names, tuple) else (names,):
            if name is not None:
                self.meaning_by_span.setdefault(name.span, ((kind, name.text), False))

    def add_file(self, text: object, kind: str = "file") -> None:
        """Add the path of a file that the program names."""
        if isinstance(text, nodes.Text):
            self.occurrences.append(
                NameOccurrence(text.span, (kind, str(resolve_path(self.names.path.parent.joinpath(text.text)))))
            )

    def mark_use(self, node: nodes.Use) -> None:
        if node.alias is not None:
            self.add_file(node.path)

    def mark_spec(self, node: nodes.Spec) -> None:
        self.add_file(node.scene)

    def mark_spec_line(self, node: nodes.SpecLine) -> None:
        self.add_file(node.target)

    def mark_quantity(self, node: nodes.Quantity) -> None:
        self.occurrences.append(NameOccurrence(node.unit_span, ("unit", node.unit)))

    def mark_setting(self, node: nodes.Setting) -> None:
        if node.name.text in WORD_SETTING_VALUES:
            self.meaning_by_span[node.value.span] = None  # `add`, `first` and similar words are not names there

    def mark_target(self, node: nodes.Target) -> None:
        if node.is_previous and node.name is not None:
            self.meaning_by_span[node.name.span] = None

    def mark_layer(self, node: nodes.Layer) -> None:
        if isinstance(node.push, nodes.NameRef) and node.push.name.text == "state":
            self.meaning_by_span[node.push.name.span] = (("steered", "state"), False)

    def mark_handler(self, node: nodes.On) -> None:
        self.meaning_by_span[node.event.span] = (("event", node.event.text), True)
        self.mark_variable(node.variable)

    def mark_variable(self, variable: nodes.Name | None) -> None:
        """Record a variable as a declaration. Do nothing if it is None."""
        if variable is not None:
            self.meaning_by_span[variable.span] = (_make_element_key(self.names, variable.span), True)

    def mark_comprehension(self, node: nodes.Comprehension) -> None:
        self.mark_variable(node.variable)

    def mark_index_all(self, node: nodes.IndexAll) -> None:
        self.mark_variable(node.variable)

    def mark_reference(self, node: nodes.NameRef) -> None:
        """Record the meaning of a plain name in an expression."""
        name = node.name.text
        self.mark_by_position(
            node.name, "given" if name in BUILTIN_ATTRIBUTE_BY_NAME else "word" if name in _LANGUAGE_WORDS else "?"
        )

    def mark_member(self, node: nodes.Member) -> None:
        """Record the meaning of a name after a dot."""
        motion = isinstance(node.owner, nodes.NameRef) and node.owner.name.text == "motion" and node.name.text in MOTION_MEASURES
        self.mark_by_position(node.name, "motion" if motion else "word" if node.name.text in STATE_WORDS else "?member")

    def mark_call(self, node: nodes.Call) -> None:
        """Record the meanings of a called function's name and of its argument names."""
        function = node.function
        function_name = function.name.text if isinstance(function, (nodes.NameRef, nodes.Member)) else ""
        if isinstance(function, (nodes.NameRef, nodes.Member)):
            bare = isinstance(function, nodes.NameRef)
            self.mark_by_position(function.name, "builtin" if bare and function_name in _CALLED_WORDS else "?behaviour")
        self.mark_arguments(function_name, node)

    def mark_verb_line(self, node: nodes.VerbLine) -> None:
        """Record the meanings of the names in a statement with a verb, such as `deposit`."""
        row = EFFECT_BY_OPERATION.get(node.verb)
        if row is not None and row.target:
            kind = row.target if row.target in ("field", "event", "species") else "thing"
            self.mark_by_position(node.name, kind)
        elif node.name is not None:
            self.mark_by_position(node.name, "body")
        self.mark_arguments(node.verb, node)

    def mark_arguments(self, function_name: str, node: nodes.Call | nodes.VerbLine) -> None:
        """Record the names of the arguments in a call or statement. `function_name`: the function or verb."""
        for each in node.arguments:
            if isinstance(each, nodes.Argument) and each.name is not None:
                self.meaning_by_span[each.name.span] = (("builtin-argument", function_name, each.name.text), False)


# Names with a meaning that follows from their place in the tree, by node and field.
_KINDS_BY_NODE_TYPE: dict[type, tuple[tuple[str, str], ...]] = {
    nodes.TypeName: (("name", "type"), ("of", "?")), nodes.WorldItem: (("kind", "kind"),), nodes.Setting: (("name", "setting"),),
    nodes.AnimalProperty: (("name", "given"),), nodes.Use: (("library", "library"),), nodes.NoneOf: (("of", "?"),),
    nodes.State: (("colour", "colour"),), nodes.FieldDecl: (("surfaces", "thing"),),
    nodes.ForEach: (("species", "species"),), nodes.Take: (("attribute", "?"),), nodes.Give: (("attribute", "?"),),
    nodes.Start: (("state", "?state"),), nodes.Target: (("name", "?state"),), nodes.Weight: (("target", "?state"),),
    nodes.Change: (("any_except", "?state"),),
}  # fmt: skip
_MARKERS_BY_NODE_TYPE: dict[type, Callable[[_OccurrenceIndexer, Any], None]] = {
    nodes.Use: _OccurrenceIndexer.mark_use, nodes.Spec: _OccurrenceIndexer.mark_spec,
    nodes.SpecLine: _OccurrenceIndexer.mark_spec_line, nodes.Quantity: _OccurrenceIndexer.mark_quantity,
    nodes.Setting: _OccurrenceIndexer.mark_setting, nodes.Layer: _OccurrenceIndexer.mark_layer,
    nodes.On: _OccurrenceIndexer.mark_handler, nodes.NameRef: _OccurrenceIndexer.mark_reference,
    nodes.Comprehension: _OccurrenceIndexer.mark_comprehension, nodes.IndexAll: _OccurrenceIndexer.mark_index_all,
    nodes.Member: _OccurrenceIndexer.mark_member,
    nodes.Call: _OccurrenceIndexer.mark_call,
    nodes.VerbLine: _OccurrenceIndexer.mark_verb_line, nodes.Target: _OccurrenceIndexer.mark_target,
}  # fmt: skip
