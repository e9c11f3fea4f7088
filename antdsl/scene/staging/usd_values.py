"""Converts the numbers and words of a USD file's points and empties to attribute values in base units."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.model import Dimension
from antdsl.program.tables.units import describe_dimension, format_with_unit
from antdsl.scene.quantities import QuantityError, parse_quantity
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.geometry.usd import UsdPoints
    from antdsl.scene.staging.stage_scene import SceneStaging


_OPTIONAL_ATTRIBUTES = ("max_turn", "min_speed")  # agents have these values only if their species defines them


@dataclass(frozen=True, slots=True, eq=False)
class UsdFile:
    """Values that a USD file has for each of its points. `name`: the name of the file. `span`: the location at which the scene
    names the file."""

    staging: SceneStaging
    name: str
    span: Span | None
    points: UsdPoints


def read_in_base_units(file: UsdFile, key: str, dim: Dimension) -> NDArray[np.float64]:
    """Return the file's values (n,) of an attribute in base units, with nan for points without a value.

    In the file, lengths are in its unit of length, angles in degrees and times in seconds. Words are parsed as quantities, as in
    a scene."""
    points, report = file.points, file.staging.report
    factor = float(points.unit**dim.length * np.radians(1.0) ** dim.angle)
    column: NDArray[np.float64] = points.values.get(key, np.full(len(points.names), np.nan)) * factor
    model = file.staging.scene.model
    for number, text in enumerate(points.texts.get(key, ())):
        if not text:
            continue
        where = f"`{key}` of `{points.names[number]}` in `{file.name}`"
        try:
            quantity = parse_quantity(text)
        except QuantityError as error:
            help = error.help or f"write a number, or one with a unit: `{format_with_unit(1, dim)}`"
            report.error("bad-usd", f"{where} has `{text}`, which {error}", file.span, help)
            return column
        if quantity.dim != dim:
            words = f"{where} has `{text}`, but `{key}` is {describe_dimension(dim)}"
            report.error("wrong-unit", words, file.span, f"write it as `{format_with_unit(1, dim)}`")
            return column
        column[number] = quantity.to_base_units(model.unit_mm, float(1 / model.fps))
    if (np.abs(column) > limits.MAX_NUMBER).any():
        most = points.names[int(np.nanargmax(np.abs(column)))]
        report.error(
            "bad-usd", f"`{key}` of `{most}` in `{file.name}` is too large to be stored", file.span, "write a smaller number"
        )
        return np.full(len(points.names), np.nan)
    return column


def warn_misspelled_names(file: UsdFile, owner: str, known_names: Collection[str]) -> None:
    """Warn about properties in the file that are not attributes but have a name similar to one.

    Other properties are ignored, because they belong to other programs."""
    keys = sorted({*file.points.values, *file.points.texts} - {*known_names, "kind", "name"})
    near = {
        key: "" if key in _OPTIONAL_ATTRIBUTES else find_nearest_name(key, known_names)
        for key in keys
        if key in _OPTIONAL_ATTRIBUTES or find_nearest_name(key, known_names)
    }
    if near:
        words = f"in `{file.name}`, no attribute of `{owner}` reads {', '.join(f'`{key}`' for key in near)}"
        help = ", ".join(
            f"`{key}`: did you mean `{meant}`?" if meant else f"`{key}`: declare it in the species first"
            for key, meant in near.items()
        )
        file.staging.report.warning("usd-left-out", words, file.span, help)
