"""Settings of fields that are changed by the scene or by the user on the command line (`set: {trail.half_life: 4 s}`).

This module also checks that fields work at the scene's frame rate: the cells must be large enough for the diffusion per step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from antdsl.diagnostics import Report
from antdsl.program.model import ChangeRate, Constant, Dimension, EffectRequest, Expr, Field, Program, TypeKind, ValueType
from antdsl.program.tables.effects import list_feeding_effects
from antdsl.program.traverse import iterate_parts
from antdsl.program.types.folding import find_constant
from antdsl.scene.load import Scene
from antdsl.scene.quantities import Quantity

DECAY_SETTING_NAMES = ("half_life", "evaporate", "keeps")  # a field has exactly one of these
_SETTING_DIMENSIONS = {
    "half_life": Dimension(time=1),
    "evaporate": Dimension(time=-1),
    "keeps": Dimension(time=-1),
    "diffuse": Dimension(length=2, time=-1),
    "limit": Dimension(),
}


def find_setting_dimension(program: Program, name: str) -> Dimension | None:
    """Return the dimension of a field setting such as `trail.half_life`, or None if there is no setting of this name."""
    field, _, word = name.partition(".")
    return _SETTING_DIMENSIONS.get(word) if field in program.fields and name not in program.params else None


def list_settable_names(program: Program) -> list[str]:
    """Return the names of all field settings that a scene or a user can change."""
    return [f"{field}.{word}" for field in program.fields for word in _SETTING_DIMENSIONS]


def format_suggested_setting(name: str, value: Quantity) -> str:
    """Return help text with a value to write instead of an invalid value of a setting. It is empty if the value is valid."""
    word = name.partition(".")[2]
    if word == "keeps" and (value.step != -1 or not 0 <= value.number <= 1):
        return "write a share from `0 %/step` to `100 %/step`"
    above = word in ("half_life", "limit")
    if value.number < 0 or (above and value.number == 0):
        return f"write {'more than' if above else 'at least'} 0"
    return ""


def replace_field_settings(program: Program, scene: Scene, values: Mapping[str, Quantity]) -> Program:
    """Return the program with these values for field settings. Unknown names are ignored."""
    fields = dict(program.fields)
    for name, value in values.items():
        dim = find_setting_dimension(program, name)
        if dim is None:
            continue
        field, _, word = name.partition(".")
        place = scene.find_span("set", name) if name in scene.model.set else fields[field].span
        const = Constant(
            ValueType(TypeKind.NUMBER, dim),
            ChangeRate.CONST,
            place,
            value.number,
            unit_power=value.length_exponent,
            step=value.step,
        )
        fields[field] = replace_field_setting(fields[field], word, const)
    return replace(program, fields=fields)


def replace_field_setting(field: Field, setting_name: str, value: Expr) -> Field:
    """Return a field with a new value for one of its settings. If the setting is about fading, it replaces all settings about
    fading."""
    values: dict[str, Any] = dict.fromkeys(DECAY_SETTING_NAMES) if setting_name in DECAY_SETTING_NAMES else {}
    return replace(field, **{**values, setting_name: value})


def compute_max_diffusion(cell: float, dt: float) -> float:
    """Return the largest diffusion (mm²/s) that is stable for cells of `cell` mm and steps of `dt` s.

    Above it, the values of cells oscillate or become negative."""
    return cell * cell / (4.0 * dt)


def check_field_dynamics(scene: Scene, program: Program, report: Report) -> None:
    """Report fields that diffuse too fast for the size of their cells, and warn about fields that are never filled."""
    dt = float(1 / scene.model.fps)
    for field in replace_field_settings(program, scene, scene.model.set).fields.values():
        cell, diffuse = _convert_constant(scene, field.cell), _convert_constant(scene, field.diffuse)
        most = compute_max_diffusion(cell, dt) if cell else 0.0
        if cell and diffuse and diffuse > most * (1 + 1e-6):
            report.error(
                "unstable-field",
                f"field `{field.name}` spreads faster than its cells of {cell:g} mm can follow at {1 / dt:g} frames a second",
                field.diffuse.span if field.diffuse is not None else field.span,
                f"write `diffuse` {most:g} mm^2/s or less, or a larger `cell`",
            )  # fmt: skip
    laying = list_feeding_effects("field")
    laid = {
        part.target
        for part in iterate_parts(tuple(program.species.values()))
        if isinstance(part, EffectRequest) and part.op in laying
    }
    for name, field in program.fields.items():
        if name in laid or name in scene.model.fields:
            continue
        if field.has_vectors:
            report.warning(
                "unlaid-field", f"no agent lays the field `{name}`", field.span,
                f"write `deposit {name} heading * 1 /s` in a state",
            )  # fmt: skip
        else:
            report.warning(
                "unlaid-field", f"no agent lays the field `{name}`, and the scene does not start it", field.span,
                f"write `deposit {name} 1 /s` in a state, or in the scene `fields: {{{name}: {{start: 1}}}}`",
            )  # fmt: skip


def _convert_constant(scene: Scene, value: Expr | None) -> float | None:
    """Return a constant setting in base units. Return None if the setting is absent or depends on params."""
    constant = find_constant(value) if value is not None else None
    if constant is None:
        return None
    return float(constant.number * scene.model.unit_mm**constant.unit_power * float(1 / scene.model.fps) ** constant.step)
