"""Where a place is wanted: items and species stand for the nearest of them, everything else that is somewhere for itself."""

from __future__ import annotations

from antdsl.program.model import Binding, Dim, Expr, Kind, Rate, Reduce, SetOf, Type
from antdsl.program.names.scope import Scope, bad
from antdsl.program.types.descriptions import mismatch
from antdsl.source import Span
from antdsl.syntax import nodes

PLACES = frozenset({Kind.ITEM, Kind.AGENT, Kind.HIT, Kind.CURVE, Kind.OBSTACLE, Kind.SURFACE, Kind.SOLID, Kind.PLACE})


def place(scope: Scope, node: nodes.Expr, who: str) -> Expr:
    """An expression as a place."""
    found = scope.typed(node, Type(Kind.PLACE))
    if found.type.kind in PLACES or found.type.kind is Kind.BAD or found.type == Type(Kind.VECTOR, Dim(length=1)):
        return found
    if found.type.kind in (Kind.ITEMS, Kind.SPECIES):
        return nearest_of(found, node.span)
    mismatch(scope.report, node, found.type, Type(Kind.PLACE), who)
    return bad(node.span)


def one_of(things: Type) -> Type:
    """The type of one element of all items of a name, or of a species."""
    return Type(Kind.ITEM if things.kind is Kind.ITEMS else Kind.AGENT, Dim(), things.of)


def nearest_of(things: Expr, span: Span) -> Reduce:
    """The nearest of all items of a name, or of a species."""
    type = one_of(things.type)
    element = Binding("it", "element", type, Rate.ELEMENT, span)
    over = SetOf(Type(Kind.SET, Dim(), type.of), Rate.AGENT, span, "all", type.of or "", (None,), element, None)
    return Reduce(type, Rate.AGENT, span, "nearest", over, element, None)
