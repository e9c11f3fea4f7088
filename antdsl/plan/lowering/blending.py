"""Blends the layers into one push with a length of at most 1 (decision 14).

There are three modes: a priority budget that the layers use from the top down, a sum, or the first layer with a push."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.plan.ir import LayerPlan, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.actions import GAZE_TEMP, STEER_TEMP, complain, face
from antdsl.plan.lowering.expressions import truth, vector
from antdsl.plan.lowering.values import VectorNodes
from antdsl.plan.lowering.writer import AXES, PlanWriter, UnsupportedConstruct
from antdsl.program import model

PUSH_REGISTER, BUDGET_LEFT_REGISTER, FACE_REGISTER = "push", "~left", "~face"


def blend(w: PlanWriter, order: Sequence[str] | None) -> tuple[LayerPlan, ...]:
    """Write the layers in order. The result is in the register `push`."""
    mode = w.species.layers.mode
    every = order_layers(w, order)
    layers = [layer for layer in every if not layer.faces]
    w.declare(BUDGET_LEFT_REGISTER, ValueKind.F32, "temp", 1.0)
    if not layers:
        _spend(w, _states(w), w.species.span, last=True)
    for number, layer in enumerate(layers):
        w.b.span = layer.span
        try:
            _layer(w, layer, mode, last=number == len(layers) - 1)
        except UnsupportedConstruct as missing:
            complain(w, missing)
    if mode == "sum":
        w.store_vector(PUSH_REGISTER, values.limit(w.b, w.read_vector(PUSH_REGISTER), w.b.number(1)), w.species.layers.span)
    _face(w, every)
    return tuple(LayerPlan(layer.text, layer.span) for layer in every)


def _layer(w: PlanWriter, layer: model.Layer, mode: str, last: bool) -> None:
    b = w.b
    strength = w.read(BUDGET_LEFT_REGISTER)
    left = b.true if mode == "sum" else b("gt", strength, b.number(0))
    with w.region(left, layer.span):
        condition = b.true if layer.condition is None else truth(w, layer.condition)
        with w.region(condition, layer.span):
            push = _states(w) if layer.push is None else vector(w, layer.push)
            w.note_layer(layer, strength, left, condition, push)
            if mode == "sum":
                w.store_vector(PUSH_REGISTER, values.add(b, w.read_vector(PUSH_REGISTER), push), layer.span)
            elif mode == "first":
                _take_first(w, push, layer, last)
            else:
                _spend(w, push, layer.span, last)


def _face(w: PlanWriter, layers: Sequence[model.Layer]) -> None:
    """Write the direction that the body faces, from the topmost `face` line with a direction. At the line `state`, the `face`
    lines of the states apply.

    A `face` line uses no strength, so layers above cannot use up its share."""
    states = f"{GAZE_TEMP}.x" in w.registers
    if not layers and states:
        face(w, FACE_REGISTER, w.read_vector(GAZE_TEMP), w.species.span)
    for number, layer in enumerate(layers, 1):
        if not layer.faces and not (layer.push is None and states):
            continue
        w.b.span = layer.span
        try:
            holds = w.b.true if layer.condition is None else truth(w, layer.condition)
            with w.region(holds, layer.span):
                direction = w.read_vector(GAZE_TEMP) if layer.push is None else vector(w, layer.push)
                if layer.push is not None:
                    w.note_steering(layer, f"{w.species.name}.layers.face#{number}", direction, holds)
                face(w, FACE_REGISTER, direction, layer.span)
        except UnsupportedConstruct as missing:
            complain(w, missing)


def _states(w: PlanWriter) -> VectorNodes:
    """Return the sum of the pushes that the current states of all machines steer."""
    if f"{STEER_TEMP}.x" not in w.registers:
        return values.zero(w.b)
    return w.read_vector(STEER_TEMP)


def _spend(w: PlanWriter, push: VectorNodes, span: object, last: bool) -> None:
    """Add a push, limited to the remaining strength, and subtract its length from the remaining strength."""
    b = w.b
    left, size = w.read(BUDGET_LEFT_REGISTER), values.length(b, push)
    too_much = b("gt", size, left)
    cut = values.scale(b, push, b("where", too_much, b("div", left, size), b.number(1)))
    place = b.span
    w.store_vector(PUSH_REGISTER, values.add(b, w.read_vector(PUSH_REGISTER), cut), place)
    if not last:
        w.store(BUDGET_LEFT_REGISTER, b("where", too_much, b.number(0), b("sub", left, size)), place)


def _take_first(w: PlanWriter, push: VectorNodes, layer: model.Layer, last: bool) -> None:
    """Use the first push that is not zero as the result, limited to length 1."""
    b = w.b
    is_nonzero = b("gt", values.length(b, push), b.number(0))
    with w.region(is_nonzero, layer.span):
        w.store_vector(PUSH_REGISTER, values.limit(b, push, b.number(1)), layer.span)
        if not last:
            w.store(BUDGET_LEFT_REGISTER, b.number(0), layer.span)


# --- an order from the scene -----------------------------------------------------------------------------------------


def order_layers(w: PlanWriter, order: Sequence[str] | None) -> tuple[model.Layer, ...]:
    """Return the layers in the order of the source, or in the order of a scene. A scene names each layer by its text, or by the
    word before its bracket."""
    layers = list(w.species.layers.layers)
    if order is None:
        return tuple(layers)
    span = w.species.layers.span
    result: list[model.Layer] = []
    for name in order:
        fitting = [layer for layer in layers if layer not in result and _is_named(layer, name)]
        exact = [layer for layer in fitting if _plain_text(layer.text) == _plain_text(name)]
        if not exact and len(fitting) != 1:
            known = ", ".join(f"`{layer.text}`" for layer in layers)
            what = "no layer" if not fitting else "more than one layer"
            w.report.error("layer-order", f"{what} of `{w.species.name}` matches `{name}`", span, f"the layers are {known}")
            return tuple(layers)
        result.append((exact or fitting)[0])
    missing = [layer for layer in layers if layer not in result]
    if missing:
        names = ", ".join(f"`{layer.text}`" for layer in missing)
        message = f"the order of the layers of `{w.species.name}` leaves out {names}"
        w.report.error("layer-order", message, span, "name every layer once")
        return tuple(layers)
    return tuple(result)


def _plain_text(text: str) -> str:
    return "".join(text.split())


def _is_named(layer: model.Layer, name: str) -> bool:
    text = _plain_text(layer.text)
    return text == _plain_text(name) or text.split("(")[0] == _plain_text(name)


def declare(w: PlanWriter) -> None:
    """Declare the temp register `push`."""
    for axis in AXES:
        w.declare(f"{PUSH_REGISTER}.{axis}", ValueKind.F32, "temp")
