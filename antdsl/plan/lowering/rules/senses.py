"""Rules for fields, rays, sets as bare operations, values of the run, and the push that reaches a velocity."""

from __future__ import annotations

from antdsl.plan.ir import Node
from antdsl.plan.lowering import values
from antdsl.plan.lowering.builder import PlanError
from antdsl.plan.lowering.expressions import lower, scalar, truth, vector
from antdsl.plan.lowering.sets import BACKWARD, bound, cast, cone, gather
from antdsl.plan.lowering.simplify import value
from antdsl.plan.lowering.values import Element, Group, Hits, Named, Ref, Value, Vec
from antdsl.plan.lowering.writing import NotYet, Writer
from antdsl.program import model


def _name(w: Writer, e: model.Op, index: int = 0) -> str:
    expr = e.args[index]
    assert expr is not None
    thing = lower(w, expr)
    if not isinstance(thing, Named):
        raise PlanError(f"a {type(thing).__name__} where a thing of the world was due: {e.span.text!r}")
    return thing.name


def _field_value(w: Writer, e: model.Op) -> Value:
    return w.b("field.value", attrs=(_name(w, e),))


def _flow_value(w: Writer, e: model.Op) -> Value:
    here = w.b("flow.value", attrs=(_name(w, e),))
    return Vec(*(w.b("get", here, attrs=(i,)) for i in range(3)))


def _map_value(w: Writer, e: model.Op) -> Value:
    return w.b("map.value", attrs=(_name(w, e),))


def _nearest_cells(w: Writer, e: model.Op) -> list[Node]:
    count_expr = e.args[1]
    assert count_expr is not None
    count = value(scalar(w, count_expr))
    if count is None:
        raise NotYet("a number of cells that is not written as a number", e.span, "write it out, `nearest: 16`")
    cells = w.b("field.strongest", attrs=(_name(w, e), max(1, min(27, int(count)))))
    return [w.b("get", cells, attrs=(i,)) for i in range(4)]


def _field_max(w: Writer, e: model.Op) -> Value:
    return _nearest_cells(w, e)[0]


def _strongest(w: Writer, e: model.Op) -> Value:
    return Vec(*_nearest_cells(w, e)[1:])


def _gradient(w: Writer, e: model.Op) -> Value:
    slope = w.b("field.gradient", attrs=(_name(w, e),))
    return Vec(*(w.b("get", slope, attrs=(i,)) for i in range(3)))


def _ray(w: Writer, e: model.Op) -> Value:
    direction, reach = e.args[0], e.args[1]
    assert direction is not None and reach is not None
    return cast(w, values.unit(w.b, vector(w, direction)), scalar(w, reach), _name(w, e, 2))


def _nearest(w: Writer, e: model.Op) -> Value:
    """The nearest of items or agents, or of a set that is written out."""
    first = e.args[0]
    assert first is not None
    group = gather(w, first) if isinstance(first, model.SetOf) else _all_of(w, e)
    if isinstance(group, Hits):
        raise PlanError("the nearest hit is a reduction")
    op = "reduce.item" if group.element.what is model.Kind.ITEM else "reduce.agent"
    return Ref(group.element.what, group.element.of, w.b(op, group.nodes, group.condition, w.b("pair.distance")))


def _all_of(w: Writer, e: model.Op) -> Group:
    """`all(X, within:, with:)` as an operation; a condition is about the element only where it is a set with a name for it."""
    b = w.b
    first, within, condition = (*e.args, None, None)[:3]
    assert first is not None
    thing = lower(w, first)
    if not isinstance(thing, Named):
        raise PlanError(f"a set of a {type(thing).__name__}")
    radius = None if within is None else scalar(w, within)
    if thing.kind is model.Kind.ITEMS:
        element = Element(model.Kind.ITEM, thing.name)
        nodes = b("set.items", b.number(float("inf")) if radius is None else radius, attrs=(thing.name,))
    else:
        element = Element(model.Kind.AGENT, thing.name)
        nodes = (
            b("set.every", attrs=(thing.name,))
            if radius is None
            else b("set.agents", radius, b.number(BACKWARD), attrs=(thing.name, True))
        )
    if condition is None:
        return Group(nodes, b.true, element)
    expr = condition
    return Group(nodes, bound(w, _unnamed(thing, expr), element, lambda: truth(w, expr)), element)


def _unnamed(thing: Named, e: model.Expr) -> model.Binding:
    return model.Binding("", "element", model.Type(thing.kind, of=thing.name), model.Rate.ELEMENT, e.span)


def _neighbours(w: Writer, e: model.Op) -> Value:
    b = w.b
    radius, fov = (scalar(w, a) for a in e.args[:2] if a is not None)
    of = w.species.name if len(e.args) < 3 or e.args[2] is None else _name(w, e, 2)
    known = value(fov)
    nodes = b("set.agents", radius, *cone(w, fov), attrs=(of, known is not None and cone(w, fov)[0] is b.number(BACKWARD)))
    return Group(nodes, b.true, Element(model.Kind.AGENT, of))


def _feelers(w: Writer, e: model.Op) -> Value:
    raise PlanError("feelers are a set: they come as SetOf")


def _slope(w: Writer, e: model.Op) -> Value:
    return values.angle_between(w.b, w.read_vector("up"), _world_up(w))


def _uphill(w: Writer, e: model.Op) -> Value:
    """The world's up less its part along the animal's own: as long as the sine of the slope."""
    up, sky = w.read_vector("up"), _world_up(w)
    return values.sub(w.b, sky, values.scale(w.b, up, values.dot(w.b, up, sky)))


def _world_up(w: Writer) -> Vec:
    return Vec(w.run("up_x"), w.run("up_y"), w.run("up_z"))


def _run(w: Writer, e: model.Op) -> Value:
    name = _name(w, e)
    return w.run(name) if name == "dt" else w.b("step", attrs=(name,))


def _switched(w: Writer, e: model.Op) -> Value:
    assert e.args[0] is not None
    return lower(w, e.args[0])


def _event(w: Writer, e: model.Op) -> Value:
    return w.b("event", attrs=(_name(w, e),))


def _match(w: Writer, e: model.Op) -> Value:
    """The push that reaches a velocity within this step, (wanted - own) mass / (max_force dt), at most 1 (Reynolds 1999, 6)."""
    assert e.args[0] is not None
    b = w.b
    change = values.sub(b, vector(w, e.args[0]), w.read_vector("velocity"))
    strength = b("mul", w.read("max_force"), w.run("dt"))
    return values.limit(b, values.scale(b, change, b("div", w.read("mass"), strength)), b.number(1))


RULES = {
    "field_value": _field_value, "flow_value": _flow_value, "map_value": _map_value, "field_max": _field_max,
    "strongest": _strongest, "gradient": _gradient, "ray": _ray, "nearest": _nearest, "all": _all_of, "neighbours": _neighbours,
    "feelers": _feelers, "slope": _slope, "uphill": _uphill, "run": _run, "switched": _switched, "event": _event, "match": _match,
}  # fmt: skip
