"""Finds all declarations of a file in its syntax tree. The bindings of the checker refer to their keys."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from antdsl.program.names.bindings import NameKey
from antdsl.program.names.collect import BUILTIN_EVENTS, raised_event
from antdsl.program.traverse import written_nodes
from antdsl.syntax import nodes

DeclarationIterator = Iterator["Declaration"]


@dataclass(frozen=True, slots=True)
class Declaration:
    """A declaration. `key`: kind, owners and name. `name`: the location that an editor jumps to. `node`: the complete
    declaration."""

    key: NameKey
    name: nodes.Name
    node: Any


def declarations(file: nodes.File) -> DeclarationIterator:
    """Return the declarations of a file. Of equal keys, the first counts, as in the checker: the `species` itself comes before
    its entry in `world`."""
    for item in sorted(file.items, key=lambda item: isinstance(item, nodes.World)):
        yield from _LISTER_BY_ITEM[type(item)](file.source.path, item)


def declaration(member: object) -> Any:
    """Return the declaring node of a species member, or None if the member declares no name."""
    if isinstance(member, nodes.ParamDecl):
        return member.declaration
    return member if isinstance(member, (nodes.Declaration, nodes.Let, nodes.Latch, nodes.Fuzzy)) else None


def _use(path: str, item: nodes.Use) -> DeclarationIterator:
    if item.alias is not None:
        yield Declaration(("alias", path, item.alias.text), item.alias, item)


def _world(path: str, item: nodes.World) -> DeclarationIterator:
    for thing in item.items:
        name, species = thing.name.text, thing.kind.text == "species"
        yield Declaration(("species" if species else "thing", name), thing.name, thing)
        for each in thing.attributes:
            yield Declaration(("own" if species else "attribute", name, each.name.text), each.name, each)


def _field(path: str, item: nodes.FieldDecl) -> DeclarationIterator:
    yield Declaration(("field", item.name.text), item.name, item)


def _behaviour(path: str, item: nodes.Behaviour) -> DeclarationIterator:
    name = item.name.text
    yield Declaration(("behaviour", path, name), item.name, item)
    for each in (*item.arguments, *item.body):
        yield Declaration(("inner", path, name, each.name.text), each.name, each)


def _species(path: str, item: nodes.Species) -> DeclarationIterator:
    name = item.name.text
    yield Declaration(("species", name), item.name, item)
    yield from _members(name, "main", item.members)
    for part, _ in written_nodes(item.members):
        event = part.event if isinstance(part, nodes.On) else raised_event(part)
        if event is not None and event.text not in BUILTIN_EVENTS:
            yield Declaration(("event", event.text), event, event)


def _members(species: str, machine: str, members: tuple[object, ...]) -> DeclarationIterator:
    for member in members:
        own = declaration(member)
        if own is not None:
            yield Declaration(("own", species, own.name.text), own.name, member)
        elif isinstance(member, nodes.Machine):
            yield Declaration(("machine", species, member.name.text), member.name, member)
            yield from _members(species, member.name.text, member.members)
        elif isinstance(member, nodes.State):
            state = member.name.text
            yield Declaration(("state", species, machine, state), member.name, member)
            lets = (line for line in member.body if isinstance(line, nodes.Let))
            yield from (Declaration(("let", species, machine, state, each.name.text), each.name, each) for each in lets)


def _no_declarations(path: str, item: nodes.Spec) -> DeclarationIterator:
    """Return no declarations, because a spec declares no names."""
    return iter(())


_LISTER_BY_ITEM: dict[type, Callable[[str, Any], DeclarationIterator]] = {
    nodes.Use: _use, nodes.World: _world, nodes.FieldDecl: _field, nodes.Behaviour: _behaviour, nodes.Species: _species,
    nodes.Spec: _no_declarations,
}  # fmt: skip
