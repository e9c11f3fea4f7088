"""The results of lowering an expression: one node, three nodes, or a value that only some operations accept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from antdsl.plan.builder import Builder
from antdsl.plan.ir import Node
from antdsl.program.model import Kind
from antdsl.program.tables.things import KINDS_OF_THINGS, KindOfThing

TINY = 1e-30  # shortest vector (mm, mm/s, …) that still has a direction: 1/x stays finite


@dataclass(frozen=True, slots=True, eq=False)
class Vec:
    x: Node
    y: Node
    z: Node

    def __iter__(self) -> Iterator[Node]:
        return iter((self.x, self.y, self.z))


@dataclass(frozen=True, slots=True, eq=False)
class EntityRef:
    """An item (`what` ITEM, a row) or an agent (AGENT, an id), perhaps none; `of` names the items or the species."""

    what: Kind
    of: str
    node: Node


@dataclass(frozen=True, slots=True, eq=False)
class Element:
    """The element of the set that is being reduced."""

    what: Kind
    of: str


@dataclass(frozen=True, slots=True, eq=False)
class Hit:
    """The result of a ray: whether it hit, the distance, the normal at the hit, and the ray's unit direction."""

    hit: Node
    distance: Node
    normal: Vec
    direction: Vec


@dataclass(frozen=True, slots=True, eq=False)
class NamedThing:
    """A thing of the world or a species, by name."""

    kind: Kind
    name: str

    @property
    def row(self) -> KindOfThing:
        """Return the row of its kind."""
        return KINDS_OF_THINGS[self.kind.value]


@dataclass(frozen=True, slots=True, eq=False)
class OwnPlace:
    """The agent itself, as a place."""


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """A set of agents or items with the condition on its elements."""

    nodes: Node
    condition: Node
    element: Element


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """The rays of a set of feelers, in their order from one side to the other."""

    hits: tuple[Hit, ...]


Value = Node | Vec | EntityRef | Element | Hit | NamedThing | OwnPlace | Group | Hits


def zip_with(f: Callable[..., Node], *vectors: Vec) -> Vec:
    """A function of scalars, component by component."""
    return Vec(f(*(v.x for v in vectors)), f(*(v.y for v in vectors)), f(*(v.z for v in vectors)))


def zero(b: Builder) -> Vec:
    return Vec(b.number(0), b.number(0), b.number(0))


def add(b: Builder, u: Vec, v: Vec) -> Vec:
    return zip_with(lambda p, q: b("add", p, q), u, v)


def sub(b: Builder, u: Vec, v: Vec) -> Vec:
    return zip_with(lambda p, q: b("sub", p, q), u, v)


def neg(b: Builder, v: Vec) -> Vec:
    return zip_with(lambda p: b("neg", p), v)


def scale(b: Builder, v: Vec, s: Node) -> Vec:
    return zip_with(lambda p: b("mul", p, s), v)


def dot(b: Builder, u: Vec, v: Vec) -> Node:
    return b("add", b("add", b("mul", u.x, v.x), b("mul", u.y, v.y)), b("mul", u.z, v.z))


def cross(b: Builder, u: Vec, v: Vec) -> Vec:
    def part(p: Node, q: Node, r: Node, s: Node) -> Node:
        return b("sub", b("mul", p, q), b("mul", r, s))

    return Vec(part(u.y, v.z, u.z, v.y), part(u.z, v.x, u.x, v.z), part(u.x, v.y, u.y, v.x))


def length(b: Builder, v: Vec) -> Node:
    return b("sqrt", dot(b, v, v))


def divide(b: Builder, v: Vec, size: Node) -> Vec:
    """Return v / size, or zero where size is not usable as a divisor."""
    inverse = b("where", b("gt", size, b.number(TINY)), b("div", b.number(1), size), b.number(0))
    return scale(b, v, inverse)


def unit(b: Builder, v: Vec) -> Vec:
    """Return the vector scaled to length 1; a zero vector stays zero (decision 24)."""
    return divide(b, v, length(b, v))


def limit(b: Builder, v: Vec, most: Node) -> Vec:
    """v, shortened to `most` if it is longer."""
    size = length(b, v)
    factor = b("where", b("gt", size, most), b("div", most, size), b.number(1))
    return scale(b, v, factor)


def choose(b: Builder, condition: Node, then: Vec, other: Vec) -> Vec:
    return zip_with(lambda p, q: b("where", condition, p, q), then, other)


def vector_if(b: Builder, condition: Node, v: Vec) -> Vec:
    """v where the condition holds, else nothing."""
    return choose(b, condition, v, zero(b))


def rotate(b: Builder, v: Vec, axis: Vec, angle: Node) -> Vec:
    """v turned about an axis of length 1 (Rodrigues 1840)."""
    cos, sin = b("cos", angle), b("sin", angle)
    ahead = scale(b, v, cos)
    side = scale(b, cross(b, axis, v), sin)
    rest = scale(b, axis, b("mul", dot(b, axis, v), b("sub", b.number(1), cos)))
    return add(b, add(b, ahead, side), rest)


def angle_between(b: Builder, u: Vec, v: Vec) -> Node:
    """0 to half a turn; well conditioned at both ends, unlike the arc cosine (Kahan 2006, "How futile …")."""
    return b("atan2", length(b, cross(b, u, v)), dot(b, u, v))
