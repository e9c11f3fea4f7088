"""Values of nodes, in the form that authors write: parts of conditions, timers and vectors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from antdsl.explain.model import ExpressionPart, FloatTriple, PlainValue, SourceLocation, TimerReading
from antdsl.plan.ir import PlanNode
from antdsl.plan.lowering.source_map import ExpressionNote, TimerNote
from antdsl.program.model import TypeKind, ValueType
from antdsl.program.tables.units import find_unit_measure
from antdsl.runtime.world import World
from antdsl.source import Span
from antdsl.specs.value_text import format_value

NodeValues = Mapping[PlanNode, Any]
_MAX_TEXT_CHARACTERS = 160


def locate_span(span: Span, text: str | None = None) -> SourceLocation:
    """Return the location of a span: its file, its line and its text. Long text is shortened."""
    line = " ".join((text or span.text).split())
    return SourceLocation(
        line if len(line) <= _MAX_TEXT_CHARACTERS else line[: _MAX_TEXT_CHARACTERS - 1] + "…",
        span.source.path,
        span.source.find_line_column(span.start)[0],
    )


def to_float_triple(parts: Any) -> FloatTriple:
    """Return three components as Python floats."""
    x, y, z = (float(part) for part in parts)
    return x, y, z


def build_condition_part(world: World, note: ExpressionNote | None, values: NodeValues) -> ExpressionPart | None:
    """Return a part of a condition with its value; None if `note` is None."""
    if note is None or any(node not in values for node in note.nodes):
        return None
    inner = tuple(inner_part for each in note.parts if (inner_part := build_condition_part(world, each, values)) is not None)
    if len(note.nodes) == 3:
        vector = to_float_triple(convert_to_unit(world, values[node], note.unit) for node in note.nodes)
        words = f"({', '.join(f'{x:.4g}' for x in vector)}) {note.unit}".strip()
        return ExpressionPart(note.text, vector, note.unit, words, note.role, inner)
    raw = values[note.nodes[0]]
    return ExpressionPart(
        note.text,
        to_plain_value(world, raw, note.type, note.unit),
        note.unit,
        format_author_value(world, raw, note.type, note.unit),
        note.role,
        inner,
    )


def format_author_value(world: World, raw: Any, type: ValueType, unit: str) -> str:
    """Return a value as text, in the form that authors write. A boolean is always written as `yes` or `no`, whatever its
    declared type."""
    if isinstance(raw, np.bool_ | bool):
        type = ValueType(TypeKind.BOOL)
    elif type.kind is TypeKind.BOOL:
        type = ValueType(TypeKind.NUMBER)
    return format_value(world, raw, type, unit)


def to_plain_value(world: World, raw: Any, type: ValueType, unit: str) -> PlainValue:
    """Return a value for JSON: a number in `unit`, a boolean, or the name of a state, item or agent."""
    if isinstance(raw, np.bool_ | bool):
        return bool(raw)
    if type.kind in (TypeKind.STATE, TypeKind.ITEM, TypeKind.AGENT):
        return format_author_value(world, raw, type, unit)
    return float(convert_to_unit(world, raw, unit))


def convert_to_unit(world: World, raw: Any, unit: str) -> float:
    """Return a number in `unit`, converted from base units."""
    measure = find_unit_measure(unit) if unit else None
    return (
        float(raw)
        if measure is None
        else float(raw) / (measure.factor * world.setting.unit_mm**measure.unit_power * world.dt**measure.step)
    )


def build_timer_reading(note: TimerNote, values: NodeValues) -> TimerReading:
    """Return the elapsed and the required time of a timer."""
    unit = "steps" if note.timer_kind == "held" else "s"
    return TimerReading(
        note.timer_kind, float(values[note.elapsed]), float(values[note.required]), unit, bool(values[note.is_over])
    )
