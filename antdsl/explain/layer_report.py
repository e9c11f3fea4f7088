"""Reports on the layers of a step: the push that each requests, the strength left for it, and how much of its push was cut.

Sums are computed in float32, as in the step itself."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.explain.model import LayerReport, SteeringLine
from antdsl.explain.tracing import AgentTrace
from antdsl.explain.value_text import build_condition_part, locate_span, to_float_triple
from antdsl.plan.lowering.source_map import LayerNote, SourceNotes
from antdsl.runtime.world import AXES, World

_F32 = np.float32
PushVector = NDArray[np.float32]


def build_layer_reports(world: World, mode: str, notes: SourceNotes, trace: AgentTrace) -> tuple[LayerReport, ...]:
    """Return a report on each layer, in the order in which the layers were evaluated. `mode`: how layers are combined."""
    with np.errstate(all="ignore"):
        return tuple(_build_layer_report(world, mode, note, trace) for note in notes.layers)


def _build_layer_report(world: World, mode: str, note: LayerNote, trace: AgentTrace) -> LayerReport:
    """Return the report on one layer. `mode`: how layers are combined."""
    where, left = locate_span(note.layer.span, note.layer.text), float(trace.values.get(note.budget_left, 0.0))
    no_push = (0.0, 0.0, 0.0)
    if not trace.values.get(note.has_budget, False):
        return LayerReport(where, "no strength", None, left, None, 0.0, no_push, 0.0, 0.0)
    condition = build_condition_part(world, note.condition, trace.values)
    if not trace.values.get(note.condition_value, False):
        return LayerReport(where, "off", condition, left, None, 0.0, no_push, 0.0, 0.0)
    push = np.array([trace.values[node] for node in note.push], _F32)
    size = compute_length(push)
    granted_push = _grant_push(mode, push, size, _F32(left))
    granted_strength = float(compute_length(granted_push))
    state = "pushed" if size > 0 else "nothing"
    return LayerReport(
        where,
        state,
        condition,
        left,
        to_float_triple(push),
        float(size),
        to_float_triple(granted_push),
        granted_strength,
        max(float(size) - granted_strength, 0.0),
    )


def _grant_push(mode: str, push: PushVector, size: np.float32, budget: np.float32) -> PushVector:
    """Return the part of a layer's push that takes effect. `mode`: how layers are combined. `size`: the length of the push.

    If pushes are summed, it is the complete push. With a priority budget, the push is shortened to the remaining `budget`. If
    the first layer takes all, it is shortened to length 1."""
    if mode == "sum":
        return push
    limit = budget if mode == "budget" else _F32(1)
    return push * (limit / size if size > limit else _F32(1))


def compute_length(push: PushVector) -> np.float32:
    """Return the length of a vector, computed with the same order of operations as in the plan."""
    x, y, z = push
    size: np.float32 = np.sqrt((x * x + y * y) + z * z)
    return size


def read_total_push(trace: AgentTrace) -> PushVector:
    """Return the sum of the pushes of all layers. It is read from the register that moves the agent."""
    return np.array([trace.end_registers[f"push.{axis}"] for axis in AXES], _F32)


def find_steering_lines(species: str, notes: SourceNotes, trace: AgentTrace, sites: tuple[str, ...]) -> tuple[SteeringLine, ...]:
    """Return the `steer` and `face` lines that ran. `sites`: prefixes of the code sites to include. Other lines are omitted."""
    steer_lines = []
    for note in notes.steers:
        if note.site.startswith(sites) and all(node in trace.values for node in note.push):
            push = np.array([trace.values[node] for node in note.push], _F32)
            if note.condition_value is None or trace.values.get(note.condition_value, False):
                part = "state" if note.condition_value is None else "layers"
                steer_lines.append(SteeringLine(note.text, to_float_triple(push), float(compute_length(push)), part))
    return tuple(steer_lines)
