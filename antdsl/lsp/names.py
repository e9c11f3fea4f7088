"""What a file declares by name, from its tree alone: the tables by which the index and completion know what a name stands for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from antdsl.bounded import real_path
from antdsl.resources import library_file
from antdsl.syntax import nodes

# A symbol is known by its kind and the names that lead to it, the same in all files: ("own", "forager", "load").
Key = tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Declared:
    """One thing that has a name: `node` is its declaration, `name` the place to jump to."""

    key: Key
    name: nodes.Name
    node: Any


@dataclass(slots=True)
class SpeciesTable:
    """`node` is None for a species that another file brings, whose attributes are known from `world` alone."""

    name: str
    node: nodes.Species | None
    own: dict[str, Any] = field(default_factory=dict)  # declarations of params, attributes, lets, latches, fuzzies
    machines: dict[str, dict[str, nodes.State]] = field(default_factory=dict)

    def machine_of(self, state: str, first: str | None = None) -> str | None:
        """The machine that has a state, the given one before others."""
        order = [first] if first in self.machines else []
        return next((name for name in (*order, *self.machines) if name is not None and state in self.machines[name]), None)


@dataclass(slots=True)
class Names:
    """The names of one file. `behaviours` are its own; `library` those that `use` brings bare, by name the file they are in."""

    path: Path
    file: nodes.File
    things: dict[str, nodes.WorldItem] = field(default_factory=dict)
    fields: dict[str, nodes.FieldDecl] = field(default_factory=dict)
    species: dict[str, SpeciesTable] = field(default_factory=dict)
    behaviours: dict[str, nodes.Behaviour] = field(default_factory=dict)
    libraries: dict[str, Path] = field(default_factory=dict)
    modules: dict[str, Path] = field(default_factory=dict)
    events: dict[str, nodes.Name] = field(default_factory=dict)
    declared: dict[Key, Declared] = field(default_factory=dict)

    def add(self, key: Key, name: nodes.Name, node: Any) -> None:
        self.declared.setdefault(key, Declared(key, name, node))


def names_of(path: Path, file: nodes.File) -> Names:
    """The tables of a file. Where a name is declared twice the first counts, as for the checker."""
    names = Names(path, file)
    for item in file.items:
        _TOP[type(item)](names, item)
    for table in names.species.values():
        for name in _events(table):
            names.events.setdefault(name.text, name)
            names.add(("event", name.text), name, name)
    return names


def _use(names: Names, item: nodes.Use) -> None:
    if item.library is not None:
        found = library_file(item.library.text)
        if found is not None:
            names.libraries[item.library.text] = found
    elif item.path is not None and item.alias is not None:
        names.modules[item.alias.text] = real_path(names.path.parent.joinpath(item.path.text))
        names.add(("alias", str(names.path), item.alias.text), item.alias, item)


def _world(names: Names, item: nodes.World) -> None:
    for thing in item.items:
        name = thing.name.text
        kind = "attribute"
        if thing.kind.text == "species":
            table = names.species.setdefault(name, SpeciesTable(name, None))
            names.add(("species", name), thing.name, thing)
            for each in thing.attributes:
                table.own.setdefault(each.name.text, each)
            kind = "own"
        else:
            names.things.setdefault(name, thing)
            names.add(("thing", name), thing.name, thing)
        for each in thing.attributes:
            names.add((kind, name, each.name.text), each.name, each)


def _field(names: Names, item: nodes.FieldDecl) -> None:
    names.fields.setdefault(item.name.text, item)
    names.add(("field", item.name.text), item.name, item)


def _behaviour(names: Names, item: nodes.Behaviour) -> None:
    name, path = item.name.text, str(names.path)
    names.behaviours.setdefault(name, item)
    names.add(("behaviour", path, name), item.name, item)
    for argument in item.arguments:
        names.add(("inner", path, name, argument.name.text), argument.name, argument)
    for line in item.body:
        names.add(("inner", path, name, line.name.text), line.name, line)


def _species(names: Names, item: nodes.Species) -> None:
    name = item.name.text
    known = names.species.get(name)
    if known is None or known.node is None:
        names.species[name] = SpeciesTable(name, item, known.own if known else {})
        names.declared.pop(("species", name), None)
    names.add(("species", name), item.name, item)
    table = names.species[name]
    loose = {m.name.text: m for m in reversed(item.members) if isinstance(m, nodes.State)}
    if loose:
        _states(names, table, "main", dict(reversed(loose.items())))
    for member in members(item):
        if isinstance(member, nodes.Machine):
            names.add(("machine", name, member.name.text), member.name, member)
            states = {m.name.text: m for m in member.members if isinstance(m, nodes.State)}
            _states(names, table, member.name.text, states)
        declared = declaration(member)
        if declared is not None:
            table.own[declared.name.text] = member
            names.declared.pop(("own", name, declared.name.text), None)
            names.add(("own", name, declared.name.text), declared.name, member)


def _states(names: Names, table: SpeciesTable, machine: str, states: dict[str, nodes.State]) -> None:
    table.machines.setdefault(machine, {}).update(states)
    for state in states.values():
        names.add(("state", table.name, machine, state.name.text), state.name, state)
        for line in state.body:
            if isinstance(line, nodes.Let):
                names.add(("let", table.name, machine, state.name.text, line.name.text), line.name, line)


def declaration(member: Any) -> Any:
    """What declares a name of the species' own, or None."""
    if isinstance(member, nodes.ParamDecl):
        return member.declaration
    return member if isinstance(member, (nodes.Declaration, nodes.Let, nodes.Latch, nodes.Fuzzy)) else None


def members(species: nodes.Species) -> Iterator[Any]:
    """The members of a species with those of its machines, in text order."""
    for member in species.members:
        yield member
        if isinstance(member, nodes.Machine):
            yield from member.members


def _events(table: SpeciesTable) -> Iterator[nodes.Name]:
    """Names of events that are raised or handled; the two that the language raises itself are not declared anywhere."""
    for member in members(table.node) if table.node is not None else ():
        if isinstance(member, nodes.On):
            if member.event.text not in ("spawn", "collision"):
                yield member.event
            yield from _emitted(member.actions)
        elif isinstance(member, nodes.Change):
            yield from _emitted(member.actions)
        elif isinstance(member, nodes.State):
            yield from _emitted((*member.body, *member.enter, *member.exit))
            for line in member.body:
                if isinstance(line, nodes.Change):
                    yield from _emitted(line.actions)


def _emitted(lines: tuple[Any, ...]) -> Iterator[nodes.Name]:
    return (line.event for line in lines if isinstance(line, nodes.Emit))


def _nothing(names: Names, item: object) -> None:
    """A spec declares nothing."""


_TOP: dict[type, Any] = {
    nodes.Use: _use, nodes.World: _world, nodes.FieldDecl: _field, nodes.Behaviour: _behaviour, nodes.Species: _species,
    nodes.Spec: _nothing,
}  # fmt: skip
