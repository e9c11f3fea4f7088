"""The values of fields that pictures show: the amount in each cell or, for vector fields, the length of the vector."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.manifest import Manifest


class FieldStrengths(NamedTuple):
    """The values of a field in one frame. `positions` float64 (n, 3): cells in scene units. `strengths` float64 (n,). `cell`: the
    edge length of a cell."""

    name: str
    positions: NDArray[np.float64]
    strengths: NDArray[np.float64]
    cell: float


def list_program_fields(manifest: Manifest) -> dict[str, tuple[str, ...]]:
    """Return the names of the arrays of each field, by field name: one array, or the components `NAME.x`, `NAME.y`, `NAME.z`."""
    parts: dict[str, tuple[str, ...]] = {}
    for entry in manifest.fields:
        name = entry.name.partition(".")[0]
        parts[name] = (*parts.get(name, ()), entry.name)
    return parts


class FieldReader:
    """Reader of the fields in the frames of a cache. `static`: the arrays that all frames share."""

    def __init__(self, manifest: Manifest, static: Arrays) -> None:
        self._static, self._parts = static, list_program_fields(manifest)
        self._cells = {entry.name: entry.cell for entry in manifest.fields}
        self._start_positions: dict[str, NDArray[np.float64]] = {}

    def read_frame(self, arrays: Arrays) -> Iterator[tuple[int, FieldStrengths]]:
        """Yield the non-empty fields of a frame, each with its index in the list of fields."""
        for number, (name, parts) in enumerate(self._parts.items()):
            present = [part for part in parts if len(arrays.get(f"field.{part}.cells", ())) and f"field.{part}.values" in arrays]
            if not present:
                continue
            positions = self._find_positions(present[0], arrays)
            strengths = np.zeros(len(positions))
            for part in present:
                cells, values = arrays[f"field.{part}.cells"], np.asarray(arrays[f"field.{part}.values"], np.float64)
                strengths[cells] += values if len(parts) == 1 else values * values
            if len(parts) > 1:
                strengths = np.sqrt(strengths)
            yield number, FieldStrengths(name, positions, strengths, self._cells[present[0]])

    def _find_positions(self, part: str, arrays: Arrays) -> NDArray[np.float64]:
        if part not in self._start_positions:
            self._start_positions[part] = np.asarray(self._static[f"field.{part}.P"], np.float64)
        added = arrays.get(f"field.{part}.added")
        start = self._start_positions[part]
        return start if added is None else np.concatenate([start, np.asarray(added, np.float64)])
