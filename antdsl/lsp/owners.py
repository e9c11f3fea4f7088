"""Whose attributes an expression has: `meal` is an item of food, `other` an agent; followed through names, without types."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from antdsl.lsp.names import Names, declaration
from antdsl.syntax import nodes

if TYPE_CHECKING:
    from antdsl.lsp.uses import Place

# ("item", "food") one of the food; ("things", "food") all of it; ("agent", "rabbit"), ("species", "rabbit"); ("hit", "").
Owner = tuple[str, str] | None
_ONE = {"things": "item", "species": "agent"}
_DEEP = 20  # lets that stand for each other may run in a circle


def set_of(names: Names, place: Place, node: Any) -> Owner:
    """What the elements of a set are, or one of what is named."""
    found = owner_of(names, place, node)
    return (_ONE.get(found[0], found[0]), found[1]) if found is not None else None


def owner_of(names: Names, place: Place, node: Any, depth: int = 0) -> Owner:
    """Whose values stand behind the dot after this expression; None where that is not known."""
    if depth > _DEEP:
        return None
    if isinstance(node, nodes.NameRef):
        return _named(names, place, node.name.text, depth)
    if isinstance(node, nodes.NoneOf):
        return _one_of(names, node.of.text) if node.of is not None else None
    if isinstance(node, nodes.IfElse):
        return owner_of(names, place, node.then, depth + 1) or owner_of(names, place, node.otherwise, depth + 1)
    if isinstance(node, nodes.Member):
        whose = owner_of(names, place, node.owner, depth + 1)
        return _declared(names, place, whose[1], node.name.text, depth) if whose and whose[0] in ("agent", "species") else None
    return _called(names, place, node, depth) if isinstance(node, nodes.Call) else None


def _named(names: Names, place: Place, name: str, depth: int) -> Owner:
    if name in place.locals:
        return place.locals[name][1]
    if name == "it":
        return place.element
    if name == "self":
        return ("agent", place.species) if place.species else None
    if place.species is not None and place.behaviour is None:
        own = names.species.get(place.species)
        if own is not None and name in own.own:
            return _declared(names, place, place.species, name, depth)
    if name in names.species:
        return ("species", name)
    return ("things", name) if name in names.things else None


def _declared(names: Names, place: Place, species: str, name: str, depth: int) -> Owner:
    """What an attribute or a let of a species refers to."""
    table = names.species.get(species)
    node = declaration(table.own.get(name)) if table is not None else None
    if isinstance(node, nodes.Declaration) and node.type is not None and node.type.of is not None:
        return _one_of(names, node.type.of.text)
    return owner_of(names, place, node.value, depth + 1) if isinstance(node, (nodes.Declaration, nodes.Let)) else None


def _one_of(names: Names, name: str) -> Owner:
    return ("agent", name) if name in names.species else ("item", name)


def _called(names: Names, place: Place, node: nodes.Call, depth: int) -> Owner:
    name = node.function.name.text if isinstance(node.function, nodes.NameRef) else ""
    first = node.arguments[0] if node.arguments else None
    if isinstance(first, nodes.Comprehension):
        found = owner_of(names, place, first.over, depth + 1) if name == "best" else None
    elif name == "neighbours":
        of = [a.value for a in node.arguments if isinstance(a, nodes.Argument) and a.name is not None and a.name.text == "of"]
        if of:
            found = owner_of(names, place, of[0], depth + 1)
        else:
            found = ("agent", place.species or "")
    elif name in ("ray", "feelers"):
        return ("hit", "")
    elif name in ("nearest", "all", "random", "first", "pick") and first is not None:
        every = (owner_of(names, place, a.value, depth + 1) for a in node.arguments if isinstance(a, nodes.Argument))
        found = next((each for each in every if each is not None), None)
    else:
        return None
    return (_ONE.get(found[0], found[0]), found[1]) if found is not None else None
