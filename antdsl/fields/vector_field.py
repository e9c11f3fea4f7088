"""Vector fields, which consist of three scalar fields on the same cells, one per component."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.cells import SurfaceCells
from antdsl.fields.pheromone import PheromoneField

if TYPE_CHECKING:
    from antdsl.runtime.world import World


@dataclass(frozen=True, slots=True, eq=False)
class VectorField:
    """A vector field with components x, y and z, which share their cells. `limit`: the largest length of a vector."""

    components: tuple[PheromoneField, PheromoneField, PheromoneField]
    limit: float = np.inf

    @property
    def cells(self) -> SurfaceCells:
        """Return the cells that all three components share."""
        return self.components[0].cells

    @property
    def vectors(self) -> NDArray[np.float64]:
        """Return the vector in each cell, float64[cells, 3], as a new array."""
        return np.stack([each.amounts for each in self.components], axis=1)

    @property
    def amounts(self) -> NDArray[np.float64]:
        """Return the length of each cell's vector, float64[cells], as a new array."""
        x, y, z = (each.amounts for each in self.components)
        return np.sqrt((x * x + y * y) + z * z)

    def limit_lengths(self) -> None:
        """Shorten vectors that are longer than `limit` to this length."""
        if not np.isfinite(self.limit):
            return
        lengths = self.amounts
        long_vectors = np.flatnonzero(lengths > self.limit)
        if long_vectors.size:
            factors = self.limit / lengths[long_vectors]
            for each in self.components:
                each.amounts[long_vectors] *= factors


def list_program_fields(world: World) -> dict[str, PheromoneField | VectorField]:
    """Return the world's fields by their names in the program. A vector field is listed once, instead of its three components."""
    components = {id(each) for vectors in world.vector_fields.values() for each in vectors.components}
    return {name: field for name, field in world.fields.items() if id(field) not in components} | world.vector_fields
