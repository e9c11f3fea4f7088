"""Moves a crowd over triangles in two loops: the first over all agents, the second over agents that may reach another surface or
a border."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh import walk as loop
from antdsl.ground.mesh import walkers
from antdsl.ground.mesh.boxes import FaceBoxes
from antdsl.ground.mesh.face_table import OPEN_BORDER_LINK, mark_border_links, pack_face_rows, pack_face_table
from antdsl.ground.mesh.open_borders import find_open_borders
from antdsl.ground.mesh.surface_clearance import FacePartClearances, PieceClearances
from antdsl.ground.mesh.surroundings import EYE_HEIGHT_BODY_LENGTHS, GroundTolerances
from antdsl.ground.mesh.topology import NO_LINKED_EDGE, MeshTopology
from antdsl.numerics import parallel

Floats = NDArray[np.float64]
_WAITING_AGENTS_PER_THREAD = 16  # fewer waiting agents are not worth another thread


@dataclass(frozen=True, slots=True)
class PendingWalkArrays:
    """The agents that wait after the first loop. `float_rows`, `integer_rows`: their states, one column per agent.

    `left_out_count`: the number of agents that the loop has left out (LEFT_OUT_STATUS)."""

    float_rows: Floats
    integer_rows: NDArray[np.int64]
    left_out_count: int

    @staticmethod
    def merge_parts(parts: list[tuple[int, int, int]], float_rows: Floats, integer_rows: NDArray[np.int64]) -> PendingWalkArrays:
        """Merge the results of a loop that kernels ran in several parts."""
        own = parallel.join_parts(parts, float_rows, integer_rows)
        return PendingWalkArrays(own[0], own[1], sum([left for _, _, left in parts]))


class WalkTables:
    """The tables for walks over meshes. `table`: the topology. `first`: the first face of each mesh. `packed_table`: the table
    that kernels read."""

    def __init__(self, table: MeshTopology, mesh: NDArray[np.int32], first: NDArray[np.int64]) -> None:
        self.table, self.first, self._mesh = table, first, mesh
        self.packed_table = pack_face_table(table, mesh)
        self._last_crowd_walk: CrowdWalk | None = None  # the walk of the last step
        self._is_unchanged = True  # no face has changed its shape
        self._open_half_edges, self._max_body_size = (
            np.empty(0, np.int64),
            -np.inf,
        )  # marked half-edges, and the body size (mm) they are valid for

    def update_faces(self, faces: slice) -> None:
        """Update the tables for faces that have changed shape. The cached walk is discarded, because open borders depend on the
        shape."""
        if self._is_unchanged:
            self._is_unchanged = False
            mark_border_links(self.packed_table, self._open_half_edges, NO_LINKED_EDGE)
        pack_face_rows(self.packed_table, self.table, self._mesh, faces)

    def combine_with_clearances(self, parts: FacePartClearances, boxes: FaceBoxes, scale: GroundTolerances) -> CrowdWalk:
        """Return a walk over these tables, with the clearances `parts`, the box tree `boxes` and the tolerances `scale`."""
        return CrowdWalk(self, parts, boxes, scale)

    def build_crowd_walk(
        self,
        clearances: PieceClearances,
        boxes: FaceBoxes,
        scale: GroundTolerances,
        max_displacement: float,
        max_body_size: float,
    ) -> CrowdWalk:
        """Return a walk for displacements of at most `max_displacement` and bodies of at most `max_body_size` (mm). The walk
        includes the clearances between the pieces of the ground."""
        if self._is_unchanged and max_body_size > self._max_body_size:
            # For larger bodies than needed: otherwise a growing crowd would cause frequent searches.
            self._max_body_size = 1.5 * max_body_size
            mark_border_links(self.packed_table, self._open_half_edges, NO_LINKED_EDGE)
            self._open_half_edges = find_open_borders(self.table, boxes, scale, self._max_body_size)
            mark_border_links(self.packed_table, self._open_half_edges, OPEN_BORDER_LINK)
        parts, known = (
            clearances.get_face_parts(max_displacement + EYE_HEIGHT_BODY_LENGTHS * max_body_size + 3 * scale.distance_noise),
            self._last_crowd_walk,
        )
        if known is None or known.part_clearances is not parts or known.boxes is not boxes or known.tolerances is not scale:
            known = self._last_crowd_walk = self.combine_with_clearances(parts, boxes, scale)
        return known


@dataclass(frozen=True, slots=True)
class CrowdWalk:
    """Everything that a crowd needs for steps over meshes. `walk_tables`: the tables of faces. `part_clearances`: the distances
    of faces from other pieces of the ground. `boxes`: the box tree of all faces. `tolerances`: lengths that depend on the size of
    the ground."""

    walk_tables: WalkTables
    part_clearances: FacePartClearances
    boxes: FaceBoxes
    tolerances: GroundTolerances

    def build_tables(self) -> tuple[walkers.SurfaceTables, walkers.ClearanceTables]:
        """Return the tables that kernels read: those of faces, and those of distances to other pieces."""
        walk, parts = self.walk_tables, self.part_clearances
        surface = walkers.SurfaceTables(walk.packed_table, walk.table.link, walk.table.has_forked_edges, walk.first)
        return surface, walkers.ClearanceTables(
            parts.first_parts, parts.parts_per_edge, parts.clearances, parts.reach, self.tolerances.distance_noise
        )

    def walk_agents(
        self,
        body: Floats,
        start: tuple[Any, ...],
        vectors: tuple[Floats, Floats, Floats],
        results: tuple[Any, ...],
        threads: int,
        stop_at_borders: bool,
    ) -> None:
        """Make one step of all agents. `start`: the arrays of their footings. `vectors`: displacement, heading and up (3, n).

        `results`: the arrays that receive the results. With `stop_at_borders`, paths end at open borders."""
        n = body.size
        how = np.empty(n, np.uint8)
        placed, moved, blocked = walkers.FootingArrays._make(results[:5]), walkers.PoseArrays._make(results[5:10]), results[10]
        reals, wholes = np.empty((loop.FLOAT_ROW_COUNT, n)), np.empty((loop.INTEGER_ROW_COUNT, n), np.int64)
        work = partial(loop.walk_all_agents, *self.build_tables(), start, body, vectors, reals, wholes, how, placed, moved)
        waiting = PendingWalkArrays.merge_parts(parallel.run_in_parts(work, n, threads), reals, wholes)
        self.continue_waiting_agents(waiting, how, placed, moved, blocked, threads, stop_at_borders)

    def continue_waiting_agents(
        self,
        waiting_agents: PendingWalkArrays,
        statuses: NDArray[np.uint8],
        footings: walkers.FootingArrays,
        poses: walkers.PoseArrays,
        is_blocked: NDArray[np.bool_],
        threads: int,
        stop_at_borders: bool = False,
    ) -> NDArray[np.int64]:
        """Complete the step of the waiting agents, and return their rows.

        `footings`, `poses`: receive the results. `is_blocked`: receives whether each agent is blocked."""
        reals, wholes = waiting_agents.float_rows, waiting_agents.integer_rows
        rows: NDArray[np.int64] = wholes[loop.AGENT_ROW]
        if not rows.size:
            return rows
        table, boxes, scale = self.walk_tables.table, self.boxes, self.tolerances
        sides, cuts = (
            walkers.SideGroups(table.piece, table.side_groups),
            walkers.CutTables(table.cuts.cut_starts, table.cuts.cutting_faces),
        )
        count = wholes.shape[1]
        parts = parallel.count_parts(count, threads, _WAITING_AGENTS_PER_THREAD)
        buffer = np.empty(parts * boxes.triangle_order.size, np.int64)
        known = walkers.PieceSearchTables(sides, cuts, boxes.to_box_tree(), scale.get_length_tolerances(), buffer, parts, count)
        further = partial(
            loop.continue_walks,
            *self.build_tables(),
            known,
            stop_at_borders,
            reals,
            wholes,
            statuses,
            footings,
            poses,
            is_blocked,
        )
        parallel.run_in_parts(further, count, threads, _WAITING_AGENTS_PER_THREAD)
        return rows
