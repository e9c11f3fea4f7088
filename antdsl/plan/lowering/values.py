"""The results of lowering an expression: one node, three nodes, or a value that only some operations accept."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from antdsl.plan.builder import PlanBuilder
from antdsl.plan.ir import PlanNode
from antdsl.program.model import TypeKind
from antdsl.program.tables.things import KIND_BY_WORD, ThingKindRow

MIN_VECTOR_LENGTH = 1e-30  # mm, mm/s, …; shorter vectors have no direction, so that 1/x stays finite


@dataclass(frozen=True, slots=True, eq=False)
class VectorNodes:
    """A vector in a plan: three nodes, one for each component."""

    x: PlanNode
    y: PlanNode
    z: PlanNode

    def __iter__(self) -> Iterator[PlanNode]:
        return iter((self.x, self.y, self.z))


@dataclass(frozen=True, slots=True, eq=False)
class EntityRef:
    """A reference to an item or an agent; it may be none. `node`: the item's row (`kind` ITEM) or the agent's id (AGENT).
    `owner`: the name of the items or species."""

    kind: TypeKind
    owner: str
    node: PlanNode


@dataclass(frozen=True, slots=True, eq=False)
class SetElement:
    """The current element of the set over which a reduction runs."""

    kind: TypeKind
    owner: str


@dataclass(frozen=True, slots=True, eq=False)
class RayHit:
    """The result of a ray: whether it hit, the distance, the surface normal at the hit, and the ray's unit direction."""

    hit: PlanNode
    distance: PlanNode
    normal: VectorNodes
    direction: VectorNodes


@dataclass(frozen=True, slots=True, eq=False)
class NamedThing:
    """A thing of the world or a species, by name."""

    kind: TypeKind
    name: str

    @property
    def row(self) -> ThingKindRow:
        """Return the row of the table of things that describes this thing's kind."""
        return KIND_BY_WORD[self.kind.value]


@dataclass(frozen=True, slots=True, eq=False)
class OwnPosition:
    """The position of the agent itself, used as a point."""


@dataclass(frozen=True, slots=True, eq=False)
class ElementGroup:
    """A set of agents or items, with the condition that its elements fulfil."""

    nodes: PlanNode
    condition: PlanNode
    element: SetElement


@dataclass(frozen=True, slots=True, eq=False)
class RayHits:
    """The rays of a set of feelers, in order from one side to the other."""

    hits: tuple[RayHit, ...]


LoweredValue = PlanNode | VectorNodes | EntityRef | SetElement | RayHit | NamedThing | OwnPosition | ElementGroup | RayHits


def apply_by_component(function: Callable[..., PlanNode], *vectors: VectorNodes) -> VectorNodes:
    """Return the vector that results from applying a function of scalars to each component of `vectors`."""
    return VectorNodes(function(*(v.x for v in vectors)), function(*(v.y for v in vectors)), function(*(v.z for v in vectors)))


def make_zero_vector(b: PlanBuilder) -> VectorNodes:
    """Return the zero vector."""
    return VectorNodes(b.add_number(0), b.add_number(0), b.add_number(0))


def add_vectors(b: PlanBuilder, u: VectorNodes, v: VectorNodes) -> VectorNodes:
    return apply_by_component(lambda p, q: b("add", p, q), u, v)


def subtract_vectors(b: PlanBuilder, u: VectorNodes, v: VectorNodes) -> VectorNodes:
    return apply_by_component(lambda p, q: b("sub", p, q), u, v)


def wrap_vector(b: PlanBuilder, v: VectorNodes, widths: tuple[float, float, float]) -> VectorNodes:
    """Return the shortest periodic image of a vector: each component is shifted by a multiple of the world's width to at most
    half a width. `widths`: in mm. Along an axis with the width 0, the component does not change."""
    parts = []
    for part, width in zip(v, widths, strict=True):
        if width:
            turns = b("floor", b("add", b("mul", part, b.add_number(1 / width)), b.add_number(0.5)))
            part = b("sub", part, b("mul", turns, b.add_number(width)))
        parts.append(part)
    return VectorNodes(*parts)


