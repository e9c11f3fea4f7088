"""Finds all declarations of a file in its syntax tree, with the keys that the checker's bindings use."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from antdsl.program.names.bindings import NameKey
from antdsl.program.names.collect import BUILTIN_EVENTS, find_emitted_event
from antdsl.program.traverse import iterate_nodes
from antdsl.syntax import nodes

DeclarationIterator = Iterator["Declaration"]


@dataclass(frozen=True, slots=True)
class Declaration:
    """A declaration in a file. `key`: its kind, owners and name. `name`: the span of its name, to which an editor jumps. `node`:
    the syntax node of the complete declaration."""

    key: NameKey
    name: nodes.Name
    node: Any


def list_declarations(file: nodes.File) -> DeclarationIterator:
    """Return the declarations of a file. If several have equal keys, only the first is returned, as in the checker. A `species`
    block comes before its entry in `world`."""
    for item in sorted(file.items, key=lambda item: isinstance(item, nodes.World)):
        yield from _LISTER_BY_ITEM[type(item)](file.source.path, item)


def find_declaring_node(member: object) -> Any:
    """Return the node that declares the name of a species member, or None if the member declares no name."""
    if isinstance(member, nodes.ParamDecl):
        return member.declaration
    return member if isinstance(member, (nodes.Declaration, nodes.Let, nodes.Latch, nodes.Fuzzy)) else None


def _list_use(path: str, item: nodes.Use) -> DeclarationIterator:
    if item.alias is not None:
        yield Declaration(("alias", path, item.alias.text), item.alias, item)


def _list_world(path: str, item: nodes.World) -> DeclarationIterator:
    for thing in item.items:
        name, species = thing.name.text, thing.kind.text == "species"
        yield Declaration(("species" if species else "thing", name), thing.name, thing)
        for each in thing.attributes:
            yield Declaration(("own" if species else "attribute", name, each.name.text), each.name, each)


def _list_field(path: str, item: nodes.FieldDecl) -> DeclarationIterator:
    yield Declaration(("field", item.name.text), item.name, item)


def _list_behaviour(path: str, item: nodes.Behaviour) -> DeclarationIterator:
    name = item.name.text
    yield Declaration(("behaviour", path, name), item.name, item)
    for each in (*item.arguments, *item.body):
        yield Declaration(("inner", path, name, each.name.text), each.name, each)


def _list_species(path: str, item: nodes.Species) -> DeclarationIterator:
    name = item.name.text
    yield Declaration(("species", name), item.name, item)
    yield from _list_members(name, "main", item.members)
    for part, _ in iterate_nodes(item.members):
        event = part.event if isinstance(part, nodes.On) else find_emitted_event(part)
        if event is not None and event.text not in BUILTIN_EVENTS:
            yield Declaration(("event", event.text), event, event)


def _list_members(species: str, machine: str, members: tuple[object, ...]) -> DeclarationIterator:
    for member in members:
        own = find_declaring_node(member)
        if own is not None:
            yield Declaration(("own", species, own.name.text), own.name, member)
        elif isinstance(member, nodes.Machine):
            yield Declaration(("machine", species, member.name.text), member.name, member)
            yield from _list_members(species, member.name.text, member.members)
        elif isinstance(member, nodes.State):
            state = member.name.text
            yield Declaration(("state", species, machine, state), member.name, member)
            lets = (line for line in member.body if isinstance(line, nodes.Let))
            yield from (Declaration(("let", species, machine, state, each.name.text), each.name, each) for each in lets)


def _list_measure(path: str, item: nodes.Measure) -> DeclarationIterator:
    yield Declaration(("measure", item.name.text), item.name, item)


def _list_nothing(path: str, item: nodes.Spec) -> DeclarationIterator:
    """Return no declarations, because a spec declares no names."""
    return iter(())


_LISTER_BY_ITEM: dict[type, Callable[[str, Any], DeclarationIterator]] = {
    nodes.Use: _list_use, nodes.World: _list_world, nodes.FieldDecl: _list_field, nodes.Behaviour: _list_behaviour,
    nodes.Species: _list_species, nodes.Spec: _list_nothing,
    nodes.Measure: _list_measure,
}  # fmt: skip
