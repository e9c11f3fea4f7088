"""Lowers sets and reductions over them. A reduction over neighbours or items runs at pair rate. Feelers are unrolled ray by
ray."""

from __future__ import annotations

from collections.abc import Callable
from math import inf, pi
from typing import TypeVar

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode, UpdateRate
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower_condition, lower_expression, lower_scalar, select_value
from antdsl.plan.lowering.values import ElementGroup, EntityRef, LoweredValue, RayHit, RayHits, SetElement, VectorNodes
from antdsl.plan.lowering.writer import PlanWriter, UnsupportedConstruct
from antdsl.plan.simplify import get_constant_value
from antdsl.program import model
from antdsl.program.model import Dimension
from antdsl.program.tables.things import KIND_BY_WORD

T = TypeVar("T")
ANY_DIRECTION_COSINE = -2.0  # below every cosine, so that every direction is inside
FULL_TURN_ANGLE = 2 * pi - 1e-5
_MAX_COUNT_ARGUMENT = {"neighbours": 2, "all": 1}  # index of the argument with the maximum count


def choose_quantum_exponent(dim: Dimension) -> int:
    """Return the exponent of the rounding unit for sums of values with this dimension.

    Terms are rounded to a multiple of 2**exponent base units, so that their sum is exact in any order.

    A float64 has 53 bits, so with the exponent -24 sums may reach 2**28. For a larger range, some dimensions have a coarser
    unit. It is 4 bits coarser for lengths, speeds and forces (1e-6 mm, sums up to 4 million metres). It is 14 bits coarser for
    areas, 24 bits for volumes, and 6 bits for densities."""
    if dim.length <= 0:
        return -30 if dim.length < 0 else -24
    return -20 if dim.length <= 1 else -10 if dim.length <= 2 else 0


def lower_set(w: PlanWriter, e: model.SetExpr) -> ElementGroup | RayHits:
    """Return the elements of a set with the condition on them or, for feelers, the rays."""
    if e.source == "feelers":
        hits = lower_feelers(w, e)
        narrowed_hits = tuple(_filter_hit(w, hit, e.element, e.condition) for hit in hits)
        return RayHits(narrowed_hits)
    b = w.b
    kind = e.element.type.kind
    if kind not in (model.TypeKind.ITEM, model.TypeKind.AGENT):
        kind = model.TypeKind.ITEM if _is_item_group(w, e.source_name) else model.TypeKind.AGENT
    if e.source == "neighbours":
        radius, fov = lower_agent_scalar(w, e.args[0], e), lower_agent_scalar(w, e.args[1], e)
        nodes = b("set.agents", radius, *compute_min_cosine(w, fov), attrs=(e.source_name, _is_full_circle(fov)))
    elif kind is model.TypeKind.ITEM:
        within = b.add_number(inf) if not e.args or e.args[0] is None else lower_agent_scalar(w, e.args[0], e)
        nodes = b("set.items", within, attrs=(e.source_name,))
    elif not e.args or e.args[0] is None:
        nodes = b("set.every", attrs=(e.source_name,))
    else:
        nodes = b(
            "set.agents", lower_agent_scalar(w, e.args[0], e), b.add_number(ANY_DIRECTION_COSINE), attrs=(e.source_name, True)
        )
    element = SetElement(kind, e.source_name)
    condition = lower_with_binding(
        w, e.element, element, lambda: b.true if e.condition is None else lower_condition(w, e.condition)
    )
    most = e.args[_MAX_COUNT_ARGUMENT[e.source]] if len(e.args) > _MAX_COUNT_ARGUMENT[e.source] else None
    if most is not None:
        condition = b("and", condition, _is_among_nearest(w, nodes, condition, kind, lower_agent_scalar(w, most, e)))
    return ElementGroup(nodes, condition, element)


