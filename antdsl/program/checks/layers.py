"""Reports species that steer in states but have no layer `state`, and layers that have no effect.

A layer has no effect if earlier layers always use the complete priority budget, or if its condition never holds."""

from __future__ import annotations

import math

from antdsl.diagnostics import Label, Report
from antdsl.program.checks.analysis.check_context import CheckContext
from antdsl.program.checks.analysis.conditions import ConditionReader, is_always_false, is_always_true
from antdsl.program.model import (
    AttributeRef,
    BindingRef,
    Constant,
    Expr,
    FaceLine,
    InlinedBehaviour,
    Layer,
    OperationExpr,
    Species,
    Steer,
)
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.folding import find_constant


def check_layer_order(context: CheckContext, report: Report) -> None:
    """Report species that steer in states but have no layer `state`."""
    for species in context.program.species.values():
        lines = [line for m in species.machines for state in m.states for line in state.body]
        steering = next((line for line in lines if isinstance(line, Steer | FaceLine)), None)
        states = [layer for layer in species.layers.layers if layer.push is None]
        if steering is not None and not states:
            verb = "steers" if isinstance(steering, Steer) else "faces a way"
            message = f"`{species.name}` {verb} in its states, but its `layers` have no line `state`"
            report.error("state-not-in-layers", message, species.layers.span, "write `state` in a line of `layers`")
        for extra in states[1:]:
            report.error("duplicate-name", "`state` appears twice in `layers`", extra.span, "delete one of them")


def check_idle_layers(context: CheckContext, report: Report) -> None:
    """Report layers that never have an effect."""
    reader = ConditionReader(context.program.params)
    for species in context.program.species.values():
        for layer in species.layers.layers:
            if (
                layer.condition is not None
                and not isinstance(layer.condition, Constant)
                and is_always_false(reader, layer.condition)
            ):
                message = f"{quote_source(layer.condition.span)} can never hold"
                report.warning("idle-layer", message, layer.condition.span, "change one of its numbers, or delete the line")
        _check_priorities(reader, species, report)


def _check_priorities(reader: ConditionReader, species: Species, report: Report) -> None:
    """Report layers below a layer that always uses the complete priority budget. Layers that are summed are not reported."""
    lines = tuple(layer for layer in species.layers.layers if not layer.is_face_line)  # `face` lines use no strength
    enough = {"budget": 1.0, "first": 1e-6}.get(species.layers.mode)
    if enough is None:
        return
    for place, layer in enumerate(lines[:-1]):
        if is_always_true(reader, layer.condition) and _compute_min_layer_strength(species, layer) >= enough:
            for below in lines[place + 1 :]:
                report.warning(
                    "idle-layer", f"earlier layers always use all strength before {quote_source(below.span)}", below.span,
                    "move it up, or weaken the layers above: `… * 0.5`",
                    labels=(Label(layer.span, "this line always uses all strength"),),
                )  # fmt: skip
            return


def _compute_min_layer_strength(species: Species, layer: Layer) -> float:
    """Return the smallest possible length of a layer's push, or 0 if nothing is known about it."""
    if layer.push is not None:
        return compute_min_strength(layer.push)
    if len(species.machines) != 1:
        return 0.0  # pushes of several machines may cancel each other
    each = []
    for state in species.machines[0].states:
        pushes = [line.push for line in state.body if isinstance(line, Steer)]
        each.append(compute_min_strength(pushes[0]) if len(pushes) == 1 else 0.0)
    return min(each, default=0.0)


def compute_min_strength(push: Expr) -> float:
    """Return the smallest possible length of a push, or 0 if nothing is known about it."""
    if isinstance(push, BindingRef) and push.binding.role in ("let", "argument") and push.binding.value is not None:
        return compute_min_strength(push.binding.value)
    if isinstance(push, InlinedBehaviour):
        return compute_min_strength(push.result)
    if isinstance(push, AttributeRef):
        return 1.0 if push.owner is None and push.name in ("heading", "up") else 0.0
    if not isinstance(push, OperationExpr):
        return 0.0
    if push.name == "neg" and push.args[0] is not None:
        return compute_min_strength(push.args[0])
    if push.name == "if" and push.args[1] is not None and push.args[2] is not None:
        return min(compute_min_strength(push.args[1]), compute_min_strength(push.args[2]))
    if push.name in ("mul", "div"):
        return _compute_min_scaled_length(push)
    if push.name == "vector":
        numbers = [find_constant(arg) if arg is not None else None for arg in push.args]
        known = [c.number for c in numbers if c is not None and not (c.unit_power or c.step)]
        return math.hypot(*known)
    return 0.0


def _compute_min_scaled_length(push: OperationExpr) -> float:
    for vector, number in (push.args, push.args[::-1]):
        if vector is None or number is None:
            continue
        factor = find_constant(number)
        if factor is not None and not (factor.unit_power or factor.step) and factor.number:
            by = abs(factor.number)
            return compute_min_strength(vector) * (by if push.name == "mul" else 1 / by)
        if push.name == "div":
            break
    return 0.0
