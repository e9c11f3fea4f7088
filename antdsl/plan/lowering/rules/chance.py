"""Rules for random draws. A drawn number depends only on the draw's site in the source, the seed, the frame and the agent's id
(decision 22)."""

from __future__ import annotations

from math import pi

from antdsl.plan.builder import PlanError
from antdsl.plan.ir import PlanNode
from antdsl.plan.lowering.expressions import lower_expression, lower_scalar, select_value
from antdsl.plan.lowering.values import EntityRef, LoweredValue, NamedThing
from antdsl.plan.lowering.writer import PlanWriter
from antdsl.program import model


def lower_draw(w: PlanWriter, e: model.OperationExpr, index: int = 0) -> PlanNode:
    """Return a uniform random number in [0, 1)."""
    if not e.site:
        raise PlanError(f"this random draw has no site: {e.span.text!r}")
    return w.b("draw", attrs=(e.site, index))


def _lower_uniform(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    low, high = (lower_scalar(w, a) for a in e.args if a is not None)
    return w.b("add", low, w.b("mul", w.b("sub", high, low), lower_draw(w, e)))


def _lower_normal(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Lower a normal draw with the Box-Muller method (1958). It uses log(1 - u); 1 - u is in (0, 1], so the logarithm is
    finite."""
    mean, deviation = (lower_scalar(w, a) for a in e.args if a is not None)
    b = w.b
    radius = b("sqrt", b("mul", b.add_number(-2), b("log", b("sub", b.add_number(1), lower_draw(w, e)))))
    wave = b("cos", b("mul", b.add_number(2 * pi), lower_draw(w, e, 1)))
    return b("add", mean, b("mul", deviation, b("mul", radius, wave)))


def _lower_pick(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    choices = [lower_expression(w, a) for a in e.args if a is not None]
    place = w.b("mul", lower_draw(w, e), w.b.add_number(len(choices)))
    result = choices[-1]
    for k in range(len(choices) - 2, -1, -1):
        result = select_value(w, w.b("lt", place, w.b.add_number(k + 1)), choices[k], result)
    return result


def _lower_random_agent(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    assert e.args[0] is not None
    of = lower_expression(w, e.args[0])
    if not isinstance(of, NamedThing) or not e.site:
        raise PlanError(f"this random draw belongs to no species: {e.span.text!r}")
    return EntityRef(model.TypeKind.AGENT, of.name, w.b("draw.agent", attrs=(e.site, of.name)))


def _lower_chance(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Lower `chance`. A rate is converted to the probability 1 - exp(-rate dt) per step, so that the result does not depend on
    the step length. A probability is used directly."""
    argument = e.args[0]
    assert argument is not None
    share = lower_scalar(w, argument)
    b = w.b
    if argument.type.dimension.time < 0:
        share = b("sub", b.add_number(1), b("exp", b("neg", b("mul", share, w.read_run_value("dt")))))
    return b("lt", lower_draw(w, e), share)


CHANCE_RULES = {
    "uniform": _lower_uniform,
    "normal": _lower_normal,
    "pick": _lower_pick,
    "random_agent": _lower_random_agent,
    "chance": _lower_chance,
}