def _is_among_nearest(w: PlanWriter, nodes: PlanNode, condition: PlanNode, kind: model.TypeKind, max_count: PlanNode) -> PlanNode:
    """Return a node that is true for elements that are among the `max_count` nearest elements that fulfil `condition`.

    If at most `max_count` elements fulfil it, all are included. At equal distance, the lower id or row counts as nearer."""
    b, away = w.b, w.b("pair.distance")
    of_items = kind is model.TypeKind.ITEM
    last = b("reduce.nth_item" if of_items else "reduce.nth_agent", nodes, condition, away, max_count)
    label = b("other.row") if of_items else b("other.id")
    far = b("reduce.min", nodes, b("eq", label, last), away)
    nearer = b("or", b("lt", away, far), b("and", b("eq", away, far), b("le", label, last)))
    every = b("eq", last, b.add_constant(last.kind, -1))
    return b("and", b("ge", max_count, b.add_number(1)), b("or", every, nearer))


def _is_item_group(w: PlanWriter, name: str) -> bool:
    thing = w.program.world.get(name)
    return thing is not None and KIND_BY_WORD[thing.kind].is_item_group


def lower_agent_scalar(w: PlanWriter, e: model.Expr | None, set_expr: model.SetExpr) -> PlanNode:
    """Return the node of a parameter of a set, such as a radius. It may depend on the agent, but not on an element of another
    set."""
    if e is None:
        raise PlanError(f"this set has no size: {set_expr.span.text!r}")
    node = lower_scalar(w, e)
    if node.rate > UpdateRate.AGENT:
        words = "a set inside another set, with a size that depends on an element of the outer one,"
        raise UnsupportedConstruct(words, e.span, "write a size that depends only on the agent itself")
    return node


def _is_full_circle(fov: PlanNode) -> bool:
    known = get_constant_value(fov)
    return known is not None and known >= FULL_TURN_ANGLE


def compute_min_cosine(w: PlanWriter, fov: PlanNode) -> tuple[PlanNode]:
    """Return the cosine of half the field of view `fov` (rad): the smallest cosine between the heading and a visible
    direction."""
    b = w.b
    if _is_full_circle(fov):
        return (b.add_number(ANY_DIRECTION_COSINE),)
    narrow = b("cos", b("mul", fov, b.add_number(0.5)))
    return (b("where", b("ge", fov, b.add_number(FULL_TURN_ANGLE)), b.add_number(ANY_DIRECTION_COSINE), narrow),)


def lower_with_binding(w: PlanWriter, binding: model.Binding, element: LoweredValue, body: Callable[[], T]) -> T:
    """Bind a name to an element, call `body` while it is bound, and return the result of `body`."""
    w.environment[binding] = element
    if isinstance(element, SetElement):
        w.set_elements.append(binding)
    try:
        return body()
    finally:
        if isinstance(element, SetElement):
            w.set_elements.pop()
        del w.environment[binding]


# --- reductions ------------------------------------------------------------------------------------------------------


def lower_reduction(w: PlanWriter, e: model.ReduceExpr) -> LoweredValue:
    """Lower a reduction over a set: sum, mean, min, max, count, any, every, best or nearest."""
    over = lower_set(w, e.elements)
    if isinstance(over, RayHits):
        return _reduce_hits(w, e, over)
    b = w.b
    if e.reducer == "nearest":
        return _select_least_element(w, over, b("pair.distance"))
    if e.body is None and e.reducer in ("count", "any"):
        return b(f"reduce.{e.reducer}", over.nodes, over.condition)
    body_expr = e.body
    if body_expr is None:
        raise PlanError(f"`{e.reducer}` has no expression to evaluate: {e.span.text!r}")
    if e.reducer in ("count", "any", "every"):
        holds = lower_with_binding(w, e.element, over.element, lambda: lower_condition(w, body_expr))
        if e.reducer == "every":
            return b("not", b("reduce.any", over.nodes, b("and", over.condition, b("not", holds))))
        return b(f"reduce.{e.reducer}", over.nodes, b("and", over.condition, holds))
    body = lower_with_binding(w, e.element, over.element, lambda: lower_expression(w, body_expr))
    if e.reducer == "best":
        if not isinstance(body, PlanNode):
            raise PlanError("`best` needs a number to compare")
        return _select_least_element(w, over, b("neg", body))
    parts = list(body) if isinstance(body, VectorNodes) else [body]
    results = [_reduce_numbers(w, e.reducer, over, part, choose_quantum_exponent(body_expr.type.dimension)) for part in parts]  # type: ignore[arg-type]
    return VectorNodes(*results) if isinstance(body, VectorNodes) else results[0]