def negate_vector(b: PlanBuilder, v: VectorNodes) -> VectorNodes:
    return apply_by_component(lambda p: b("neg", p), v)


def scale_vector(b: PlanBuilder, v: VectorNodes, s: PlanNode) -> VectorNodes:
    """Return the vector times a scalar."""
    return apply_by_component(lambda p: b("mul", p, s), v)


def compute_dot_product(b: PlanBuilder, u: VectorNodes, v: VectorNodes) -> PlanNode:
    return b("add", b("add", b("mul", u.x, v.x), b("mul", u.y, v.y)), b("mul", u.z, v.z))


def compute_cross_product(b: PlanBuilder, u: VectorNodes, v: VectorNodes) -> VectorNodes:
    def cross_component(p: PlanNode, q: PlanNode, r: PlanNode, s: PlanNode) -> PlanNode:
        return b("sub", b("mul", p, q), b("mul", r, s))

    return VectorNodes(
        cross_component(u.y, v.z, u.z, v.y), cross_component(u.z, v.x, u.x, v.z), cross_component(u.x, v.y, u.y, v.x)
    )


def compute_length(b: PlanBuilder, v: VectorNodes) -> PlanNode:
    """Return the length of a vector."""
    return b("sqrt", compute_dot_product(b, v, v))


def divide_vector(b: PlanBuilder, v: VectorNodes, size: PlanNode) -> VectorNodes:
    """Return v / size. The result is a zero vector if `size` is too close to 0."""
    inverse = b("where", b("gt", size, b.add_number(MIN_VECTOR_LENGTH)), b("div", b.add_number(1), size), b.add_number(0))
    return scale_vector(b, v, inverse)


def normalise_vector(b: PlanBuilder, v: VectorNodes) -> VectorNodes:
    """Return the vector scaled to length 1. A zero vector stays zero (decision 24)."""
    return divide_vector(b, v, compute_length(b, v))


def limit_length(b: PlanBuilder, v: VectorNodes, max_length: PlanNode) -> VectorNodes:
    """Return v, shortened to the length `max_length` if it is longer."""
    size = compute_length(b, v)
    factor = b("where", b("gt", size, max_length), b("div", max_length, size), b.add_number(1))
    return scale_vector(b, v, factor)


def choose_vector(b: PlanBuilder, condition: PlanNode, true_vector: VectorNodes, false_vector: VectorNodes) -> VectorNodes:
    """Return `true_vector` where the condition holds, else `false_vector`."""
    return apply_by_component(lambda p, q: b("where", condition, p, q), true_vector, false_vector)


def select_or_zero(b: PlanBuilder, condition: PlanNode, v: VectorNodes) -> VectorNodes:
    """Return v if the condition holds, else a zero vector."""
    return choose_vector(b, condition, v, make_zero_vector(b))


def rotate_vector(b: PlanBuilder, v: VectorNodes, axis: VectorNodes, angle: PlanNode) -> VectorNodes:
    """Return v, rotated by `angle` (rad) about an axis of length 1 (Rodrigues 1840)."""
    cos, sin = b("cos", angle), b("sin", angle)
    ahead = scale_vector(b, v, cos)
    side = scale_vector(b, compute_cross_product(b, axis, v), sin)
    rest = scale_vector(b, axis, b("mul", compute_dot_product(b, axis, v), b("sub", b.add_number(1), cos)))
    return add_vectors(b, add_vectors(b, ahead, side), rest)


def compute_angle_between(b: PlanBuilder, u: VectorNodes, v: VectorNodes) -> PlanNode:
    """Return the angle between two vectors, from 0 to pi. It is accurate at both ends, unlike the arc cosine (Kahan 2006, "How
    futile …")."""
    return b("atan2", compute_length(b, compute_cross_product(b, u, v)), compute_dot_product(b, u, v))
