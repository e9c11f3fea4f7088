"""Footings on meshes and solids in one table."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.surface import Footing

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Standing:
    """Where agents stand: on a face of a mesh, or `over` its border, as `Footing` says, or on a solid: `mesh` counts solids after
    the meshes, `face` is 0 and (x, y, z) is the place on its surface (mm; 0 on meshes)."""

    mesh: NDArray[np.int32]
    face: NDArray[np.int32]
    b1: Floats
    b2: Floats
    over: Floats
    x: Floats
    y: Floats
    z: Floats

    def __len__(self) -> int:
        return len(self.face)

    def take(self, rows: Rows) -> Standing:
        """Copies of the footings of some rows."""
        return Standing(*(getattr(self, f.name)[rows] for f in fields(Standing)))

    def copy(self) -> Standing:
        """Arrays of its own."""
        return Standing(*(getattr(self, f.name).copy() for f in fields(Standing)))

    def put(self, rows: Rows, other: Standing) -> None:
        """Put other footings into rows."""
        for f in fields(Standing):
            getattr(self, f.name)[rows] = getattr(other, f.name)

    def footing(self, rows: Rows) -> Footing:
        """Of rows that stand on meshes."""
        return Footing(self.mesh[rows], self.face[rows], self.b1[rows], self.b2[rows], self.over[rows])

    @staticmethod
    def on_mesh(footing: Footing) -> Standing:
        """On faces of meshes, or nowhere."""
        n = len(footing)
        mesh, face, b1, b2, over = (getattr(footing, f.name).copy() for f in fields(Footing))
        return Standing(mesh, face, b1, b2, over, *np.zeros((3, n)))

    @staticmethod
    def on_solid(mesh: int | NDArray[np.int32], place: Floats) -> Standing:
        """At places [n,3] on the surface of the solid that counts as `mesh`, one or [n]."""
        n = len(place)
        x, y, z = np.ascontiguousarray(place.T)
        return Standing(np.full(n, mesh, np.int32), np.zeros(n, np.int32), *np.zeros((3, n)), x, y, z)