def _reduce_numbers(w: PlanWriter, reducer: str, elements: ElementGroup, body: PlanNode, exponent: int) -> PlanNode:
    b = w.b
    if reducer in ("min", "max"):
        return b(f"reduce.{reducer}", elements.nodes, elements.condition, body)
    total = b("reduce.sum", elements.nodes, elements.condition, body, attrs=(exponent,))
    if reducer == "sum":
        return total
    if reducer != "mean":
        raise PlanError(f"there is no reduction `{reducer}`")
    count = b("reduce.count", elements.nodes, elements.condition)
    return b("where", b("gt", count, b.add_number(0)), b("div", total, count), b.add_number(0))


def _select_least_element(w: PlanWriter, elements: ElementGroup, body: PlanNode) -> EntityRef:
    op = "reduce.item" if elements.element.kind is model.TypeKind.ITEM else "reduce.agent"
    return EntityRef(elements.element.kind, elements.element.owner, w.b(op, elements.nodes, elements.condition, body))


# --- feelers ---------------------------------------------------------------------------------------------------------


def lower_feelers(w: PlanWriter, e: model.SetExpr) -> tuple[RayHit, ...]:
    """Return the rays of feelers. Their directions are at equal angles about the up direction, from `-spread` to `spread`
    relative to the heading (Reynolds 1999, p. 12)."""
    b = w.b
    count_expr, spread_expr, reach_expr = e.args
    count = get_constant_value(lower_agent_scalar(w, count_expr, e))
    if count is None:
        raise UnsupportedConstruct("a computed number of feelers", e.span, "write the number itself: `feelers: 3`")
    n = max(1, min(16, int(count)))
    spread, reach = lower_agent_scalar(w, spread_expr, e), lower_agent_scalar(w, reach_expr, e)
    heading, up = w.read_vector("heading"), w.read_vector("up")
    across = values.compute_cross_product(b, up, heading)
    hits = []
    for k in range(n):
        share = 0.0 if n == 1 else 2 * k / (n - 1) - 1
        angle = b("mul", spread, b.add_number(share))
        ahead = heading
        if share != 0:
            ahead = values.add_vectors(
                b, values.scale_vector(b, heading, b("cos", angle)), values.scale_vector(b, across, b("sin", angle))
            )
        hits.append(cast_ray(w, ahead, reach, e.source_name))
    return tuple(hits)


def cast_ray(w: PlanWriter, direction: VectorNodes, reach: PlanNode, target: str) -> RayHit:
    """Return one ray. `direction`: a unit vector. `reach`: the length in mm. In a periodic world, at most half of the world's
    width is used."""
    if w.period is not None:
        reach = w.b("min", reach, w.b.add_number(min(width for width in w.period if width) / 2))
    ray = w.b("ray", *direction, reach, attrs=(target,))
    hit, distance, x, y, z = (w.b("get", ray, attrs=(i,)) for i in range(5))
    return RayHit(hit, distance, VectorNodes(x, y, z), direction)


def _filter_hit(w: PlanWriter, hit: RayHit, element: model.Binding, condition: model.Expr | None) -> RayHit:
    if condition is None:
        return hit
    holds = lower_with_binding(w, element, _assume_hit(w, hit), lambda: lower_condition(w, condition))
    return RayHit(w.b("and", hit.hit, holds), hit.distance, hit.normal, hit.direction)


