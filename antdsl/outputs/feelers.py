"""The feelers in a species' program, for pictures: their number, spread and length."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.manifest import FeelersEntry
from antdsl.program.model import AttributeRef, BindingRef, Constant, Expr, OperationExpr, ParamRef, Program, SetExpr, Species
from antdsl.program.traverse import iterate_parts

_OPERATOR_FUNCTIONS: dict[str, Callable[..., float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "min": min,
    "max": max,
}


def list_feelers(
    program: Program, species: str, params: Mapping[str, Any], unit_mm: float, dt: float
) -> tuple[FeelersEntry, ...]:
    """Return the feelers in all layers and states of a species. Feelers with numbers that change during a run are omitted."""
    entries = []
    for part in _find_feelers(program.species[species]):
        count, spread, reach = (_evaluate_number(a, 0.0, params, unit_mm, dt) for a in part.args)
        longer = _evaluate_number(part.args[2], 1.0, params, unit_mm, dt)
        if count is not None and spread is not None and reach is not None and longer is not None:
            entries.append(FeelersEntry(count=int(count), spread=spread, reach=reach / unit_mm, per_length=longer - reach))
    return tuple(dict.fromkeys(entries))


@lru_cache(maxsize=16)  # read for each frame while an agent is followed
def _find_feelers(species: Species) -> tuple[SetExpr, ...]:
    """Return the feeler expressions of a species."""
    return tuple(part for part in iterate_parts(species) if isinstance(part, SetExpr) and part.source == "feelers")


def _evaluate_number(expression: Expr | None, size: float, params: Mapping[str, Any], unit_mm: float, dt: float) -> float | None:
    """Return the value of an expression in base units, for an agent of `size` mm.

    None if it depends on anything but the size and `params`."""
    if isinstance(expression, Constant):
        return float(expression.number * unit_mm**expression.unit_power * dt**expression.step)
    if isinstance(expression, ParamRef):
        return float(params[expression.name])
    if isinstance(expression, AttributeRef) and expression.owner is None and expression.name == "size":
        return size
    if isinstance(expression, BindingRef) and expression.binding.role in ("argument", "let"):
        return _evaluate_number(expression.binding.value, size, params, unit_mm, dt)
    if isinstance(expression, OperationExpr) and expression.name in _OPERATOR_FUNCTIONS:
        values = [_evaluate_number(a, size, params, unit_mm, dt) for a in expression.args]
        numbers = [v for v in values if v is not None]
        if len(numbers) == len(values) and not (expression.name == "div" and numbers[1] == 0):
            return float(_OPERATOR_FUNCTIONS[expression.name](*numbers))
    return None


def compute_feeler_rays(entry: FeelersEntry, position: NDArray[np.float64], ahead: NDArray[np.float64], up: NDArray[np.float64],
         scale: NDArray[np.float64]) -> NDArray[np.float64]:  # fmt: skip
    """Return the start point and the end point of each feeler of n agents, (n · count, 2, 3).

    `position` (n, 3): positions of the agents. `ahead`, `up` (n, 3): unit vectors. `scale` (n,): body lengths."""
    angles = np.linspace(-entry.spread, entry.spread, entry.count) if entry.count > 1 else np.zeros(1)
    side = np.cross(up, ahead)
    reach = (entry.reach + entry.per_length * scale)[:, None]
    parts = [np.stack([position, position + reach * (np.cos(a) * ahead + np.sin(a) * side)], axis=1) for a in angles]
    return np.concatenate(parts)
