"""Values that override those of a scene: params that the user sets for a run, and settings in specs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from antdsl.diagnostics import Report
from antdsl.program.expectations import SpecChange
from antdsl.program.model import Program
from antdsl.program.types.folding import find_constant
from antdsl.scene.checks.entry_checks import convert_constant
from antdsl.scene.checks.scene_checks import check_param
from antdsl.scene.field_settings import replace_field_setting
from antdsl.scene.load import Scene
from antdsl.scene.quantities import Quantity, QuantityError, parse_quantity

if TYPE_CHECKING:
    from antdsl.scene.setting import WorldSetting  # imported late, because it imports NumPy and a check does not need it


def read_overrides(scene: Scene, program: Program, params: Mapping[str, str], report: Report) -> Mapping[str, Quantity]:
    """Return the values of `--set NAME=TEXT` by name. Each value is checked against the scene and the program."""
    quantities = {}
    for name, text in params.items():
        try:
            quantities[name] = parse_quantity(text)
        except QuantityError as error:
            usual = "write a number and a unit: `--set NAME=50mm`"
            report.error("wrong-value", f"`--set {name}={text}`: `{text}` {error}", None, error.help or usual)
            continue
        check_param(scene, program, report, name, quantities[name])
    return quantities


def apply_field_changes(program: Program, changes: Iterable[SpecChange]) -> Program:
    """Return the program after a spec has changed some settings of its fields."""
    fields = dict(program.fields)
    for change in changes:
        name, _, word = change.name.partition(".")
        if name in fields and change.name not in program.params:
            fields[name] = replace_field_setting(fields[name], word, change.value)
    return replace(program, fields=fields)


def apply_param_changes(setting: WorldSetting, scene: Scene, program: Program, changes: Iterable[SpecChange]) -> WorldSetting:
    """Return the setting with the params that a spec changes."""
    known = {change.name: find_constant(change.value) for change in changes if change.name in program.params}
    changed = {name: convert_constant(value, scene) for name, value in known.items() if value is not None}
    return replace(setting, params={**setting.params, **changed}) if changed else setting
