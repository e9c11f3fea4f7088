"""Lowers the combination of the layers into one push with a length of at most 1 (decision 14).

There are three modes. In the budget mode, layers spend a priority budget from top to bottom. The other modes are the sum of all
layers, and the first layer with a push."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.plan.ir import LayerPlan, ValueKind
from antdsl.plan.lowering import values
from antdsl.plan.lowering.actions import GAZE_TEMP, STEER_TEMP, report_unsupported, store_face_direction
from antdsl.plan.lowering.expressions import lower_condition, lower_vector
from antdsl.plan.lowering.values import VectorNodes
from antdsl.plan.lowering.writer import AXES, PlanWriter, UnsupportedConstruct
from antdsl.program import model

PUSH_REGISTER_NAME, BUDGET_LEFT_REGISTER_NAME, FACE_REGISTER_NAME = "push", "~left", "~face"


def write_layer_arbitration(w: PlanWriter, order: Sequence[str] | None) -> tuple[LayerPlan, ...]:
    """Write the statements that combine the layers into the register `push`. Return the layers in the order of evaluation.

    `order`: the names of the layers in the order of the scene; None: the order of the source."""
    mode = w.species.layers.mode
    every = order_layers(w, order)
    layers = [layer for layer in every if not layer.is_face_line]
    w.declare_register(BUDGET_LEFT_REGISTER_NAME, ValueKind.F32, "temp", 1.0)
    if not layers:
        _subtract_from_budget(w, _read_state_push(w), w.species.span, is_last=True)
    for number, layer in enumerate(layers):
        w.b.span = layer.span
        try:
            _write_layer(w, layer, mode, is_last=number == len(layers) - 1)
        except UnsupportedConstruct as missing:
            report_unsupported(w, missing)
    if mode == "sum":
        w.store_vector(
            PUSH_REGISTER_NAME,
            values.limit_length(w.b, w.read_vector(PUSH_REGISTER_NAME), w.b.add_number(1)),
            w.species.layers.span,
        )
    _write_face_direction(w, every)
    return tuple(LayerPlan(layer.text, layer.span) for layer in every)


def _write_layer(w: PlanWriter, layer: model.Layer, mode: str, is_last: bool) -> None:
    b = w.b
    strength = w.read_at_step_start(BUDGET_LEFT_REGISTER_NAME)
    left = b.true if mode == "sum" else b("gt", strength, b.add_number(0))
    with w.open_region(left, layer.span):
        condition = b.true if layer.condition is None else lower_condition(w, layer.condition)
        with w.open_region(condition, layer.span):
            push = _read_state_push(w) if layer.push is None else lower_vector(w, layer.push)
            w.note_layer(layer, strength, left, condition, push)
            if mode == "sum":
                w.store_vector(PUSH_REGISTER_NAME, values.add_vectors(b, w.read_vector(PUSH_REGISTER_NAME), push), layer.span)
            elif mode == "first":
                _store_first_push(w, push, layer, is_last)
            else:
                _subtract_from_budget(w, push, layer.span, is_last)


def _write_face_direction(w: PlanWriter, layers: Sequence[model.Layer]) -> None:
    """Write the store of the direction that the body faces. The topmost `face` line that has a direction decides. The line
    `state` stands for the `face` lines of the current states.

    A `face` line uses no strength of the priority budget. Therefore it does not depend on how much earlier layers leave."""
    states = f"{GAZE_TEMP}.x" in w.registers
    if not layers and states:
        store_face_direction(w, FACE_REGISTER_NAME, w.read_vector(GAZE_TEMP), w.species.span)
    for number, layer in enumerate(layers, 1):
        if not layer.is_face_line and not (layer.push is None and states):
            continue
        w.b.span = layer.span
        try:
            holds = w.b.true if layer.condition is None else lower_condition(w, layer.condition)
            with w.open_region(holds, layer.span):
                direction = w.read_vector(GAZE_TEMP) if layer.push is None else lower_vector(w, layer.push)
                if layer.push is not None:
                    w.note_steering(layer, f"{w.species.name}.layers.face#{number}", direction, holds)
                store_face_direction(w, FACE_REGISTER_NAME, direction, layer.span)
        except UnsupportedConstruct as missing:
            report_unsupported(w, missing)


def _read_state_push(w: PlanWriter) -> VectorNodes:
    """Return the sum of the pushes that the current states of all machines request."""
    if f"{STEER_TEMP}.x" not in w.registers:
        return values.make_zero_vector(w.b)
    return w.read_vector(STEER_TEMP)


def _subtract_from_budget(w: PlanWriter, push: VectorNodes, span: object, is_last: bool) -> None:
    """Add a push to the result, and subtract its length from the strength that remains. A push longer than this strength is
    shortened to it first."""
    b = w.b
    left, size = w.read_at_step_start(BUDGET_LEFT_REGISTER_NAME), values.compute_length(b, push)
    too_much = b("gt", size, left)
    cut = values.scale_vector(b, push, b("where", too_much, b("div", left, size), b.add_number(1)))
    place = b.span
    w.store_vector(PUSH_REGISTER_NAME, values.add_vectors(b, w.read_vector(PUSH_REGISTER_NAME), cut), place)
    if not is_last:
        w.add_store(BUDGET_LEFT_REGISTER_NAME, b("where", too_much, b.add_number(0), b("sub", left, size)), place)


def _store_first_push(w: PlanWriter, push: VectorNodes, layer: model.Layer, is_last: bool) -> None:
    """Write the selection of a layer's push as the result, if the push is not zero and no earlier layer had a push. It is
    shortened to length 1 if it is longer."""
    b = w.b
    is_nonzero = b("gt", values.compute_length(b, push), b.add_number(0))
    with w.open_region(is_nonzero, layer.span):
        w.store_vector(PUSH_REGISTER_NAME, values.limit_length(b, push, b.add_number(1)), layer.span)
        if not is_last:
            w.add_store(BUDGET_LEFT_REGISTER_NAME, b.add_number(0), layer.span)


# --- an order from the scene -----------------------------------------------------------------------------------------


def order_layers(w: PlanWriter, order: Sequence[str] | None) -> tuple[model.Layer, ...]:
    """Return the layers in the order of the scene (`order`) or, if `order` is None, of the source. A scene names each layer by
    its text, or by the word before its bracket."""
    layers = list(w.species.layers.layers)
    if order is None:
        return tuple(layers)
    span = w.species.layers.span
    result: list[model.Layer] = []
    for name in order:
        fitting = [layer for layer in layers if layer not in result and _is_named(layer, name)]
        exact = [layer for layer in fitting if _remove_blanks(layer.text) == _remove_blanks(name)]
        if not exact and len(fitting) != 1:
            known = ", ".join(f"`{layer.text}`" for layer in layers)
            what = "no layer" if not fitting else "more than one layer"
            w.report.error("layer-order", f"{what} of `{w.species.name}` matches `{name}`", span, f"the layers are {known}")
            return tuple(layers)
        result.append((exact or fitting)[0])
    missing = [layer for layer in layers if layer not in result]
    if missing:
        names = ", ".join(f"`{layer.text}`" for layer in missing)
        message = f"the order of the layers of `{w.species.name}` omits {names}"
        w.report.error("layer-order", message, span, "name every layer once")
        return tuple(layers)
    return tuple(result)


def _remove_blanks(text: str) -> str:
    return "".join(text.split())


def _is_named(layer: model.Layer, name: str) -> bool:
    text = _remove_blanks(layer.text)
    return text == _remove_blanks(name) or text.split("(")[0] == _remove_blanks(name)


def declare_push(w: PlanWriter) -> None:
    """Declare the temp register `push`."""
    for axis in AXES:
        w.declare_register(f"{PUSH_REGISTER_NAME}.{axis}", ValueKind.F32, "temp")
