"""The compiled walk: a loop over all agents, and one over those of whom it has found that they may come to something else."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh import walk_compiled as loop
from antdsl.ground.mesh.boxes import Boxes
from antdsl.ground.mesh.face_table import pack, packed
from antdsl.ground.mesh.surface_clearance import Parts
from antdsl.ground.mesh.surroundings import Scale
from antdsl.ground.mesh.topology import Topology
from antdsl.numerics import compiled

Floats = NDArray[np.float64]
_WAITING = 64  # agents who look out for other surfaces, for whom a thread pays


class Walk:
    """Steps of a crowd by the compiled loop: `table` with the mesh int32[m] of each face and the first face of each mesh, which
    are `packed` for it."""

    def __init__(self, table: Topology, mesh: NDArray[np.int32], first: NDArray[np.int64]) -> None:
        self._table, self._mesh, self._first = table, mesh, first
        self.packed = packed(table, mesh)

    def changed(self, faces: slice) -> None:
        """Some faces have another shape in the table."""
        pack(self.packed, self._table, self._mesh, faces)

    def step(
        self,
        parts: Parts,
        boxes: Boxes,
        scale: Scale,
        body: Floats,
        at: tuple[Any, ...],
        vectors: tuple[Floats, Floats, Floats],
        to: tuple[Any, ...],
        threads: int,
        straight: bool,
    ) -> NDArray[np.bool_]:
        """Move agents with wish, heading and up (3, n) from footings `at` to the arrays of a result, `to`; says who was moved.
        Others are nowhere, or their numbers are not finite. `straight`: ways end at open borders."""
        n = body.size
        done = np.empty(n, np.bool_)
        table = (self.packed, self._table.link, self._table.forked, self._first)
        near = (parts.first, parts.count, parts.least, parts.reach, scale.noise)
        placed, moved, blocked = to[:5], to[5:10], to[10]

        def part(begin: int, end: int) -> tuple[Floats, NDArray[np.int64]]:
            reals, wholes = np.empty((loop.REALS, end - begin)), np.empty((loop.WHOLES, end - begin), np.int64)
            waiting = loop.walk_all(table, near, *at, body, vectors, reals, wholes, done, placed, moved, begin, end)
            return reals[:, :waiting], wholes[:, :waiting]

        parted = compiled.in_parts(part, n, threads)
        if not any(some.size for _, some in parted):
            return done
        reals, wholes = (np.concatenate(half, axis=1) for half in zip(*parted, strict=True))
        topology = self._table
        sides, tree = (topology.piece, topology.way), (boxes.order, boxes.first, boxes.bounds)
        cuts = (topology.cuts.first, topology.cuts.other)
        known = (sides, cuts, tree, (scale.least, scale.fine, scale.under), scale.touch)

        def further(begin: int, end: int) -> None:
            found = np.empty(boxes.order.size, np.int64)
            loop.walk_on(table, near, *known, straight, found, body, reals, wholes, done, placed, moved, blocked, begin, end)

        compiled.in_parts(further, wholes.shape[1], threads, _WAITING)
        return done
