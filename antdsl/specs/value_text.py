"""Values as text, in the form that authors write: numbers with a unit, and states and items by name."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from antdsl.program.model import TypeKind, ValueType
from antdsl.program.tables.units import find_unit_measure
from antdsl.runtime.world import World

_COORDINATE_DECIMALS = 6  # digits after the point


def format_value(world: World, value: Any, type: ValueType, unit: str, is_exact: bool = False) -> str:
    """Return a value as text, such as `41.3 mm/s`, `12 %`, `move_world`, `yes` or `apple`. `is_exact`: whether to write all
    digits of a number instead of six."""
    match type.kind:
        case TypeKind.BOOL:
            return "yes" if value else "no"
        case TypeKind.STATE:
            return _find_state_name(world, int(value), type.referent or "")
        case TypeKind.ITEM:
            names = world.items[type.referent].names if type.referent in world.items else ()
            return names[int(value)] if 0 <= int(value) < len(names) else "none"
        case TypeKind.AGENT:
            return f"{type.referent} {int(value)}" if int(value) >= 0 else "none"
    return _format_number(world, value, unit, is_exact)


def describe_states_and_position(world: World, species: str, row: int) -> tuple[tuple[str, str], ...]:
    """Return names and texts for the agent's states, the time spent in each, and its position in the scene's units."""
    population = world.populations[species]
    entries = []
    for machine in population.plan.machines:
        state = machine.states[int(population.now[f"{machine.name}.state"][row])]
        seconds_in_state = float(population.now[f"{machine.name}.time_in_state"][row])
        entries.append(("state" if machine.name == "main" else machine.name, f"{state}, for {seconds_in_state:.4g} s"))
    return (*entries, ("position", format_position(population.position[row], world.origin, world.setting.unit_mm)))


def format_position(position: Iterable[float], origin: Iterable[float], unit_mm: float) -> str:
    """Return a position as text: coordinates in a unit of `unit_mm` mm. `position`: in mm, relative to `origin`. Coordinates are
    rounded to four significant digits of `position`, but at least to one decimal place."""
    return ", ".join(_format_coordinate(float(x) / unit_mm, float(o) / unit_mm) for x, o in zip(position, origin, strict=True))


def _format_coordinate(relative: float, origin: float) -> str:
    decimals = 3 - math.floor(math.log10(abs(relative))) if relative and math.isfinite(relative) else 1
    text = f"{origin + relative:.{min(max(decimals, 1), _COORDINATE_DECIMALS)}f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text


def _find_state_name(world: World, index: int, machine: str) -> str:
    species, _, name = machine.partition(".")
    plan = world.plan.species.get(species)
    states = next((m.states for m in plan.machines if m.name == name), ()) if plan is not None else ()
    return states[index] if 0 <= index < len(states) else str(index)


def _format_number(world: World, value: Any, unit: str, is_exact: bool) -> str:
    if np.isnan(value):
        return "no number"
    if np.isinf(value):
        return "endless" if value > 0 else "minus endless"
    measure = find_unit_measure(unit) if unit else None
    one = 1.0 if measure is None else measure.factor * world.setting.unit_mm**measure.unit_power * world.dt**measure.step
    number = type(value)(float(value) / one)
    text = np.format_float_positional(number, trim="-") if is_exact else f"{number:.6g}"
    return f"{text} {unit}".strip()
