"""Numbers and words that a USD file gives its points and empties, as values of attributes in base units."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.diagnostics.suggestion import nearest_name
from antdsl.program.model import Dim
from antdsl.program.tables.units import dimension_words, with_unit
from antdsl.scene.quantities import BadQuantity, parse_quantity
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.geometry.usd import UsdPoints
    from antdsl.scene.staging.stage_scene import Staging


@dataclass(frozen=True, slots=True, eq=False)
class UsdFile:
    """What was found in a file, with the file's name and the place of the scene that names it."""

    staging: Staging
    name: str
    span: Span | None
    found: UsdPoints


def in_base_units(file: UsdFile, key: str, dim: Dim) -> NDArray[np.float64]:
    """What the file says of an attribute (n,), nan where it says nothing: numbers are in the file's unit of length, degrees and
    seconds, words are numbers with a unit as in a scene."""
    found, report = file.found, file.staging.report
    factor = float(found.unit**dim.length * np.radians(1.0) ** dim.angle)
    column: NDArray[np.float64] = found.values.get(key, np.full(len(found.names), np.nan)) * factor
    model = file.staging.scene.model
    for number, text in enumerate(found.texts.get(key, ())):
        if not text:
            continue
        where = f"`{key}` of `{found.names[number]}` in `{file.name}`"
        try:
            quantity = parse_quantity(text)
        except BadQuantity as why:
            help = why.help or f"write a number, or one with a unit: `{with_unit(1, dim)}`"
            report.error("bad-usd", f"{where} says `{text}`, which {why}", file.span, help)
            return column
        if quantity.dim != dim:
            words = f"{where} says `{text}`, and `{key}` is {dimension_words(dim)}"
            report.error("wrong-unit", words, file.span, f"write it like `{with_unit(1, dim)}`")
            return column
        column[number] = quantity.base(model.unit_mm, float(1 / model.fps))
    return column


def tell_near_misses(file: UsdFile, of: str, known: Collection[str]) -> None:
    """Warn of properties of the file that no attribute takes, where one is named nearly so. Others mean other programs."""
    for key in sorted({*file.found.values, *file.found.texts} - {*known, "kind", "name"}):
        near = nearest_name(key, known)
        if near:
            words = f"`{key}` of `{file.name}` is read by no attribute of `{of}`"
            file.staging.report.warning("usd-left-out", words, file.span, f"did you mean `{near}`?")