def _assume_hit(w: PlanWriter, hit: RayHit) -> RayHit:
    """Return a copy of a ray in which the hit counts as present, for use in the body of a reduction. The caller discards the
    results of rays without a hit."""
    return RayHit(w.b.true, hit.distance, hit.normal, hit.direction)


def _reduce_hits(w: PlanWriter, e: model.ReduceExpr, elements: RayHits) -> LoweredValue:
    """Lower a reduction over the hits of feelers, unrolled in the order of the rays."""
    b = w.b
    if e.reducer == "nearest":
        return _select_least_hit(w, elements, [hit.distance for hit in elements.hits])
    if e.body is None:
        conditions = [hit.hit for hit in elements.hits]
    else:
        body_expr = e.body
        lower_body = lower_condition if e.reducer in ("count", "any", "every") else lower_expression
        bodies = [
            lower_with_binding(w, e.element, _assume_hit(w, hit), lambda: lower_body(w, body_expr)) for hit in elements.hits
        ]
        if e.reducer == "best":
            return _select_least_hit(w, elements, [b("neg", body) for body in bodies])  # type: ignore[arg-type]
        if e.reducer not in ("count", "any", "every"):
            return _reduce_hit_numbers(w, e.reducer, elements, bodies)
        if e.reducer == "every":
            return b.add_conjunction(*(b("or", b("not", hit.hit), body) for hit, body in zip(elements.hits, bodies, strict=True)))  # type: ignore[arg-type]
        conditions = [b("and", hit.hit, body) for hit, body in zip(elements.hits, bodies, strict=True)]  # type: ignore[arg-type]
    if e.reducer == "any":
        return _fold_nodes(w, "or", conditions, b.false)
    return _fold_nodes(w, "add", [b("number", each) for each in conditions], b.add_number(0))


def _fold_nodes(w: PlanWriter, op: str, nodes: list[PlanNode], start: PlanNode) -> PlanNode:
    for node in nodes:
        start = w.b(op, start, node)
    return start


def _reduce_hit_numbers(w: PlanWriter, reducer: str, elements: RayHits, bodies: list[LoweredValue]) -> LoweredValue:
    b = w.b
    nothing = {"min": inf, "max": -inf}.get(reducer, 0.0)

    def reduce_component(parts: list[PlanNode]) -> PlanNode:
        terms = [b("where", hit.hit, part, b.add_number(nothing)) for hit, part in zip(elements.hits, parts, strict=True)]
        if reducer in ("min", "max"):
            return _fold_nodes(w, reducer, terms[1:], terms[0])
        total = _fold_nodes(w, "add", terms, b.add_number(0))
        if reducer == "sum":
            return total
        count = _fold_nodes(w, "add", [b("number", hit.hit) for hit in elements.hits], b.add_number(0))
        return b("where", b("gt", count, b.add_number(0)), b("div", total, count), b.add_number(0))

    if isinstance(bodies[0], VectorNodes):
        return values.apply_by_component(lambda *parts: reduce_component(list(parts)), *bodies)  # type: ignore[arg-type]
    return reduce_component(bodies)  # type: ignore[arg-type]


def _select_least_hit(w: PlanWriter, elements: RayHits, keys: list[PlanNode]) -> RayHit:
    """Return the hit with the smallest key. Among equal keys, the earlier ray wins."""
    best, least = elements.hits[0], keys[0]
    for hit, key in zip(elements.hits[1:], keys[1:], strict=True):
        better = w.b("and", hit.hit, w.b("or", w.b("not", best.hit), w.b("lt", key, least)))
        chosen = select_value(w, better, hit, best)
        assert isinstance(chosen, RayHit)
        best, least = chosen, w.b("where", better, key, least)
    return best
