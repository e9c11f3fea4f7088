"""A step of a crowd over triangles: a loop over all agents, then one over the agents that may meet another surface or a
border."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh import walk as loop
from antdsl.ground.mesh import walkers
from antdsl.ground.mesh.boxes import FaceBoxes
from antdsl.ground.mesh.face_table import OPEN_BORDER_LINK, mark_open, pack_rows, pack_table
from antdsl.ground.mesh.open_borders import find_open_borders
from antdsl.ground.mesh.surface_clearance import FaceParts, PieceClearances
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_PER_BODY, GroundScale
from antdsl.ground.mesh.topology import NO_LINK, MeshTopology
from antdsl.numerics import parallel

Floats = NDArray[np.float64]
_WAITING_PER_THREAD = 16  # number of waiting agents from which another thread is worthwhile


@dataclass(frozen=True, slots=True)
class WaitingAgents:
    """Agents that wait after the first loop: their floats and integers, one column each, and the number of agents left out."""

    reals: Floats
    wholes: NDArray[np.int64]
    left: int

    @staticmethod
    def of(parts: list[tuple[int, int, int]], reals: Floats, wholes: NDArray[np.int64]) -> WaitingAgents:
        """Merge the results of kernels that ran the loop in parts."""
        own = parallel.join_parts(parts, reals, wholes)
        return WaitingAgents(own[0], own[1], sum([left for _, _, left in parts]))


class WalkTables:
    """Input of the loops: the `table` of faces, the mesh int32[m] of each face, the first face of each mesh, and the packed
    table."""

    def __init__(self, table: MeshTopology, mesh: NDArray[np.int32], first: NDArray[np.int64]) -> None:
        self.table, self.first, self._mesh = table, first, mesh
        self.packed = pack_table(table, mesh)
        self._crowd: CrowdWalk | None = None  # the walk of the last step
        self._still = True  # no face has changed its shape
        self._open, self._widest = np.empty(0, np.int64), -np.inf  # marked half-edges, and the body size (mm) they are valid for

    def changed(self, faces: slice) -> None:
        """Update faces with a new shape. Open borders change with each new shape, so the walk no longer uses them."""
        if self._still:
            self._still = False
            mark_open(self.packed, self._open, NO_LINK)
        pack_rows(self.packed, self.table, self._mesh, faces)

    def over(self, parts: FaceParts, boxes: FaceBoxes, scale: GroundScale) -> CrowdWalk:
        """Return the walk with `parts`, the distances to other surfaces."""
        return CrowdWalk(self, parts, boxes, scale)

    def crowd_walk_for(
        self, clearances: PieceClearances, boxes: FaceBoxes, scale: GroundScale, longest: float, widest: float
    ) -> CrowdWalk:
        """Return the walk for displacements up to `longest` and bodies up to `widest` (mm), with the distances to surrounding
        surfaces."""
        if self._still and widest > self._widest:
            # For larger bodies than needed: otherwise a growing crowd would repeat the search often.
            self._widest = 1.5 * widest
            mark_open(self.packed, self._open, NO_LINK)
            self._open = find_open_borders(self.table, boxes, scale, self._widest)
            mark_open(self.packed, self._open, OPEN_BORDER_LINK)
        parts, known = clearances.parts_within(longest + EYE_HEIGHT_PER_BODY * widest + 3 * scale.noise), self._crowd
        if known is None or known.parts is not parts or known.boxes is not boxes or known.scale is not scale:
            known = self._crowd = self.over(parts, boxes, scale)
        return known


@dataclass(frozen=True, slots=True)
class CrowdWalk:
    """A `walk` with `parts` (distances to other surfaces), `boxes` (their locations) and a `scale` (tolerances)."""

    walk: WalkTables
    parts: FaceParts
    boxes: FaceBoxes
    scale: GroundScale

    def tables(self) -> tuple[walkers.SurfaceTables, walkers.ClearanceTables]:
        """Return the tables that kernels read: the faces, and the distances to other surfaces."""
        walk, parts = self.walk, self.parts
        surface = walkers.SurfaceTables(walk.packed, walk.table.link, walk.table.forked, walk.first)
        return surface, walkers.ClearanceTables(parts.first, parts.count, parts.least, parts.reach, self.scale.noise)

    def step(
        self,
        body: Floats,
        at: tuple[Any, ...],
        vectors: tuple[Floats, Floats, Floats],
        to: tuple[Any, ...],
        threads: int,
        straight: bool,
    ) -> None:
        """Move agents with wish, heading and up (3, n) from footings `at` to the result arrays `to`. With `straight`, paths end
        at open borders."""
        n = body.size
        how = np.empty(n, np.uint8)
        placed, moved, blocked = walkers.FootingArrays._make(to[:5]), walkers.PoseArrays._make(to[5:10]), to[10]
        reals, wholes = np.empty((loop.FLOAT_ROW_COUNT, n)), np.empty((loop.INTEGER_ROW_COUNT, n), np.int64)
        work = partial(loop.walk_all, *self.tables(), at, body, vectors, reals, wholes, how, placed, moved)
        waiting = WaitingAgents.of(parallel.in_parts(work, n, threads), reals, wholes)
        self.continue_waiting(waiting, how, placed, moved, blocked, threads, straight)

    def continue_waiting(
        self,
        waiting: WaitingAgents,
        how: NDArray[np.uint8],
        placed: walkers.FootingArrays,
        moved: walkers.PoseArrays,
        blocked: NDArray[np.bool_],
        threads: int,
        straight: bool = False,
    ) -> NDArray[np.int64]:
        """Move waiting agents to footings `placed` and poses `moved`, and mark those that are `blocked`; return their rows."""
        reals, wholes = waiting.reals, waiting.wholes
        rows: NDArray[np.int64] = wholes[loop.AGENT_ROW]
        if not rows.size:
            return rows
        table, boxes, scale = self.walk.table, self.boxes, self.scale
        sides, cuts = walkers.SideGroups(table.piece, table.way), walkers.CutTables(table.cuts.first, table.cuts.other)
        count = wholes.shape[1]
        parts = parallel.parts(count, threads, _WAITING_PER_THREAD)
        buffer = np.empty(parts * boxes.order.size, np.int64)
        known = walkers.PieceTables(sides, cuts, boxes.tree(), scale.lengths(), buffer, parts, count)
        further = partial(loop.continue_walks, *self.tables(), known, straight, reals, wholes, how, placed, moved, blocked)
        parallel.in_parts(further, count, threads, _WAITING_PER_THREAD)
        return rows
